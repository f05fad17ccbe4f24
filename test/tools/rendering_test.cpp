#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"
#include "support/test_files.h"
#include "support/test_fixtures.h"
#include "tools/rendering/rgbd_sequence.h"
#include "tools/rendering/scene_renderer.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::looking_along_x;
using simulation_test::options_of;
using simulation_test::turned_object;

Room box_room() {
  Room room;
  room.half = {3.0, 2.5, 1.3};
  room.T_world_room.t.z() = 1.3;
  return room;
}

constexpr int kOrange = 49;  ///< drawn as its ellipsoid
constexpr int kBook = 73;    ///< drawn as a box

/// In double and by other formulas than the renderer's: depth of the room's walls along a ray from inside.
double room_depth(const Room& room, const SE3& T_world_camera, const Vec3& ray) {
  const SE3 T_room_camera = room.T_world_room.inverse() * T_world_camera;
  const Vec3 direction = T_room_camera.q * ray;
  double depth = 1e9;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {-1.0, 1.0}) {
      const double t = (side * room.half[axis] - T_room_camera.t[axis]) / direction[axis];
      if (t > 0.0) depth = std::min(depth, t);
    }
  }
  return depth;
}

/// Depth of a quadric p^T Q p = 0 along a ray; none if missed.
std::optional<double> ellipsoid_depth(const Ellipsoid& ellipsoid, const SE3& T_world_camera, const Vec3& ray) {
  const Mat4 Q = ellipsoid.dual().inverse();
  const Eigen::Vector4d origin = T_world_camera.t.homogeneous();
  Eigen::Vector4d direction = Eigen::Vector4d::Zero();
  direction.head<3>() = T_world_camera.q * ray;
  const double a = direction.dot(Q * direction), b = direction.dot(Q * origin), c = origin.dot(Q * origin);
  if (b * b < a * c) return std::nullopt;
  return (-b - std::sqrt(b * b - a * c)) / a;
}

class SceneRendererTest : public ::testing::Test {
 protected:
  Vec3 ray(int x, int y) const { return camera_.ray(camera_.undistort(Vec2(x, y))); }
  RenderedImage look_ahead(const Scene& scene) const {
    return SceneRenderer(scene, box_room(), 1).render(rays_, ahead_);
  }

  const Camera camera_ = camera_fr2();
  const PixelRays rays_{camera_};
  const SE3 ahead_ = looking_along_x({0.0, 0.0, 1.3});  ///< T_world_camera
};

TEST_F(SceneRendererTest, walls_have_their_exact_depth) {
  const Room room = box_room();
  const SceneRenderer renderer({}, room, 1);
  Random random(3);
  for (int i = 0; i < 3; ++i) {
    SE3 T_world_camera(random.rotation(), {0.5, -0.4, 1.5});
    const RenderedImage image = renderer.render(rays_, T_world_camera, 0.0, false);
    EXPECT_TRUE(image.color.empty());
    for (int y = 0; y < camera_.height; y += 37) {
      for (int x = 0; x < camera_.width; x += 41) {
        EXPECT_NEAR(image.depth_m.at<float>(y, x), room_depth(room, T_world_camera, ray(x, y)), 1e-4) << x << ' ' << y;
      }
    }
  }
}

TEST_F(SceneRendererTest, ellipsoids_have_their_exact_depth) {
  Scene scene;
  scene.objects.push_back(turned_object(kOrange, {1.6, 0.1, 1.2}, {0.30, 0.15, 0.22}));
  const RenderedImage image = look_ahead(scene);
  int hits = 0;
  for (int y = 0; y < camera_.height; y += 7) {
    for (int x = 0; x < camera_.width; x += 7) {
      const auto depth = ellipsoid_depth(scene.objects[0].ellipsoid, ahead_, ray(x, y));
      // Where the ray is tangent, rounding decides whether it hits.
      if (!depth || image.cosine.at<float>(y, x) < 0.02F) continue;
      EXPECT_NEAR(image.depth_m.at<float>(y, x), *depth, 1e-4) << x << ' ' << y;
      ++hits;
    }
  }
  EXPECT_GT(hits, 200);
  EXPECT_NEAR(image.cosine.at<float>(250, 325), 1.0, 0.3);
}

