#include "pose_graph/solver/graph_objects.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <cmath>
#include <utility>

#include "geometry/statistics.h"
#include "geometry/wide_image.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kMinViews = 4;  // sixteen edges for the six unknowns of an object, and some to spare for outliers
constexpr double kMinOverlap = 0.1;   // IoU: less shows something else, by more than any pose is off
constexpr double kVisibleShare = 0.7;  // of the extent: at the median over a hemisphere's outline it is 1 / sqrt(2)

/// A side that the image border cuts bounds nothing: the projection's counts there.
bool overlaps(const GraphObjectView& view, const Box& projected) {
  Vec4 edges = view.box.edges();
  for (int i = 0; i < 4; ++i) {
    if ((view.truncated & (1 << i)) != 0) edges(i) = projected.edges()(i);
  }
  return iou({edges(0), edges(1), edges(2), edges(3)}, projected) > kMinOverlap;
}

/// @return none where the frame does not tell the depth of the object, or only a part of it is in the image
std::optional<SurfaceDepth> surface_depth(const Camera& camera, const Association& association) {
  if (!association.has_depth() || association.truncated != 0) return std::nullopt;
  const Vec3 ray = camera.ray(association.box.center());
  return SurfaceDepth{ray.normalized(), association.near_m * ray.norm()};
}

}  // namespace

Mat34 projection_matrix(const GraphObjectView& view, const SE3& T_world_camera) {
  Mat3 K = Mat3::Identity();
  K(0, 0) = view.intrinsics(0);
  K(1, 1) = view.intrinsics(1);
  K.col(2).head<2>() = view.intrinsics.tail<2>();
  const Mat3 R_camera_world = T_world_camera.q.normalized().toRotationMatrix().transpose();
  Mat34 P;
  P << K * R_camera_world, -(K * (R_camera_world * T_world_camera.t));
  return P;
}

std::optional<ObjectTerms<4>> box_terms(const GraphObjectView& view, const SE3& T_world_camera,
                                        const Ellipsoid& ellipsoid) {
  BoxJacobian J;
  const std::optional<Box> box = project_box(ellipsoid, projection_matrix(view, T_world_camera), &J);
  if (!box) return std::nullopt;
  ObjectTerms<4> terms;
  terms.error = box->edges() - view.box.edges();
  terms.center = J.center;
  terms.log_axes = J.log_axes;
  // What the camera does, the ellipsoid does the other way round.
  terms.camera_t = -J.center;
  terms.camera_rotation = J.center * hat(ellipsoid.center() - T_world_camera.t) - J.rotation;
  for (int i = 0; i < 4; ++i) {
    if ((view.truncated & (1 << i)) == 0) continue;
    terms.error(i) = 0.0;
    for (ObjectTerms<4>::Jacobian* jacobian :
         {&terms.camera_t, &terms.camera_rotation, &terms.center, &terms.log_axes}) {
      jacobian->row(i).setZero();
    }
  }
  return terms;
}

ObjectTerms<1> depth_terms(const SurfaceDepth& depth, const SE3& T_world_camera, const Ellipsoid& ellipsoid) {
  const Vec3 ray = T_world_camera.q.normalized() * depth.ray_camera;
  const Vec3 shape_ray = ellipsoid.shape() * ray;
  const double extent = std::sqrt(ray.dot(shape_ray));
  const Vec3 to_center = ellipsoid.center() - T_world_camera.t;
  const Vec3 along = ellipsoid.T_world_quadric.q.conjugate() * ray;
  ObjectTerms<1> terms;
  terms.error(0) = ray.dot(to_center) - kVisibleShare * extent - depth.distance_m;
  terms.camera_t = -ray.transpose();
  terms.camera_rotation = (ray.cross(to_center) - kVisibleShare / extent * ray.cross(shape_ray)).transpose();
  terms.center = ray.transpose();
  terms.log_axes = -kVisibleShare / extent * ellipsoid.semi_axes.cwiseProduct(along).cwiseAbs2().transpose();
  return terms;
}

GraphObjects well_seen(const GraphObjects& objects, const std::vector<SE3>& T_world_vertex, int max_views) {
  const auto pose = [&T_world_vertex](int vertex) { return T_world_vertex[static_cast<std::size_t>(vertex)]; };
  GraphObjects result{objects.noise, {}};
  for (const GraphObject& object : objects.objects) {
    const Ellipsoid ellipsoid{pose(object.anchor) * object.T_anchor_quadric, object.semi_axes};
    std::vector<GraphObjectView> views;
    for (const GraphObjectView& view : object.views) {
      const std::optional<Box> box = project_box(ellipsoid, projection_matrix(view, pose(view.vertex)));
      if (box && overlaps(view, *box)) views.push_back(view);
    }
    if (views.size() < kMinViews) continue;
    views = evenly_taken(std::move(views), static_cast<std::size_t>(max_views));
    result.objects.push_back({object.anchor, object.T_anchor_quadric, object.semi_axes, std::move(views)});
  }
  return result;
}

