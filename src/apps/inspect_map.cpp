#include <Eigen/LU>
#include <algorithm>
#include <boost/algorithm/string/predicate.hpp>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <limits>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "apps/program.h"
#include "io/csv.h"
#include "pipeline/map_changes.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/point_cloud_file.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/map/point_map.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/g2o/g2o.h"

namespace {

using boost::algorithm::ends_with;
using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct Arguments {
  std::string map, classes, objects, trajectory, graph, points, refused, merges, live;
  bool dump = false;
};

void print_counts(const MapState& map, const ClassTable& classes) {
  std::printf("integrity   ok");
  if (map.left_out > 0)
    std::printf(", %zu boxes, submaps, points, merges and loops newer than the graph left out", map.left_out);
  std::printf("\nsessions    %zu\n", map.graph.sessions.size());
  for (const Session& session : map.graph.sessions) {
    std::printf("            from keyframe %lld, stamps %s to %s\n", static_cast<long long>(session.first_keyframe_id),
                format_stamp(session.begin_ns).c_str(), format_stamp(session.end_ns).c_str());
  }
  std::size_t sparse = 0, semi_dense = 0;
  for (const PointsOfKeyframe& keyframe : map.points) {
    sparse += keyframe.points->sparse.size();
    semi_dense += keyframe.points->semi_dense.size();
  }
  std::size_t kept = 0;
  for (const RememberedLoop& loop : map.graph.loops) kept += loop.told.kept ? 1 : 0;
  std::map<std::string, int> states, labels;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    ++states[to_string(landmark.state.state)];
    if (landmark.state.state == LandmarkState::kConfirmed) ++labels[classes.name(landmark.state.class_id)];
  }
  std::printf("keyframes   %zu\nedges       %zu\nloops       %zu, %zu of them kept\nsubmaps     %zu\n",
              map.graph.keyframes.size(), map.graph.edges.size(), map.graph.loops.size(), kept, map.submaps.size());
  std::map<std::string, int> reasons;
  for (const LoopFigures& loop : map.refused) ++reasons[to_string(loop.reason)];
  std::printf("refused     %zu candidates for loops\n", map.refused.size());
  for (const auto& [reason, count] : reasons) std::printf("            %d %s\n", count, reason.c_str());
  std::printf("points      %zu sparse, %zu semi-dense, in %zu keyframes\n", sparse, semi_dense, map.points.size());
  std::printf("objects     %zu\n", map.objects.landmarks.size());
  for (const auto& [state, count] : states) std::printf("            %d %s\n", count, state.c_str());
  const std::vector<LoggedMerge>& merges = map.objects.merges;
  const auto undone = std::count_if(merges.begin(), merges.end(),
                                    [](const LoggedMerge& merge) { return merge.undone_frame_id.has_value(); });
  std::printf("merges      %zu, %td of them taken back\n", merges.size(), undone);
  std::printf("confirmed  ");
  for (const auto& [label, count] : labels) std::printf(" %d %s", count, label.c_str());
  std::printf("\n");
}

void print_changes(const MapState& map, const ClassTable& classes) {
  const auto object = [&](std::int64_t id) {
    for (const MappedLandmark& landmark : map.objects.landmarks) {
      if (landmark.state.id != id) continue;
      const Vec3& at = landmark.state.ellipsoid->center();
      return classes.name(landmark.state.class_id) + " " + std::to_string(id) + " (" + format_fixed(at.x(), 2) + " " +
             format_fixed(at.y(), 2) + " " + format_fixed(at.z(), 2) + ")";
    }
    return std::string();
  };
  const std::vector<MapChange> changes = map_changes(map);
  std::printf("changes     %zu since the session before the last\n", changes.size());
  for (const MapChange& change : changes) {
    std::string text = std::string("            ") + to_string(change.kind) + ":";
    if (change.before_id) {
      text += " " + object(*change.before_id) + ", " + std::to_string(change.boxes_before) + " boxes before, where " +
              std::to_string(change.looked_at_after) + " keyframes now show none";
      if (change.seen_through_s > 0.0) text += ", seen through for " + format_fixed(change.seen_through_s, 1) + " s";
    }
    if (change.before_id && change.after_id) text += ";";
    if (change.after_id) {
      text += " " + object(*change.after_id) + ", " + std::to_string(change.boxes_after) + " boxes now, where " +
              std::to_string(change.looked_at_before) + " keyframes before showed none";
    }
    std::printf("%s\n", text.c_str());
  }
}

std::map<std::string, int> class_histogram(const Landmark& landmark, const ClassTable& classes) {
  std::map<std::string, int> histogram;
  for (const ClassCount& c : landmark.class_counts) histogram[classes.name(c.class_id)] = c.count;
  return histogram;
}

