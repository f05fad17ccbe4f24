#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_msgs/TFMessage.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "semantic_topo_loop/ros/conversions.h"
#include "semantic_topo_loop/ros/tum_bag_writer.h"
#include "test_fixtures.h"

namespace semantic_topo_loop {
namespace {

namespace test = core::simulation_test;

core::SE3 pose_of(const geometry_msgs::Transform& t) {
  return {core::Quaternion(t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z),
          {t.translation.x, t.translation.y, t.translation.z}};
}

class TumBagTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "stl_bag_XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    directory_ = name;
    path_ = directory_ + "/a.bag";
    std::string error;
    auto sequence =
        core::simulate(test::options_of({{"trajectory.duration_s", "2"}}), test::camera_fr2(), test::coco(), &error);
    ASSERT_TRUE(sequence) << error;
    sequence_ = std::move(*sequence);
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  void write(const TumBagOptions& options = {}) {
    std::string error;
    ASSERT_TRUE(write_tum_bag(sequence_, path_, options, &error)) << error;
  }

  std::string directory_, path_;
  core::SimulatedSequence sequence_;
};

TEST_F(TumBagTest, topics_and_types_are_those_of_the_official_bags) {
  write();
  rosbag::Bag bag(path_);
  EXPECT_EQ(bag.getCompression(), rosbag::compression::Uncompressed);
  rosbag::View view(bag);
  std::map<std::string, std::pair<std::string, std::string>> types;
  for (const rosbag::ConnectionInfo* c : view.getConnections()) types[c->topic] = {c->datatype, c->md5sum};
  ASSERT_EQ(types.size(), 3u);
  EXPECT_EQ(types["/tf"].first, "tf/tfMessage");
  EXPECT_EQ(types["/tf"].second, "94810edda583a504dfda3829e70d7eec");
  EXPECT_EQ(types["/camera/rgb/camera_info"].first, "sensor_msgs/CameraInfo");
  EXPECT_EQ(types["/camera/rgb/image_color"].first, "sensor_msgs/Image");
}

TEST_F(TumBagTest, images_carry_the_frames_stamps_and_the_drivers_intrinsics) {
  write();
  rosbag::Bag bag(path_);
  std::size_t infos = 0, images = 0;
  for (const rosbag::MessageInstance& m : rosbag::View(bag)) {
    if (const auto info = m.instantiate<sensor_msgs::CameraInfo>()) {
      ASSERT_LT(infos, sequence_.truth.size());
      EXPECT_EQ(to_stamp_ns(info->header.stamp), sequence_.truth[infos++].stamp_ns);
      EXPECT_EQ(info->header.frame_id, "/openni_rgb_optical_frame");
      EXPECT_EQ(info->K[0], 525.0);
      EXPECT_EQ(info->K[2], 319.5);
      EXPECT_EQ(info->width, 640u);
    } else if (const auto image = m.instantiate<sensor_msgs::Image>()) {
      EXPECT_EQ(to_stamp_ns(image->header.stamp), sequence_.truth[images++].stamp_ns);
      EXPECT_EQ(image->encoding, "rgb8");
      EXPECT_EQ(image->data.size(), image->step * image->height);
    }
  }
  EXPECT_EQ(infos, sequence_.truth.size());
  EXPECT_EQ(images, sequence_.truth.size());
}

TEST_F(TumBagTest, the_tf_chain_gives_the_true_camera_pose) {
  write();
  rosbag::Bag bag(path_);
  std::map<std::string, std::pair<std::string, core::SE3>> edges;  // child to parent
  std::map<std::int64_t, core::SE3> T_world_kinect;
  for (const rosbag::MessageInstance& m : rosbag::View(bag, rosbag::TopicQuery("/tf"))) {
    // instantiate<> refuses the other type name, which is why the payload is read by hand.
    std::vector<std::uint8_t> buffer(m.size());
    ros::serialization::OStream out(buffer.data(), m.size());
    m.write(out);
    ros::serialization::IStream in(buffer.data(), m.size());
    tf2_msgs::TFMessage message;
    ros::serialization::deserialize(in, message);
    for (const auto& t : message.transforms) {
      ASSERT_EQ(t.child_frame_id.front(), '/');
      ASSERT_EQ(t.header.frame_id.front(), '/');
      if (t.child_frame_id == "/kinect") {
        EXPECT_EQ(t.header.frame_id, "/world");
        T_world_kinect[to_stamp_ns(t.header.stamp)] = pose_of(t.transform);
      } else {
        edges[t.child_frame_id] = {t.header.frame_id, pose_of(t.transform)};
      }
    }
  }
  core::SE3 T_kinect_optical;
  std::string frame = "/openni_rgb_optical_frame";
  for (const char* parent : {"/openni_rgb_frame", "/openni_camera", "/kinect"}) {
    ASSERT_EQ(edges[frame].first, parent);
    T_kinect_optical = edges[frame].second * T_kinect_optical;
    frame = parent;
  }
  ASSERT_EQ(T_world_kinect.size(), sequence_.mocap.size());
  for (const core::StampedPose& pose : sequence_.mocap) {
    const core::SE3 T_world_optical = T_world_kinect[pose.stamp_ns] * T_kinect_optical;
    EXPECT_LT(core::se3_log(T_world_optical.inverse() * pose.T_world_camera).norm(), 1e-9);
  }
}

TEST_F(TumBagTest, images_can_be_left_out) {
  TumBagOptions options;
  options.with_images = false;
  write(options);
  rosbag::Bag bag(path_);
  EXPECT_EQ(rosbag::View(bag, rosbag::TopicQuery("/camera/rgb/image_color")).size(), 0u);
  EXPECT_EQ(rosbag::View(bag, rosbag::TopicQuery("/camera/rgb/camera_info")).size(), sequence_.truth.size());
}

TEST_F(TumBagTest, same_sequence_same_bytes) {
  write();
  const auto bytes = [this] {
    std::ifstream file(path_, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  const std::string first = bytes();
  EXPECT_NE(first.find("compression=bz2"), std::string::npos);
  write();
  EXPECT_TRUE(first == bytes());
}

TEST_F(TumBagTest, an_unwritable_file_is_an_error_with_its_path) {
  std::string error;
  EXPECT_FALSE(write_tum_bag(sequence_, directory_ + "/none/a.bag", {}, &error));
  EXPECT_NE(error.find(directory_ + "/none/a.bag"), std::string::npos) << error;
}

}  // namespace
}  // namespace semantic_topo_loop