void ObjectMemory::add(int vertex, const Camera& camera, const AssociationFrame& associations) {
  const double factor = pixel_factor(camera);
  for (const Association& association : associations.associations) {
    if (association.landmark_id < 0) continue;
    const Vec4 edges = association.box.edges() / factor;
    sightings_.push_back(
        {association.landmark_id,
         {vertex, Vec4(camera.fx, camera.fy, camera.cx, camera.cy) / factor,
          Box{edges(0), edges(1), edges(2), edges(3)}, association.truncated, surface_depth(camera, association)}});
  }
}

void ObjectMemory::apply(const MapUpdate& update, const std::function<int(std::int64_t)>& vertex_of,
                         const std::vector<SE3>& T_map_vertex) {
  redirects_.apply(update);
  for (const LandmarkMerge& merge : update.merged) landmarks_.erase(merge.merged_id);
  for (const std::int64_t id : update.removed) landmarks_.erase(id);
  for (const Landmark& landmark : update.changed) {
    if (landmark.state != LandmarkState::kConfirmed || !landmark.ellipsoid) {
      landmarks_.erase(landmark.id);
      continue;
    }
    const int anchor = vertex_of(landmark.anchor_keyframe_id);
    if (anchor < 0) continue;
    const SE3& T_map_anchor = T_map_vertex[static_cast<std::size_t>(anchor)];
    landmarks_[landmark.id] = {
        anchor, T_map_anchor.inverse() * landmark.ellipsoid->T_world_quadric, landmark.ellipsoid->semi_axes, {}};
  }
}

void ObjectMemory::move(const std::vector<Carrier>& carriers) {
  const auto of = [&carriers](int vertex) -> const Carrier& { return carriers[static_cast<std::size_t>(vertex)]; };
  for (auto& [id, object] : landmarks_) {
    const Carrier& carrier = of(object.anchor);
    if (carrier.T_vertex_keyframe) object.T_anchor_quadric = *carrier.T_vertex_keyframe * object.T_anchor_quadric;
    object.anchor = carrier.vertex;
  }
  std::vector<Sighting> left;
  for (Sighting& sighting : sightings_) {
    const Carrier& carrier = of(sighting.view.vertex);
    if (carrier.T_vertex_keyframe) continue;
    sighting.view.vertex = carrier.vertex;
    left.push_back(std::move(sighting));
  }
  sightings_ = std::move(left);
}

std::vector<GraphObject> ObjectMemory::objects() const {
  std::map<std::int64_t, GraphObject> objects = landmarks_;
  for (const Sighting& sighting : sightings_) {
    const auto object = objects.find(redirects_.resolve(sighting.landmark_id));
    if (object != objects.end()) object->second.views.push_back(sighting.view);
  }
  std::vector<GraphObject> result;
  result.reserve(objects.size());
  for (auto& [id, object] : objects) result.push_back(std::move(object));
  return result;
}

namespace {

// What a view errs by itself, of what all from its direction err by alike. On good poses its median is a third, with
// many outliers; chosen on later sessions of fr3_office and the drifted odometry of both sequences, from 0.3 to 1.
constexpr double kOwnShare = 0.6;
constexpr double kUnseenResidual = 20.0;  // own sigmas, far outside the noise: no view may vanish to lower the cost
constexpr double kLossScale = 1.0 / kOwnShare;  // own sigmas: most boxes are better, some show half of an object
constexpr double kAxesSigma = 0.5;              // of the logarithms of the semi-axes: the map's are right to about half

template <int n, int m>
void write(const Eigen::Matrix<double, n, m>& J, double* target) {
  Eigen::Map<Eigen::Matrix<double, n, m, Eigen::RowMajor>>{target} = J;
}

/// Errors of one view, less those of its aspect, in own sigmas; over t, q, centre, log axes and the errors of the
/// aspect, which are in shared ones.
template <int n>
class ViewCost : public ceres::SizedCostFunction<n, 3, 4, 3, 3, n> {
 public:
  /// @param shared_sigma of the errors of the aspect
  ViewCost(const GraphObjectView& view, const Quaternion& axes, double shared_sigma)
      : view_(view), axes_(axes), sigma_(kOwnShare * shared_sigma) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const SE3 T_world_camera{Quaternion(blocks[1]), Vec3(blocks[0])};
    const Ellipsoid ellipsoid{SE3(axes_, Vec3(blocks[2])), Vec3(blocks[3]).array().exp()};
    const ObjectTerms<n> terms = this->terms(T_world_camera, ellipsoid);
    for (int i = 0; i < n; ++i) residuals[i] = terms.error(i) / sigma_ - share(i) * blocks[4][i];
    if (jacobians == nullptr) return true;
    if (jacobians[0] != nullptr) write<n, 3>(terms.camera_t / sigma_, jacobians[0]);
    if (jacobians[1] != nullptr) {
      const Eigen::Matrix<double, n, 3> by_rotation = terms.camera_rotation / sigma_;
      write<n, 4>(2.0 * by_rotation * quaternion_by_rotation(T_world_camera.q).transpose(), jacobians[1]);
    }
    if (jacobians[2] != nullptr) write<n, 3>(terms.center / sigma_, jacobians[2]);
    if (jacobians[3] != nullptr) write<n, 3>(terms.log_axes / sigma_, jacobians[3]);
    for (int i = 0; i < n * n && jacobians[4] != nullptr; ++i) jacobians[4][i] = i % (n + 1) == 0 ? -share(i % n) : 0.0;
    return true;
  }

