#include <ros/publication.h>
#include <ros/subscriber_link.h>
#include <ros/topic_manager.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <std_msgs/Empty.h>
#include <visualization_msgs/MarkerArray.h>

#include <deque>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <vector>

#include "ros/conversions.h"
#include "ros/tum_bag.h"
#include "semantic_topo_loop/FrameDone.h"
#include "semantic_topo_loop/Keyframe.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"

namespace semantic_topo_loop {
namespace {

/// Sees what roscpp is given to publish, before it is passed on. Keeps every message alive, so that no address is used
/// twice.
class PublishProbe : public ros::SubscriberLink {
 public:
  void enqueueMessage(const ros::SerializedMessage& m, bool /*ser*/, bool nocopy) override {
    if (!nocopy || !m.message) return;
    const std::lock_guard<std::mutex> lock(mutex_);
    kept_.push_back(m.message);
    addresses_.insert(m.message.get());
  }
  void drop() override {}
  std::string getTransportType() override { return "probe"; }
  std::string getTransportInfo() override { return "probe"; }
  bool isIntraprocess() override { return true; }
  void getPublishTypes(bool& ser, bool& nocopy, const std::type_info& /*type*/) override {
    ser = false;
    nocopy = true;
  }
  bool has(const void* address) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return addresses_.count(address) > 0;
  }

 private:
  std::mutex mutex_;  ///< guards both below
  std::vector<boost::shared_ptr<void const>> kept_;
  std::set<const void*> addresses_;
};

/// Listens on one topic like any stage does.
struct Listener {
  std::string topic;
  std::size_t least = 0;  ///< messages that there must be
  boost::shared_ptr<PublishProbe> probe = boost::make_shared<PublishProbe>();
  ros::Subscriber subscriber;
  std::mutex mutex;  ///< guards received
  std::vector<boost::shared_ptr<void const>> received;
};

class ZeroCopy : public ::testing::Test {
 protected:
  template <class Message>
  void listen(const std::string& topic, std::size_t least = 20) {
    auto& listener = *listeners_.emplace_back(std::make_unique<Listener>());
    listener.topic = ros::names::resolve(topic);
    listener.least = least;
    const boost::function<void(const boost::shared_ptr<const Message>&)> callback =
        [&listener](const boost::shared_ptr<const Message>& message) {
          const std::lock_guard<std::mutex> lock(listener.mutex);
          listener.received.push_back(message);
        };
    listener.subscriber = node_.subscribe<Message>(listener.topic, 10000, callback);
    const ros::PublicationPtr publication = ros::TopicManager::instance()->lookupPublication(listener.topic);
    ASSERT_TRUE(publication) << listener.topic << " is not advertised in this process";
    publication->addSubscriberLink(listener.probe);
  }
  void listen_to_chain() {
    listen<FrameMessage>("frames");
    listen<Keyframe>("keyframes");
    listen<DetectionsMessage>("detections");
    listen<AssociationsMessage>("associations");
    listen<MapUpdateMessage>("quadric_map_updates");
    listen<LoopsMessage>("loop_closures");
    listen<CorrectionMessage>("map_corrections");
    listen<FrameDone>("frame_done");
  }

  void expect_nothing_copied() {
    for (const auto& listener : listeners_) {
      listener->subscriber.shutdown();
      const std::lock_guard<std::mutex> lock(listener->mutex);
      EXPECT_GE(listener->received.size(), listener->least) << listener->topic;
      std::size_t copied = 0;
      for (const auto& message : listener->received) copied += listener->probe->has(message.get()) ? 0 : 1;
      EXPECT_EQ(copied, 0u) << "of " << listener->received.size() << " messages on " << listener->topic;
    }
  }