TEST_F(SceneRendererTest, boxes_share_the_ellipsoids_centre_and_height) {
  Scene scene;
  scene.objects.push_back(turned_object(kBook, {1.5, 0.0, 1.3}, {0.10, 0.14, 0.03}));
  scene.objects[0].ellipsoid.T_world_quadric.q = Quaternion::Identity();
  const RenderedImage image = look_ahead(scene);
  ASSERT_TRUE(image.objects[0]);
  const double front_m = 1.5 - 0.8 * 0.10;
  EXPECT_NEAR(image.depth_m.at<float>(250, 325), front_m, 1e-4);
  const Box box = camera_.undistort(image.objects[0]->box);
  EXPECT_NEAR(box.height(), 2.0 * 0.03 / front_m * camera_.fy, 1.5);
  EXPECT_NEAR(box.width(), 2.0 * 0.8 * 0.14 / front_m * camera_.fx, 1.5);
  EXPECT_NEAR(box.center().x(), camera_.cx, 1.0);
  EXPECT_NEAR(box.center().y(), camera_.cy, 1.0);
  EXPECT_EQ(image.objects[0]->inside, 1.0);
  EXPECT_EQ(image.objects[0]->visible, 1.0);
}

TEST_F(SceneRendererTest, boxes_of_ellipsoids_agree_with_their_projection) {
  Scene scene = make_scene({}, 5);
  scene.objects.clear();
  const SE3& T_world_desk = scene.desks[0].T_world_desk;
  for (int i = -2; i <= 2; ++i) {
    const SceneObject object = turned_object(kOrange, T_world_desk * Vec3(0.1 * i, 0.3 * i, 0.1), {0.06, 0.05, 0.1});
    scene.objects.push_back(object);
  }
  const auto trajectory = make_trajectory(scene, {}, 2);
  Room room = box_room();
  room.T_world_room = T_world_desk;
  room.half = {4.0, 4.0, 2.0};
  const SceneRenderer renderer(scene, room, 1);
  const SceneProjector projector(scene, camera_);
  int compared = 0;
  for (int i = 0; i < 5; ++i) {
    const SE3 T_world_camera = trajectory(7.0 * i);
    const auto drawn = renderer.render(rays_, T_world_camera, 0.0, false).objects;
    const auto projected = projector.project(T_world_camera);
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
      // Where the border cuts an object, the projector's box is that of the part outside, clipped.
      if (!projected[k] || projected[k]->visible < 1.0 || projected[k]->inside < 1.0) continue;
      ASSERT_TRUE(drawn[k]);
      if (drawn[k]->visible < 1.0) continue;
      EXPECT_LT((drawn[k]->box.edges() - projected[k]->box.edges()).cwiseAbs().maxCoeff(), 1.0);
      EXPECT_NEAR(drawn[k]->inside, projected[k]->inside, 0.1);
      ++compared;
    }
  }
  EXPECT_GT(compared, 10);
}

TEST_F(SceneRendererTest, what_is_nearer_hides) {
  Scene scene;
  scene.objects.push_back(turned_object(kOrange, {2.0, 0.0, 1.3}, {0.2, 0.2, 0.2}));
  scene.objects.push_back(turned_object(kBook, {1.0, 0.1, 1.3}, {0.1, 0.1, 0.5}));
  scene.objects[1].ellipsoid.T_world_quadric.q = Quaternion::Identity();
  scene.objects.push_back(turned_object(kOrange, {-1.0, 0.0, 1.3}, {0.2, 0.2, 0.2}));
  const auto views = look_ahead(scene).objects;
  ASSERT_TRUE(views[0] && views[1]);
  EXPECT_FALSE(views[2]) << "behind the camera";
  EXPECT_EQ(views[1]->visible, 1.0);
  EXPECT_LT(views[0]->visible, 0.75);
  EXPECT_GT(views[0]->visible, 0.3);
  EXPECT_GE(views[0]->box.x1, views[1]->box.x2 - 1.0) << "the box ends where the nearer object begins";
}

