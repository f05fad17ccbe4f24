#include <sensor_msgs/CameraInfo.h>
#include <std_msgs/String.h>

#include <chrono>
#include <deque>
#include <filesystem>
#include <functional>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <utility>

#include "pipeline/map_state.h"
#include "ros/conversions.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"
#include "support/package_config.h"
#include "tools/evaluation/object_evaluation.h"
#include "tools/evaluation/trajectory_evaluation.h"

namespace semantic_topo_loop {
namespace {

/// Passes messages on after a while, as a slow stage would.
template <class Message>
class Delay {
 public:
  using IsSlow = std::function<bool(const Message&)>;

  /// @param is_slow of which messages; the others are passed on at once
  Delay(
      const std::string& from, const std::string& to, std::chrono::milliseconds delay,
      IsSlow is_slow = [](const Message&) { return true; })
      : delay_(delay), is_slow_(std::move(is_slow)) {
    publisher_ = node_.advertise<Message>(to, 1000);
    subscriber_ = node_.subscribe<Message>(from, 1000, &Delay::take, this);
    thread_ = std::thread([this] { run(); });
  }
  ~Delay() {
    subscriber_.shutdown();
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }

 private:
  using Clock = std::chrono::steady_clock;

  void take(const typename Message::ConstPtr& message) {
    if (!is_slow_(*message)) return publisher_.publish(message);
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting_.emplace_back(Clock::now() + delay_, message);
    changed_.notify_all();
  }
  void run() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (!stop_) {
      if (waiting_.empty()) {
        changed_.wait(lock);
      } else if (Clock::now() < waiting_.front().first) {
        changed_.wait_until(lock, waiting_.front().first);
      } else {
        publisher_.publish(waiting_.front().second);
        waiting_.pop_front();
      }
    }
  }

  const std::chrono::milliseconds delay_;
  const IsSlow is_slow_;
  ros::NodeHandle node_;
  ros::Publisher publisher_;
  ros::Subscriber subscriber_;
  std::mutex mutex_;  ///< guards all below but the thread
  std::condition_variable changed_;
  std::deque<std::pair<Clock::time_point, typename Message::ConstPtr>> waiting_;
  bool stop_ = false;
  std::thread thread_;
};

/// Which landmarks the associations speak of, and which of them the map knows.
class LandmarkWatch {
 public:
  LandmarkWatch() {
    associations_ = node_.subscribe<AssociationsMessage>("associations", 1000, &LandmarkWatch::take_associations, this);
    updates_ = node_.subscribe<MapUpdateMessage>("quadric_map_updates", 1000, &LandmarkWatch::take_update, this);
  }
  std::set<std::int64_t> used() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return used_;
  }
  std::set<std::int64_t> known() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return known_;
  }

 private:
  void take_associations(const AssociationsMessage::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const core::Association& association : message->associations) {
      if (association.landmark_id >= 0) used_.insert(association.landmark_id);
    }
  }
  void take_update(const MapUpdateMessage::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const core::Landmark& landmark : message->changed) known_.insert(landmark.id);
    for (const core::LandmarkMerge& merge : message->merged) known_.insert(merge.merged_id);
    known_.insert(message->removed.begin(), message->removed.end());
  }

  ros::NodeHandle node_;
  ros::Subscriber associations_, updates_;
  std::mutex mutex_;  ///< guards both below
  std::set<std::int64_t> used_, known_;
};

/// F of a run's confirmed objects against the simulation's truth.
double object_f(const std::string& results, const std::string& data) {
  const auto objects = core::read_objects(results + "/objects.csv");
  const auto references = core::read_reference_objects(data + "/reference_objects.csv");
  const auto estimate = core::read_tum_trajectory(results + "/trajectory.txt");
  const auto truth = core::read_tum_trajectory(data + "/groundtruth_frames.txt");
  if (!objects || !references || !estimate || !truth) {
    ADD_FAILURE() << objects.message() << references.message() << estimate.message() << truth.message();
    return 0.0;
  }
  const auto trajectory = core::evaluate_trajectory(*estimate, *truth);
  if (!trajectory) {
    ADD_FAILURE() << trajectory.message();
    return 0.0;
  }
  return core::evaluate_objects(*objects, *references, trajectory->alignment).certain.f();
}

