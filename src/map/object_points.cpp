#include "semantic_topo_loop/map/object_points.h"

#include <pcl/filters/statistical_outlier_removal.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <pcl/search/kdtree.h>
#include <pcl/segmentation/extract_clusters.h>

#include <cmath>
#include <limits>

namespace semantic_topo_loop::core {
namespace {

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

constexpr std::size_t kMinPoints = 5;

Cloud::Ptr points_in_box(const std::vector<Vec3>& points_camera, const Camera& camera, const Box& box) {
  Cloud::Ptr cloud(new Cloud);
  for (const Vec3& p : points_camera) {
    if (!p.allFinite() || !(p.z() > 0.0)) continue;
    const double u = camera.fx * p.x() / p.z() + camera.cx;
    const double v = camera.fy * p.y() / p.z() + camera.cy;
    if (u < box.x1 || u > box.x2 || v < box.y1 || v > box.y2) continue;
    cloud->push_back({static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())});
  }
  return cloud;
}

Cloud::Ptr without_outliers(const Cloud::Ptr& cloud) {
  pcl::StatisticalOutlierRemoval<pcl::PointXYZ> filter;
  filter.setInputCloud(cloud);
  filter.setMeanK(static_cast<int>(kMinPoints) - 1);
  filter.setStddevMulThresh(2.0);
  Cloud::Ptr filtered(new Cloud);
  filter.filter(*filtered);
  return filtered;
}

/// Mean distance of the cluster's projections from the middle of the box, in box sizes.
double offset(const Cloud& cloud, const pcl::PointIndices& cluster, const Camera& camera, const Box& box) {
  double sum = 0.0;
  for (const int index : cluster.indices) {
    const pcl::PointXYZ& p = cloud[static_cast<std::size_t>(index)];
    const Vec2 pixel(camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy);
    sum += (pixel - box.center()).norm() / box.size();
  }
  return sum / static_cast<double>(cluster.indices.size());
}

}  // namespace

std::vector<Vec3> object_points(const std::vector<Vec3>& points_camera, const Camera& camera, const Box& box) {
  const Cloud::Ptr in_box = points_in_box(points_camera, camera, box);
  if (in_box->size() < kMinPoints || !box.is_valid()) return {};
  const Cloud::Ptr cloud = without_outliers(in_box);
  if (cloud->size() < kMinPoints) return {};

  double mean_depth = 0.0;
  for (const pcl::PointXYZ& p : *cloud) mean_depth += p.z / static_cast<double>(cloud->size());
  pcl::search::KdTree<pcl::PointXYZ>::Ptr tree(new pcl::search::KdTree<pcl::PointXYZ>);
  tree->setInputCloud(cloud);
  pcl::EuclideanClusterExtraction<pcl::PointXYZ> clustering;
  // Surfaces within a third of the object's own size belong together.
  clustering.setClusterTolerance(std::max(0.01, box.size() * mean_depth / camera.fx / 3.0));
  clustering.setMinClusterSize(static_cast<int>(kMinPoints));
  clustering.setSearchMethod(tree);
  clustering.setInputCloud(cloud);
  std::vector<pcl::PointIndices> clusters;
  clustering.extract(clusters);

  const pcl::PointIndices* best = nullptr;
  double best_offset = std::numeric_limits<double>::infinity();
  for (const pcl::PointIndices& cluster : clusters) {
    const double value = offset(*cloud, cluster, camera, box);
    if (value < best_offset) {
      best_offset = value;
      best = &cluster;
    }
  }
  std::vector<Vec3> points;
  if (best == nullptr) return points;
  points.reserve(best->indices.size());
  for (const int index : best->indices) {
    const pcl::PointXYZ& p = (*cloud)[static_cast<std::size_t>(index)];
    points.emplace_back(p.x, p.y, p.z);
  }
  return points;
}

}  // namespace semantic_topo_loop::core
