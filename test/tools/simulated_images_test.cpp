#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"
#include "support/test_files.h"
#include "support/test_fixtures.h"
#include "tools/rendering/kinect_model.h"
#include "tools/rendering/rgbd_sequence.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::coco;
using simulation_test::options_of;

Camera camera(int width, int height) {
  Camera camera;
  camera.fx = camera.fy = 0.8 * width;
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  camera.width = width;
  camera.height = height;
  return camera;
}

/// An ideal picture of a slanted or upright wall.
RenderedImage wall(const Camera& camera, float depth_m, float slope) {
  RenderedImage image;
  image.depth_m.create(camera.height, camera.width, CV_32FC1);
  image.cosine = cv::Mat(camera.height, camera.width, CV_32FC1, cv::Scalar(1.0));
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      image.depth_m.at<float>(y, x) = depth_m + slope * static_cast<float>(x) / static_cast<float>(camera.width);
    }
  }
  return image;
}

TEST(KinectModel, depth_noise_grows_with_the_square_of_the_range) {
  const Camera small = camera(320, 240);
  const PixelRays rays(small);
  for (const float depth_m : {0.8F, 2.0F, 4.0F}) {
    const RenderedImage ideal = wall(small, depth_m, 0.4F);
    const cv::Mat depth = kinect_depth(ideal, rays, 7);
    double sum = 0.0, squares = 0.0;
    int count = 0;
    for (int i = 0; i < 320 * 240; ++i) {
      const double range = static_cast<double>(ideal.depth_m.ptr<float>()[i]);
      const double error = (static_cast<double>(depth.ptr<float>()[i]) - range) / (range * range);
      if (!std::isfinite(error)) continue;
      sum += error;
      squares += error * error;
      ++count;
    }
    EXPECT_GT(count, 0.99 * 320 * 240) << depth_m;
    EXPECT_NEAR(sum / count, 0.0, 1e-4) << depth_m;
    EXPECT_NEAR(std::sqrt(squares / count), 1.42e-3, 0.2e-3) << depth_m;
  }
}

TEST(KinectModel, depth_comes_in_steps_of_disparity) {
  const Camera small = camera(160, 120);
  const cv::Mat depth = kinect_depth(wall(small, 1.5F, 0.5F), PixelRays(small), 7);
  for (int i = 0; i < 160 * 120; ++i) {
    const float z = depth.ptr<float>()[i];
    if (!std::isfinite(z)) continue;
    const float steps = 580.0F * 0.075F / z / 0.125F;
    EXPECT_NEAR(steps, std::round(steps), 1e-3F);
  }
}

TEST(KinectModel, too_near_is_a_hole_and_too_far_is_infinite) {
  const Camera small = camera(160, 120);
  const PixelRays rays(small);
  const auto share = [&](float depth_m, auto is_such) {
    const cv::Mat depth = kinect_depth(wall(small, depth_m, 0.0F), rays, 7);
    return static_cast<double>(std::count_if(depth.ptr<float>(), depth.ptr<float>() + depth.total(), is_such)) /
           static_cast<double>(depth.total());
  };
  const auto is_hole = [](float z) { return std::isnan(z); };
  const auto is_far = [](float z) { return std::isinf(z); };
  EXPECT_EQ(share(0.3F, is_hole), 1.0);
  EXPECT_NEAR(share(2.0F, is_hole), 0.002, 0.002);
  EXPECT_EQ(share(3.0F, is_far), 0.0);
  EXPECT_NEAR(share(5.25F, is_far), 0.5, 0.03);
  EXPECT_GT(share(7.0F, is_far), 0.99);
}

TEST(KinectModel, grazing_surfaces_return_nothing) {
  const Camera small = camera(160, 120);
  RenderedImage ideal = wall(small, 1.5F, 0.0F);
  ideal.cosine.setTo(0.05);
  const cv::Mat depth = kinect_depth(ideal, PixelRays(small), 7);
  EXPECT_TRUE(
      std::all_of(depth.ptr<float>(), depth.ptr<float>() + depth.total(), [](float z) { return std::isnan(z); }));
}

TEST(KinectModel, a_near_object_shades_the_wall_on_its_left) {
  const Camera small = camera(320, 240);
  RenderedImage ideal = wall(small, 2.0F, 0.0F);
  const cv::Range object(150, 200);
  ideal.depth_m.colRange(object).setTo(1.0);
  const cv::Mat depth = kinect_depth(ideal, PixelRays(small), 7);
  const auto holes = [&depth](int from, int to) {
    int count = 0;
    for (int y = 0; y < depth.rows; ++y) {
      for (int x = from; x < to; ++x) count += std::isnan(depth.at<float>(y, x)) ? 1 : 0;
    }
    return static_cast<double>(count) / depth.rows;
  };
  // f b (1/near - 1/far), px
  EXPECT_NEAR(holes(100, 152), small.fx * 0.075 * 0.5, 1.5);
  EXPECT_LT(holes(152, 300), 1.5);
}

