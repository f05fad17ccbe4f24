// Random messages, good and bad, on every topic, and services called at random. `_messages:=1000000 _seed:=7` for as
// many as wanted.
#include <dynamic_reconfigure/Reconfigure.h>
#include <nav_msgs/Odometry.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud2.h>
#include <sensor_msgs/image_encodings.h>
#include <std_msgs/Empty.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>

#include <atomic>
#include <functional>
#include <limits>
#include <random>
#include <thread>
#include <vector>

#include "ros/conversions.h"
#include "semantic_topo_loop/FrameDone.h"
#include "semantic_topo_loop/Keyframe.h"
#include "semantic_topo_loop/LoadMap.h"
#include "semantic_topo_loop/MapPart.h"
#include "semantic_topo_loop/QueryObjects.h"
#include "semantic_topo_loop/SaveMap.h"
#include "semantic_topo_loop/SavePoints.h"
#include "semantic_topo_loop/SaveTrajectory.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/WhyLoop.h"
#include "semantic_topo_loop/WithdrawLoop.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"

namespace semantic_topo_loop {
namespace {

/// 32 random bits.
class Random {
 public:
  using result_type = std::uint32_t;
  explicit Random(std::uint32_t seed) : engine_(seed) {}
  static constexpr result_type min() { return 0; }
  static constexpr result_type max() { return 0xFFFFFFFFU; }
  result_type operator()() { return static_cast<result_type>(engine_()); }

 private:
  std::mt19937 engine_;
};

/// Reads a message of whatever type from nowhere: every field is random, and often what nobody expects.
class RandomStream {
 public:
  static const ros::serialization::StreamType stream_type = ros::serialization::stream_types::Input;

  explicit RandomStream(Random* random) : random_(*random) {}

  template <class Value>
  void next(Value& value) {
    if constexpr (std::is_floating_point_v<Value>) {
      constexpr double kOdd[] = {0.0, -0.0, 1.0, -1.0, 1e300, -1e300, 1e-300, 0.5};
      const auto pick = random_() % 16;
      value = static_cast<Value>(pick < 8 ? kOdd[pick] : std::normal_distribution<double>(0.0, 10.0)(random_));
      if (pick == 8) value = std::numeric_limits<Value>::quiet_NaN();
      if (pick == 9) value = -std::numeric_limits<Value>::infinity();
    } else if constexpr (std::is_integral_v<Value>) {
      const auto pick = random_() % 8;
      value = static_cast<Value>(random_() % 50);
      if (pick == 0) value = std::numeric_limits<Value>::max();
      if (pick == 1) value = std::numeric_limits<Value>::min();
      if (pick == 2) value = static_cast<Value>((std::uint64_t{random_()} << 32U) | random_());
    } else {
      ros::serialization::deserialize(*this, value);
    }
  }
  void next(bool& value) { value = random_() % 2 == 0; }
  void next(ros::Time& value) {
    value = ros::Time(random_() % 3 == 0 ? random_() : 1000 + random_() % 5, random_() % 1000000000);
  }
  void next(std::string& value) {
    const char* const kNames[] = {"",      "/",     "odom", "map",        "camera", "/camera",
                                  "mono8", "16UC1", "x",    "\xff\xfe\n", "base"};
    value = kNames[random_() % std::size(kNames)];
  }
  template <class Value, class Allocator>
  void next(std::vector<Value, Allocator>& values) {
    values.resize(random_() % 20 == 0 ? 100 : random_() % 4);
    for (auto& value : values) next(value);
  }
  template <class Value, std::size_t size>
  void next(boost::array<Value, size>& values) {
    for (auto& value : values) next(value);
  }

 private:
  Random& random_;
};

/// Sends, and keeps count of what should be answered.
class Fuzzer {
 public:
  explicit Fuzzer(std::uint32_t seed) : random_(seed), stream_(&random_) {
    const boost::function<void(const SessionControl::ConstPtr&)> follow =
        [this](const SessionControl::ConstPtr& control) { session_ = control->session_id; };
    subscriber_ = node_.subscribe<SessionControl>("session_control", 100, follow);
    add_inputs();
    add_stages();
    add_services();
  }
  ~Fuzzer() { subscriber_.shutdown(); }

  void send() { senders_[random_() % senders_.size()](); }
  /// An image with all that belongs to it, of which a chain that lives makes a frame.
  void send_good(double time_s) {
    time_ = ros::Time(time_s);
    for (const Good& good : goods_) good();
    send_camera_info(true);
  }
  std::uint64_t images() const { return images_; }