TEST_F(SceneRendererTest, moving_objects_are_where_they_are_at_the_time) {
  Scene scene;
  scene.objects.push_back(turned_object(kOrange, {1.5, 0.0, 1.3}, {0.2, 0.2, 0.2}));
  ObjectPhase moving, gone;
  moving.T_world_object = scene.objects[0].ellipsoid.T_world_quadric;
  moving.velocity = {0.0, 0.2, 0.0};
  gone.begin_s = 5.0;
  gone.is_present = false;
  scene.objects[0].phases = {moving, gone};
  const SceneRenderer renderer(scene, box_room(), 1);
  const auto view = [&](double time_s) { return renderer.render(rays_, ahead_, time_s).objects[0]; };
  ASSERT_TRUE(view(0.0) && view(1.0));
  EXPECT_NEAR(view(0.0)->box.center().x() - view(1.0)->box.center().x(), 0.2 / 1.5 * 521.0, 5.0);
  EXPECT_FALSE(view(6.0));
}

TEST_F(SceneRendererTest, textures_stay_on_their_surfaces) {
  const SceneRenderer renderer({}, box_room(), 1);
  const SE3 a = ahead_, b = looking_along_x({0.6, 0.25, 1.2}) * SE3(so3_exp({0.0, 0.0, 0.2}), Vec3::Zero());
  const RenderedImage image_a = renderer.render(rays_, a), image_b = renderer.render(rays_, b);
  double difference = 0.0, spread = 0.0;
  int count = 0;
  for (int y = 0; y < camera_.height; y += 5) {
    for (int x = 0; x < camera_.width; x += 5) {
      const Vec3 point = a * (static_cast<double>(image_a.depth_m.at<float>(y, x)) * ray(x, y));
      const Vec3 seen = b.inverse() * point;
      const Vec2 pixel = camera_.distort((camera_.intrinsics() * seen).hnormalized());
      const int u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
      if (u < 0 || v < 0 || u >= camera_.width || v >= camera_.height) continue;
      const double green_a = image_a.color.at<cv::Vec3b>(y, x)[1], green_b = image_b.color.at<cv::Vec3b>(v, u)[1];
      difference += std::abs(green_a - green_b);
      spread += std::abs(green_a - image_b.color.at<cv::Vec3b>(y, x)[1]);
      ++count;
    }
  }
  ASSERT_GT(count, 3000);
  EXPECT_LT(difference / count, 6.0);
  EXPECT_GT(spread / count, 15.0) << "the wall is textured";
}

TEST_F(SceneRendererTest, same_seed_same_picture) {
  const Scene scene = make_scene({}, 4);
  const auto picture = [&](std::uint64_t seed) {
    const auto trajectory = make_trajectory(scene, {}, 1);
    const Room room = room_around(scene, {{0, trajectory(0.0)}});
    return SceneRenderer(scene, room, seed).render(rays_, trajectory(0.0));
  };
  const RenderedImage first = picture(1), again = picture(1), other = picture(2);
  EXPECT_EQ(cv::norm(first.color, again.color, cv::NORM_INF), 0.0);
  EXPECT_EQ(cv::norm(first.depth_m, again.depth_m, cv::NORM_INF), 0.0);
  EXPECT_GT(cv::norm(first.color, other.color, cv::NORM_INF), 50.0);
  EXPECT_EQ(cv::norm(first.depth_m, other.depth_m, cv::NORM_INF), 0.0);
}

