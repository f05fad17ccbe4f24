#include <ros/publication.h>
#include <ros/subscriber_link.h>
#include <ros/topic_manager.h>
#include <sensor_msgs/CameraInfo.h>
#include <std_msgs/Empty.h>
#include <visualization_msgs/MarkerArray.h>

#include <deque>
#include <memory>
#include <set>
#include <vector>

#include "semantic_topo_loop/FrameDone.h"
#include "semantic_topo_loop/Keyframe.h"
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
  boost::shared_ptr<PublishProbe> probe = boost::make_shared<PublishProbe>();
  ros::Subscriber subscriber;
  std::mutex mutex;  ///< guards received
  std::vector<boost::shared_ptr<void const>> received;
};

class ZeroCopy : public ::testing::Test {
 protected:
  template <class Message>
  void listen(const std::string& topic) {
    auto& listener = *listeners_.emplace_back(std::make_unique<Listener>());
    listener.topic = ros::names::resolve(topic);
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
  for (const auto& listener : listeners_) {
    listener->subscriber.shutdown();
    const std::lock_guard<std::mutex> lock(listener->mutex);
    EXPECT_GT(listener->received.size(), 20u) << listener->topic;
    std::size_t copied = 0;
    for (const auto& message : listener->received) copied += listener->probe->has(message.get()) ? 0 : 1;
    EXPECT_EQ(copied, 0u) << "of " << listener->received.size() << " messages on " << listener->topic;
  }
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

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "zero_copy_test");
  const ros::NodeHandle node;
  ros::AsyncSpinner spinner(2);
  spinner.start();
  return RUN_ALL_TESTS();
}