 private:
  using Good = std::function<void()>;
  static constexpr int kWidth = 320, kHeight = 240;

  template <class Message>
  boost::shared_ptr<Message> make_random() {
    auto message = boost::make_shared<Message>();
    stream_.next(*message);
    return message;
  }
  /// Random messages on a topic, and, as often, good ones with one thing wrong or nothing.
  /// @return sends a good one, spoilt or not
  template <class Message>
  std::function<void(bool spoilt)> add_input(const std::string& topic, const std::function<void(Message*)>& make_good,
                                             const std::function<void(Message*)>& spoil = {}) {
    const ros::Publisher publisher = node_.advertise<Message>(topic, 100);
    senders_.push_back([this, publisher] { publisher.publish(make_random<Message>()); });
    const auto send_good = [this, publisher, make_good](const std::function<void(Message*)>& spoil) {
      auto message = boost::make_shared<Message>();
      make_good(message.get());
      if (spoil) spoil(message.get());
      publisher.publish(message);
    };
    senders_.push_back([this, send_good, spoil] {
      move_time();
      send_good(random_() % 2 == 0 ? spoil : nullptr);
    });
    goods_.push_back([send_good] { send_good({}); });
    return [send_good, spoil](bool spoilt) { send_good(spoilt ? spoil : nullptr); };
  }
  /// Of a stage to others: with the session that they are in, mostly.
  template <class Message>
  void add_stage(const std::string& topic) {
    const ros::Publisher publisher = node_.advertise<Message>(topic, 100);
    senders_.push_back([this, publisher] {
      auto message = make_random<Message>();
      if (random_() % 4 != 0) message->session_id = session_;
      publisher.publish(message);
    });
  }
  template <class Service>
  void add_service(const std::string& name) {
    senders_.push_back([this, name] {
      if (random_() % 20 != 0) return;
      Service service;
      stream_.next(service.request);
      ros::service::call(name, service);
    });
  }

  void move_time() {
    time_ += ros::Duration(0.03);
    if (random_() % 100 == 0) time_ += ros::Duration(5.0);
    if (random_() % 100 == 0 && time_.toSec() > 200.0) time_ -= ros::Duration(random_() % 100);
  }
  std_msgs::Header header(const std::string& frame_id) const { return make_header(time_, frame_id); }

  void send_camera_info(bool is_good) {
    auto message = is_good ? boost::make_shared<sensor_msgs::CameraInfo>() : make_random<sensor_msgs::CameraInfo>();
    if (is_good) {
      to_msg(core::Camera{262.5, 262.5, 159.5, 119.5, kWidth, kHeight, {}}, message.get());
      message->header = header("camera");
    } else if (random_() % 2 == 0) {
      to_msg(core::Camera{262.5, 262.5, 159.5, 119.5, kWidth, kHeight, {}}, message.get());
      message->width = message->height = 1000000;
    }
    camera_info_.publish(message);
    ++images_;
  }