 private:
  /// Of the aspect's error: none at a side that the image border cuts.
  double share(int i) const { return n == 4 && (view_.truncated & (1 << i)) != 0 ? 0.0 : 1.0 / kOwnShare; }

  ObjectTerms<n> terms(const SE3& T_world_camera, const Ellipsoid& ellipsoid) const {
    if constexpr (n == 1) {
      return depth_terms(*view_.depth, T_world_camera, ellipsoid);
    } else {
      if (const auto terms = box_terms(view_, T_world_camera, ellipsoid)) return *terms;
      ObjectTerms<n> unseen;
      unseen.error.setConstant(kUnseenResidual * sigma_);
      return unseen;
    }
  }

  GraphObjectView view_;
  Quaternion axes_;
  double sigma_;
};

/// Holds errors, given in sigmas, to that.
void add_prior(int n, double* errors, ceres::Problem* problem) {
  problem->AddResidualBlock(new ceres::NormalPrior(ceres::Matrix::Identity(n, n), ceres::Vector::Zero(n)), nullptr,
                            errors);
}

/// What is in doubt of the distance of an object's visible side: a quarter of its radius, since no object is an
/// ellipsoid, and what a Kinect adds. The camera's part is twice that of geometry/depth_points.h, and 1 cm more: it
/// stands for a median over points that share the calibration's error, which does not average out.
double visible_side_sigma_m(const GraphObject& object, double distance_m) {
  constexpr double kShapeShare = 0.25, kCalibration_m = 0.01, kNoisePerSquareMetre = 0.003;
  const double radius = std::cbrt(object.semi_axes.prod());
  return kShapeShare * radius + kCalibration_m + kNoisePerSquareMetre * distance_m * distance_m;
}

}  // namespace

ObjectBlocks::ObjectBlocks(const GraphObjects& objects, std::vector<SE3>* T_world_vertex, ceres::Problem* problem) {
  const ObjectNoise& noise = objects.noise;
  for (const GraphObject& object : objects.objects) {
    const SE3 T_world_quadric = (*T_world_vertex)[static_cast<std::size_t>(object.anchor)] * object.T_anchor_quadric;
    unknowns_.push_back({T_world_quadric.t, object.semi_axes.array().log()});
    Unknowns& unknowns = unknowns_.back();
    const std::size_t first_aspect = aspects_.size();
    // Keeps the semi-axes near their start.
    problem->AddResidualBlock(new ceres::NormalPrior(Mat3::Identity() / kAxesSigma, unknowns.log_axes), nullptr,
                              unknowns.log_axes.data());
    for (const GraphObjectView& view : object.views) {
      SE3& T_world_camera = (*T_world_vertex)[static_cast<std::size_t>(view.vertex)];
      Aspect& aspect = this->aspect(T_world_camera.t - T_world_quadric.t, first_aspect, problem);
      const auto add = [&](ceres::CostFunction* cost, double* aspect_errors) {
        problem->AddResidualBlock(cost, new ceres::CauchyLoss(kLossScale), T_world_camera.t.data(),
                                  T_world_camera.q.coeffs().data(), unknowns.center.data(), unknowns.log_axes.data(),
                                  aspect_errors);
      };
      const double sigma_px = noise.sigma_px + noise.sigma_share * view.box.size();
      add(new ViewCost<4>(view, T_world_quadric.q, sigma_px), aspect.edge_errors.data());
      if (!view.depth) continue;
      if (!problem->HasParameterBlock(&aspect.depth_error)) add_prior(1, &aspect.depth_error, problem);
      add(new ViewCost<1>(view, T_world_quadric.q, visible_side_sigma_m(object, view.depth->distance_m)),
          &aspect.depth_error);
    }
  }
}

/// The angle was chosen on later sessions of fr3_office and the drifted odometry of both sequences: from 15 to 40 deg.
ObjectBlocks::Aspect& ObjectBlocks::aspect(const Vec3& to_camera, std::size_t first, ceres::Problem* problem) {
  const double min_cos = std::cos(radians(25.0));
  const Vec3 direction = to_camera.normalized();
  for (std::size_t i = first; i < aspects_.size(); ++i) {
    if (aspects_[i].direction.dot(direction) >= min_cos) return aspects_[i];
  }
  aspects_.emplace_back();
  Aspect& added = aspects_.back();
  added.direction = direction;
  add_prior(4, added.edge_errors.data(), problem);
  return added;
}

}  // namespace semantic_topo_loop::core
