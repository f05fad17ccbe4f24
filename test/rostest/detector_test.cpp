// A real network on real images in the chain's first part: front end, detector, ingestion; and the last two alone.
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <iterator>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "geometry/up_estimator.h"
#include "ros/conversions.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/frontend/object_detector.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"
#include "support/package_config.h"
#include "support/rolled_image.h"
#include "support/tiny_yolo.h"

namespace semantic_topo_loop {
namespace {

void expect_same(const std::vector<core::Detection>& a, const std::vector<core::Detection>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < b.size(); ++k) {
    EXPECT_EQ(a[k].class_id, b[k].class_id);
    EXPECT_EQ(a[k].score, b[k].score);
    EXPECT_EQ(a[k].box.edges(), b[k].box.edges());
  }
}

sensor_msgs::Image::ConstPtr image_message(std::int64_t stamp_ns, const cv::Mat& pixels) {
  auto image = boost::make_shared<sensor_msgs::Image>();
  image->header = make_header(to_ros_time(stamp_ns), "camera");
  image->width = static_cast<std::uint32_t>(pixels.cols);
  image->height = static_cast<std::uint32_t>(pixels.rows);
  image->step = static_cast<std::uint32_t>(pixels.step);
  image->encoding = sensor_msgs::image_encodings::BGR8;
  image->data.assign(pixels.datastart, pixels.dataend);
  return image;
}

class DetectorInTheChain : public testing::Test {
 protected:
  void SetUp() override {
    const auto model = core::shared_detector(), folder = core::shared_folder("tum/fr1_xyz", "rgb.txt");
    if (!model) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set, or OpenCV too old";
    model_ = *model;
    for (const auto& [stamp_ns, path] : core::checked(core::list_color_images(*folder))) {
      images_.push_back({stamp_ns, path});
    }
  }

  void load(bool lockstep, double rate_hz) {
    info_ = node_.advertise<sensor_msgs::CameraInfo>("camera_info", 100);
    color_ = node_.advertise<sensor_msgs::Image>("color", 100);
    tf_ = node_.advertise<tf2_msgs::TFMessage>("/tf", 100);
    answers_ = node_.subscribe("detections", 100, &DetectorInTheChain::take, this);
    chain_ = std::make_unique<InProcessChain>();
    chain_->set("object_detector", "class_table", STL_CONFIG_DIR "/classes_coco.yaml");
    chain_->set("object_detector", "lockstep", lockstep);
    chain_->set("object_detector", "detector/model", model_);
    chain_->set("object_detector", "detector/rate_hz", rate_hz);
    chain_->set("detection_ingestion", "class_table", STL_CONFIG_DIR "/classes_coco.yaml");
    constexpr double kForever = 60.0;
    chain_->set("detection_ingestion", "detection_timeout_s", kForever);
    chain_->set("pose_frontend", "pose_source", "tf");
    chain_->set("pose_frontend", "pose_timeout_s", kForever);
    chain_->load("detection_ingestion", "DetectionIngestion");
    chain_->load("object_detector", "ObjectDetector");
    // What comes before a stage knows of the session is not of it.
    std::set<std::string> ready;  // stages
    const boost::function<void(const SessionAck::ConstPtr&)> acknowledge = [this, &ready](const auto& ack) {
      const std::lock_guard<std::mutex> lock(mutex_);
      ready.insert(ack->stage);
      changed_.notify_all();
    };
    const ros::Subscriber acks = node_.subscribe<SessionAck>("session_acks", 100, acknowledge);
    chain_->load("pose_frontend", "PoseFrontend");
    std::unique_lock<std::mutex> lock(mutex_);
    ASSERT_TRUE(changed_.wait_for(lock, std::chrono::minutes(1), [&ready] { return ready.size() == 2; }));
  }
  void TearDown() override {
    answers_.shutdown();
    if (chain_) chain_->unload_all();
  }