nlohmann::json to_json(const MappedLandmark& landmark, const ClassTable& classes) {
  const Landmark& state = landmark.state;
  const Ellipsoid& ellipsoid = *state.ellipsoid;
  const auto& [q, center] = ellipsoid.T_world_quadric;
  const Vec3& axes = ellipsoid.semi_axes;
  return {{"id", state.id},
          {"class_id", state.class_id},
          {"label", classes.name(state.class_id)},
          {"classes", class_histogram(state, classes)},
          {"state", to_string(state.state)},
          {"center_m", {center.x(), center.y(), center.z()}},
          {"rotation_xyzw", {q.x(), q.y(), q.z(), q.w()}},
          {"semi_axes_m", {axes.x(), axes.y(), axes.z()}},
          {"sigma_m", std::sqrt(state.center_covariance.trace() / 3.0)},
          {"observations", state.observations},
          {"quality", state.quality},
          {"last_seen_ns", landmark.last_stamp_ns}};
}

Status write_objects(const std::string& path, const MapState& map, const ClassTable& classes) {
  nlohmann::json array = nlohmann::json::array();
  std::string table = object_table_header();
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    if (!landmark.state.ellipsoid) continue;
    array.push_back(to_json(landmark, classes));
    table += table_row(mapped_object(landmark.state, classes));
  }
  constexpr int kIndent = 2;
  return write_text_file(path, ends_with(path, ".json") ? array.dump(kIndent) + '\n' : table);
}

/// The keyframes of each session that has some.
std::vector<StampedPoses> trajectories(const MapState& map, bool live) {
  std::vector<StampedPoses> result;
  auto session = map.graph.sessions.begin();
  for (const GraphKeyframe& keyframe : map.graph.keyframes) {
    if (live && !keyframe.T_map_live) continue;
    bool is_first = result.empty();
    for (; session != map.graph.sessions.end() && session->first_keyframe_id <= keyframe.pose.keyframe_id; ++session) {
      is_first = true;
    }
    if (is_first) result.emplace_back();
    result.back().push_back({keyframe.pose.stamp_ns, live ? *keyframe.T_map_live : keyframe.pose.T_map_camera});
  }
  return result;
}

/// FILE.txt as FILE_1.txt.
std::string numbered(const std::string& path, std::size_t number) {
  const std::filesystem::path whole(path);
  return whole.parent_path() / (whole.stem().string() + '_' + std::to_string(number) + whole.extension().string());
}

/// Every keyframe in order of time, as readers of the format ask for. Sessions whose stamps overlap, of two robots at
/// a time say, are no one trajectory: then a file each.
/// @param live as they were told when they were made, those of which it is known
Status write_trajectory(const std::string& path, const MapState& map, bool live) {
  const std::vector<StampedPoses> sessions = trajectories(map, live);
  std::vector<StampedPoses> in_time = sessions;
  std::stable_sort(in_time.begin(), in_time.end(), [](const StampedPoses& a, const StampedPoses& b) {
    return a.front().stamp_ns < b.front().stamp_ns;
  });
  StampedPoses all;
  for (const StampedPoses& session : in_time) all.insert(all.end(), session.begin(), session.end());
  const auto goes_back = [](const StampedPose& a, const StampedPose& b) { return a.stamp_ns >= b.stamp_ns; };
  if (std::adjacent_find(all.begin(), all.end(), goes_back) == all.end()) return write_tum_trajectory(path, all);
  Status written;
  for (std::size_t i = 0; written && i < sessions.size(); ++i) {
    written = write_tum_trajectory(numbered(path, i + 1), sessions[i]);
  }
  std::printf("sessions overlap in time, a file each: %s to %s\n", numbered(path, 1).c_str(),
              numbered(path, sessions.size()).c_str());
  return written;
}

/// Vertices, their odometry edges and the loops that are kept, with the noise and the jumps that were found; all in the
/// map's unit of length.
Status write_graph(const std::string& path, const MapState& map) {
  G2oGraph graph;
  std::vector<std::int64_t> ids;
  std::vector<double> scales;  // of that unit over what each vertex's edges are in
  for (const GraphKeyframe& keyframe : map.graph.keyframes) {
    if (keyframe.T_vertex_keyframe) continue;
    ids.push_back(keyframe.pose.keyframe_id);
    scales.push_back(keyframe.pose.scale);
    graph.vertices.push_back({ids.back(), keyframe.pose.T_map_camera, ids.size() == 1});
  }
  const auto add = [&](std::size_t from, std::size_t to, SE3 T, const Mat6& covariance) {
    T.t *= scales[from];
    Vec6 by_quaternion;  // whose vector part, in g2o's errors, is half the rotation
    by_quaternion << Vec3::Constant(1.0 / scales[from]), Vec3::Constant(2.0);
    const Mat6 information = by_quaternion.asDiagonal() * covariance.inverse() * by_quaternion.asDiagonal();
    graph.edges.push_back({ids[from], ids[to], T, 0.5 * (information + information.transpose())});
  };
  const NoiseEstimate& noise = map.graph.noise;
  std::vector<Mat6> covariances;
  for (const OdometryEdge& edge : map.graph.edges) covariances.push_back(odometry_covariance(edge, noise.odometry));
  for (const OdometryJump& jump : noise.jumps) covariances[jump.edge] += jump.covariance();
  for (std::size_t i = 0; i < covariances.size(); ++i) {
    const OdometryEdge& edge = map.graph.edges[i];
    add(i, i + 1, edge.T_from_to * se3_exp(expected_jump(edge, noise.odometry)).inverse(), covariances[i]);
  }
  for (const RememberedLoop& loop : map.graph.loops) {
    if (!loop.is_in_graph || !loop.kept) continue;
    const auto from = static_cast<std::size_t>(loop.loop->from), to = static_cast<std::size_t>(loop.loop->to);
    add(from, to, loop.loop->T_from_to, noise.loop_factor * noise.loop_factor * loop.loop->covariance);
  }
  return write_g2o(path, graph);
}

