// What PoseGraph makes of loops: corrections and tf, of loops that come late or from outside, of one that is withdrawn
// by service, and of a new session; and that no stage misses a frame whose boxes are lost.
#include <nav_msgs/Path.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "ros/conversions.h"
#include "semantic_topo_loop/ExternalLoop.h"
#include "semantic_topo_loop/QueryObjects.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/WithdrawLoop.h"
#include "semantic_topo_loop/geometry/lie.h"
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
    external_loops_ = node_.advertise<ExternalLoop>("external_loops", 10);
    acks_ = node_.subscribe<SessionAck>("session_acks", 10, &Feed::take_ack, this);
    corrections_ = node_.subscribe<CorrectionMessage>("map_corrections", 1000, &Feed::take_correction, this);
    updates_ = node_.subscribe<MapUpdateMessage>("quadric_map_updates", 1000, &Feed::take_update, this);
    tf_ = node_.subscribe<tf2_msgs::TFMessage>("/tf", 1000, &Feed::take_tf, this);
    for (const char* topic : {"path_odometry", "path_corrected"}) {
      const boost::function<void(const nav_msgs::Path::ConstPtr&)> take = [this, topic](const auto& path) {
        const std::lock_guard<std::mutex> lock(mutex_);
        paths_[topic] = path;
        changed_.notify_all();
      };
      path_subscribers_.push_back(node_.subscribe<nav_msgs::Path>(topic, 10, take));
    }
  }

  /// @param stages that are to acknowledge it
  bool start_session(std::uint32_t session = kSession, int stages = 2) {
    SessionControl start;
    start.header.stamp = ros::Time(session);
    start.session_id = session_ = session;
    start.command = SessionControl::COMMAND_START;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      acknowledged_ = 0;
    }
    control_.publish(start);
    return wait([this, stages] { return acknowledged_ >= stages; });
  }

  /// In the order of the chain, each stage awaited, so that the run is the same every time.
  void step(const core::Frame& frame, const core::AssociationFrame& associations,
            const std::vector<core::LoopClosure>& loops) {
    if (is_stuck_) return;
    begin_step(frame, associations);
    publish_loops(frame, loops);
    is_stuck_ = is_stuck_ || !wait([&] { return completed_ == frame.frame_id; });
    EXPECT_FALSE(is_stuck_) << "no answer to frame " << frame.frame_id;
  }
  /// As step, as far as it goes without the frame's loops.
  void begin_step(const core::Frame& frame, const core::AssociationFrame& associations) {
    AssociationsMessage seen(header_of(frame), session_, associations);
    seen.frame_id = frame.frame_id;
    publish_frame(frame);
    associations_.publish(seen);
    is_stuck_ = !wait([&] { return observed_ == frame.frame_id; });
  }
  void publish_frame(const core::Frame& frame) {
    frames_.publish(FrameMessage(header_of(frame), session_, CameraFrame{frame, "camera"}));
  }
  void publish_loops(const core::Frame& frame, const std::vector<core::LoopClosure>& loops) {
    loops_.publish(LoopsMessage(header_of(frame), session_, FrameLoops{frame.frame_id, 0.0, loops, {}, {}}));
  }

  void publish(const ExternalLoop& loop) { external_loops_.publish(loop); }

  /// Transforms between map and odom, as sent.
  std::vector<geometry_msgs::TransformStamped> tf() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return tf_sent_;
  }
  /// Waits for the next transform.
  bool wait_for_tf() {
    const std::size_t before = tf().size();
    return wait([this, before] { return tf_sent_.size() > before + 1; });
  }

  /// Poses of each path, once both have the stamp.
  std::map<std::string, std::size_t> path_sizes(const ros::Time& stamp) {
    EXPECT_TRUE(wait([this, &stamp] {
      return paths_.size() == 2 && std::all_of(paths_.begin(), paths_.end(), [&stamp](const auto& path) {
               return path.second->header.stamp == stamp;
             });
    }));
    const std::lock_guard<std::mutex> lock(mutex_);
    std::map<std::string, std::size_t> sizes;
    for (const auto& [topic, path] : paths_) sizes[topic] = path->poses.size();
    return sizes;
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
  static std_msgs::Header header_of(const core::Frame& frame) {
    return make_header(to_ros_time(frame.stamp_ns), "odom");
  }
  void take_tf(const tf2_msgs::TFMessage::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const geometry_msgs::TransformStamped& transform : message->transforms) {
      if (transform.child_frame_id == "odom" || transform.header.frame_id == "odom") tf_sent_.push_back(transform);
    }
    changed_.notify_all();
  }
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
  ros::Publisher control_, frames_, associations_, loops_, external_loops_;
  ros::Subscriber acks_, corrections_, updates_, tf_;
  std::vector<ros::Subscriber> path_subscribers_;
  std::uint32_t session_ = kSession;
  bool is_stuck_ = false;
  std::mutex mutex_;  ///< guards all below but the condition
  std::condition_variable changed_;
  int acknowledged_ = 0;
  std::int64_t observed_ = -1, completed_ = -1;
  std::vector<core::MapCorrection> changes_;
  std::vector<core::LandmarkMerge> merged_, unmerged_;
  std::vector<geometry_msgs::TransformStamped> tf_sent_;
  std::map<std::string, nav_msgs::Path::ConstPtr> paths_;  ///< the last by topic
};

