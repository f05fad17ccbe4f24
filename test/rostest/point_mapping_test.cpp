// The points of the map, as others see them: on the topics, after corrections, by service.
#include <sensor_msgs/PointCloud2.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <thread>
#include <vector>

#include "ros/conversions.h"
#include "semantic_topo_loop/SavePoints.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"

namespace semantic_topo_loop {
namespace {

constexpr double kPatience_s = 20.0, kRate_hz = 20.0;
constexpr double kTolerance_m = 1e-5;

using Points = std::vector<core::Vec3>;

/// Hears a topic of clouds.
class Listener {
 public:
  explicit Listener(const std::string& topic) {
    subscriber_ = node_.subscribe<sensor_msgs::PointCloud2>(topic, 100, &Listener::take, this);
  }
  ~Listener() { subscriber_.shutdown(); }

  /// Waits until the last cloud has `size` points. @return it, or nullopt if none came in time
  std::optional<Points> wait_for(std::size_t size) {
    std::unique_lock<std::mutex> lock(mutex_);
    const auto has_come = [this, size] { return !clouds_.empty() && clouds_.back()->width == size; };
    if (!changed_.wait_for(lock, std::chrono::duration<double>(kPatience_s), has_come)) return std::nullopt;
    return points();
  }
  /// Waits until the last cloud has a point at a place.
  bool wait_for(std::size_t index, const core::Vec3& place) {
    std::unique_lock<std::mutex> lock(mutex_);
    return changed_.wait_for(lock, std::chrono::duration<double>(kPatience_s), [this, index, &place] {
      return !clouds_.empty() && clouds_.back()->width > index && (points()[index] - place).norm() < kTolerance_m;
    });
  }
  std::vector<sensor_msgs::PointCloud2ConstPtr> clouds() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return clouds_;
  }

 private:
  void take(const sensor_msgs::PointCloud2ConstPtr& cloud) {
    const std::lock_guard<std::mutex> lock(mutex_);
    clouds_.push_back(cloud);
    changed_.notify_all();
  }
  /// Of the last cloud; the lock is held.
  Points points() const {
    const core::Result<Points> points = from_msg(*clouds_.back());
    EXPECT_TRUE(points) << points.message();
    return points ? *points : Points(clouds_.back()->width, core::Vec3::Zero());
  }

  ros::NodeHandle node_;
  ros::Subscriber subscriber_;
  std::mutex mutex_;  ///< guards clouds_
  std::condition_variable changed_;
  std::vector<sensor_msgs::PointCloud2ConstPtr> clouds_;
};

/// Feeds PointMapping as the front end and the pose graph would.
class PointMapping : public ::testing::Test {
 protected:
  void SetUp() override {
    control_ = node_.advertise<SessionControl>("session_control", 1, true);
    points_ = node_.advertise<KeyframePointsMessage>("keyframe_points", 10);
    corrections_ = node_.advertise<CorrectionMessage>("map_corrections", 10);
    acks_ = node_.subscribe<SessionAck>("session_acks", 10, &PointMapping::take_ack, this);
    chain_.load_point_mapping(kRate_hz, directory_.path("saved"));
    ASSERT_TRUE(start_session(1));
    const auto deadline = ros::WallTime::now() + ros::WallDuration(kPatience_s);
    while ((points_.getNumSubscribers() == 0 || corrections_.getNumSubscribers() == 0) &&
           ros::WallTime::now() < deadline) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }
  void TearDown() override { chain_.unload_all(); }

  bool start_session(std::uint32_t session) {
    session_ = session;
    SessionControl start;
    start.header.stamp = ros::Time(session);
    start.session_id = session;
    start.command = SessionControl::COMMAND_START;
    control_.publish(start);
    std::unique_lock<std::mutex> lock(mutex_);
    return changed_.wait_for(lock, std::chrono::duration<double>(kPatience_s),
                             [this] { return acknowledged_ == session_; });
  }
  /// In order with other messages that are published by pointer.
  bool fix_map(bool fixed) {
    const auto control = boost::make_shared<SessionControl>();
    control->header.stamp = ros::Time(session_);
    control->session_id = session_;
    control->command = SessionControl::COMMAND_LOCALIZATION;
    control->localization = fixed;
    std::unique_lock<std::mutex> lock(mutex_);
    is_fixed_ = false;
    control_.publish(control);
    return changed_.wait_for(lock, std::chrono::duration<double>(kPatience_s), [this] { return is_fixed_; });
  }
  /// A keyframe at (id, 0, 0), looking along z, that sees a sparse point 2 m before it and a semi-dense one 3 m before.
  KeyframePointsMessage keyframe(std::int64_t id) const {
    PointsKeyframe frame;
    frame.is_keyframe = true;
    frame.keyframe_id = id;
    frame.T_odom_camera.t.x() = static_cast<double>(id);
    core::KeyframePoints points;
    points.sparse.push_back({id, Eigen::Vector3f(0.0F, 0.0F, 2.0F)});
    points.semi_dense.emplace_back(0.0F, 0.0F, 3.0F);
    frame.keyframe_points = std::make_shared<const core::KeyframePoints>(points);
    return {make_header(ros::Time(static_cast<double>(10 + id)), "camera"), session_, frame};
  }
  /// The odometry has drifted by `shift` before keyframe 1; later keyframes were not in the solution.
  CorrectionMessage correction(const core::Vec3& shift) const {
    core::MapCorrection correction;
    correction.changed = true;
    correction.frame_id = 2;
    correction.valid_to_keyframe_id = 1;
    correction.T_map_odom.t = shift;
    for (const std::int64_t id : {0, 1}) {
      core::KeyframePose pose;
      pose.keyframe_id = id;
      pose.T_map_camera.t = core::Vec3(static_cast<double>(id), 0.0, 0.0) + static_cast<double>(id) * shift;
      correction.keyframes.push_back(pose);
    }
    return {{}, session_, correction};
  }

