// Nodelets are loaded and unloaded in random order under traffic. `_rounds:=500 _seed:=7` for as often as wanted.
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <std_msgs/Empty.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <atomic>
#include <map>
#include <mutex>
#include <random>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include "ros/conversions.h"
#include "ros/stage.h"
#include "semantic_topo_loop/FrameDone.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"

namespace semantic_topo_loop {
namespace {

const std::vector<std::pair<std::string, std::string>> kNodelets = {{"pose_frontend", "PoseFrontend"},
                                                                    {"rgbd_frontend", "RgbdFrontend"},
                                                                    {"detection_ingestion", "DetectionIngestion"},
                                                                    {"object_detector", "ObjectDetector"},
                                                                    {"object_association", "ObjectAssociation"},
                                                                    {"quadric_mapping", "QuadricMapping"},
                                                                    {"loop_detection", "LoopDetection"},
                                                                    {"map_database", "MapDatabase"},
                                                                    {"pose_graph", "PoseGraph"},
                                                                    {"point_mapping", "PointMapping"},
                                                                    {"visualization", "Visualization"},
                                                                    {"recorder", "Recorder"},
                                                                    {"player", "Player"}};

/// What a robot sends, from this process: images, detections and tf at 30 Hz, and queries at 1 kHz.
class Traffic {
 public:
  Traffic() {
    info_ = node_.advertise<sensor_msgs::CameraInfo>("camera_info", 10);
    color_ = node_.advertise<sensor_msgs::Image>("color", 10);
    depth_ = node_.advertise<sensor_msgs::Image>("depth", 10);
    detections_ = node_.advertise<DetectionsMessage>("detections_in", 10);
    tf_ = node_.advertise<tf2_msgs::TFMessage>("/tf", 10);
    queries_ = node_.advertise<std_msgs::Empty>("session_queries", 10);
    images_thread_ = std::thread([this] { repeat(std::chrono::microseconds(33333), [this] { send_image(); }); });
    queries_thread_ = std::thread([this] {
      repeat(std::chrono::milliseconds(1), [this] { queries_.publish(boost::make_shared<std_msgs::Empty>()); });
    });
  }
  ~Traffic() {
    stop_ = true;
    images_thread_.join();
    queries_thread_.join();
  }

 private:
  template <class Period, class Task>
  void repeat(Period period, Task task) {
    auto next = std::chrono::steady_clock::now();
    while (!stop_) {
      task();
      next += period;
      std::this_thread::sleep_until(next);
    }
  }

  void send_image() {
    const ros::Time stamp = ros::Time::now();
    const std_msgs::Header header = make_header(stamp, "camera");
    const core::Camera camera{120.0, 120.0, 79.5, 59.5, 160, 120, {}};
    auto transforms = boost::make_shared<tf2_msgs::TFMessage>();
    transforms->transforms.push_back(make_transform(make_header(stamp, "odom"), "camera", core::SE3()));
    tf_.publish(transforms);
    auto info = boost::make_shared<sensor_msgs::CameraInfo>();
    to_msg(camera, info.get());
    info->header = header;
    info_.publish(info);
    auto color = boost::make_shared<sensor_msgs::Image>();
    color->header = header;
    color->width = color->step = 160;
    color->height = 120;
    color->encoding = sensor_msgs::image_encodings::MONO8;
    for (std::size_t i = 0; i < 160 * 120; ++i) color->data.push_back(static_cast<std::uint8_t>((i / 7 * 37) % 251));
    auto depth = boost::make_shared<sensor_msgs::Image>(*color);
    depth->encoding = sensor_msgs::image_encodings::TYPE_16UC1;
    depth->step = 320;
    depth->data.assign(320 * 120, 4);  // 1.028 m everywhere
    color_.publish(color);
    depth_.publish(depth);
    auto detections = boost::make_shared<DetectionsMessage>();
    detections->header = header;
    detections->detections.push_back({41, 0.9, {40.0, 40.0, 80.0, 80.0}});
    detections_.publish(detections);
  }

