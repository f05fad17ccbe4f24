// What a stage does that cannot keep up, and the chain under a load: 60 boxes at 30 Hz. `_duration_s:=600
// _max_tf_age_s:=0.2` for a long run whose map -> odom must never be older.
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>
#include <visualization_msgs/MarkerArray.h>

#include <cmath>
#include <cstdlib>
#include <future>
#include <random>
#include <thread>
#include <vector>

#include "ros/stage.h"
#include "semantic_topo_loop/Keyframe.h"
#include "support/in_process_chain.h"

namespace semantic_topo_loop {
namespace {

using Clock = std::chrono::steady_clock;

/// A stage that stops at its first frame until it is let go.
class SlowStage : public Stage {
 public:
  static constexpr int kQueueSize = 5;

  SlowStage() : Stage("Slow") {}
  ~SlowStage() override { stop(); }

  /// As a nodelet manager does.
  void load(const std::string& name = "/slow") {
    init(name, {}, {}, ros::getGlobalCallbackQueue(), ros::getGlobalCallbackQueue());
  }
  void let_go() { gate_.set_value(); }

  std::atomic<bool> is_stopped{false};
  std::atomic<int> frames{0}, updates{0}, ticks{0}, sessions{0}, ends{0}, calls{0};

 private:
  void onInit() override {
    core::Options options;
    StageParameters parameters;
    if (!start(&options, &parameters, 1)) return;
    serve("call", &SlowStage::on_call);
    subscribe("frames", Keep::kDroppable, &SlowStage::on_frame);
    subscribe("quadric_map_updates", Keep::kAlways, &SlowStage::on_update);
    start_timer(0.01, [this] { ++ticks; });
    follow_sessions();
  }
  void reset_session() override { ++sessions; }
  void on_frame(const FrameMessage::ConstPtr& frame) {
    if (frame->frame_id == 0) {
      is_stopped = true;
      gate_.get_future().wait();
    }
    ++frames;
    if (frame->is_end) ++ends;
    count_processed();
  }
  void on_update(const MapUpdateMessage::ConstPtr& /*update*/) { ++updates; }
  /// Waits for the worker, as a service may.
  bool on_call(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    ++calls;
    wait_until([this] { return frames > 0; });
    response.success = true;
    return true;
  }

  std::promise<void> gate_;
};

class Backpressure : public ::testing::Test {
 protected:
  void SetUp() override {
    ros::param::set("/slow/queue_size", SlowStage::kQueueSize);
    frames_ = node_.advertise<FrameMessage>("frames", 1000);
    updates_ = node_.advertise<MapUpdateMessage>("quadric_map_updates", 1000);
    control_ = node_.advertise<SessionControl>("session_control", 10);
    stage_.load();
    start_session(1);
    ASSERT_TRUE(wait_until([this] { return stage_.sessions == 1; })) << "a frame may overtake its session";
    send(0);
    ASSERT_TRUE(wait_until([this] { return stage_.is_stopped.load(); }));
  }
  void start_session(std::uint32_t session) {
    session_ = session;
    auto start = boost::make_shared<SessionControl>();
    start->header.stamp = ros::Time(session);
    start->session_id = session;
    start->command = SessionControl::COMMAND_START;
    control_.publish(start);
  }
  void send(std::int64_t frame_id, bool is_end = false) {
    CameraFrame frame;
    frame.frame_id = frame_id;
    frame.is_end = is_end;
    frames_.publish(boost::make_shared<FrameMessage>(std_msgs::Header(), session_, frame));
    // Slowly enough for roscpp's own queue.
    std::this_thread::sleep_for(std::chrono::milliseconds(3));
  }