  /// Calls the service. @return what it says
  SavePoints::Response save(const std::string& path) {
    SavePoints::Request request;
    SavePoints::Response response;
    request.path = path;
    EXPECT_TRUE(ros::service::call("/point_mapping/save_points", request, response));
    return response;
  }

  const core::TestDirectory directory_;
  InProcessChain chain_;
  ros::NodeHandle node_;
  ros::Publisher control_, points_, corrections_;
  ros::Subscriber acks_;
  std::uint32_t session_ = 0;

 private:
  void take_ack(const SessionAck::ConstPtr& ack) {
    const std::lock_guard<std::mutex> lock(mutex_);
    acknowledged_ = ack->session_id;
    is_fixed_ = is_fixed_ || ack->command == SessionControl::COMMAND_LOCALIZATION;
    changed_.notify_all();
  }

  std::mutex mutex_;  ///< guards what follows
  std::condition_variable changed_;
  std::uint32_t acknowledged_ = 0;
  bool is_fixed_ = false;  ///< or grows, as told last
};

TEST_F(PointMapping, PublishesTheMapAndMovesItWithCorrections) {
  Listener sparse("map_points_sparse"), semi_dense("map_points_semi_dense");
  for (const std::int64_t id : {0, 1, 2}) points_.publish(keyframe(id));
  const std::optional<Points> before = sparse.wait_for(3);
  ASSERT_TRUE(before);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_LT(((*before)[i] - core::Vec3(static_cast<double>(i), 0.0, 2.0)).norm(), kTolerance_m) << i;
  }
  ASSERT_TRUE(semi_dense.wait_for(3));
  const sensor_msgs::PointCloud2ConstPtr cloud = sparse.clouds().back();
  EXPECT_EQ(cloud->header.frame_id, "map");
  EXPECT_EQ(cloud->header.stamp, ros::Time(12.0)) << "of the last keyframe";

  corrections_.publish(correction(core::Vec3(0.0, 0.5, 0.0)));
  // Keyframe 0 stays, 1 is told, 2 hangs on the new transform; a keyframe to come does, too.
  ASSERT_TRUE(sparse.wait_for(2, core::Vec3(2.0, 0.5, 2.0)));
  points_.publish(keyframe(3));
  const std::optional<Points> after = sparse.wait_for(4);
  ASSERT_TRUE(after);
  for (std::size_t i = 0; i < 4; ++i) {
    const core::Vec3 expected(static_cast<double>(i), i == 0 ? 0.0 : 0.5, 2.0);
    EXPECT_LT(((*after)[i] - expected).norm(), kTolerance_m) << i;
  }
  const std::optional<Points> dense = semi_dense.wait_for(4);
  ASSERT_TRUE(dense);
  EXPECT_LT(((*dense)[2] - core::Vec3(2.0, 0.5, 3.0)).norm(), kTolerance_m);
}

TEST_F(PointMapping, PublishesOnlyWhatAListenerHasNotSeen) {
  const int quiet_ms = 500;
  {
    Listener first("map_points_sparse");
    points_.publish(keyframe(0));
    ASSERT_TRUE(first.wait_for(1));
    const std::size_t count = first.clouds().size();
    std::this_thread::sleep_for(std::chrono::milliseconds(quiet_ms));
    EXPECT_EQ(first.clouds().size(), count) << "nothing has changed since";
  }
  // Nobody listens: whoever comes afterwards gets one cloud, that of the map as it is then.
  for (const std::int64_t id : {1, 2, 3}) points_.publish(keyframe(id));
  std::this_thread::sleep_for(std::chrono::milliseconds(quiet_ms));
  Listener late("map_points_sparse");
  ASSERT_TRUE(late.wait_for(4));
  EXPECT_EQ(late.clouds().size(), 1U);
}