  ros::NodeHandle node_;
  ros::Publisher info_, color_, depth_, detections_, tf_, queries_;
  std::atomic<bool> stop_{false};
  std::thread images_thread_, queries_thread_;
};

/// Counts the frames that are through with the chain.
class DoneCounter {
 public:
  DoneCounter() {
    const boost::function<void(const FrameDone::ConstPtr&)> count = [this](const FrameDone::ConstPtr& done) {
      if (done->status == FrameDone::STATUS_PROCESSED) ++processed_;
    };
    subscriber_ = node_.subscribe<FrameDone>("frame_done", 100, count);
  }
  ~DoneCounter() { subscriber_.shutdown(); }
  bool wait_for_more(int frames) const {
    const int enough = processed_ + frames;
    return wait_until([this, enough] { return processed_ >= enough; });
  }

 private:
  ros::NodeHandle node_;
  ros::Subscriber subscriber_;
  std::atomic<int> processed_{0};
};

TEST(Load, EveryNodeletComesAndGoesUnderTraffic) {
  const int rounds = ros::param::param("~rounds", 20);
  std::mt19937 random(static_cast<std::uint32_t>(ros::param::param("~seed", 1)));
  const core::TestDirectory directory;
  write_simulation({{"trajectory.duration_s", "2"}}, directory.path("data"));
  if (HasFatalFailure()) return;
  const DoneCounter done;
  InProcessChain chain;
  chain.configure(directory.path("data"), directory.path("results"));
  chain.configure_player(directory.path("data"), true);
  chain.set("pose_frontend", "pose_source", "tf");
  chain.set("detection_ingestion", "source", "topic");
  chain.set("object_detector", "class_table", STL_CONFIG_DIR "/classes_coco.yaml");
  if (const auto model = core::shared_data("models/yolox_nano.onnx")) {
    chain.set("object_detector", "detector/model", *model);
  }
  const Traffic traffic;
  std::set<std::string> loaded;
  const auto toggle = [&](const std::pair<std::string, std::string>& nodelet) {
    const auto& [name, type] = nodelet;
    if (loaded.erase(name) > 0) return chain.unload(name);
    chain.load(name, type);
    loaded.insert(name);
  };
  // Each is loaded and unloaded `rounds` times.
  for (int half = 0; half < 2 * rounds && !HasFatalFailure(); ++half) {
    auto order = kNodelets;
    std::shuffle(order.begin(), order.end(), random);
    for (const auto& nodelet : order) {
      toggle(nodelet);
      std::this_thread::sleep_for(std::chrono::milliseconds(random() % 20));
    }
  }
  EXPECT_TRUE(loaded.empty());
  // What is left works.
  for (const auto& nodelet : kNodelets) {
    if (nodelet.first != "rgbd_frontend" && nodelet.first != "player") toggle(nodelet);
  }
  EXPECT_TRUE(done.wait_for_more(10));
  chain.unload_all();
}

TEST(Load, AFrontEndThatIsLoadedUnderTrafficHasItsSession) {
  InProcessChain chain;
  chain.set("pose_frontend", "pose_source", "tf");
  const Traffic traffic;
  for (int i = 0; i < ros::param::param("~rounds", 20); ++i) {
    for (const auto& [name, type] : {kNodelets[0], kNodelets[1]}) {
      chain.load(name, type);
      std::atomic<bool> is_open{false};
      const boost::function<void(const SessionControl::ConstPtr&)> hear = [&](const SessionControl::ConstPtr& control) {
        if (control->command == SessionControl::COMMAND_START && control->session_id == 1) is_open = true;
      };
      ros::NodeHandle node;
      ros::Subscriber subscriber = node.subscribe<SessionControl>("session_control", 10, hear);
      EXPECT_TRUE(wait_until([&is_open] { return is_open.load(); })) << type << ", the " << i << ". time";
      subscriber.shutdown();
      chain.unload(name);
    }
  }
}

/// A stage on a queue like a nodelet manager's.
template <class StageType>
struct Managed {
  explicit Managed(const std::string& name) {
    spinner.start();
    stage.init(name, {}, {}, &queue, &queue);
  }
  ros::CallbackQueue queue;
  ros::AsyncSpinner spinner{1, &queue};
  StageType stage;
};

/// Its timer's task takes longer than anything else in `stop`.
class SlowTicker : public Stage {
 public:
  SlowTicker() : Stage("SlowTicker") {}
  ~SlowTicker() override { stop(); }
  using Stage::stop;
  std::atomic<int> begun{0}, ended{0}, heard{0};