  void add_inputs() {
    camera_info_ = node_.advertise<sensor_msgs::CameraInfo>("camera_info", 100);
    for (const bool is_good : {true, true, false}) {
      senders_.push_back([this, is_good] {
        move_time();
        send_camera_info(is_good);
      });
    }
    const auto transform = [this](const std::string& parent, const std::string& child) {
      return [this, parent, child](tf2_msgs::TFMessage* message) {
        message->transforms.push_back(make_transform(header(parent), child, core::SE3()));
      };
    };
    const auto spoil_transform = [this](tf2_msgs::TFMessage* message) {
      stream_.next(message->transforms[0].transform.translation.x);
      stream_.next(message->transforms[0].child_frame_id);
    };
    add_input<tf2_msgs::TFMessage>("/tf", transform("odom", "base"), spoil_transform);
    add_input<tf2_msgs::TFMessage>("/tf_static", transform("base", "camera"));
    add_input<nav_msgs::Odometry>(
        "odometry",
        [this](nav_msgs::Odometry* message) {
          message->header = header("odom");
          message->child_frame_id = "base";
          message->pose.pose.orientation.w = 1.0;
        },
        [this](nav_msgs::Odometry* message) { stream_.next(message->pose.pose.position.y); });
    add_input<sensor_msgs::PointCloud2>(
        "points",
        [this](sensor_msgs::PointCloud2* message) {
          to_cloud(std::vector<core::Vec3>{{0.0, 0.0, 1.0}, {0.1, 0.0, 1.0}}, message);
          message->header = header("camera");
        },
        [this](sensor_msgs::PointCloud2* message) {
          stream_.next(random_() % 2 == 0 ? message->width : message->point_step);
        });
    const auto color = add_image("color", false), depth = add_image("depth", true);
    senders_.push_back([this, color, depth] {
      move_time();
      send_camera_info(true);
      color(random_() % 8 == 0);
      depth(random_() % 8 == 0);
    });
    add_input<DetectionArray>(
        "detections_in",
        [this](DetectionArray* message) {
          message->header = header("camera");
          message->detections.resize(3);
          for (std::size_t i = 0; i < 3; ++i) {
            Detection& detection = message->detections[i];
            detection.class_id = 41;
            detection.score = 0.9;
            detection.box.x1 = 5.0 + 20.0 * static_cast<double>(i);
            detection.box.x2 = detection.box.x1 + 10.0;
            detection.box.y1 = 10.0;
            detection.box.y2 = 20.0;
          }
        },
        [this](DetectionArray* message) { message->detections.push_back(*make_random<Detection>()); });
    for (const char* topic : {"end_of_stream", "session_queries"}) {
      const ros::Publisher publisher = node_.advertise<std_msgs::Empty>(topic, 100);
      senders_.push_back([this, publisher] {
        if (random_() % 20 == 0) publisher.publish(boost::make_shared<std_msgs::Empty>());
      });
    }
  }

  std::function<void(bool)> add_image(const std::string& topic, bool is_depth) {
    return add_input<sensor_msgs::Image>(
        topic,
        [this, is_depth](sensor_msgs::Image* message) {
          message->header = header("camera");
          message->width = kWidth;
          message->height = kHeight;
          message->encoding = is_depth ? sensor_msgs::image_encodings::TYPE_16UC1 : sensor_msgs::image_encodings::MONO8;
          message->step = is_depth ? 2 * kWidth : kWidth;
          // Every depth is 1.028 m; the blocks of the colour image have corners to follow.
          for (std::uint32_t y = 0; y < message->height; ++y) {
            for (std::uint32_t x = 0; x < message->step; ++x) {
              const std::uint32_t block = (y / 6) * message->width + x / 6;
              message->data.push_back(is_depth ? 4 : static_cast<std::uint8_t>((block * 2654435761U) >> 24U));
            }
          }
        },
        [this](sensor_msgs::Image* message) {
          switch (random_() % 4) {
            case 0:
              message->data.resize(random_() % 5000);
              break;
            case 1:
              stream_.next(message->encoding);
              break;
            case 2:
              stream_.next(message->height);
              break;
            default:
              stream_.next(message->step);
          }
        });
  }

  void add_stages() {
    add_stage<Frame>("frames");
    add_stage<DetectionArray>("detections");
    add_stage<AssociationArray>("associations");
    add_stage<QuadricMapUpdate>("quadric_map_updates");
    add_stage<QuadricMap>("quadric_map");
    add_stage<LoopClosureArray>("loop_closures");
    add_stage<MapCorrection>("map_corrections");
    add_stage<Keyframe>("keyframes");
    add_stage<KeyframePoints>("keyframe_points");
    add_stage<TrackingReport>("tracking_report");
    add_stage<MapPart>("map_parts");
    add_stage<SessionAck>("session_acks");
  }

  void add_services() {
    for (const char* name : {"pose_frontend/reset", "pose_frontend/pause", "pose_frontend/resume",
                             "rgbd_frontend/reset", "recorder/save_results"}) {
      add_service<std_srvs::Trigger>("/" + std::string(name));
    }
    for (const char* name : {"loop_detection/set_loop_closing", "pose_frontend/set_localization_mode"}) {
      add_service<std_srvs::SetBool>("/" + std::string(name));
    }
    for (const char* name : {"loop_detection", "object_association", "pose_graph", "quadric_mapping"}) {
      add_service<dynamic_reconfigure::Reconfigure>("/" + std::string(name) + "/set_parameters");
    }
    add_service<LoadMap>("/pose_frontend/load_map");
    add_service<SaveMap>("/map_database/save_map");
    add_service<QueryObjects>("/quadric_mapping/query_objects");
    add_service<SaveTrajectory>("/pose_graph/save_trajectory");
    add_service<WhyLoop>("/loop_detection/why_loop");
    add_service<WithdrawLoop>("/pose_graph/withdraw_loop");
    add_service<SavePoints>("/point_mapping/save_points");
  }