TEST(LateMapping, CostsNeitherLandmarksNorObjects) {
  const core::TestDirectory directory;
  const std::string data = directory.path("data");
  write_simulation({{"trajectory.duration_s", "24"}}, data);
  if (::testing::Test::HasFatalFailure()) return;
  {
    InProcessChain prompt;
    prompt.load_stages(data, directory.path("prompt"));
    prompt.load_player(data, true);
    ASSERT_EQ(prompt.wait_for_end(60.0), "finished");
    prompt.unload_all();
  }
  {
    const Delay<MapUpdateMessage> delay("prompt_updates", "quadric_map_updates", std::chrono::milliseconds(300));
    LandmarkWatch watch;
    InProcessChain late;
    late.load_stages(data, directory.path("late"), {{"quadric_map_updates", "prompt_updates"}});
    late.load_player(data, false);
    ASSERT_EQ(late.wait_for_end(90.0), "finished");
    late.unload_all();
    const std::set<std::int64_t> known = watch.known();
    EXPECT_FALSE(watch.used().empty());
    for (const std::int64_t id : watch.used()) EXPECT_EQ(known.count(id), 1u) << "landmark " << id << " is unresolved";
  }
  const double prompt_f = object_f(directory.path("prompt"), data);
  const double late_f = object_f(directory.path("late"), data);
  EXPECT_GT(prompt_f, 0.5) << "the scene is too hard to say anything";
  EXPECT_GE(late_f, prompt_f - 0.03);
  RecordProperty("prompt_f", std::to_string(prompt_f));
  RecordProperty("late_f", std::to_string(late_f));
}

std::string rows_of(const std::string& path) {
  std::ostringstream text;
  EXPECT_EQ(core::dump_map(path, text).message(), "");
  return text.str();
}

TEST(LateMapping, LosesNothingOfTheMap) {
  const core::TestDirectory directory;
  const std::string data = directory.path("data"), prompt = directory.path("prompt.db"),
                    late = directory.path("late.db");
  write_simulation({{"trajectory.duration_s", "24"}}, data);
  if (::testing::Test::HasFatalFailure()) return;
  const Delay<MapPartMessage> delay("map_parts", "late_parts", std::chrono::seconds(2),
                                    [](const auto& part) { return part.stage == MapPart::STAGE_QUADRIC_MAPPING; });
  InProcessChain chain;
  chain.set("map_database", "save_map_file", prompt);
  chain.load("map_database", "MapDatabase", {});
  chain.set("late_map_database", "save_map_file", late);
  chain.set("late_map_database", "queue_size", 2);
  chain.load("late_map_database", "MapDatabase", {{"map_parts", "late_parts"}});
  chain.load_stages(data, directory.path("results"));
  chain.load_player(data, true);
  ASSERT_EQ(chain.wait_for_end(60.0), "finished");
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  const auto is_same = [&] { return std::filesystem::exists(late) && rows_of(late) == rows_of(prompt); };
  while (!is_same() && std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  EXPECT_TRUE(is_same());
  EXPECT_NE(rows_of(prompt).find("object "), std::string::npos);
  chain.unload_all();
}

/// A stage that is loaded anew begins with nothing; what it told the map before is not lost by that.
TEST(LateMapping, AStageThatIsLoadedAnewDoesNotTakeAwayWhatItToldBefore) {
  const core::TestDirectory directory;
  const std::string data = directory.path("data"), map = directory.path("map.db");
  write_simulation({{"trajectory.duration_s", "24"}}, data);
  if (::testing::Test::HasFatalFailure()) return;
  InProcessChain chain;
  chain.set("map_database", "save_map_file", map);
  chain.load("map_database", "MapDatabase", {});
  chain.load_stages(data, directory.path("results"));
  chain.set("player", "rate", 3.0);
  chain.load_player(data, false);
  const auto submaps = [](const std::string& path) {
    const auto read = std::filesystem::exists(path) ? core::read_map(path, *core::shared_coco()) : core::Error{path};
    return read ? (*read)->submaps.size() : 0;
  };
  const auto wait_for = [](const auto& is_so) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(30);
    while (!is_so() && std::chrono::steady_clock::now() < end)
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
  };
  wait_for([&] { return submaps(map) >= 3; });
  chain.unload("loop_detection");
  const std::size_t told = submaps(map);
  ASSERT_GE(told, 3U);
  chain.load("loop_detection", "LoopDetection", {});
  ASSERT_EQ(chain.wait_for_end(60.0), "finished");
  chain.unload_all();
  EXPECT_GE(submaps(map + "~"), told);
  EXPECT_GT(submaps(map), 0U);
}

