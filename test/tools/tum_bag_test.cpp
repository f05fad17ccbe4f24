#include "ros/tum_bag.h"

#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_msgs/TFMessage.h>

#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "apps/tum_bag_writer.h"
#include "ros/conversions.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/test_files.h"
#include "support/test_fixtures.h"
#include "tools/rendering/rgbd_sequence.h"

namespace semantic_topo_loop {
namespace {

namespace test = core::simulation_test;

core::SE3 pose_of(const geometry_msgs::Transform& t) {
  return {core::Quaternion(t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z),
          {t.translation.x, t.translation.y, t.translation.z}};
}

struct Transforms {
  std::map<std::string, std::pair<std::string, core::SE3>> edges;  ///< child to parent
  std::map<std::int64_t, core::SE3> T_world_kinect;
};

Transforms read_tf(const rosbag::Bag& bag) {
  Transforms result;
  for (const rosbag::MessageInstance& m : rosbag::View(bag, rosbag::TopicQuery("/tf"))) {
    // instantiate<> refuses the other type name, which is why the payload is read by hand.
    std::vector<std::uint8_t> buffer(m.size());
    ros::serialization::OStream out(buffer.data(), m.size());
    m.write(out);
    ros::serialization::IStream in(buffer.data(), m.size());
    tf2_msgs::TFMessage message;
    ros::serialization::deserialize(in, message);
    for (const auto& t : message.transforms) {
      EXPECT_EQ(t.child_frame_id.front(), '/');
      EXPECT_EQ(t.header.frame_id.front(), '/');
      if (t.child_frame_id == "/kinect") {
        EXPECT_EQ(t.header.frame_id, "/world");
        result.T_world_kinect[to_stamp_ns(t.header.stamp)] = pose_of(t.transform);
      } else {
        result.edges[t.child_frame_id] = {t.header.frame_id, pose_of(t.transform)};
      }
    }
  }
  return result;
}

/// Up the chain of frames, which must have these parents.
core::SE3 kinect_from(std::string frame, const std::vector<std::string>& parents,
                      const std::map<std::string, std::pair<std::string, core::SE3>>& edges) {
  core::SE3 T;
  for (const std::string& parent : parents) {
    const auto edge = edges.find(frame);
    EXPECT_TRUE(edge != edges.end() && edge->second.first == parent) << frame;
    if (edge == edges.end()) return T;
    T = edge->second.second * T;
    frame = parent;
  }
  return T;
}

class TumBagTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "stl_bag_XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    directory_ = name;
    path_ = directory_ + "/a.bag";
    sequence_ = test::simulate_fr2({{"trajectory.duration_s", "2"}});
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  void write(const TumBagOptions& options = {}) { ASSERT_EQ(write_tum_bag(sequence_, path_, options).message(), ""); }

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
  const auto [edges, T_world_kinect] = read_tf(bag);
  const core::SE3 T_kinect_optical =
      kinect_from("/openni_rgb_optical_frame", {"/openni_rgb_frame", "/openni_camera", "/kinect"}, edges);
  ASSERT_EQ(T_world_kinect.size(), sequence_.mocap.size());
  for (const core::StampedPose& pose : sequence_.mocap) {
    const core::SE3 T_world_optical = T_world_kinect.at(pose.stamp_ns) * T_kinect_optical;
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

TEST_F(TumBagTest, color_is_played_without_depth_where_poses_come_from_elsewhere) {
  write();
  TumBagPlayback playback;
  playback.file = path_;
  playback.with_images = true;
  EXPECT_NE(TumBagSource::open(playback, std::nullopt).message().find("/camera/depth/image"), std::string::npos);
  playback.with_depth = false;
  const auto source = TumBagSource::open(playback, std::nullopt);
  ASSERT_TRUE(source) << source.message();
  for (const core::StampedPose& frame : sequence_.truth) {
    const std::optional<PlayerItem> item = (*source)->next();
    ASSERT_TRUE(item && item->color);
    EXPECT_EQ(item->left_out, "");
    EXPECT_FALSE(item->depth);
    EXPECT_EQ(to_stamp_ns(item->color->header.stamp), frame.stamp_ns);
    EXPECT_EQ(item->camera_info.header.stamp, item->color->header.stamp);
  }
  EXPECT_FALSE((*source)->next());
  EXPECT_TRUE((*source)->end());
}

TEST_F(TumBagTest, an_unwritable_file_is_an_error_with_its_path) {
  const std::string error = write_tum_bag(sequence_, directory_ + "/none/a.bag", {}).message();
  EXPECT_NE(error.find(directory_ + "/none/a.bag"), std::string::npos) << error;
}

TEST_F(TumBagTest, a_full_disk_is_an_error_and_keeps_the_bag_that_was_there) {
  std::ofstream(path_) << "before";
  TumBagOptions options;
  for (const char* compression : {"none", "lz4", "bz2"}) {
    options.compression = compression;
    const core::SmallFiles limit(4096);
    const std::string error = write_tum_bag(sequence_, path_, options).message();
    EXPECT_EQ(error.find(path_ + ": cannot write the bag: "), 0U) << compression << ": " << error;
    EXPECT_EQ(core::read_whole(path_), "before");
  }
}

TEST_F(TumBagTest, a_missing_image_is_an_error_with_its_path) {
  TumBagOptions options;
  options.image_directory = directory_;
  const std::string error = write_tum_bag(sequence_, path_, options).message();
  EXPECT_NE(error.find(directory_ + "/rgb/1400000000.000000.png"), std::string::npos) << error;
}

/// With rendered images, of a small camera.
class RenderedBagTest : public TumBagTest {
 protected:
  void render(std::map<std::string, std::string> texts) {
    texts.insert({{"trajectory.duration_s", "0.3"}, {"trajectory.rate_hz", "20"}});
    const core::Camera camera{100.0, 100.0, 64.0, 48.0, 128, 96, {}};
    const core::SimulationOptions simulation = test::options_of(texts);
    sequence_ = core::checked(core::simulate(simulation, camera, core::coco()));
    ASSERT_EQ(core::render_sequence(simulation, core::coco(), 1, directory_, &sequence_).message(), "");
    options_.image_directory = directory_;
    options_.rendering = simulation.rendering;
    options_.compression = "lz4";
  }

  template <class Message>
  std::vector<typename Message::ConstPtr> messages(const char* topic) {
    rosbag::Bag bag(path_);
    std::vector<typename Message::ConstPtr> result;
    for (const rosbag::MessageInstance& m : rosbag::View(bag, rosbag::TopicQuery(topic))) {
      result.push_back(m.instantiate<Message>());
      EXPECT_EQ(m.getTime(), result.back()->header.stamp);
    }
    return result;
  }

  TumBagOptions options_;
};

TEST_F(RenderedBagTest, images_are_those_of_the_folder) {
  ASSERT_NO_FATAL_FAILURE(render({}));
  ASSERT_NO_FATAL_FAILURE(write(options_));
  const auto colors = messages<sensor_msgs::Image>("/camera/rgb/image_color");
  const auto depths = messages<sensor_msgs::Image>("/camera/depth/image");
  const auto infos = messages<sensor_msgs::CameraInfo>("/camera/depth/camera_info");
  ASSERT_EQ(colors.size(), 6u);
  ASSERT_EQ(depths.size(), 6u);
  ASSERT_EQ(infos.size(), 6u);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(to_stamp_ns(colors[i]->header.stamp), sequence_.truth[i].stamp_ns);
    EXPECT_EQ(to_stamp_ns(depths[i]->header.stamp), sequence_.truth[i].stamp_ns + 8000000);
    EXPECT_EQ(infos[i]->header.stamp, depths[i]->header.stamp);
    EXPECT_EQ(infos[i]->K[0], 525.0);
    EXPECT_EQ(colors[i]->encoding, "rgb8");
    EXPECT_EQ(depths[i]->encoding, "32FC1");
    EXPECT_EQ(depths[i]->header.frame_id, "/openni_rgb_optical_frame");
    EXPECT_EQ(depths[i]->step, 4u * 128u);
    const auto color = core::read_rendered_color(sequence_, directory_, i);
    const auto depth = core::read_rendered_depth(sequence_, options_.rendering, directory_, i);
    ASSERT_TRUE(color && depth);
    for (int k = 0; k < 128 * 96; ++k) {
      const auto at = static_cast<std::size_t>(k);
      ASSERT_EQ(colors[i]->data[3 * at], color->ptr()[3 * k + 2]) << "red comes first";
      ASSERT_EQ(colors[i]->data[3 * at + 2], color->ptr()[3 * k]);
    }
    EXPECT_EQ(std::memcmp(depths[i]->data.data(), depth->data, depths[i]->data.size()), 0);
  }
}

TEST_F(RenderedBagTest, unregistered_depth_has_its_own_frame) {
  ASSERT_NO_FATAL_FAILURE(render({{"rendering.depth_offset_m", "0.025"}}));
  ASSERT_NO_FATAL_FAILURE(write(options_));
  EXPECT_EQ(messages<sensor_msgs::Image>("/camera/depth/image")[0]->header.frame_id, "/openni_depth_optical_frame");
  rosbag::Bag bag(path_);
  const auto edges = read_tf(bag).edges;
  const core::SE3 T_kinect_depth =
      kinect_from("/openni_depth_optical_frame", {"/openni_depth_frame", "/openni_camera", "/kinect"}, edges);
  const core::SE3 T_color_depth = tum_kinect_from_optical().inverse() * T_kinect_depth;
  EXPECT_LT((T_color_depth.t - core::Vec3(0.025, 0.0, 0.0)).norm(), 1e-9);
  EXPECT_LT(core::so3_log(T_color_depth.q).norm(), 1e-9);
}

}  // namespace
}  // namespace semantic_topo_loop