  Random random_;
  RandomStream stream_;
  ros::NodeHandle node_;
  ros::Subscriber subscriber_;
  ros::Publisher camera_info_;
  std::atomic<std::uint32_t> session_{1};
  ros::Time time_{1000.0};
  std::vector<std::function<void()>> senders_;
  std::vector<Good> goods_;
  std::uint64_t images_ = 0;
};

class Fuzz : public ::testing::Test {
 protected:
  void load(const std::string& frontend, const std::string& type) {
    const core::TestDirectory& directory = directory_;
    chain_.configure(directory.path("data"), directory.path("results"));
    chain_.set("pose_frontend", "pose_source", "odometry");
    chain_.set("pose_frontend", "use_points", true);
    chain_.set("pose_frontend", "pose_timeout_s", 0.05);
    chain_.set("detection_ingestion", "source", "topic");
    chain_.set("detection_ingestion", "detection_timeout_s", 0.05);
    chain_.set("map_database", "save_map_file", directory.path("map.db"));
    for (const char* name : {"point_mapping", "map_database", "pose_graph", "pose_frontend", "rgbd_frontend"}) {
      chain_.set(name, "save_dir", directory.path("saved"));
    }
    for (const auto& [name, stage] : std::map<std::string, std::string>{{"detection_ingestion", "DetectionIngestion"},
                                                                        {"object_association", "ObjectAssociation"},
                                                                        {"quadric_mapping", "QuadricMapping"},
                                                                        {"loop_detection", "LoopDetection"},
                                                                        {"map_database", "MapDatabase"},
                                                                        {"pose_graph", "PoseGraph"},
                                                                        {"point_mapping", "PointMapping"},
                                                                        {"visualization", "Visualization"},
                                                                        {"recorder", "Recorder"},
                                                                        {frontend, type}}) {
      chain_.load(name, stage);
    }
  }
  /// Sends, then asks the chain for a frame.
  void run(Fuzzer* fuzzer) {
    std::atomic<int> processed{0};
    const boost::function<void(const FrameDone::ConstPtr&)> count = [&](const FrameDone::ConstPtr& done) {
      processed += done->status == FrameDone::STATUS_PROCESSED ? 1 : 0;
    };
    ros::NodeHandle node;
    ros::Subscriber subscriber = node.subscribe<FrameDone>("frame_done", 1000, count);
    const int messages = ros::param::param("~messages", 4000) / 2;
    for (int i = 0; i < messages; ++i) {
      fuzzer->send();
      if (i % 4 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    for (const char* service : {"/pose_frontend/resume", "/pose_frontend/reset", "/rgbd_frontend/reset"}) {
      std_srvs::Trigger call;
      ros::service::call(service, call);
    }
    const int before = processed;
    double time_s = 100000.0;
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (processed < before + 5 && std::chrono::steady_clock::now() < deadline) {
      fuzzer->send_good(time_s += 0.05);
      std::this_thread::sleep_for(std::chrono::milliseconds(30));
    }
    EXPECT_GE(processed, before + 5) << "the chain lives";
    subscriber.shutdown();
  }
  void expect_counted(const std::string& stage, const std::vector<std::string>& causes) {
    for (const std::string& cause : causes) {
      EXPECT_TRUE(wait_until([&] { return diagnostics_.count(stage, cause) > 0; })) << stage << ": " << cause;
    }
  }

  const core::TestDirectory directory_;
  Diagnostics diagnostics_;
  InProcessChain chain_;
};

TEST_F(Fuzz, PosesOfAnOdometry) {
  load("pose_frontend", "PoseFrontend");
  Fuzzer fuzzer(static_cast<std::uint32_t>(ros::param::param("~seed", 1)));
  run(&fuzzer);
  expect_counted("PoseFrontend", {"camera_info without a usable calibration", "bad odometry", "bad transforms",
                                  "images without a pose"});
  expect_counted("QuadricMapping", {"dropped, other session"});
  chain_.unload_all();
}

TEST_F(Fuzz, Images) {
  load("rgbd_frontend", "RgbdFrontend");
  Fuzzer fuzzer(static_cast<std::uint32_t>(ros::param::param("~seed", 1)) + 1);
  run(&fuzzer);
  expect_counted("RgbdFrontend", {"camera_info without a usable calibration", "unusable images"});
  chain_.unload_all();
}

}  // namespace
}  // namespace semantic_topo_loop