/// With the columns of loops.csv.
Status write_refused(const std::string& path, const MapState& map) {
  std::string table = loop_table_header();
  for (const LoopFigures& loop : map.refused) table += table_row(loop);
  return write_text_file(path, table);
}

/// Which object went into which, and when.
Status write_merges(const std::string& path, const MapState& map, const ClassTable& classes) {
  std::string table = "number,merged_id,survivor_id,merged_label,merged_observations,frame,stamp,undone_frame\n";
  for (const LoggedMerge& merge : map.objects.merges) {
    table += csv_row(merge.number, merge.merge.merged_id, merge.merge.survivor_id, classes.name(merge.merged_class_id),
                     merge.merged_observations, merge.frame_id, format_stamp(merge.stamp_ns),
                     merge.undone_frame_id.value_or(-1));
  }
  return write_text_file(path, table);
}

/// All points, with the objects that they lie on.
Status write_points(const std::string& path, const MapState& map) {
  PointMapOptions options;
  options.points_max = std::numeric_limits<int>::max();
  PointMap point_map(options);
  restore_points(map, &point_map);
  const MapPoints points = point_map.points();
  return write_point_cloud(path, points, objects_under(points, map));
}

Status run(const Arguments& arguments) {
  if (arguments.dump) return dump_map(arguments.map, std::cout);
  const Result<ClassTable> classes = read_class_table(arguments.classes);
  if (!classes) return classes.error();
  for (const std::string& path : {arguments.objects, arguments.trajectory, arguments.live, arguments.graph,
                                  arguments.points, arguments.refused, arguments.merges}) {
    if (!path.empty() && is_same_file(path, arguments.map)) return Error{path + ": would take the place of the map"};
  }
  const auto read = read_map(arguments.map, *classes);
  if (!read) return read.error();
  const MapState& map = **read;
  print_counts(map, *classes);
  if (map.graph.sessions.size() > 1) print_changes(map, *classes);
  Status written;
  if (!arguments.objects.empty()) written = write_objects(arguments.objects, map, *classes);
  if (written && !arguments.trajectory.empty()) written = write_trajectory(arguments.trajectory, map, false);
  if (written && !arguments.live.empty()) written = write_trajectory(arguments.live, map, true);
  if (written && !arguments.graph.empty()) written = write_graph(arguments.graph, map);
  if (written && !arguments.points.empty()) written = write_points(arguments.points, map);
  if (written && !arguments.refused.empty()) written = write_refused(arguments.refused, map);
  if (written && !arguments.merges.empty()) written = write_merges(arguments.merges, map, *classes);
  return written;
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  Command command{"",
                  "MAP.db [--objects FILE] [--trajectory FILE] [--live FILE] [--graph FILE] [--points FILE] "
                  "[--refused FILE] [--merges FILE] [--dump] [--classes YAML]",
                  "Says what a map holds and whether it is whole, and takes parts of it out.\n",
                  [&arguments] { return run(arguments); },
                  [&arguments] {
                    if (arguments.dump) return Status();
                    return default_to_package("classes_coco.yaml", "--classes", &arguments.classes);
                  }};
  command.words = {{"MAP.db", &arguments.map}};
  const auto take_objects = [&arguments](const std::string& given) {
    arguments.objects = given;
    return ends_with(given, ".csv") || ends_with(given, ".json");
  };
  const auto take_points = [&arguments](const std::string& given) {
    arguments.points = given;
    return is_point_cloud_path(given);
  };
  command
      .option("objects", checked("a path that ends in .csv or .json", take_objects),
              "file for the objects: the columns of objects.csv, or these and how often each class was seen")
      .option("trajectory", po::value(&arguments.trajectory),
              "file for the keyframes of all sessions, TUM format, in the map; FILE_1, FILE_2, ... if sessions overlap "
              "in time")
      .option("live", po::value(&arguments.live),
              "file for the same as they were told when they were made, before later corrections")
      .option("graph", po::value(&arguments.graph), "file for the pose graph, g2o")
      .option("points", checked("a path that ends in .ply or .pcd", take_points),
              "file for the points, with the objects that they lie on")
      .option("refused", po::value(&arguments.refused),
              "file for the candidates that loop detection refused, with the columns of loops.csv")
      .option("merges", po::value(&arguments.merges), "file for which object went into which, CSV")
      .option("dump", po::bool_switch(&arguments.dump), "prints every row, in order, and nothing else")
      .option("classes", po::value(&arguments.classes),
              "class table (default: config/classes_coco.yaml of the package)");
  return run_program("inspect_map", {command}, argc, argv);
}
