// A loop closure is withdrawn by service: what follows is heard on the topics.
#include <algorithm>
#include <utility>
#include <vector>

#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/WithdrawLoop.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"
#include "support/two_rounds.h"

namespace semantic_topo_loop {
namespace {

constexpr std::uint32_t kSession = 1;
constexpr double kPatience_s = 20.0;

/// Feeds PoseGraph and QuadricMapping, as the other stages would, and hears what they say.
class Feed {
 public:
  Feed() {
    control_ = node_.advertise<SessionControl>("session_control", 1, true);
    frames_ = node_.advertise<FrameMessage>("frames", 10);
    associations_ = node_.advertise<AssociationsMessage>("associations", 10);
    loops_ = node_.advertise<LoopsMessage>("loop_closures", 10);
    acks_ = node_.subscribe<SessionAck>("session_acks", 10, &Feed::take_ack, this);
    corrections_ = node_.subscribe<CorrectionMessage>("map_corrections", 1000, &Feed::take_correction, this);
    updates_ = node_.subscribe<MapUpdateMessage>("quadric_map_updates", 1000, &Feed::take_update, this);
  }

  bool start_session() {
    SessionControl start;
    start.header.stamp = ros::Time(1.0);
    start.session_id = kSession;
    start.command = SessionControl::COMMAND_START;
    control_.publish(start);
    return wait([this] { return acknowledged_ >= 2; });
  }

  /// In the order of the chain, each stage awaited, so that the run is the same every time.
  void step(const core::Frame& frame, const core::AssociationFrame& associations,
            const std::vector<core::LoopClosure>& loops) {
    if (is_stuck_) return;
    std_msgs::Header header;
    header.stamp.fromNSec(static_cast<std::uint64_t>(frame.stamp_ns));
    AssociationsMessage seen(header, kSession, associations);
    seen.frame_id = frame.frame_id;
    frames_.publish(FrameMessage(header, kSession, CameraFrame{frame, "camera"}));
    associations_.publish(seen);
    is_stuck_ = !wait([&] { return observed_ == frame.frame_id; });
    loops_.publish(LoopsMessage(header, kSession, FrameLoops{frame.frame_id, 0.0, loops}));
    is_stuck_ = is_stuck_ || !wait([&] { return completed_ == frame.frame_id; });
    EXPECT_FALSE(is_stuck_) << "no answer to frame " << frame.frame_id;
  }

  bool is_stuck() const { return is_stuck_; }
  /// The corrections that changed something.
  std::vector<core::MapCorrection> corrections() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return changes_;
  }
  std::vector<core::LandmarkMerge> merged() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return merged_;
  }
  std::vector<core::LandmarkMerge> unmerged() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return unmerged_;
  }

 private:
  template <class Condition>
  bool wait(Condition condition) {
    std::unique_lock<std::mutex> lock(mutex_);
    return changed_.wait_for(lock, std::chrono::duration<double>(kPatience_s), condition);
  }
  void take_ack(const SessionAck::ConstPtr&) {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++acknowledged_;
    changed_.notify_all();
  }
  void take_correction(const CorrectionMessage::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (message->changed) changes_.push_back(*message);
  }
  void take_update(const MapUpdateMessage::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    merged_.insert(merged_.end(), message->merged.begin(), message->merged.end());
    unmerged_.insert(unmerged_.end(), message->unmerged.begin(), message->unmerged.end());
    (message->phase == core::MapUpdatePhase::kObservation ? observed_ : completed_) = message->frame_id;
    changed_.notify_all();
  }

  ros::NodeHandle node_;
  ros::Publisher control_, frames_, associations_, loops_;
  ros::Subscriber acks_, corrections_, updates_;
  bool is_stuck_ = false;
  std::mutex mutex_;  ///< guards all below but the condition
  std::condition_variable changed_;
  int acknowledged_ = 0;
  std::int64_t observed_ = -1, completed_ = -1;
  std::vector<core::MapCorrection> changes_;
  std::vector<core::LandmarkMerge> merged_, unmerged_;
};

core::Vec3 old_position(const core::MapCorrection& correction) { return correction.T_map_odom_old.t; }
core::Vec3 new_position(const core::MapCorrection& correction) { return correction.T_map_odom.t; }

TEST(WithdrawLoop, TakesBackTheVerdictTheCorrectionAndTheMerge) {
  InProcessChain chain;
  chain.load_correction();
  Feed feed;
  ASSERT_TRUE(feed.start_session());
  core::TwoRounds run([&feed](const core::Frame& frame, const core::AssociationFrame& associations,
                              const std::vector<core::LoopClosure>& loops) { feed.step(frame, associations, loops); });
  const std::vector<core::LoopClosure> loops = core::TwoRounds::loops();
  run.first_round();
  run.go_away();
  run.second_round();
  run.idle(loops);
  ASSERT_FALSE(feed.is_stuck());
  ASSERT_FALSE(feed.corrections().empty());
  const core::MapCorrection closed = feed.corrections().back();
  ASSERT_EQ(closed.loops.size(), loops.size());
  EXPECT_TRUE(std::all_of(closed.loops.begin(), closed.loops.end(), [](const core::LoopVerdict& v) { return v.kept; }));
  EXPECT_GT(new_position(closed).norm(), 0.3) << "the drift is corrected";
  ASSERT_EQ(feed.merged().size(), 1U) << "one cup, seen twice";
  EXPECT_TRUE(feed.unmerged().empty());

  WithdrawLoop::Request request;
  WithdrawLoop::Response response;
  request.query_keyframe_id = loops[0].query_keyframe_id;
  request.match_keyframe_id = loops[0].match_keyframe_id + 1;
  ASSERT_TRUE(ros::service::call("/pose_graph/withdraw_loop", request, response));
  EXPECT_FALSE(response.success);
  EXPECT_NE(response.message.find("there is no accepted loop"), std::string::npos) << response.message;
  for (const core::LoopClosure& loop : loops) {
    request.query_keyframe_id = loop.query_keyframe_id;
    request.match_keyframe_id = loop.match_keyframe_id;
    ASSERT_TRUE(ros::service::call("/pose_graph/withdraw_loop", request, response));
    EXPECT_TRUE(response.success) << response.message;
  }
  const std::size_t before = feed.corrections().size();
  run.idle({});
  ASSERT_FALSE(feed.is_stuck());
  ASSERT_GT(feed.corrections().size(), before) << "the next frame is optimised without them";
  const core::MapCorrection reopened = feed.corrections()[before];
  EXPECT_TRUE(reopened.loops.empty());
  EXPECT_LT((old_position(reopened) - new_position(closed)).norm(), 1e-9) << "old and new transform are both told";
  EXPECT_LT(new_position(reopened).norm(), 0.05) << "the odometry is believed again";
  ASSERT_EQ(feed.unmerged().size(), 1U);
  EXPECT_EQ(feed.unmerged()[0].merged_id, feed.merged()[0].merged_id);
  EXPECT_EQ(feed.unmerged()[0].survivor_id, feed.merged()[0].survivor_id);
  chain.unload_all();
}

}  // namespace
}  // namespace semantic_topo_loop

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "withdraw_test");
  const ros::NodeHandle node;
  ros::AsyncSpinner spinner(2);
  spinner.start();
  return RUN_ALL_TESTS();
}