TEST(KinectModel, seeds_of_noise) {
  const Camera small = camera(160, 120);
  const PixelRays rays(small);
  const RenderedImage ideal = wall(small, 1.5F, 0.5F);
  const auto differ = [](const cv::Mat& a, const cv::Mat& b) {
    const cv::Mat words_a(a.rows, a.cols, CV_32SC1, a.data), words_b(b.rows, b.cols, CV_32SC1, b.data);
    return cv::countNonZero(words_a != words_b);
  };
  EXPECT_EQ(differ(kinect_depth(ideal, rays, 7), kinect_depth(ideal, rays, 7)), 0);
  EXPECT_GT(differ(kinect_depth(ideal, rays, 7), kinect_depth(ideal, rays, 8)), 5000);
  const cv::Mat grey(120, 160, CV_8UC3, cv::Scalar::all(128));
  EXPECT_EQ(cv::norm(kinect_color(grey, 1), kinect_color(grey, 1), cv::NORM_INF), 0.0);
  EXPECT_GT(cv::norm(kinect_color(grey, 1), kinect_color(grey, 2), cv::NORM_INF), 0.0);
}

TEST(KinectModel, color_noise) {
  const cv::Mat grey(240, 320, CV_8UC3, cv::Scalar::all(128));
  const cv::Mat noisy = kinect_color(grey, 3);
  cv::Scalar mean, deviation;
  cv::meanStdDev(noisy(cv::Rect(140, 100, 40, 40)), mean, deviation);
  EXPECT_NEAR(mean[0], 128.0, 1.0);
  EXPECT_NEAR(deviation[0], 2.2, 0.3);
  cv::meanStdDev(noisy(cv::Rect(0, 0, 10, 10)), mean, deviation);
  EXPECT_NEAR(mean[0], 128.0 * 0.79, 3.0) << "corners are darker";
}

class RenderedSequenceTest : public ::testing::Test {
 protected:
  SimulatedSequence render(const std::string& name, const std::map<std::string, std::string>& texts, int threads) {
    std::map<std::string, std::string> all = texts;
    all.insert({{"trajectory.duration_s", "0.5"}, {"trajectory.rate_hz", "10"}});
    options_ = options_of(all);
    std::string error;
    auto sequence = simulate(options_, camera(160, 120), coco(), &error);
    EXPECT_TRUE(sequence) << error;
    EXPECT_TRUE(render_sequence(options_, coco(), threads, directory_.path(name), &*sequence, &error)) << error;
    return *sequence;
  }

  TestDirectory directory_;
  SimulationOptions options_;
};

TEST_F(RenderedSequenceTest, same_bytes_on_any_number_of_threads) {
  const SimulatedSequence a = render("a", {}, 1), b = render("b", {}, 3);
  int files = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(directory_.path("a"))) {
    if (!entry.is_regular_file()) continue;
    const std::string name = std::filesystem::relative(entry.path(), directory_.path("a")).string();
    EXPECT_TRUE(read_whole(directory_.path("a/" + name)) == read_whole(directory_.path("b/" + name))) << name;
    ++files;
  }
  EXPECT_EQ(files, 5 + 5 + 3);
  for (std::size_t i = 0; i < a.detections.size(); ++i) {
    ASSERT_EQ(a.detections[i].size(), b.detections[i].size());
    for (std::size_t k = 0; k < a.detections[i].size(); ++k) {
      EXPECT_EQ(a.detections[i][k].detection.box.edges(), b.detections[i][k].detection.box.edges());
    }
  }
}

TEST_F(RenderedSequenceTest, lists_pair_each_image_with_its_depth) {
  const SimulatedSequence sequence = render("a", {{"rendering.depth_delay_s", "0.012"}}, 2);
  const std::string text = read_whole(directory_.path("a/associations.txt"));
  const auto lines = content_lines(text);
  ASSERT_EQ(lines.size(), sequence.truth.size());
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const auto fields = split_blanks(lines[i].text);
    ASSERT_EQ(fields.size(), 4u);
    EXPECT_EQ(parse_stamp(fields[0]), sequence.truth[i].stamp_ns);
    EXPECT_EQ(parse_stamp(fields[2]), sequence.truth[i].stamp_ns + 12000000);
    EXPECT_TRUE(std::filesystem::exists(directory_.path("a/" + std::string(fields[1]))));
    EXPECT_TRUE(std::filesystem::exists(directory_.path("a/" + std::string(fields[3]))));
  }
}