  ros::NodeHandle node_;
  ros::Publisher frames_, updates_, control_;
  std::uint32_t session_ = 0;
  Diagnostics diagnostics_;
  SlowStage stage_;
};

TEST_F(Backpressure, DropsAreCountedByTopicAndShown) {
  constexpr int kFrames = 40;
  for (int i = 1; i <= kFrames; ++i) send(i);
  const std::uint64_t dropped = kFrames - SlowStage::kQueueSize;
  EXPECT_TRUE(wait_until([&] { return diagnostics_.count("Slow", "dropped, queue full: frames") == dropped; }))
      << diagnostics_.count("Slow", "dropped, queue full: frames");
  EXPECT_EQ(diagnostics_.count("Slow", "dropped, queue full"), dropped);
  EXPECT_EQ(diagnostics_.of("Slow")["summary"], "frames were lost");
  stage_.let_go();
  EXPECT_TRUE(wait_until([this] { return stage_.frames == 1 + SlowStage::kQueueSize; }));
  EXPECT_TRUE(wait_until([this] { return diagnostics_.of("Slow")["summary"] == "working"; })) << "it is over";
}

TEST_F(Backpressure, WhatNeverArrivesIsCounted) {
  stage_.let_go();
  for (const int frame_id : {1, 2, 5, 6, 9}) send(frame_id);
  EXPECT_TRUE(wait_until([this] { return diagnostics_.count("Slow", "never arrived: frames") == 4; }))
      << diagnostics_.count("Slow", "never arrived: frames");
  EXPECT_EQ(diagnostics_.of("Slow")["summary"], "frames were lost");
  start_session(2);
  ASSERT_TRUE(wait_until([this] { return stage_.sessions == 2; }));
  send(7);
  send(8);
  const int reports = diagnostics_.reports();
  EXPECT_TRUE(wait_until([&] { return diagnostics_.reports() > reports + 1; }));
  EXPECT_EQ(diagnostics_.count("Slow", "never arrived: frames"), 4U) << "a session may be joined late";
}

/// A correction that takes longer than a frame comes after the next frames' observations.
TEST_F(Backpressure, OfEachPhaseOfTheMapsUpdatesOneAFrameArrives) {
  stage_.let_go();
  constexpr auto kObservation = core::MapUpdatePhase::kObservation, kCorrection = core::MapUpdatePhase::kCorrection;
  const std::vector<std::pair<std::int64_t, core::MapUpdatePhase>> updates{
      {1, kObservation}, {2, kObservation}, {1, kCorrection}, {3, kObservation},
      {2, kCorrection},  {5, kObservation}, {3, kCorrection}};
  for (const auto& [frame_id, phase] : updates) {
    core::MapUpdate update;
    update.frame_id = frame_id;
    update.phase = phase;
    updates_.publish(boost::make_shared<MapUpdateMessage>(std_msgs::Header(), session_, update));
  }
  EXPECT_TRUE(wait_until([&] { return stage_.updates == static_cast<int>(updates.size()); }));
  EXPECT_TRUE(wait_until([this] { return diagnostics_.count("Slow", "never arrived: quadric_map_updates") > 0; }));
  EXPECT_EQ(diagnostics_.count("Slow", "never arrived: quadric_map_updates"), 1U) << "the observation of frame 4";
}

TEST_F(Backpressure, WhatIsOfAnotherSessionIsLeftOutAndCounted) {
  stage_.let_go();
  ASSERT_TRUE(wait_until([this] { return stage_.frames == 1; }));
  session_ = 99;
  send(1);
  send(2);
  EXPECT_TRUE(wait_until([this] { return diagnostics_.count("Slow", "dropped, other session") == 2; }));
  EXPECT_EQ(stage_.frames, 1);
  EXPECT_EQ(diagnostics_.of("Slow")["summary"], "working") << "a new session loses nothing";
}

TEST_F(Backpressure, SessionsTimersAndTheEndSurviveAStall) {
  const int ticks = stage_.ticks, sessions = stage_.sessions;
  start_session(2);
  for (int i = 0; i < 200; ++i) {
    send(i + 1, i == 100);
    if (i % 20 == 0) start_session(3);
  }
  stage_.let_go();
  EXPECT_TRUE(wait_until([&] { return stage_.ticks > ticks + 10; })) << "the timer goes on";
  EXPECT_EQ(stage_.sessions, sessions + 2);
  EXPECT_EQ(stage_.ends, 1);
}

TEST_F(Backpressure, AServiceThatWaitsHoldsNobodyUp) {
  std::future<bool> answer = std::async(std::launch::async, [] {
    std_srvs::Trigger call;
    return ros::service::call("/slow/call", call) && call.response.success;
  });
  ASSERT_TRUE(wait_until([this] { return stage_.calls == 1; }));
  // Diagnostics and arrivals go on all the while.
  const int reports = diagnostics_.reports();
  for (int i = 1; i <= 3; ++i) send(i);
  EXPECT_TRUE(wait_until([&] { return diagnostics_.reports() > reports + 1; }));
  EXPECT_NE(diagnostics_.of("Slow")["frames rate"], "");
  EXPECT_GE(diagnostics_.count("Slow", "queue length"), 3U);
  stage_.let_go();
  EXPECT_TRUE(answer.get());
}

TEST_F(Backpressure, AStageSaysSoWhileItWorks) {
  std::mutex mutex;
  int said = 0;
  const boost::function<void(const std_msgs::String::ConstPtr&)> hear = [&](const std_msgs::String::ConstPtr& stage) {
    const std::lock_guard<std::mutex> lock(mutex);
    said += stage->data == "Slow" ? 1 : 0;
  };
  ros::Subscriber subscriber = node_.subscribe<std_msgs::String>("working", 10, hear);
  const auto count = [&] {
    const std::lock_guard<std::mutex> lock(mutex);
    return said;
  };
  EXPECT_TRUE(wait_until([&] { return count() >= 2; }));
  stage_.let_go();
  ASSERT_TRUE(wait_until([this] { return stage_.frames == 1; }));
  const int before = count(), reports = diagnostics_.reports();
  EXPECT_TRUE(wait_until([&] { return diagnostics_.reports() > reports + 2; }));
  EXPECT_LE(count(), before + 1);
  subscriber.shutdown();
}

TEST(Diagnostics, AStageThatDoesNotWorkShowsItsValuesAllTheSame) {
  ros::param::set("/broken/no_such_key", 1);
  Diagnostics diagnostics;
  SlowStage stage;
  stage.load("/broken");
  EXPECT_TRUE(wait_until([&] { return !diagnostics.of("Slow")["errors"].empty(); }));
  auto values = diagnostics.of("Slow");
  EXPECT_NE(values["summary"].find("unknown parameter 'no_such_key'"), std::string::npos) << values["summary"];
  EXPECT_EQ(values["errors"], "0");
  EXPECT_GT(std::atof(values["memory of the process"].c_str()), 1.0) << values["memory of the process"];
}

TEST(Diagnostics, AFrontEndWithoutItsTransportNamesItAndIsInert) {
  Diagnostics diagnostics;
  InProcessChain chain;
  chain.set("deaf_frontend", "depth_transport", "nonsense");
  chain.load("deaf_frontend", "RgbdFrontend");
  const auto summary = [&] { return diagnostics.of("RgbdFrontend")["summary"]; };
  EXPECT_TRUE(wait_until([&] { return summary().find("parameter 'depth_transport' = 'nonsense': ") == 0; }))
      << summary();
  EXPECT_EQ(summary().find('\n'), std::string::npos) << summary();
  EXPECT_FALSE(ros::service::exists("/deaf_frontend/reset", false));
  chain.unload_all();
}

/// Follows the camera at its own pace, not at the end of its queue.
TEST(RgbdFrontend, LeavesOutImagesThatAreFarBehindTheNewest) {
  constexpr int kImages = 30;
  Diagnostics diagnostics;
  InProcessChain chain;
  chain.set("late_frontend", "camera_file", STL_CONFIG_DIR "/camera/tum_fr2.yaml");
  chain.set("late_frontend", "max_lag_s", 0.01);
  for (const char* topic : {"color", "depth", "sync"}) {
    chain.set("late_frontend", topic + std::string("_queue_size"), kImages);
  }
  chain.load("late_frontend", "RgbdFrontend");
  ros::NodeHandle node;
  ros::Publisher color = node.advertise<sensor_msgs::Image>("color", kImages);
  ros::Publisher depth = node.advertise<sensor_msgs::Image>("depth", kImages);
  ASSERT_TRUE(wait_until([&] { return color.getNumSubscribers() > 0 && depth.getNumSubscribers() > 0; }));
  std::mt19937 random(1);
  const auto make_image = [](const std::string& encoding, std::uint32_t bytes) {
    auto image = boost::make_shared<sensor_msgs::Image>();
    image->width = 640;
    image->height = 480;
    image->encoding = encoding;
    image->step = 640 * bytes;
    image->data.resize(480 * image->step, 4);
    return image;
  };
  std::vector<sensor_msgs::ImagePtr> colors;
  for (int i = 0; i < kImages; ++i) {
    colors.push_back(make_image("mono8", 1));
    for (std::uint8_t& pixel : colors.back()->data) pixel = static_cast<std::uint8_t>(random());
  }
  // All at once, as after a stall.
  for (int i = 0; i < kImages; ++i) {
    const sensor_msgs::ImagePtr image = colors[static_cast<std::size_t>(i)], of_depth = make_image("16UC1", 2);
    image->header = of_depth->header = make_header(ros::Time(100.0 + i), "camera");
    color.publish(image);
    depth.publish(of_depth);
  }
  const auto late = [&] { return diagnostics.count("RgbdFrontend", "dropped, late"); };
  const auto looked_at = [&] {
    return diagnostics.count("RgbdFrontend", "frames processed") +
           diagnostics.count("RgbdFrontend", "images lost track of") +
           diagnostics.count("RgbdFrontend", "images with nothing to follow");
  };
  EXPECT_TRUE(wait_until([&] { return late() + looked_at() == kImages; })) << late() << " and " << looked_at();
  EXPECT_GT(late(), 0U);
  EXPECT_GT(looked_at(), 0U) << "the newest";
  chain.unload_all();
}

TEST(Player, WaitsForWhoWorksAndNamesWhoDoesNot) {
  const core::TestDirectory directory;
  write_simulation({{"trajectory.duration_s", "2"}}, directory.path("data"));
  if (::testing::Test::HasFatalFailure()) return;
  InProcessChain chain;
  chain.configure_player(directory.path("data"), true);
  chain.set("player", "stages", "");
  chain.set("player", "stall_timeout_s", 2.0);
  ros::NodeHandle node;
  ros::Publisher control = node.advertise<SessionControl>("session_control", 10, true);
  ros::Publisher working = node.advertise<std_msgs::String>("working", 10);
  std::atomic<int> images{0};
  const boost::function<void(const sensor_msgs::CameraInfo::ConstPtr&)> hear = [&](const auto&) { ++images; };
  ros::Subscriber subscriber = node.subscribe<sensor_msgs::CameraInfo>("camera_info", 10, hear);
  chain.load("player", "Player");
  SessionControl start;
  start.session_id = 1;
  control.publish(start);
  ASSERT_TRUE(wait_until([&] { return images == 1; }));
  std_msgs::String stage;
  stage.data = "PoseGraph";
  // Twice as long as its patience.
  for (int i = 0; i < 8; ++i) {
    working.publish(stage);
    EXPECT_EQ(chain.wait_for_end(0.5), "");
  }
  EXPECT_EQ(chain.wait_for_end(20.0), "stalled: PoseFrontend");
  subscriber.shutdown();
  chain.unload_all();
}

/// A camera that goes round among 60 objects.
class Scene {
 public:
  static constexpr int kObjects = 60;

