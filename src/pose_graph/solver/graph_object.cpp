#include "pose_graph/solver/graph_object.h"

#include <cmath>
#include <utility>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kMinViews = 4;
constexpr double kMinOverlap = 0.1;
constexpr double kVisibleShare = 0.7;

/// A side that the image border cuts bounds nothing: the projection's counts there.
bool overlaps(const GraphObjectView& view, const Box& projected) {
  Vec4 edges = view.box.edges();
  for (int i = 0; i < 4; ++i) {
    if ((view.truncated & (1 << i)) != 0) edges(i) = projected.edges()(i);
  }
  return iou({edges(0), edges(1), edges(2), edges(3)}, projected) > kMinOverlap;
}

std::vector<GraphObjectView> thinned(std::vector<GraphObjectView> views, std::size_t count) {
  if (views.size() <= count) return views;
  std::vector<GraphObjectView> some;
  for (std::size_t i = 0; i < count; ++i) some.push_back(views[i * views.size() / count]);
  return some;
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
    views = thinned(std::move(views), static_cast<std::size_t>(max_views));
    result.objects.push_back({object.anchor, object.T_anchor_quadric, object.semi_axes, std::move(views)});
  }
  return result;
}

}  // namespace semantic_topo_loop::core