core::Frame first_frame(double time_s) {
  core::Frame frame;
  frame.frame_id = frame.keyframe_id = 0;
  frame.is_keyframe = true;
  frame.stamp_ns = static_cast<std::int64_t>(time_s * 1e9);
  return frame;
}

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
  run.both_rounds();
  run.idle(loops);
  ASSERT_FALSE(feed.is_stuck());
  ASSERT_FALSE(feed.corrections().empty());
  const core::MapCorrection closed = feed.corrections().back();
  const auto verdicts = [&feed] {
    std::map<std::int64_t, core::LoopVerdict> last;
    for (const core::MapCorrection& correction : feed.corrections()) {
      for (const core::LoopVerdict& verdict : correction.loops) last.insert_or_assign(verdict.number, verdict);
    }
    return last;
  };
  ASSERT_EQ(verdicts().size(), loops.size());
  for (const auto& [number, verdict] : verdicts()) EXPECT_TRUE(verdict.kept) << number;
  EXPECT_GT(new_position(closed).norm(), 0.3) << "the drift is corrected";
  ASSERT_TRUE(feed.wait_for_tf());
  const geometry_msgs::TransformStamped sent = feed.tf().back();
  EXPECT_EQ(sent.header.frame_id, "map");
  const geometry_msgs::Vector3& t = sent.transform.translation;
  const geometry_msgs::Quaternion& q = sent.transform.rotation;
  EXPECT_LT((core::Vec3(t.x, t.y, t.z) - new_position(closed)).norm(), 1e-9) << "from odom to map, not the other way";
  EXPECT_LT(core::rotation_angle(core::Quaternion(q.w, q.x, q.y, q.z), closed.T_map_odom.q), 1e-9);
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
  ASSERT_EQ(verdicts().size(), loops.size());
  for (const auto& [number, verdict] : verdicts()) {
    EXPECT_FALSE(verdict.kept) << number;
    EXPECT_EQ(verdict.reason, "withdrawn") << number;
  }
  EXPECT_LT((old_position(reopened) - new_position(closed)).norm(), 1e-9) << "old and new transform are both told";
  EXPECT_LT(new_position(reopened).norm(), 0.05) << "the odometry is believed again";
  ASSERT_EQ(feed.unmerged().size(), 1U);
  EXPECT_EQ(feed.unmerged()[0].merged_id, feed.merged()[0].merged_id);
  EXPECT_EQ(feed.unmerged()[0].survivor_id, feed.merged()[0].survivor_id);
  chain.unload_all();
}