  Scene() {
    info_ = node_.advertise<sensor_msgs::CameraInfo>("camera_info", 100);
    detections_ = node_.advertise<DetectionsMessage>("detections_in", 100);
    tf_ = node_.advertise<tf2_msgs::TFMessage>("/tf", 100);
    std::mt19937 random(1);
    std::uniform_real_distribution<double> place(-1.0, 1.0);
    for (int i = 0; i < kObjects; ++i) {
      objects_.emplace_back(1.2 * place(random), 0.9 * place(random), 3.0 + 0.8 * place(random));
    }
  }

  void send(double time_s, const ros::Time& stamp) {
    const core::SE3 T_odom_camera(core::Quaternion::Identity(),
                                  {0.4 * std::sin(0.6 * time_s), 0.3 * std::cos(0.6 * time_s), 0.0});
    auto transforms = boost::make_shared<tf2_msgs::TFMessage>();
    transforms->transforms.push_back(make_transform(make_header(stamp, "odom"), "camera", T_odom_camera));
    tf_.publish(transforms);
    const core::Camera camera{520.0, 520.0, 319.5, 239.5, 640, 480, {}};
    auto detections = boost::make_shared<DetectionsMessage>();
    detections->header = make_header(stamp, "camera");
    for (int i = 0; i < kObjects; ++i) {
      const core::Vec3 p = objects_[static_cast<std::size_t>(i)] - T_odom_camera.t;
      const double x = camera.fx * p.x() / p.z() + camera.cx, y = camera.fy * p.y() / p.z() + camera.cy;
      const double half = 0.05 * camera.fx / p.z();
      detections->detections.push_back({24 + i % 50, 0.9, {x - half, y - half, x + half, y + half}});
    }
    detections_.publish(detections);
    auto info = boost::make_shared<sensor_msgs::CameraInfo>();
    to_msg(camera, info.get());
    info->header = detections->header;
    info_.publish(info);
  }