 private:
  void onInit() override {
    const boost::function<void(const std_msgs::Empty::ConstPtr&)> hear = [this](const auto&) { ++heard; };
    keep_subscriber(subscriber_node().subscribe<std_msgs::Empty>("slow_ticker_input", 10, hear));
    keep_timer(0.01, [this] {
      ++begun;
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
      ++ended;
    });
  }
};

TEST(Load, NoMessageWaitsForATimersTaskAndTheStageDoesNotGoBeforeIt) {
  Managed<SlowTicker> managed("/slow_ticker");
  SlowTicker& stage = managed.stage;
  ros::NodeHandle node;
  const ros::Publisher publisher = node.advertise<std_msgs::Empty>("slow_ticker_input", 10);
  ASSERT_TRUE(wait_until([&stage] { return stage.begun > 0; }));
  publisher.publish(boost::make_shared<std_msgs::Empty>());
  EXPECT_TRUE(wait_until([&stage] { return stage.heard > 0; }));
  EXPECT_EQ(stage.ended, 0) << "the task takes half a second";
  stage.stop();
  EXPECT_EQ(stage.begun, stage.ended);
}

/// Hears nothing for a while.
class BusyListener : public StageWith<StageParameters> {
 public:
  BusyListener() : StageWith("BusyListener") {}
  ~BusyListener() override { stop(); }
  std::atomic<bool> is_busy{false};
  std::atomic<int> heard{0};

 private:
  void onInit() override {
    if (!start(1)) return;
    set_session(1);
    const boost::function<void(const std_msgs::Empty::ConstPtr&)> wait = [this](const auto&) {
      is_busy = true;
      std::this_thread::sleep_for(std::chrono::milliseconds(300));
    };
    keep_subscriber(subscriber_node().subscribe<std_msgs::Empty>("busy_listener_wait", 1, wait));
    subscribe("busy_listener_input", Keep::kAlways, &BusyListener::on_frame);
    open_queue();
  }
  void on_frame(const FrameMessage::ConstPtr&) { ++heard; }
};

TEST(Load, WhatLaterFramesBuildOnIsNotLostWhileAStageHearsNothing) {
  Managed<BusyListener> managed("/busy_listener");
  BusyListener& stage = managed.stage;
  ros::NodeHandle node;
  const ros::Publisher wait = node.advertise<std_msgs::Empty>("busy_listener_wait", 10);
  const ros::Publisher frames = node.advertise<FrameMessage>("busy_listener_input", 10);
  wait.publish(boost::make_shared<std_msgs::Empty>());
  ASSERT_TRUE(wait_until([&stage] { return stage.is_busy.load(); }));
  constexpr int kFrames = 500;
  for (int i = 0; i < kFrames; ++i) {
    const auto frame = boost::make_shared<FrameMessage>();
    frame->session_id = 1;
    frame->frame_id = i;
    frames.publish(frame);
  }
  EXPECT_TRUE(wait_until([&stage] { return stage.heard == kFrames; })) << stage.heard;
}

TEST(Load, AStageThatIsLoadedLateHearsOfEverySessionAtOnce) {
  std::mutex mutex;  // guards acknowledged
  std::map<std::string, std::uint32_t> acknowledged;
  const boost::function<void(const SessionAck::ConstPtr&)> hear = [&](const SessionAck::ConstPtr& ack) {
    const std::lock_guard<std::mutex> lock(mutex);
    acknowledged[ack->stage] = ack->session_id;
  };
  ros::NodeHandle node;
  const ros::Subscriber subscriber = node.subscribe<SessionAck>("session_acks", 100, hear);
  const auto has_acknowledged = [&](const std::string& stage, std::uint32_t session_id) {
    return wait_until([&] {
      const std::lock_guard<std::mutex> lock(mutex);
      return acknowledged[stage] == session_id;
    });
  };
  InProcessChain chain;
  chain.set("pose_frontend", "pose_source", "tf");
  chain.load("pose_frontend", "PoseFrontend");
  const std::vector<std::string> stages = {"PoseGraph", "PointMapping"};
  for (const auto& [name, type] : kNodelets) {
    if (std::count(stages.begin(), stages.end(), type) > 0) chain.load(name, type);
  }
  for (const std::string& stage : stages) EXPECT_TRUE(has_acknowledged(stage, 1)) << stage;
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros::service::call("/pose_frontend/reset", reset));
  for (const std::string& stage : stages) EXPECT_TRUE(has_acknowledged(stage, 2)) << stage;
  chain.unload_all();
}

}  // namespace
}  // namespace semantic_topo_loop