TEST(LateLoops, OfAFrameThatWentInWithoutThemCloseWithALaterOne) {
  InProcessChain chain;
  chain.load_correction();
  Feed feed;
  ASSERT_TRUE(feed.start_session());
  std::optional<core::Frame> late_frame;
  std::vector<core::LoopClosure> late_loops;
  core::TwoRounds run([&](const core::Frame& frame, const core::AssociationFrame& associations,
                          const std::vector<core::LoopClosure>& loops) {
    if (!loops.empty()) {
      late_frame = frame;
      late_loops = loops;
      return feed.begin_step(frame, associations);
    }
    feed.step(frame, associations, {});
    if (late_frame) feed.publish_loops(*std::exchange(late_frame, std::nullopt), late_loops);
  });
  run.both_rounds();
  run.idle(core::TwoRounds::loops());
  ASSERT_FALSE(feed.is_stuck());
  ASSERT_FALSE(feed.corrections().empty());
  EXPECT_EQ(feed.corrections().back().loops.size(), late_loops.size());
  EXPECT_GT(new_position(feed.corrections().back()).norm(), 0.3) << "the drift is corrected";
  chain.unload_all();
}

TEST(LoopDetection, HearsOfAFrameWhoseBoxesAreLost) {
  InProcessChain chain;
  chain.load_correction();
  chain.load("loop_detection", "LoopDetection");
  Feed feed;
  std::mutex mutex;
  std::map<std::int64_t, LoopsMessage::ConstPtr> heard;  // by frame
  ros::NodeHandle node;
  const boost::function<void(const LoopsMessage::ConstPtr&)> take = [&](const LoopsMessage::ConstPtr& loops) {
    const std::lock_guard<std::mutex> lock(mutex);
    heard[loops->frame_id] = loops;
  };
  const ros::Subscriber subscriber = node.subscribe<LoopsMessage>("loop_closures", 10, take);
  ASSERT_TRUE(feed.start_session(kSession, 3));
  constexpr std::int64_t kFrames = 4, kLost = 2;
  for (std::int64_t i = 0; i < kFrames; ++i) {
    core::Frame frame = first_frame(10.0 + 0.5 * static_cast<double>(i));
    frame.frame_id = frame.keyframe_id = i;
    if (i != kLost) {
      feed.begin_step(frame, {});
      continue;
    }
    frame.is_break = true;
    frame.source_loop = core::SourceLoop{first_frame(10.0).stamp_ns, {}, core::Mat6::Identity(), 100};
    feed.publish_frame(frame);
  }
  EXPECT_TRUE(wait_until([&] {
    const std::lock_guard<std::mutex> lock(mutex);
    return heard.size() == kFrames;
  }));
  const std::lock_guard<std::mutex> lock(mutex);
  ASSERT_EQ(heard.count(kLost), 1U);
  ASSERT_EQ(heard[kLost]->closures.size(), 1U) << "what the odometry's source found";
  EXPECT_EQ(heard[kLost]->closures[0].match_frame, 0);
  chain.unload_all();
}

TEST(QuadricMapping, TakesUpBoxesInAKeyframeWhoseOwnAreLost) {
  InProcessChain chain;
  chain.load_correction();
  Feed feed;
  ASSERT_TRUE(feed.start_session());
  core::Frame frame = first_frame(10.0);
  frame.camera = {500.0, 500.0, 319.5, 239.5, 640, 480, {}};
  feed.begin_step(frame, {});
  const auto go_on = [&frame](bool is_keyframe) {
    ++frame.frame_id;
    frame.stamp_ns += 100'000'000;
    frame.is_keyframe = is_keyframe;
    frame.keyframe_id += is_keyframe ? 1 : 0;
  };
  go_on(true);
  feed.publish_frame(frame);  // and no boxes
  core::AssociationFrame cup;
  cup.associations.resize(1);
  cup.associations[0].landmark_id = 7;
  cup.associations[0].class_id = cup.associations[0].landmark_class_id = 41;
  cup.associations[0].box = {300.0, 200.0, 340.0, 260.0};
  cup.associations[0].score = 0.9;
  go_on(false);
  feed.begin_step(frame, cup);
  EXPECT_FALSE(feed.is_stuck());
  QueryObjects query;
  ASSERT_TRUE(ros::service::call("/quadric_mapping/query_objects", query));
  ASSERT_EQ(query.response.objects.size(), 1U) << query.response.message;
  EXPECT_EQ(query.response.objects[0].id, 7);
  chain.unload_all();
}