  cv::Mat image(std::size_t index) const { return core::checked(core::read_color_image(images_[index].second)); }

  void send(std::size_t index, const core::Quaternion& q_odom_camera = core::Quaternion::Identity()) {
    send(index, image(index), q_odom_camera);
  }
  void send(std::size_t index, const cv::Mat& pixels, const core::Quaternion& q_odom_camera) {
    const sensor_msgs::Image::ConstPtr image = image_message(images_[index].first, pixels);
    auto transforms = boost::make_shared<tf2_msgs::TFMessage>();
    transforms->transforms.push_back(make_transform(make_header(image->header.stamp, "odom"), "camera",
                                                    core::SE3(q_odom_camera, core::Vec3::Zero())));
    tf_.publish(transforms);
    auto info = boost::make_shared<sensor_msgs::CameraInfo>();
    to_msg(core::Camera{517.3, 516.5, 318.6, 255.3, 640, 480, {}}, info.get());
    info->header = image->header;
    info_.publish(info);
    color_.publish(image);
  }

  void take(const DetectionsMessage::ConstPtr& answer) {
    const std::lock_guard<std::mutex> lock(mutex_);
    received_.push_back(answer);
    changed_.notify_all();
  }
  /// What ingestion says of the first `count` frames; fewer after a minute.
  std::vector<DetectionsMessage::ConstPtr> wait_for(std::size_t count) {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait_for(lock, std::chrono::minutes(1), [this, count] { return received_.size() >= count; });
    return received_;
  }

  std::string model_;
  std::vector<std::pair<std::int64_t, std::string>> images_;

