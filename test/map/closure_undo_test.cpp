// Mapper and pose graph together: what a loop closure merges comes apart when the loop is withdrawn.
#include <gtest/gtest.h>

#include <cmath>

#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/map/quadric_mapper.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"

namespace semantic_topo_loop::core {
namespace {

const Ellipsoid kCup{SE3(so3_exp(Vec3(0.0, 0.0, 0.4)), Vec3(0.05, -0.1, 0.02)), Vec3(0.05, 0.04, 0.08)};
constexpr int kRound = 60, kAway = 60, kIdle = 120, kFramesPerKeyframe = 5;

SE3 look(const Vec3& position, const Vec3& direction) {
  const Vec3 z = direction.normalized(), x = z.cross(Vec3::UnitZ()).normalized();
  Mat3 R;
  R << x, z.cross(x), z;
  return {R, position};
}

/// A camera that goes round a cup, away, and round the same cup again, while its odometry drifts sideways on the way.
class TwoRounds {
 public:
  TwoRounds() : mapper_(QuadricMapperOptions(), classes()), graph_(PoseGraphOptions()) {}

  void first_round() { round(0); }
  void second_round() { round(1); }
  void go_away() {
    for (int i = 0; i < kAway; ++i) {
      constexpr double kDrift_m = 0.01;
      T_odom_world_.t.y() += kDrift_m;
      step(away(std::min(i, kAway - 1 - i)), -1, {});
    }
  }
  /// Looks at nothing; the loops are handed over first.
  void idle(std::vector<LoopClosure> loops) {
    for (int i = 0; i < kIdle; ++i) {
      step(away(0), -1, loops);
      loops.clear();
    }
  }
  void end() {
    Frame frame;
    frame.frame_id = next_frame_;
    frame.is_end = true;
    count(mapper_.integrate(frame, {}));
    count(mapper_.apply(graph_.process(frame, {})));
  }
  PoseGraph& graph() { return graph_; }
  std::vector<Landmark> landmarks() const { return mapper_.landmarks(); }
  int merged() const { return merged_; }
  int unmerged() const { return unmerged_; }

  /// From each keyframe of the second round to the same of the first.
  static std::vector<LoopClosure> loops() {
    std::vector<LoopClosure> loops;
    for (int i = 0; i < kRound; i += kFramesPerKeyframe) {
      LoopClosure loop;
      loop.match_frame = loop.match_begin = loop.match_end = i;
      loop.query_frame = loop.query_begin = loop.query_end = i + kRound + kAway;
      loop.match_keyframe_id = loop.match_frame / kFramesPerKeyframe;
      loop.query_keyframe_id = loop.query_frame / kFramesPerKeyframe;
      loop.accepted = true;
      loop.covariance = 1e-6 * Mat6::Identity();
      loops.push_back(loop);
    }
    return loops;
  }

 private:
  static std::shared_ptr<const ClassTable> classes() {
    return std::make_shared<ClassTable>(*ClassTable::create({{41, "cup", ClassRole::kMovable, "", 0.1}}, nullptr));
  }
  static SE3 away(int i) { return look(Vec3(1.5, 0.03 * i, 0.8), Vec3(1.0, 0.01, 0.0)); }

  void round(std::int64_t id) {
    for (int i = 0; i < kRound; ++i) {
      const double angle = kPi / 2.0 * i / (kRound - 1);
      const Vec3 position(1.5 * std::cos(angle), 1.5 * std::sin(angle), 0.8);
      step(look(position, -position), id, {});
    }
  }

  void step(const SE3& T_world_camera, std::int64_t seen, const std::vector<LoopClosure>& loops) {
    Frame frame;
    frame.frame_id = next_frame_++;
    frame.stamp_ns = frame.frame_id * 33333333;
    frame.is_keyframe = frame.frame_id % kFramesPerKeyframe == 0;
    frame.keyframe_id = frame.frame_id / kFramesPerKeyframe;
    frame.T_odom_camera = T_odom_world_ * T_world_camera;
    frame.camera = Camera{520.0, 520.0, 320.0, 240.0, 640, 480, {}};
    AssociationFrame associations;
    associations.frame_id = frame.frame_id;
    if (seen >= 0) {
      Association association;
      association.landmark_id = seen;
      association.class_id = association.landmark_class_id = 41;
      association.box = *project_box(kCup, projection_matrix(frame.camera, T_world_camera));
      associations.associations.push_back(association);
    }
    count(mapper_.integrate(frame, associations));
    count(mapper_.apply(graph_.process(frame, loops)));
  }

  void count(const MapUpdate& update) {
    merged_ += static_cast<int>(update.merged.size());
    unmerged_ += static_cast<int>(update.unmerged.size());
  }

  QuadricMapper mapper_;
  PoseGraph graph_;
  SE3 T_odom_world_;
  std::int64_t next_frame_ = 0;
  int merged_ = 0, unmerged_ = 0;
};

TEST(ClosureUndo, TheMapIsAsBeforeWhenTheLoopsAreWithdrawn) {
  TwoRounds with, without;
  for (TwoRounds* run : {&with, &without}) {
    run->first_round();
    run->go_away();
    run->second_round();
  }
  ASSERT_EQ(with.landmarks().size(), 2U);
  with.idle(TwoRounds::loops());
  EXPECT_EQ(with.merged(), 1);
  ASSERT_EQ(with.landmarks().size(), 1U) << "one cup, seen twice";
  EXPECT_LT((with.landmarks().front().ellipsoid->center() - kCup.center()).norm(), 0.1);

  for (const LoopClosure& loop : TwoRounds::loops()) {
    EXPECT_TRUE(with.graph().withdraw(loop.query_keyframe_id, loop.match_keyframe_id));
  }
  with.idle({});
  without.idle({});
  without.idle({});
  with.end();
  without.end();
  EXPECT_EQ(with.unmerged(), 1);
  EXPECT_EQ(without.merged(), 0);
  const std::vector<Landmark> now = with.landmarks(), before = without.landmarks();
  ASSERT_EQ(now.size(), 2U);
  ASSERT_EQ(before.size(), 2U);
  for (std::size_t i = 0; i < now.size(); ++i) {
    EXPECT_EQ(now[i].id, before[i].id);
    EXPECT_EQ(now[i].class_id, before[i].class_id);
    EXPECT_EQ(now[i].state, before[i].state);
    EXPECT_EQ(now[i].observations, before[i].observations);
    EXPECT_NEAR(now[i].quality, before[i].quality, 0.01);
    ASSERT_TRUE(now[i].ellipsoid && before[i].ellipsoid);
    EXPECT_LT((now[i].ellipsoid->center() - before[i].ellipsoid->center()).norm(), 1e-3);
    EXPECT_LT((now[i].ellipsoid->shape() - before[i].ellipsoid->shape()).norm(),
              0.02 * before[i].ellipsoid->shape().norm());
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
