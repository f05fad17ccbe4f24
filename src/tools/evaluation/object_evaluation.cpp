#include "tools/evaluation/object_evaluation.h"

#include <algorithm>
#include <set>

#include "geometry/assignment.h"
#include "io/csv.h"

namespace semantic_topo_loop::core {
namespace {

/// Confirmed objects in the reference frame and what they were matched with.
struct Candidate {
  const MappedObject* object = nullptr;
  Vec3 center = Vec3::Zero();
  double scale = 1.0;
  const ReferenceObject* reference = nullptr;
  double distance_m = 0.0;
};

/// Distance up to which an object counts as the reference.
double match_radius_m(const Vec3& semi_axes) {
  constexpr double kMinRadius = 0.15;  // m: a cup's length, so that small objects need not be placed to centimetres
  return std::max(kMinRadius, 0.5 * semi_axes.maxCoeff());
}

/// Matches what is still free with the references of one certainty.
/// @return number of matches
int match(Certainty certainty, const std::vector<ReferenceObject>& references, std::vector<Candidate>* candidates) {
  std::vector<Candidate*> rows;
  std::vector<const ReferenceObject*> columns;
  for (Candidate& candidate : *candidates) {
    if (candidate.reference == nullptr) rows.push_back(&candidate);
  }
  for (const ReferenceObject& reference : references) {
    if (reference.certainty == certainty) columns.push_back(&reference);
  }
  const auto n = static_cast<Eigen::Index>(rows.size()), m = static_cast<Eigen::Index>(columns.size());
  const auto row = [&rows](Eigen::Index i) { return rows[static_cast<std::size_t>(i)]; };
  const auto column = [&columns](Eigen::Index j) { return columns[static_cast<std::size_t>(j)]; };
  const auto distance = [&](Eigen::Index i, Eigen::Index j) { return (row(i)->center - column(j)->center).norm(); };
  // Every pair is worth 1 and all bonuses for closeness together less than 1: most pairs first, then the closest.
  const double bonus = 1.0 / static_cast<double>(std::min(n, m) + 1);
  Eigen::MatrixXd score = Eigen::MatrixXd::Zero(n, m);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < m; ++j) {
      const double radius = match_radius_m(column(j)->semi_axes);
      if (row(i)->object->class_id != column(j)->class_id || distance(i, j) > radius) continue;
      score(i, j) = 1.0 + bonus * (1.0 - distance(i, j) / radius);
    }
  }
  int matched = 0;
  const std::vector<int> assignment = assign_max(score);
  for (Eigen::Index i = 0; i < n; ++i) {
    const int j = assignment[static_cast<std::size_t>(i)];
    if (j < 0) continue;
    row(i)->reference = column(j);
    row(i)->distance_m = distance(i, j);
    ++matched;
  }
  return matched;
}

/// True if no other constructed object lies within the object's match radius.
bool is_undisputed(const Candidate& candidate, const std::vector<Candidate>& all) {
  const double radius = match_radius_m(candidate.scale * candidate.object->semi_axes);
  return std::none_of(all.begin(), all.end(), [&](const Candidate& other) {
    return &other != &candidate && (other.center - candidate.center).norm() <= radius;
  });
}

int count(const std::vector<ReferenceObject>& references, Certainty certainty) {
  return static_cast<int>(std::count_if(references.begin(), references.end(),
                                        [&](const ReferenceObject& r) { return r.certainty == certainty; }));
}

void list_matches(const std::vector<Candidate>& candidates, const std::vector<ReferenceObject>& references,
                  ObjectEvaluation* result) {
  std::vector<double> distances;
  for (const Candidate& candidate : candidates) {
    const ReferenceObject* reference = candidate.reference;
    result->matches.push_back({candidate.object->id, reference == nullptr ? -1 : reference->id, candidate.distance_m});
    if (reference != nullptr && reference->certainty == Certainty::kCertain) {
      distances.push_back(candidate.distance_m);
    }
  }
  for (const ReferenceObject& reference : references) {
    const bool found = std::any_of(candidates.begin(), candidates.end(),
                                   [&](const Candidate& candidate) { return candidate.reference == &reference; });
    if (!found && reference.certainty == Certainty::kCertain) result->matches.push_back({-1, reference.id, 0.0});
  }
  result->center_m = error_statistics(std::move(distances));
}

ReferenceObject read_reference(CsvTable& table) {
  ReferenceObject object;
  table("id", object.id);
  if (object.id < 0) table.reject("id", "must be >= 0");
  table("label_id", object.class_id);
  table("label", object.label);
  table("x,y,z", object.center);
  table("a,b,c", object.semi_axes);
  const auto name = std::find(kCertaintyNames.begin(), kCertaintyNames.end(), table.text("certainty"));
  if (name == kCertaintyNames.end()) table.reject("certainty", "must be certain, probable or marginal");
  object.certainty = static_cast<Certainty>(name - kCertaintyNames.begin());
  return object;
}

}  // namespace

Result<std::vector<ReferenceObject>> read_reference_objects(const std::string& path) {
  auto references = read_csv<ReferenceObject>(path, read_reference);
  std::set<int> ids;
  for (std::size_t i = 0; references && i < references->size(); ++i) {
    const int id = (*references)[i].id;
    if (!ids.insert(id).second) return Error{path + ": id: " + std::to_string(id) + " is there twice"};
  }
  return references;
}

Status check_labels(const std::vector<MappedObject>& objects, const std::vector<ReferenceObject>& references) {
  for (const ReferenceObject& reference : references) {
    const auto same = std::find_if(objects.begin(), objects.end(),
                                   [&](const MappedObject& object) { return object.label == reference.label; });
    if (same == objects.end() || same->class_id == reference.class_id) continue;
    return Error{"label_id: " + std::to_string(reference.class_id) + " of reference " + std::to_string(reference.id) +
                 ", '" + reference.label + "', is " + std::to_string(same->class_id) +
                 " in the class table of the run"};
  }
  return {};
}

ObjectEvaluation evaluate_objects(const std::vector<MappedObject>& objects,
                                  const std::vector<ReferenceObject>& references, const Alignment& alignment) {
  std::vector<Candidate> candidates;
  for (const MappedObject& object : objects) {
    if (object.state != "confirmed") continue;
    const Vec3 center = alignment.scale * (alignment.T_a_b.q * object.center) + alignment.T_a_b.t;
    candidates.push_back({&object, center, alignment.scale});
  }
  ObjectEvaluation result;
  result.matched_certain = match(Certainty::kCertain, references, &candidates);
  result.matched_probable = match(Certainty::kProbable, references, &candidates);
  result.matched_marginal = match(Certainty::kMarginal, references, &candidates);

  const int confirmed = static_cast<int>(candidates.size());
  const int certain = count(references, Certainty::kCertain);
  const int wrong = confirmed - result.matched_certain - result.matched_probable - result.matched_marginal;
  result.certain.precision = {result.matched_certain, result.matched_certain + wrong};
  result.certain.recall = {result.matched_certain, certain};
  const int strictly_right = result.matched_certain + result.matched_probable;
  result.strict.precision = {strictly_right, confirmed};
  result.strict.recall = {strictly_right, certain + count(references, Certainty::kProbable)};
  for (const Candidate& candidate : candidates) {
    result.undisputed.right += is_undisputed(candidate, candidates) ? 1 : 0;
  }
  result.undisputed.total = confirmed;
  list_matches(candidates, references, &result);
  return result;
}

}  // namespace semantic_topo_loop::core