 private:
  ros::NodeHandle node_;
  ros::Publisher info_, color_, tf_;
  ros::Subscriber answers_;
  std::unique_ptr<InProcessChain> chain_;
  std::mutex mutex_;  ///< guards received_
  std::condition_variable changed_;
  std::vector<DetectionsMessage::ConstPtr> received_;
};

TEST_F(DetectorInTheChain, InLockstepEveryImageThatIsDueHasItsBoxes) {
  constexpr std::size_t kImages = 12;
  constexpr double kRate_hz = 10.0;
  load(true, kRate_hz);
  core::ObjectDetectorOptions options;
  options.model = model_;
  options.rate_hz = kRate_hz;
  const auto detector =
      core::ObjectDetector::load(options, core::checked(core::read_class_table(STL_CONFIG_DIR "/classes_coco.yaml")));
  ASSERT_TRUE(detector) << detector.message();
  std::size_t answered = 0;
  for (std::size_t i = 0; i < kImages; ++i) {
    send(i);
    const auto received = wait_for(i + 1);
    ASSERT_EQ(received.size(), i + 1);
    const DetectionsMessage& answer = *received.back();
    EXPECT_EQ(answer.frame_id, static_cast<std::int64_t>(i));
    EXPECT_EQ(answer.unanswered, !(*detector)->is_due(images_[i].first));
    if (answer.unanswered) continue;
    ++answered;
    const auto boxes = core::checked((*detector)->detect(image(i)));
    expect_same(answer.detections, boxes);
  }
  EXPECT_GE(answered, 3U);
  EXPECT_LE(answered, 6U);
}

TEST_F(DetectorInTheChain, InLockstepEachImageIsTurnedUprightByItsOwnPose) {
  constexpr std::size_t kLevel = 30, kApart = 3;  // images: what is up is estimated from frames 0.1 s apart
  load(true, 0.0);
  core::UpEstimator up(core::LoopOptions().up_window_s);
  core::Quaternion q;
  const auto push = [&](std::size_t index) {
    core::Frame frame;
    frame.stamp_ns = images_[index].first;
    frame.T_odom_camera.q = q;
    up.push(frame);
  };
  for (std::size_t i = 0; i < kLevel; ++i) {
    q = core::so3_exp(core::Vec3(0.0, 0.06 * static_cast<double>(i), 0.0));
    push(kApart * i);
    send(kApart * i, q);
    ASSERT_EQ(wait_for(i + 1).size(), i + 1);
  }
  const double roll_rad = 1.0;
  constexpr std::size_t kClear = 300;  // an image with much in it
  const cv::Mat color = core::testing::rolled(image(kClear), roll_rad);
  q = q * core::so3_exp(core::Vec3(0.0, 0.0, roll_rad));
  push(kApart * kLevel);
  send(kApart * kLevel, color, q);
  const auto received = wait_for(kLevel + 1);
  ASSERT_EQ(received.size(), kLevel + 1);
  EXPECT_NEAR(up.roll_rad(q), roll_rad, 0.1);
  core::ObjectDetectorOptions options;
  options.model = model_;
  const auto detector =
      core::ObjectDetector::load(options, core::checked(core::read_class_table(STL_CONFIG_DIR "/classes_coco.yaml")));
  expect_same(received.back()->detections, core::checked((*detector)->detect(color, up.roll_rad(q))));
  EXPECT_GE(received.back()->detections.size(), 2U);
}

TEST_F(DetectorInTheChain, ImagesOfAnotherSizeThanTheCalibrationsAreLeftOut) {
  load(true, 0.0);
  send(0);
  ASSERT_EQ(wait_for(1).size(), 1U);
  EXPECT_FALSE(wait_for(1)[0]->unanswered);
  cv::Mat small;
  cv::resize(image(1), small, {320, 240});
  send(1, small, core::Quaternion::Identity());
  ASSERT_EQ(wait_for(2).size(), 2U);
  EXPECT_TRUE(wait_for(2)[1]->unanswered) << "its boxes would be in other pixels";
}

TEST_F(DetectorInTheChain, InRealTimeTheNewestImageHasItsBoxesAndNoFrameWaitsForMore) {
  constexpr std::size_t kImages = 20;
  load(false, 0.0);
  send(0);
  ASSERT_EQ(wait_for(1).size(), 1U) << "everything is up";
  for (std::size_t i = 1; i < kImages; ++i) send(i);
  const auto received = wait_for(kImages);
  ASSERT_EQ(received.size(), kImages);
  std::size_t unanswered = 0;
  for (std::size_t i = 0; i < kImages; ++i) {
    EXPECT_EQ(received[i]->frame_id, static_cast<std::int64_t>(i));
    EXPECT_EQ(to_stamp_ns(received[i]->header.stamp), images_[i].first);
    if (received[i]->unanswered) ++unanswered;
    EXPECT_EQ(received[i]->unanswered, received[i]->detections.empty()) << "the desk is never empty";
  }
  EXPECT_GE(unanswered, 1U) << "images come faster than they can be looked at";
  EXPECT_FALSE(received.back()->unanswered) << "nothing was newer";
}

TEST(DetectorAlone, TellsHowLongItsLastImagesTook) {
  const core::TestDirectory directory;
  ros::NodeHandle node;
  Diagnostics diagnostics;
  const boost::function<void(const ros::SingleSubscriberPublisher&)> connect = [](const auto& subscriber) {
    subscriber.publish(image_message(1'000'000'000, cv::Mat(48, 64, CV_8UC3, cv::Scalar::all(90))));
  };
  const auto before = std::chrono::steady_clock::now();
  const ros::Publisher color = node.advertise<sensor_msgs::Image>("color", 1, connect);
  InProcessChain chain;
  chain.set("object_detector", "detector/model", directory.write("tiny.onnx", core::testing::TinyYolo().onnx()));
  chain.set("object_detector", "lockstep", false);
  chain.set("object_detector", "detector/rate_hz", 0.0);
  chain.load("object_detector", "ObjectDetector");
  ASSERT_TRUE(wait_until([&] { return diagnostics.count("ObjectDetector", "frames processed") == 1; }, 60.0));
  const double latency_ms = std::stod(diagnostics.of("ObjectDetector")["latency p50"]);
  EXPECT_GT(latency_ms, 0.0);
  EXPECT_LT(latency_ms, 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now() - before).count());
  chain.unload_all();
}

TEST(IngestionAlone, AnswersOfTheFirstPassVoidNoFrameOfTheSecond) {
  ros::NodeHandle node;
  const ros::Publisher control = node.advertise<SessionControl>("session_control", 10);
  const ros::Publisher frames = node.advertise<FrameMessage>("frames", 10);
  const ros::Publisher boxes = node.advertise<DetectionsMessage>("detections_in", 10);
  std::mutex mutex;  // guards both below
  std::condition_variable changed;
  std::uint32_t acknowledged = 0;  // session
  DetectionsMessage::ConstPtr joined;
  const boost::function<void(const SessionAck::ConstPtr&)> acknowledge = [&](const auto& ack) {
    const std::lock_guard<std::mutex> lock(mutex);
    acknowledged = ack->session_id;
    changed.notify_all();
  };
  const boost::function<void(const DetectionsMessage::ConstPtr&)> take = [&](const auto& message) {
    const std::lock_guard<std::mutex> lock(mutex);
    joined = message;
    changed.notify_all();
  };
  const ros::Subscriber acks = node.subscribe<SessionAck>("session_acks", 10, acknowledge);
  const ros::Subscriber detections = node.subscribe<DetectionsMessage>("detections", 10, take);
  InProcessChain chain;
  constexpr double kForever = 60.0;
  chain.set("rewound_ingestion", "detection_timeout_s", kForever);
  chain.load("rewound_ingestion", "DetectionIngestion");
  const auto is_connected = [&] {
    return control.getNumSubscribers() > 0 && frames.getNumSubscribers() > 0 && boxes.getNumSubscribers() > 0 &&
           acks.getNumPublishers() > 0 && detections.getNumPublishers() > 0;
  };
  for (int i = 0; i < 6000 && !is_connected(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  ASSERT_TRUE(is_connected());
  // A session with one frame.
  const auto begin = [&](std::uint32_t session_id, bool rewind, double time_s) {
    SessionControl start;
    start.header.stamp = ros::Time(session_id, 0);
    start.session_id = session_id;
    start.rewind = rewind;
    control.publish(start);
    std::unique_lock<std::mutex> lock(mutex);
    ASSERT_TRUE(changed.wait_for(lock, std::chrono::minutes(1), [&] { return acknowledged == session_id; }));
    auto frame = boost::make_shared<FrameMessage>();
    frame->header = make_header(ros::Time(time_s), "odom");
    frame->session_id = session_id;
    frame->stamp_ns = to_stamp_ns(frame->header.stamp);
    frames.publish(frame);
  };
  const auto detect = [&boxes](double time_s) {
    auto detected = boost::make_shared<DetectionsMessage>();
    detected->header = make_header(ros::Time(time_s), "camera");
    detected->detections.push_back({41, 0.9, {40.0, 40.0, 80.0, 80.0}});
    boxes.publish(detected);
  };
  const auto wait_for = [&](std::uint32_t session_id) {
    std::unique_lock<std::mutex> lock(mutex);
    changed.wait_for(lock, std::chrono::minutes(1), [&] { return joined && joined->session_id == session_id; });
    return joined;
  };
  ASSERT_NO_FATAL_FAILURE(begin(1, false, 1.4));
  detect(1.5);
  const auto first = wait_for(1);
  ASSERT_TRUE(first);
  EXPECT_TRUE(first->unanswered) << "a later image was answered, and waits for its frame";
  ASSERT_NO_FATAL_FAILURE(begin(2, true, 1.0));
  detect(1.0);
  const auto second = wait_for(2);
  ASSERT_TRUE(second);
  EXPECT_EQ(second->session_id, 2U);
  EXPECT_EQ(second->detections.size(), 1U);
  chain.unload_all();
}

}  // namespace
}  // namespace semantic_topo_loop