TEST_F(PointMapping, TakesNoneWhileTheMapIsFixed) {
  Listener sparse("map_points_sparse");
  points_.publish(keyframe(0));
  ASSERT_TRUE(sparse.wait_for(1));
  ASSERT_TRUE(fix_map(true));
  points_.publish(boost::make_shared<KeyframePointsMessage>(keyframe(1)));
  ASSERT_TRUE(fix_map(false));
  points_.publish(keyframe(2));
  EXPECT_TRUE(sparse.wait_for(1, core::Vec3(2.0, 0.0, 2.0)));
  EXPECT_EQ(sparse.clouds().back()->width, 2U);
}

TEST_F(PointMapping, ForgetsWithTheSession) {
  Listener sparse("map_points_sparse");
  points_.publish(keyframe(0));
  points_.publish(keyframe(1));
  ASSERT_TRUE(sparse.wait_for(2));
  const KeyframePointsMessage stale = keyframe(2);
  ASSERT_TRUE(start_session(2));
  points_.publish(stale);
  auto broken = to_generated<KeyframePoints>(keyframe(4));
  broken.sparse_ids.clear();
  points_.publish(broken);
  points_.publish(keyframe(5));
  EXPECT_TRUE(sparse.wait_for(0, core::Vec3(5.0, 0.0, 2.0)));
  EXPECT_EQ(sparse.clouds().back()->width, 1U) << "of the last session, or of a message that is none";
}

TEST_F(PointMapping, SavesTheCorrectedPoints) {
  std::filesystem::create_directory(directory_.path("saved"));
  {
    Listener sparse("map_points_sparse");
    points_.publish(keyframe(0));
    points_.publish(keyframe(1));
    ASSERT_TRUE(sparse.wait_for(2));
    corrections_.publish(correction(core::Vec3(0.0, 0.5, 0.0)));
    ASSERT_TRUE(sparse.wait_for(1, core::Vec3(1.0, 0.5, 2.0)));
    points_.publish(keyframe(2));
    ASSERT_TRUE(sparse.wait_for(3));
  }
  const SavePoints::Response response = save("map.ply");
  ASSERT_TRUE(response.success) << response.message;
  EXPECT_EQ(response.message, directory_.path("saved/map.ply"));
  std::ifstream file(response.message, std::ios::binary);
  std::string line;
  bool has_count = false;
  while (std::getline(file, line) && line != "end_header") has_count = has_count || line == "element vertex 6";
  EXPECT_TRUE(has_count);
  std::vector<float> values(24);
  ASSERT_TRUE(file.read(reinterpret_cast<char*>(values.data()), 24 * sizeof(float)));
  EXPECT_NEAR(values[4], 1.0, kTolerance_m) << "x of the second sparse point";
  EXPECT_NEAR(values[5], 0.5, kTolerance_m) << "y, corrected";

  const SavePoints::Response refused = save("map.txt");
  EXPECT_FALSE(refused.success);
  EXPECT_NE(refused.message.find("map.txt"), std::string::npos) << refused.message;
}

TEST_F(PointMapping, SavesBelowItsDirectoryOnly) {
  namespace fs = std::filesystem;
  fs::create_directories(directory_.path("saved/deeper"));
  fs::create_directory(directory_.path("elsewhere"));
  const std::string own = directory_.write("elsewhere/own.ply", "a user's own");
  fs::create_symlink(directory_.path("elsewhere"), directory_.path("saved/link"));
  fs::create_symlink(own, directory_.path("saved/own.ply"));
  for (const std::string& path :
       {std::string(), std::string("."), std::string("../map.ply"), directory_.path("map.ply"), own,
        std::string("deeper/../../elsewhere/own.ply"), std::string("link/own.ply"), std::string("own.ply")}) {
    const SavePoints::Response response = save(path);
    EXPECT_FALSE(response.success) << path;
    EXPECT_NE(response.message.find("is not below '" + directory_.path("saved")), std::string::npos)
        << response.message;
  }
  EXPECT_EQ(core::read_whole(own), "a user's own");
  EXPECT_TRUE(save("map.ply").success);
  EXPECT_TRUE(save("deeper/map.pcd").success);
  EXPECT_TRUE(save(directory_.path("saved/absolute.ply")).success);
  // What was there before survives a write that fails.
  const std::string before = directory_.write("saved/kept.txt", "kept");
  EXPECT_FALSE(save("kept.txt").success);
  EXPECT_EQ(core::read_whole(before), "kept");
}

}  // namespace
}  // namespace semantic_topo_loop
