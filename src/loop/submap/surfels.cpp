#include "loop/submap/surfels.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <optional>
#include <unordered_map>
#include <utility>

#include "geometry/depth_points.h"
#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kVoxel_m = 0.06;  ///< three of them: enough of a surface to know its normal in Kinect's noise
constexpr std::size_t kMaxSurfels = 2000;
constexpr int kMinPoints = 8;             ///< about a surfel
constexpr double kUneven_m = 0.005;       ///< of a surface, which no number of near points makes flatter
constexpr double kMaxThickness_m = 0.03;  ///< of what counts as flat: the noise at the greatest range
constexpr double kMaxRoundness = 0.2;     ///< of the spread along the normal over the lesser one across it, squared

using Cell = Eigen::Matrix<std::int64_t, 3, 1>;

std::uint64_t key(const Cell& cell) {
  constexpr std::int64_t kHalf = 1 << 20;  // of the 21 bits of each coordinate: 60 km
  constexpr auto bits = [](std::int64_t i) { return static_cast<std::uint64_t>(i + kHalf) & 0x1fffff; };
  return bits(cell.x()) << 42 | bits(cell.y()) << 21 | bits(cell.z());
}

/// The points of a voxel, weighed by the noise of their depth.
struct Voxel {
  Cell cell = Cell::Zero();
  int count = 0;
  double weight = 0.0;
  Vec3 sum = Vec3::Zero();
  Mat3 products = Mat3::Zero();
  Vec3 towards_cameras = Vec3::Zero();

  void add(const Voxel& other) {
    count += other.count;
    weight += other.weight;
    sum += other.sum;
    products += other.products;
    towards_cameras += other.towards_cameras;
  }
};

class VoxelGrid {
 public:
  void add(const ObservedFrame& frame, const SE3& T_local_odom) {
    const SE3 T_local_camera = T_local_odom * frame.T_odom_camera;
    const Mat3 R_local_camera = T_local_camera.rotation();
    for (const Eigen::Vector3f& point : *frame.points) {
      const Vec3 point_camera = point.cast<double>();
      const Vec3 local = R_local_camera * point_camera + T_local_camera.t;
      const double sigma = depth_sigma_m(point_camera.z());
      const double weight = 1.0 / (kUneven_m * kUneven_m + sigma * sigma);
      Voxel& voxel = at((local / kVoxel_m).array().floor().cast<std::int64_t>());
      ++voxel.count;
      voxel.weight += weight;
      voxel.sum += weight * local;
      voxel.products += weight * local * local.transpose();
      voxel.towards_cameras += T_local_camera.t - local;
    }
  }

  /// In the order in which the voxels were first seen.
  const std::vector<Voxel>& voxels() const { return voxels_; }

  std::optional<Surfel> surfel(const Voxel& middle) const {
    Voxel sum;
    for (int x = -1; x <= 1; ++x) {
      for (int y = -1; y <= 1; ++y) {
        for (int z = -1; z <= 1; ++z) {
          const auto found = index_.find(key(middle.cell + Cell(x, y, z)));
          if (found != index_.end()) sum.add(voxels_[found->second]);
        }
      }
    }
    if (sum.count < kMinPoints) return std::nullopt;
    const Vec3 mean = sum.sum / sum.weight;
    const Eigen::SelfAdjointEigenSolver<Mat3> solver(sum.products / sum.weight - mean * mean.transpose());
    const Vec3& spread = solver.eigenvalues();
    if (spread(0) > kMaxRoundness * spread(1) || spread(0) > kMaxThickness_m * kMaxThickness_m) return std::nullopt;
    Vec3 normal = solver.eigenvectors().col(0);
    if (normal.dot(middle.towards_cameras) < 0.0) normal = -normal;
    // On the surface, above the voxel's own points.
    const Vec3 own = middle.sum / middle.weight;
    return Surfel{(own - normal * normal.dot(own - mean)).cast<float>(), normal.cast<float>()};
  }

 private:
  Voxel& at(const Cell& cell) {
    const auto [entry, is_new] = index_.emplace(key(cell), voxels_.size());
    if (is_new) voxels_.emplace_back().cell = cell;
    return voxels_[entry->second];
  }

  std::vector<Voxel> voxels_;
  std::unordered_map<std::uint64_t, std::size_t> index_;  ///< looked up only, never iterated over
};

}  // namespace

std::shared_ptr<const std::vector<Surfel>> make_surfels(const std::deque<ObservedFrame>& window,
                                                        const SE3& T_local_odom) {
  VoxelGrid grid;
  for (const ObservedFrame& frame : window) {
    if (frame.points) grid.add(frame, T_local_odom);
  }
  if (grid.voxels().empty()) return nullptr;
  // Some are not flat; the neighbours of more than these need not be looked at.
  std::vector<std::size_t> candidates(grid.voxels().size());
  std::iota(candidates.begin(), candidates.end(), 0);
  std::vector<Surfel> surfels;
  for (const std::size_t i : evenly_taken(std::move(candidates), kMaxSurfels * 3 / 2)) {
    if (const std::optional<Surfel> surfel = grid.surfel(grid.voxels()[i])) surfels.push_back(*surfel);
  }
  return std::make_shared<const std::vector<Surfel>>(evenly_taken(std::move(surfels), kMaxSurfels));
}

}  // namespace semantic_topo_loop::core
