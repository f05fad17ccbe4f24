#include "semantic_topo_loop/loop/loop_explanation.h"

#include <gtest/gtest.h>

#include <map>

#include "loop/graph/local_map.h"
#include "loop/pair_record.h"
#include "support/synthetic_desk.h"

namespace semantic_topo_loop::core {
namespace {

using testing::random_desk;
using testing::run;
using testing::RunSetup;

RunSetup revisit() {
  RunSetup setup;
  setup.desk = random_desk(1, 12);
  setup.visits = {{0.0, 12.0, 0.0, 80.0}, {30.0, 42.0, 60.0, -20.0}};
  setup.end_s = 42.0;
  return setup;
}

TEST(LoopExplanation, TellsTheRecordOfEveryCandidate) {
  std::map<std::pair<std::int64_t, std::int64_t>, LoopExplanation> answers;
  const LoopOptions options;
  testing::RunOutcome outcome = run(options, revisit());
  run(options, revisit(), [&](const LoopDetector& detector) {
    for (const LoopClosure& loop : outcome.loops) {
      answers[{loop.query_keyframe_id, loop.match_keyframe_id}] =
          detector.explain(loop.query_keyframe_id, loop.match_keyframe_id);
    }
  });
  ASSERT_FALSE(answers.empty());
  int accepted = 0;
  for (const LoopClosure& loop : outcome.loops) {
    const LoopExplanation& answer = answers.at({loop.query_keyframe_id, loop.match_keyframe_id});
    EXPECT_EQ(answer.status, PairStatus::kVerified);
    ASSERT_TRUE(answer.closure.has_value());
    if (!loop.accepted) continue;
    ++accepted;
    EXPECT_TRUE(answer.closure->accepted) << "an accepted loop is not hidden by a later candidate of the same pair";
    EXPECT_GE(answer.closure->inliers, options.min_inliers);
    EXPECT_GT(answer.closure->sigma_m, 0.0);
    EXPECT_LE(answer.closure->sigma_m, options.max_sigma_m);
    EXPECT_NE(answer.text.find("accepted"), std::string::npos) << answer.text;
    EXPECT_NE(answer.text.find("sigma deg"), std::string::npos) << answer.text;
  }
  EXPECT_GT(accepted, 0);
}

TEST(LoopExplanation, SaysWhyAPairWasNotCompared) {
  run(LoopOptions(), revisit(), [](const LoopDetector& detector) {
    const auto status = [&detector](std::int64_t query, std::int64_t match) {
      const LoopExplanation answer = detector.explain(query, match);
      EXPECT_FALSE(answer.text.empty());
      return answer.status;
    };
    EXPECT_EQ(status(100000, 2), PairStatus::kUnknownKeyframe);
    EXPECT_EQ(status(3, -1), PairStatus::kUnknownKeyframe);
    EXPECT_EQ(status(2, 2), PairStatus::kWrongOrder);
    EXPECT_EQ(status(2, 5), PairStatus::kWrongOrder);
    const std::vector<LocalMap> submaps = detector.submaps();
    ASSERT_GE(submaps.size(), 3u);
    const LoopExplanation recent = detector.explain(submaps[1].keyframe_id, submaps[0].keyframe_id);
    EXPECT_EQ(recent.status, PairStatus::kTooRecent);
    ASSERT_TRUE(recent.closure.has_value()) << "it is compared for the answer all the same";
    EXPECT_GE(recent.closure->inliers, 6);
    EXPECT_NE(recent.text.find("compared now"), std::string::npos) << recent.text;
  });
}

TEST(LoopExplanation, AskingChangesNothing) {
  const auto first = run(LoopOptions(), revisit()), second = run(LoopOptions(), revisit(), [](const LoopDetector&d) {
                                                      const LoopExplanation once = d.explain(30, 5),
                                                                            again = d.explain(30, 5);
                                                      EXPECT_EQ(once.status, again.status);
                                                      EXPECT_EQ(once.text, again.text);
                                                    });
  EXPECT_EQ(first.loops.size(), second.loops.size());
}

TEST(LoopExplanation, LoopClosingOffIsSaid) {
  LoopOptions options;
  options.enabled = false;
  run(options, revisit(), [](const LoopDetector& detector) {
    const std::vector<LocalMap> submaps = detector.submaps();
    const LoopExplanation answer = detector.explain(submaps.back().keyframe_id, submaps.front().keyframe_id);
    EXPECT_EQ(answer.status, PairStatus::kNotAttempted);
    EXPECT_TRUE(answer.closure && answer.closure->accepted) << answer.text;
  });
}

TEST(LoopExplanation, ABreakLeavesKeyframesWithoutASubmap) {
  RunSetup setup = revisit();
  setup.drift_is_break = true;
  setup.drift_from_s = 40.0;
  run(LoopOptions(), setup, [](const LoopDetector& detector) {
    std::int64_t last = 0;
    while (detector.explain(last + 1, 0).status != PairStatus::kUnknownKeyframe) ++last;
    EXPECT_EQ(detector.explain(last, 1).status, PairStatus::kNoSubmap);
  });
}

TEST(LoopExplanation, PaperModeToo) {
  LoopOptions options;
  options.mode = "paper";
  options.paper_min_gap_frames = 150;
  RunSetup setup = revisit();
  setup.same_ids = true;
  std::vector<LoopClosure> loops = run(options, setup).loops;
  ASSERT_FALSE(loops.empty());
  run(options, setup, [&loops](const LoopDetector& detector) {
    const LoopClosure& loop = loops.back();
    EXPECT_EQ(detector.explain(loop.query_keyframe_id, loop.match_keyframe_id).status, PairStatus::kVerified);
    EXPECT_EQ(detector.explain(2, 1).status, PairStatus::kNotAttempted);
  });
}

TEST(PairRecord, ForgetsTheEarliestQueries) {
  PairRecord record(4);
  for (std::int64_t query = 10; query < 14; ++query) {
    LoopClosure loop;
    loop.query_keyframe_id = query;
    loop.match_keyframe_id = 1;
    LoopClosure other = loop;
    other.match_keyframe_id = 2;
    record.add({loop, other});
  }
  EXPECT_EQ(record.find(10, 1), nullptr);
  EXPECT_EQ(record.find(11, 2), nullptr);
  EXPECT_NE(record.find(12, 1), nullptr);
  EXPECT_NE(record.find(13, 2), nullptr);
  EXPECT_EQ(record.find(13, 3), nullptr);
}

}  // namespace
}  // namespace semantic_topo_loop::core