 private:
  ros::NodeHandle node_;
  ros::Publisher info_, detections_, tf_;
  std::vector<core::Vec3> objects_;
};

TEST(Load, SixtyBoxesAtThirtyHertz) {
  const double duration_s = ros::param::param("~duration_s", 10.0);
  const double max_tf_age_s = ros::param::param("~max_tf_age_s", 0.0);  // 0: on a machine that does other things, too
  const core::TestDirectory directory;
  InProcessChain chain;
  chain.configure(directory.path("data"), directory.path("results"));
  chain.set("pose_frontend", "pose_source", "tf");
  chain.set("detection_ingestion", "source", "topic");
  for (const auto& [name, type] : std::map<std::string, std::string>{{"pose_frontend", "PoseFrontend"},
                                                                     {"detection_ingestion", "DetectionIngestion"},
                                                                     {"object_association", "ObjectAssociation"},
                                                                     {"quadric_mapping", "QuadricMapping"},
                                                                     {"loop_detection", "LoopDetection"},
                                                                     {"pose_graph", "PoseGraph"},
                                                                     {"visualization", "Visualization"}}) {
    chain.load(name, type);
  }
  Diagnostics diagnostics;
  ros::NodeHandle node;
  std::vector<ros::Subscriber> listeners;
  // rviz.
  std::atomic<int> shown{0};
  const boost::function<void(const visualization_msgs::MarkerArray::ConstPtr&)> show = [&](const auto&) { ++shown; };
  for (const char* topic : {"quadrics", "labels", "topology", "loops", "keyframes"}) {
    listeners.push_back(node.subscribe<visualization_msgs::MarkerArray>("markers/" + std::string(topic), 10, show));
  }
  std::atomic<std::uint64_t> answered{0}, processed{0};
  const boost::function<void(const FrameDone::ConstPtr&)> count = [&](const FrameDone::ConstPtr& done) {
    ++answered;
    processed += done->status == FrameDone::STATUS_PROCESSED ? 1 : 0;
  };
  listeners.push_back(node.subscribe<FrameDone>("frame_done", 1000, count));
  std::mutex mutex;
  ros::Time newest_tf;
  const boost::function<void(const tf2_msgs::TFMessage::ConstPtr&)> take_tf = [&](const auto& message) {
    for (const auto& transform : message->transforms) {
      if (transform.header.frame_id != "map" || transform.child_frame_id != "odom") continue;
      const std::lock_guard<std::mutex> lock(mutex);
      newest_tf = transform.header.stamp;
    }
  };
  listeners.push_back(node.subscribe<tf2_msgs::TFMessage>("/tf", 1000, take_tf));

  Scene scene;
  const auto begin = Clock::now();
  const auto images = static_cast<std::uint64_t>(30.0 * duration_s);
  double oldest_s = 0.0;
  for (std::uint64_t i = 0; i < images; ++i) {
    const double time_s = static_cast<double>(i) / 30.0;
    std::this_thread::sleep_until(begin +
                                  std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(time_s)));
    const ros::Time stamp = ros::Time::now();
    scene.send(time_s, stamp);
    const std::lock_guard<std::mutex> lock(mutex);
    if (time_s > 2.0) oldest_s = std::max(oldest_s, (stamp - newest_tf).toSec());
  }
  // What was dropped has a name: of every image that found no answer, a stage says where it went.
  // (Drops of full queues are told in all, too, and by topic.)
  const auto named = [&] {
    return diagnostics.sum("dropped, ") - diagnostics.sum("dropped, queue full: ") + diagnostics.sum("never arrived: ");
  };
  EXPECT_TRUE(wait_until([&] { return answered + named() >= images; }))
      << answered << " of " << images << " answered, " << named() << " drops named";
  EXPECT_GT(processed, images / 2);
  EXPECT_GT(shown, 0);
  std::printf("%lu images, %lu processed, map -> odom %.3f s old at most, %lu drops named\n",
              static_cast<unsigned long>(images), static_cast<unsigned long>(processed), oldest_s,
              static_cast<unsigned long>(named()));
  if (max_tf_age_s > 0.0) {
    EXPECT_LE(oldest_s, max_tf_age_s);
  }
  for (ros::Subscriber& listener : listeners) listener.shutdown();
  chain.unload_all();
}

}  // namespace
}  // namespace semantic_topo_loop
