#include "semantic_topo_loop/pose_graph/pose_graph.h"

#include <chrono>
#include <map>
#include <string>
#include <utility>

#include "semantic_topo_loop/pose_graph/relative_pose.h"
#include "semantic_topo_loop/pose_graph/trajectory_optimizer.h"

namespace semantic_topo_loop::core {

class PoseGraph::Impl {
 public:
  explicit Impl(const PoseGraphOptions& options) : options_(options) { noise_.odometry = noise_prior(options).least; }

  MapCorrection process(const Frame& frame, const std::vector<LoopClosure>& loops) {
    MapCorrection correction;
    correction.frame_id = frame.frame_id;
    correction.T_map_odom_old = T_map_odom_;
    if (!frame.is_end) add_frame(frame);
    for (const LoopClosure& loop : loops) add_loop(loop);
    if (is_due(frame)) {
      const auto start = std::chrono::steady_clock::now();
      correction.changed = optimize();
      correction.duration_us =
          std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count();
    }
    correction.T_map_odom = T_map_odom_;
    if (!keyframes_.empty()) correction.valid_to_keyframe_id = keyframes_.back().keyframe_id;
    if (correction.changed) {
      correction.keyframes = keyframes();
      correction.loops = verdicts();
    }
    return correction;
  }

  const SE3& T_map_odom() const { return T_map_odom_; }

  std::vector<KeyframePose> keyframes() const {
    std::vector<KeyframePose> poses = keyframes_;
    for (std::size_t i = 0; i < poses.size(); ++i) poses[i].T_map_camera = trajectory_.T_map_vertex[i];
    return poses;
  }

 private:
  void add_frame(const Frame& frame) {
    if (!frame.T_odom_camera.is_finite()) return;
    accumulator_.add(frame);
    if (!frame.is_keyframe || vertex_of_.count(frame.keyframe_id) != 0) return;
    if (!keyframes_.empty()) trajectory_.edges.push_back(accumulator_.finish(T_odom_keyframe_, frame.T_odom_camera));
    vertex_of_[frame.keyframe_id] = static_cast<int>(keyframes_.size());
    keyframes_.push_back({frame.keyframe_id, frame.frame_id, frame.stamp_ns, SE3()});
    trajectory_.T_map_vertex.push_back(T_map_odom_ * frame.T_odom_camera);
    T_odom_keyframe_ = frame.T_odom_camera;
    ++keyframes_since_;
  }

  void add_loop(const LoopClosure& closure) {
    if (!closure.accepted) return;
    std::string why_refused;
    const auto loop =
        make_graph_loop(closure, vertex(closure.query_keyframe_id), vertex(closure.match_keyframe_id), &why_refused);
    if (!loop) {
      refused_.push_back({closure.query_keyframe_id, closure.match_keyframe_id, false});
      return;
    }
    trajectory_.loops.push_back(*loop);
    kept_.push_back(true);
    has_new_loops_ = true;
    const Vec6 e =
        relative_pose_residual(trajectory_.T_map_vertex[static_cast<std::size_t>(loop->from)],
                               trajectory_.T_map_vertex[static_cast<std::size_t>(loop->to)], loop->T_from_to);
    is_urgent_ = is_urgent_ || (square_root_information(loop->covariance) * e).squaredNorm() > options_.urgent_chi2;
  }

  int vertex(std::int64_t keyframe_id) const {
    const auto found = vertex_of_.find(keyframe_id);
    return found == vertex_of_.end() ? -1 : found->second;
  }

  bool is_due(const Frame& frame) const {
    if (trajectory_.loops.empty()) return false;
    if (frame.is_end) return true;
    return has_new_loops_ && (keyframes_since_ >= options_.interval_keyframes ||
                              (is_urgent_ && keyframes_since_ >= options_.min_interval_keyframes));
  }

  bool optimize() {
    keyframes_since_ = 0;
    has_new_loops_ = is_urgent_ = false;
    OptimizedTrajectory result = optimize_trajectory(trajectory_, options_, noise_);
    if (!result.usable) return false;
    trajectory_.T_map_vertex = std::move(result.T_map_vertex);
    kept_ = std::move(result.kept);
    noise_ = result.noise;
    T_map_odom_ = trajectory_.T_map_vertex.back() * T_odom_keyframe_.inverse();
    return true;
  }

  std::vector<LoopVerdict> verdicts() const {
    std::vector<LoopVerdict> verdicts = refused_;
    for (std::size_t k = 0; k < kept_.size(); ++k) {
      const GraphLoop& loop = trajectory_.loops[k];
      verdicts.push_back({loop.query_keyframe_id, loop.match_keyframe_id, kept_[k]});
    }
    return verdicts;
  }

  PoseGraphOptions options_;
  Trajectory trajectory_;
  std::vector<KeyframePose> keyframes_;
  std::map<std::int64_t, int> vertex_of_;
  OdometryAccumulator accumulator_;
  SE3 T_odom_keyframe_;  ///< of the last keyframe
  SE3 T_map_odom_;
  NoiseEstimate noise_;
  std::vector<bool> kept_;
  std::vector<LoopVerdict> refused_;
  int keyframes_since_ = 0;
  bool has_new_loops_ = false, is_urgent_ = false;
};

PoseGraph::PoseGraph(const PoseGraphOptions& options) : impl_(std::make_unique<Impl>(options)) {}
PoseGraph::~PoseGraph() = default;
PoseGraph::PoseGraph(PoseGraph&&) noexcept = default;
PoseGraph& PoseGraph::operator=(PoseGraph&&) noexcept = default;

MapCorrection PoseGraph::process(const Frame& frame, const std::vector<LoopClosure>& loops) {
  return impl_->process(frame, loops);
}
const SE3& PoseGraph::T_map_odom() const { return impl_->T_map_odom(); }
std::vector<KeyframePose> PoseGraph::keyframes() const { return impl_->keyframes(); }

}  // namespace semantic_topo_loop::core