TEST(ObjectAssociation, LoadedInMidStreamPassesAFrameOnWhoseDetectionsAreLost) {
  InProcessChain chain;
  chain.load("object_association", "ObjectAssociation");
  Feed feed;
  std::mutex mutex;
  std::vector<AssociationsMessage::ConstPtr> heard;
  ros::NodeHandle node;
  const boost::function<void(const AssociationsMessage::ConstPtr&)> take = [&](const auto& associations) {
    const std::lock_guard<std::mutex> lock(mutex);
    heard.push_back(associations);
  };
  const ros::Subscriber subscriber = node.subscribe<AssociationsMessage>("associations", 10, take);
  ros::Publisher detections = node.advertise<DetectionsMessage>("detections", 10);
  ASSERT_TRUE(feed.start_session(kSession, 1));
  constexpr std::int64_t kFirst = 90, kFrames = 4, kLost = 2;
  for (std::int64_t i = 0; i < kFrames; ++i) {
    core::Frame frame = first_frame(10.0 + 0.1 * static_cast<double>(i));
    frame.frame_id = kFirst + i;
    frame.is_keyframe = i == 0;
    frame.camera = {500.0, 500.0, 319.5, 239.5, 640, 480, {}};
    feed.publish_frame(frame);
    if (i == kLost) continue;
    DetectionsMessage seen(make_header(to_ros_time(frame.stamp_ns), "odom"), kSession, {});
    seen.frame_id = frame.frame_id;
    seen.detections = {{41, 0.9, {300.0, 200.0, 340.0, 260.0}}};
    detections.publish(seen);
  }
  EXPECT_TRUE(wait_until([&] {
    const std::lock_guard<std::mutex> lock(mutex);
    return heard.size() == kFrames;
  }));
  const std::lock_guard<std::mutex> lock(mutex);
  for (std::size_t i = 0; i < heard.size(); ++i) {
    EXPECT_EQ(heard[i]->frame_id, kFirst + static_cast<std::int64_t>(i));
    EXPECT_EQ(heard[i]->unanswered, i == kLost);
  }
  EXPECT_GT(heard.at(0)->associations.at(0).landmark_id, 10 * kFirst) << "ids were given out before it was loaded";
  chain.unload_all();
}

TEST(ExternalLoops, BetweenAnyImagesCloseAsOthersDoAndSaySo) {
  InProcessChain chain;
  chain.load_correction();
  Feed feed;
  ASSERT_TRUE(feed.start_session());
  std::map<std::int64_t, core::Frame> frames;
  core::TwoRounds run(
      [&](const core::Frame& frame, const core::AssociationFrame& associations, const std::vector<core::LoopClosure>&) {
        frames[frame.frame_id] = frame;
        feed.step(frame, associations, {});
      });
  run.both_rounds();
  ExternalLoop message;
  message.match_from_query.pose.orientation.w = 1.0;
  for (std::size_t i = 0; i < 36; i += 7) message.match_from_query.covariance[i] = 1e-6;
  constexpr std::int64_t kAfterKeyframe = 2;  // images that are no keyframes
  std::vector<std::pair<std::int64_t, std::int64_t>> closed;
  for (const core::LoopClosure& loop : core::TwoRounds::loops()) {
    const core::Frame& query = frames.at(loop.query_frame + kAfterKeyframe);
    const core::Frame& match = frames.at(loop.match_frame + kAfterKeyframe);
    ASSERT_FALSE(query.is_keyframe);
    message.header.stamp = to_ros_time(query.stamp_ns);
    message.match_stamp = to_ros_time(match.stamp_ns);
    feed.publish(message);
    closed.emplace_back(loop.query_keyframe_id, loop.match_keyframe_id);
  }
  message.match_stamp = ros::Time(0.5);  // before the session
  feed.publish(message);
  message.match_stamp = message.header.stamp;
  feed.publish(message);
  run.idle({});
  ASSERT_FALSE(feed.is_stuck());
  ASSERT_FALSE(feed.corrections().empty());
  std::map<std::int64_t, core::LoopVerdict> verdicts;
  for (const core::MapCorrection& correction : feed.corrections()) {
    for (const core::LoopVerdict& verdict : correction.loops) verdicts.insert_or_assign(verdict.number, verdict);
  }
  ASSERT_EQ(verdicts.size(), closed.size()) << "those of no use are left out";
  for (const auto& [number, verdict] : verdicts) {
    EXPECT_TRUE(verdict.kept && verdict.is_extra) << number;
    EXPECT_EQ(std::pair(verdict.query_keyframe_id, verdict.match_keyframe_id),
              closed[static_cast<std::size_t>(number)]);
  }
  EXPECT_GT(new_position(feed.corrections().back()).norm(), 0.3) << "the drift is corrected";
  chain.unload_all();
}