/// The last optimisation of a day takes longer than the second after which images are a new session's.
TEST(LateMapping, ACameraThatGoesOnDoesNotTakeTheEndFromTheStagesThatWorkOnIt) {
  const core::TestDirectory directory;
  const std::string data = directory.path("data");
  write_simulation({{"trajectory.duration_s", "6"}}, data);
  if (::testing::Test::HasFatalFailure()) return;
  std::mutex mutex;  // guards both below
  FrameMessage::ConstPtr end;
  std::uint32_t session_id = 0;
  ros::NodeHandle node;
  const boost::function<void(const FrameMessage::ConstPtr&)> take_frame = [&](const auto& frame) {
    const std::lock_guard<std::mutex> lock(mutex);
    if (frame->is_end && !end) end = frame;
  };
  const boost::function<void(const SessionControl::ConstPtr&)> take_control = [&](const auto& control) {
    const std::lock_guard<std::mutex> lock(mutex);
    session_id = control->session_id;
  };
  const auto get = [&mutex](const auto& value) {
    const std::lock_guard<std::mutex> lock(mutex);
    return value;
  };
  const ros::Subscriber frames = node.subscribe<FrameMessage>("frames", 1000, take_frame);
  const ros::Subscriber control = node.subscribe<SessionControl>("session_control", 10, take_control);
  ros::Publisher camera = node.advertise<sensor_msgs::CameraInfo>("camera_info", 10);
  ros::Publisher working = node.advertise<std_msgs::String>("working", 10);
  const Delay<MapUpdateMessage> delay("prompt_updates", "quadric_map_updates", std::chrono::seconds(4),
                                      [&](const auto& update) {
                                        const FrameMessage::ConstPtr last = get(end);
                                        return last && update.frame_id == last->frame_id;
                                      });
  InProcessChain chain;
  chain.load_stages(data, directory.path("results"), {{"quadric_map_updates", "prompt_updates"}});
  chain.load_player(data, false);
  ASSERT_TRUE(wait_until([&] { return get(end) != nullptr; }, 60.0));
  const std::uint32_t first = get(session_id);
  sensor_msgs::CameraInfo image;
  to_msg(core::Camera{500.0, 500.0, 319.5, 239.5, 640, 480, {}}, &image);
  std_msgs::String stage;
  stage.data = "QuadricMapping";
  const auto next_image = [&] {
    image.header.stamp =
        (image.header.stamp.isZero() ? get(end)->header.stamp + ros::Duration(2.0) : image.header.stamp) +
        ros::Duration(0.1);
    camera.publish(image);
    working.publish(stage);
    return !chain.wait_for_end(0.1).empty();
  };
  ASSERT_TRUE(wait_until(next_image, 30.0));
  EXPECT_EQ(chain.wait_for_end(0.0), "finished");
  EXPECT_TRUE(std::filesystem::exists(directory.path("results/summary.json")));
  EXPECT_TRUE(wait_until([&] { return next_image() && get(session_id) == first + 1; }, 10.0));
  chain.unload_all();
}

}  // namespace
}  // namespace semantic_topo_loop