  ros::NodeHandle node_;
  std::deque<std::unique_ptr<Listener>> listeners_;
};

TEST_F(ZeroCopy, WhatIsPublishedIsWhatIsReceived) {
  const core::TestDirectory directory;
  write_simulation({{"trajectory.duration_s", "8"}}, directory.path("data"));
  if (HasFatalFailure()) return;
  InProcessChain chain;
  chain.load_stages(directory.path("data"), directory.path("results"));
  chain.load_viewers();
  listen_to_chain();
  if (HasFatalFailure()) return;
  // Visualization reads frames while somebody looks at what it makes of them.
  const boost::function<void(const visualization_msgs::MarkerArray::ConstPtr&)> ignore = [](const auto&) {};
  const ros::Subscriber viewer = node_.subscribe<visualization_msgs::MarkerArray>("markers/keyframes", 1, ignore);
  const std::uint64_t decoded_before = decoded_frames();
  chain.load_player(directory.path("data"), true);
  ASSERT_EQ(chain.wait_for_end(60.0), "finished");
  chain.unload_all();
  EXPECT_EQ(decoded_frames(), decoded_before) << "every stage reads the front end's own Frame";
  expect_nothing_copied();
}

/// A textured wall that moves by two pixels an image, a metre away, in the layout of the TUM bags.
void write_bag(const std::string& file, int images) {
  constexpr std::uint32_t kWidth = 320, kHeight = 240;
  std::mt19937 random(1);
  std::vector<std::uint8_t> texture(1000 * kHeight);
  for (std::uint8_t& value : texture) value = static_cast<std::uint8_t>(random() % 256);
  rosbag::Bag bag(file, rosbag::bagmode::Write);
  for (int i = 0; i < images; ++i) {
    const ros::Time stamp(1000.0 + i / 30.0);
    sensor_msgs::CameraInfo info;
    to_msg(core::Camera{262.5, 262.5, 159.5, 119.5, 320, 240, {}}, &info);
    info.header = make_header(stamp, "openni_rgb_optical_frame");
    sensor_msgs::Image color, depth;
    color.header = depth.header = info.header;
    color.width = depth.width = color.step = kWidth;
    color.height = depth.height = kHeight;
    color.encoding = sensor_msgs::image_encodings::MONO8;
    for (std::uint32_t y = 0; y < kHeight; ++y) {
      for (std::uint32_t x = 0; x < kWidth; ++x) {
        // Blocks, so that there are corners to follow.
        const std::uint32_t column = (x + 2 * static_cast<std::uint32_t>(i)) / 6;
        color.data.push_back(texture[(y / 6) * 1000 + column]);
      }
    }
    depth.encoding = sensor_msgs::image_encodings::TYPE_16UC1;
    depth.step = 2 * kWidth;
    for (std::uint32_t p = 0; p < kWidth * kHeight; ++p) {
      depth.data.push_back(1000 % 256);
      depth.data.push_back(1000 / 256);
    }
    bag.write(tum_topic::kCameraInfo, stamp, info);
    bag.write(tum_topic::kColor, stamp, color);
    bag.write(tum_topic::kDepth, stamp, depth);
  }
}

TEST_F(ZeroCopy, ImagesPointsAndReports) {
  const core::TestDirectory directory;
  write_bag(directory.path("wall.bag"), 40);
  InProcessChain chain;
  chain.configure(directory.path("data"), directory.path("results"));
  chain.set("detection_ingestion", "source", "none");
  chain.set("player", "mode", "bag");
  chain.set("player", "bag_file", directory.path("wall.bag"));
  chain.set("player", "images", true);
  chain.set("player", "camera_file", std::string());
  chain.set("player", "await_results", true);
  chain.set("player", "stages", "Listener");
  for (const auto& [name, type] : std::map<std::string, std::string>{{"detection_ingestion", "DetectionIngestion"},
                                                                     {"object_association", "ObjectAssociation"},
                                                                     {"quadric_mapping", "QuadricMapping"},
                                                                     {"loop_detection", "LoopDetection"},
                                                                     {"pose_graph", "PoseGraph"},
                                                                     {"recorder", "Recorder"},
                                                                     {"point_mapping", "PointMapping"},
                                                                     {"rgbd_frontend", "RgbdFrontend"},
                                                                     {"player", "Player"}}) {
    chain.load(name, type);
  }
  listen<sensor_msgs::Image>("color");
  listen<sensor_msgs::Image>("depth");
  listen<KeyframePointsMessage>("keyframe_points", 1);
  listen<TrackingMessage>("tracking_report", 1);
  if (HasFatalFailure()) return;
  // Playback begins now.
  ros::Publisher acks = node_.advertise<SessionAck>("session_acks", 10);
  SessionAck ack;
  ack.session_id = 1;
  ack.stage = "Listener";
  acks.publish(ack);
  ASSERT_EQ(chain.wait_for_end(60.0), "finished");
  chain.unload_all();
  expect_nothing_copied();
}

TEST_F(ZeroCopy, AFrameFromOutsideIsDecodedOnceForAllStages) {
  constexpr int kStages = 6;
  std::mutex mutex;
  std::set<const FrameMessage*> frames;
  int heard = 0;
  const boost::function<void(const FrameMessage::ConstPtr&)> hear = [&](const FrameMessage::ConstPtr& frame) {
    const std::lock_guard<std::mutex> lock(mutex);
    frames.insert(frame.get());
    ++heard;
  };
  std::vector<ros::Subscriber> stages;
  for (int i = 0; i < kStages; ++i) stages.push_back(node_.subscribe<FrameMessage>("outside_frames", 10, hear));
  // Of the generated type, as from a program that knows no core.
  const ros::Publisher publisher = node_.advertise<Frame>("outside_frames", 10);
  const std::uint64_t decoded_before = decoded_frames();
  publisher.publish(boost::make_shared<Frame>());
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  const auto all_heard = [&] {
    const std::lock_guard<std::mutex> lock(mutex);
    return heard == kStages;
  };
  while (!all_heard() && std::chrono::steady_clock::now() < deadline) ros::WallDuration(0.01).sleep();
  EXPECT_TRUE(all_heard());
  EXPECT_EQ(decoded_frames(), decoded_before + 1);
  for (ros::Subscriber& stage : stages) stage.shutdown();
  EXPECT_EQ(frames.size(), 1u) << "one object for all of them";
}

}  // namespace
}  // namespace semantic_topo_loop
