// Mapper and pose graph together: what a loop closure merges comes apart when the loop is withdrawn.
#include <gtest/gtest.h>

#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/map/quadric_mapper.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"
#include "support/two_rounds.h"

namespace semantic_topo_loop::core {
namespace {

/// The run, through a mapper and a pose graph.
class MappedRounds : public TwoRounds {
 public:
  MappedRounds()
      : TwoRounds([this](const Frame& frame, const AssociationFrame& associations,
                         const std::vector<LoopClosure>& loops) { process(frame, associations, loops); }),
        mapper_(QuadricMapperOptions(), classes()),
        graph_(PoseGraphOptions()) {}

  void end() { process(end_frame(), {}, {}); }
  PoseGraph& graph() { return graph_; }
  std::vector<Landmark> landmarks() const { return mapper_.landmarks(); }
  int merged() const { return merged_; }
  int unmerged() const { return unmerged_; }

 private:
  static std::shared_ptr<const ClassTable> classes() {
    return std::make_shared<ClassTable>(*ClassTable::create({{kCup, "cup", ClassRole::kMovable, "", 0.1}}));
  }
  void process(const Frame& frame, const AssociationFrame& associations, const std::vector<LoopClosure>& loops) {
    count(mapper_.integrate(frame, associations));
    count(mapper_.apply(graph_.process(frame, loops)));
  }
  void count(const MapUpdate& update) {
    merged_ += static_cast<int>(update.merged.size());
    unmerged_ += static_cast<int>(update.unmerged.size());
  }

  QuadricMapper mapper_;
  PoseGraph graph_;
  int merged_ = 0, unmerged_ = 0;
};

TEST(ClosureUndo, TheMapIsAsBeforeWhenTheLoopsAreWithdrawn) {
  MappedRounds with, without;
  for (MappedRounds* run : {&with, &without}) {
    run->first_round();
    run->go_away();
    run->second_round();
  }
  ASSERT_EQ(with.landmarks().size(), 2U);
  with.idle(TwoRounds::loops());
  EXPECT_EQ(with.merged(), 1);
  ASSERT_EQ(with.landmarks().size(), 1U) << "one cup, seen twice";
  EXPECT_LT((with.landmarks().front().ellipsoid->center() - TwoRounds::cup().center()).norm(), 0.1);

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