TEST(Room, holds_furniture_and_camera) {
  for (const char* layout : {"desk", "office"}) {
    SceneOptions options;
    options.layout = layout;
    const Scene scene = make_scene(options, 3);
    const auto trajectory = make_trajectory(scene, {}, 3);
    StampedPoses poses;
    for (int i = 0; i < 40; ++i) poses.push_back({i, trajectory(i)});
    const Room room = room_around(scene, poses);
    const auto margin = [&room](const Vec3& p) {
      return (room.half - (room.T_world_room.inverse() * p).cwiseAbs()).head<2>().minCoeff();
    };
    for (const StampedPose& pose : poses) EXPECT_GT(margin(pose.T_world_camera.t), 0.6);
    for (const SceneObject& object : scene.objects) {
      EXPECT_GT(margin(object.ellipsoid.center()), object.ellipsoid.semi_axes.head<2>().maxCoeff());
    }
    EXPECT_NEAR(room.T_world_room.t.z(), room.half.z(), 1e-12) << "the floor is z = 0";
  }
}

Camera camera(int width, int height) {
  return {0.8 * width, 0.8 * width, 0.5 * width, 0.5 * height, width, height, {}};
}

const PixelRays kSmall(camera(160, 120)), kLarge(camera(320, 240));

/// An ideal picture of a slanted or upright wall.
RenderedImage wall(const PixelRays& rays, float depth_m, float slope) {
  const Camera& camera = rays.camera;
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
  for (const float depth_m : {0.8F, 2.0F, 4.0F}) {
    const RenderedImage ideal = wall(kLarge, depth_m, 0.4F);
    const cv::Mat depth = kinect_depth(ideal, kLarge, 7);
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
  const cv::Mat depth = kinect_depth(wall(kSmall, 1.5F, 0.5F), kSmall, 7);
  for (int i = 0; i < 160 * 120; ++i) {
    const float z = depth.ptr<float>()[i];
    if (!std::isfinite(z)) continue;
    const float steps = 580.0F * 0.075F / z / 0.125F;
    EXPECT_NEAR(steps, std::round(steps), 1e-3F);
  }
}

TEST(KinectModel, too_near_is_a_hole_and_too_far_is_infinite) {
  const auto share = [&](float depth_m, auto is_such) {
    const cv::Mat depth = kinect_depth(wall(kSmall, depth_m, 0.0F), kSmall, 7);
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
  RenderedImage ideal = wall(kSmall, 1.5F, 0.0F);
  ideal.cosine.setTo(0.05);
  const cv::Mat depth = kinect_depth(ideal, kSmall, 7);
  EXPECT_TRUE(
      std::all_of(depth.ptr<float>(), depth.ptr<float>() + depth.total(), [](float z) { return std::isnan(z); }));
}

TEST(KinectModel, a_near_object_shades_the_wall_on_its_left) {
  RenderedImage ideal = wall(kLarge, 2.0F, 0.0F);
  const cv::Range object(150, 200);
  ideal.depth_m.colRange(object).setTo(1.0);
  const cv::Mat depth = kinect_depth(ideal, kLarge, 7);
  const auto holes = [&depth](int from, int to) {
    int count = 0;
    for (int y = 0; y < depth.rows; ++y) {
      for (int x = from; x < to; ++x) count += std::isnan(depth.at<float>(y, x)) ? 1 : 0;
    }
    return static_cast<double>(count) / depth.rows;
  };
  // f b (1/near - 1/far), px
  EXPECT_NEAR(holes(100, 152), kLarge.camera.fx * 0.075 * 0.5, 1.5);
  EXPECT_LT(holes(152, 300), 1.5);
}

TEST(KinectModel, seeds_of_noise) {
  const RenderedImage ideal = wall(kSmall, 1.5F, 0.5F);
  const auto differ = [](const cv::Mat& a, const cv::Mat& b) {
    const cv::Mat words_a(a.rows, a.cols, CV_32SC1, a.data), words_b(b.rows, b.cols, CV_32SC1, b.data);
    return cv::countNonZero(words_a != words_b);
  };
  EXPECT_EQ(differ(kinect_depth(ideal, kSmall, 7), kinect_depth(ideal, kSmall, 7)), 0);
  EXPECT_GT(differ(kinect_depth(ideal, kSmall, 7), kinect_depth(ideal, kSmall, 8)), 5000);
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
    SimulatedSequence sequence = checked(simulate(options_, camera(160, 120), coco()));
    EXPECT_EQ(render_sequence(options_, coco(), threads, directory_.path(name), &sequence).message(), "");
    return sequence;
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
  EXPECT_EQ(files, 5 + 5 + 4) << "color, depth, three lists and the manifest";
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
  const auto color = read_rendered_color(sequence, directory_.path("a"), 2);
  const auto depth = read_rendered_depth(sequence, options_.rendering, directory_.path("a"), 2);
  ASSERT_TRUE(color && depth) << color.message() << depth.message();
  const SceneRenderer renderer(sequence.scene, room_around(sequence.scene, sequence.mocap), 1);
  const RenderedImage ideal = renderer.render(PixelRays(sequence.camera), sequence.truth[2].T_world_camera, 0.2);
  EXPECT_LT(cv::norm(*depth, ideal.depth_m, cv::NORM_INF), 0.51e-3);
  std::filesystem::remove_all(directory_.path("a/rgb"));
  const std::string error = read_rendered_color(sequence, directory_.path("a"), 2).message();
  EXPECT_NE(error.find("rgb/1400000000.200000.png"), std::string::npos) << error;
}

TEST_F(RenderedSequenceTest, a_slope_of_depth_is_that_asked_for) {
  const SimulatedSequence sequence = render(
      "a", {{"rendering.noise", "false"}, {"rendering.depth_delay_s", "0"}, {"rendering.depth_slope", "0.1"}}, 1);
  const auto depth = read_rendered_depth(sequence, options_.rendering, directory_.path("a"), 2);
  ASSERT_TRUE(depth) << depth.message();
  const SceneRenderer renderer(sequence.scene, room_around(sequence.scene, sequence.mocap), 1);
  const RenderedImage ideal = renderer.render(PixelRays(sequence.camera), sequence.truth[2].T_world_camera, 0.2);
  for (const auto& [x, factor] : {std::pair(0, 0.9F), {53, 0.9F + 0.2F * 53.0F / 159.0F}, {159, 1.1F}}) {
    EXPECT_NEAR(depth->at<float>(60, x), factor * ideal.depth_m.at<float>(60, x), 0.2e-3) << "column " << x;
  }
}

TEST_F(RenderedSequenceTest, depth_of_a_camera_beside) {
  const SimulatedSequence sequence = render(
      "a", {{"rendering.noise", "false"}, {"rendering.depth_delay_s", "0"}, {"rendering.depth_offset_m", "0.05"}}, 1);
  const SceneRenderer renderer(sequence.scene, room_around(sequence.scene, sequence.mocap), 1);
  const SE3 T_world_depth = sequence.truth[1].T_world_camera * SE3(Quaternion::Identity(), {0.05, 0.0, 0.0});
  const RenderedImage ideal = renderer.render(PixelRays(sequence.camera), T_world_depth, 0.1);
  const auto depth = read_rendered_depth(sequence, options_.rendering, directory_.path("a"), 1);
  ASSERT_TRUE(depth);
  EXPECT_LT(cv::norm(*depth, ideal.depth_m, cv::NORM_INF), 0.2e-3);
}

TEST_F(RenderedSequenceTest, far_pixels_have_the_value_asked_for) {
  // A room that is larger than the range.
  const SimulatedSequence sequence = render("a", {{"rendering.far_value", "65535"}, {"trajectory.distance_m", "4"}}, 1);
  const std::string name = "depth/" + format_stamp(sequence.depth[0].stamp_ns) + ".png";
  const auto far_is_none = read_rendered_depth(sequence, options_.rendering, directory_.path("a"), 0);
  RenderingOptions as_depth = options_.rendering;
  as_depth.far_value = 0;
  const auto far_is_depth = read_rendered_depth(sequence, as_depth, directory_.path("a"), 0);
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
  const std::string error = render_sequence(options_, coco(), 1, "/dev/null/here", &sequence).message();
  EXPECT_NE(error.find("/dev/null/here"), std::string::npos) << error;
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
