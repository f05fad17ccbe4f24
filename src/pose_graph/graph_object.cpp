#include "semantic_topo_loop/pose_graph/graph_object.h"

#include <utility>

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kMinViews = 4;
constexpr double kMinOverlap = 0.1;

/// A side that the image border cuts bounds nothing: the projection's counts there.
bool overlaps(const ObjectView& view, const Box& projected) {
  Vec4 edges = view.box.edges();
  for (int i = 0; i < 4; ++i) {
    if ((view.truncated & (1 << i)) != 0) edges(i) = projected.edges()(i);
  }
  return iou({edges(0), edges(1), edges(2), edges(3)}, projected) > kMinOverlap;
}

std::vector<ObjectView> thinned(std::vector<ObjectView> views, std::size_t count) {
  if (views.size() <= count) return views;
  std::vector<ObjectView> some;
  for (std::size_t i = 0; i < count; ++i) some.push_back(views[i * views.size() / count]);
  return some;
}

}  // namespace

Mat34 projection_matrix(const ObjectView& view, const SE3& T_world_camera) {
  Mat3 K = Mat3::Identity();
  K(0, 0) = view.intrinsics(0);
  K(1, 1) = view.intrinsics(1);
  K.col(2).head<2>() = view.intrinsics.tail<2>();
  const Mat3 R_camera_world = T_world_camera.q.normalized().toRotationMatrix().transpose();
  Mat34 P;
  P << K * R_camera_world, -(K * (R_camera_world * T_world_camera.t));
  return P;
}

GraphObjects well_seen(const GraphObjects& objects, const std::vector<SE3>& T_world_vertex, int max_views) {
  const auto pose = [&T_world_vertex](int vertex) { return T_world_vertex[static_cast<std::size_t>(vertex)]; };
  GraphObjects result{objects.noise, {}};
  for (const GraphObject& object : objects.objects) {
    const Ellipsoid ellipsoid{pose(object.anchor) * object.T_anchor_quadric, object.semi_axes};
    std::vector<ObjectView> views;
    for (const ObjectView& view : object.views) {
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