TEST_F(RenderedSequenceTest, images_read_back) {
  const SimulatedSequence sequence = render(
      "a", {{"rendering.noise", "false"}, {"rendering.depth_scale", "1000"}, {"rendering.depth_delay_s", "0"}}, 1);
  std::string error;
  const auto color = read_rendered_color(sequence, directory_.path("a"), 2, &error);
  const auto depth = read_rendered_depth(sequence, options_.rendering, directory_.path("a"), 2, &error);
  ASSERT_TRUE(color && depth) << error;
  const SceneRenderer renderer(sequence.scene, room_around(sequence.scene, sequence.mocap), 1);
  const RenderedImage ideal = renderer.render(PixelRays(sequence.camera), sequence.truth[2].T_world_camera, 0.2);
  EXPECT_LT(cv::norm(*depth, ideal.depth_m, cv::NORM_INF), 0.51e-3);
  std::filesystem::remove_all(directory_.path("a/rgb"));
  EXPECT_FALSE(read_rendered_color(sequence, directory_.path("a"), 2, &error));
  EXPECT_NE(error.find("rgb/1400000000.200000.png"), std::string::npos) << error;
}

TEST_F(RenderedSequenceTest, depth_of_a_camera_beside) {
  const SimulatedSequence sequence = render(
      "a", {{"rendering.noise", "false"}, {"rendering.depth_delay_s", "0"}, {"rendering.depth_offset_m", "0.05"}}, 1);
  const SceneRenderer renderer(sequence.scene, room_around(sequence.scene, sequence.mocap), 1);
  const SE3 T_world_depth = sequence.truth[1].T_world_camera * SE3(Quaternion::Identity(), {0.05, 0.0, 0.0});
  const RenderedImage ideal = renderer.render(PixelRays(sequence.camera), T_world_depth, 0.1);
  const auto depth = read_rendered_depth(sequence, options_.rendering, directory_.path("a"), 1, nullptr);
  ASSERT_TRUE(depth);
  EXPECT_LT(cv::norm(*depth, ideal.depth_m, cv::NORM_INF), 0.2e-3);
}

TEST_F(RenderedSequenceTest, far_pixels_have_the_value_asked_for) {
  // A room that is larger than the range.
  const SimulatedSequence sequence = render("a", {{"rendering.far_value", "65535"}, {"trajectory.distance_m", "4"}}, 1);
  const std::string name = "depth/" + format_stamp(sequence.depth[0].stamp_ns) + ".png";
  const auto far_is_none = read_rendered_depth(sequence, options_.rendering, directory_.path("a"), 0, nullptr);
  RenderingOptions as_depth = options_.rendering;
  as_depth.far_value = 0;
  const auto far_is_depth = read_rendered_depth(sequence, as_depth, directory_.path("a"), 0, nullptr);
  ASSERT_TRUE(far_is_none && far_is_depth);
  double largest = 0.0;
  cv::minMaxLoc(*far_is_depth, nullptr, &largest);
  EXPECT_NEAR(largest, 65535.0 / 5000.0, 1e-3);
  for (int i = 0; i < 160 * 120; ++i) {
    const float z = far_is_none->ptr<float>()[i];
    EXPECT_TRUE(std::isnan(z) || z < 6.5F);
  }
}

TEST_F(RenderedSequenceTest, an_unwritable_directory_is_an_error_with_its_path) {
  SimulatedSequence sequence = render("a", {}, 1);
  std::string error;
  EXPECT_FALSE(render_sequence(options_, coco(), 1, "/dev/null/here", &sequence, &error));
  EXPECT_NE(error.find("/dev/null/here"), std::string::npos) << error;
}

TEST(RenderingOptions, values_out_of_range_are_named) {
  const std::pair<const char*, const char*> bad[] = {
      {"rendering.depth_scale", "0"},   {"rendering.depth_scale", "nan"},   {"rendering.far_value", "7"},
      {"rendering.depth_delay_s", "1"}, {"rendering.depth_offset_m", "-3"}, {"rendering.noise", "much"},
      {"trajectory.model", "drone"},    {"trajectory.arc_deg", "0"}};
  for (const auto& [key, value] : bad) {
    const std::string error = make_options<SimulationOptions>({{key, value}}).message();
    EXPECT_NE(error.find(key), std::string::npos) << error;
    EXPECT_NE(error.find(value), std::string::npos) << error;
  }
}

TEST(SequenceManifest, tells_requests_apart) {
  const auto manifest = [](const std::map<std::string, std::string>& texts, int width, const char* classes) {
    return sequence_manifest(options_of(texts), camera(width, 120), classes, "images=true");
  };
  const std::string base = manifest({}, 160, "a");
  EXPECT_EQ(base, manifest({}, 160, "a"));
  EXPECT_NE(base, manifest({{"simulation.seed", "2"}}, 160, "a"));
  EXPECT_NE(base, manifest({{"rendering.noise", "false"}}, 160, "a"));
  EXPECT_NE(base, manifest({}, 161, "a"));
  EXPECT_NE(base, manifest({}, 160, "b"));
}

}  // namespace
}  // namespace semantic_topo_loop::core