TEST(MapToOdom, IsSentTheOtherWayRoundBelowAnotherMap) {
  InProcessChain chain;
  for (const char* nodelet : {"pose_graph", "quadric_mapping"}) chain.set(nodelet, "map_frame", "object_map");
  chain.set("pose_graph", "map_below_odom", true);
  chain.load_correction();
  ros::param::del("/pose_graph");
  ros::param::del("/quadric_mapping/map_frame");
  Feed feed;
  ASSERT_TRUE(feed.start_session());
  core::TwoRounds run([&feed](const core::Frame& frame, const core::AssociationFrame& associations,
                              const std::vector<core::LoopClosure>& loops) { feed.step(frame, associations, loops); });
  run.both_rounds();
  run.idle(core::TwoRounds::loops());
  ASSERT_FALSE(feed.corrections().empty());
  ASSERT_TRUE(feed.wait_for_tf());
  for (const geometry_msgs::TransformStamped& sent : feed.tf()) {
    EXPECT_EQ(sent.header.frame_id, "odom");
    EXPECT_EQ(sent.child_frame_id, "object_map");
  }
  const geometry_msgs::Vector3& t = feed.tf().back().transform.translation;
  EXPECT_LT((core::Vec3(t.x, t.y, t.z) - feed.corrections().back().T_map_odom.inverse().t).norm(), 1e-9);
  chain.unload_all();
}

TEST(MapToOdom, IsSentByNobodyWhereItIsTurnedOff) {
  InProcessChain chain;
  chain.set("pose_graph", "publish_tf", false);
  chain.load_correction();
  ros::param::del("/pose_graph");
  Feed feed;
  ASSERT_TRUE(feed.start_session());
  feed.step(first_frame(1000.0), {}, {});
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_TRUE(feed.tf().empty());
  chain.unload_all();
}

TEST(MapToOdom, FollowsTimeThatJumpsBackWithTheSession) {
  InProcessChain chain;
  chain.load_correction();
  Feed feed;
  for (const std::uint32_t session : {1U, 2U}) {
    ASSERT_TRUE(feed.start_session(session));
    const std::size_t before = feed.tf().size();
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    EXPECT_LE(feed.tf().size(), before + 1) << "nothing is said before the session's first pose";
    const double begin_s = session == 1 ? 1000.0 : 10.0;
    feed.step(first_frame(begin_s), {}, {});
    ASSERT_TRUE(feed.wait_for_tf());
    EXPECT_NEAR(feed.tf().back().header.stamp.toSec(), begin_s + 0.1, 0.01) << session;
  }
  chain.unload_all();
}

TEST(Sessions, TheSecondKnowsNothingOfTheFirst) {
  InProcessChain chain;
  chain.load_correction();
  Feed feed;
  ASSERT_TRUE(feed.start_session());
  core::TwoRounds run([&](const core::Frame& frame, const core::AssociationFrame& associations,
                          const std::vector<core::LoopClosure>& loops) { feed.step(frame, associations, loops); });
  run.both_rounds();
  run.idle(core::TwoRounds::loops());
  ASSERT_FALSE(feed.is_stuck());
  ASSERT_FALSE(feed.corrections().empty());

  ASSERT_TRUE(feed.start_session(2));
  const core::Frame frame = first_frame(50000.0);
  feed.step(frame, {}, {});
  ASSERT_TRUE(feed.wait_for_tf());
  const geometry_msgs::Vector3 t = feed.tf().back().transform.translation;
  EXPECT_EQ(core::Vec3(t.x, t.y, t.z), core::Vec3::Zero()) << "nothing is corrected yet";
  const std::map<std::string, std::size_t> expected{{"path_corrected", 2}, {"path_odometry", 2}};  // keyframe and frame
  EXPECT_EQ(feed.path_sizes(to_ros_time(frame.stamp_ns)), expected);
  chain.unload_all();
}

}  // namespace
}  // namespace semantic_topo_loop
