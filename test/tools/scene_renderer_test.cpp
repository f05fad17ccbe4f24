#include "tools/rendering/scene_renderer.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/geometry/lie.h"
#include "support/test_fixtures.h"
#include "tools/simulation/random.h"
#include "tools/simulation/trajectory.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::camera_fr2;

Room box_room() {
  Room room;
  room.half = {3.0, 2.5, 1.3};
  room.T_world_room.t.z() = 1.3;
  return room;
}

SceneObject object_at(int class_id, const Vec3& center, const Vec3& semi_axes) {
  SceneObject object;
  object.class_id = class_id;
  object.ellipsoid.T_world_quadric = {so3_exp({0.0, 0.0, 0.7}), center};
  object.ellipsoid.semi_axes = semi_axes;
  return object;
}

constexpr int kOrange = 49;  ///< drawn as its ellipsoid
constexpr int kBook = 73;    ///< drawn as a box

/// Looks along +x from the middle of the room.
SE3 looking_along_x(const Vec3& position) {
  Mat3 R;
  R << 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0;
  return {R, position};
}

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

TEST(SceneRenderer, walls_have_their_exact_depth) {
  const Room room = box_room();
  const SceneRenderer renderer({}, room, 1);
  const Camera camera = camera_fr2();
  const PixelRays rays(camera);
  Random random(3);
  for (int i = 0; i < 3; ++i) {
    SE3 T_world_camera(random.rotation(), {0.5, -0.4, 1.5});
    const RenderedImage image = renderer.render(rays, T_world_camera, 0.0, false);
    EXPECT_TRUE(image.color.empty());
    for (int y = 0; y < camera.height; y += 37) {
      for (int x = 0; x < camera.width; x += 41) {
        const Vec3 ray = camera.ray(camera.undistort(Vec2(x, y)));
        EXPECT_NEAR(image.depth_m.at<float>(y, x), room_depth(room, T_world_camera, ray), 1e-4) << x << ' ' << y;
      }
    }
  }
}

TEST(SceneRenderer, ellipsoids_have_their_exact_depth) {
  Scene scene;
  scene.objects.push_back(object_at(kOrange, {1.6, 0.1, 1.2}, {0.30, 0.15, 0.22}));
  const SceneRenderer renderer(scene, box_room(), 1);
  const Camera camera = camera_fr2();
  const SE3 T_world_camera = looking_along_x({0.0, 0.0, 1.3});
  const RenderedImage image = renderer.render(PixelRays(camera), T_world_camera);
  int hits = 0;
  for (int y = 0; y < camera.height; y += 7) {
    for (int x = 0; x < camera.width; x += 7) {
      const Vec3 ray = camera.ray(camera.undistort(Vec2(x, y)));
      const auto depth = ellipsoid_depth(scene.objects[0].ellipsoid, T_world_camera, ray);
      // Where the ray is tangent, rounding decides whether it hits.
      if (!depth || image.cosine.at<float>(y, x) < 0.02F) continue;
      EXPECT_NEAR(image.depth_m.at<float>(y, x), *depth, 1e-4) << x << ' ' << y;
      ++hits;
    }
  }
  EXPECT_GT(hits, 200);
  EXPECT_NEAR(image.cosine.at<float>(250, 325), 1.0, 0.3);
}

TEST(SceneRenderer, boxes_share_the_ellipsoids_centre_and_height) {
  Scene scene;
  scene.objects.push_back(object_at(kBook, {1.5, 0.0, 1.3}, {0.10, 0.14, 0.03}));
  scene.objects[0].ellipsoid.T_world_quadric.q = Quaternion::Identity();
  const SceneRenderer renderer(scene, box_room(), 1);
  const Camera camera = camera_fr2();
  const RenderedImage image = renderer.render(PixelRays(camera), looking_along_x({0.0, 0.0, 1.3}));
  ASSERT_TRUE(image.objects[0]);
  const double front_m = 1.5 - 0.8 * 0.10;
  EXPECT_NEAR(image.depth_m.at<float>(250, 325), front_m, 1e-4);
  const Box box = camera.undistort(image.objects[0]->box);
  EXPECT_NEAR(box.height(), 2.0 * 0.03 / front_m * camera.fy, 1.5);
  EXPECT_NEAR(box.width(), 2.0 * 0.8 * 0.14 / front_m * camera.fx, 1.5);
  EXPECT_NEAR(box.center().x(), camera.cx, 1.0);
  EXPECT_NEAR(box.center().y(), camera.cy, 1.0);
  EXPECT_EQ(image.objects[0]->inside, 1.0);
  EXPECT_EQ(image.objects[0]->visible, 1.0);
}

TEST(SceneRenderer, boxes_of_ellipsoids_agree_with_their_projection) {
  Scene scene = make_scene({}, 5);
  scene.objects.clear();
  const SE3& T_world_desk = scene.desks[0].T_world_desk;
  for (int i = -2; i <= 2; ++i) {
    const SceneObject object = object_at(kOrange, T_world_desk * Vec3(0.1 * i, 0.3 * i, 0.1), {0.06, 0.05, 0.1});
    scene.objects.push_back(object);
  }
  const HandheldTrajectory trajectory(scene, {}, 2);
  const Camera camera = camera_fr2();
  const PixelRays rays(camera);
  Room room = box_room();
  room.T_world_room = T_world_desk;
  room.half = {4.0, 4.0, 2.0};
  const SceneRenderer renderer(scene, room, 1);
  const SceneProjector projector(scene, camera);
  int compared = 0;
  for (int i = 0; i < 5; ++i) {
    const SE3 T_world_camera = trajectory.T_world_camera(7.0 * i);
    const auto drawn = renderer.render(rays, T_world_camera, 0.0, false).objects;
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

TEST(SceneRenderer, what_is_nearer_hides) {
  Scene scene;
  scene.objects.push_back(object_at(kOrange, {2.0, 0.0, 1.3}, {0.2, 0.2, 0.2}));
  scene.objects.push_back(object_at(kBook, {1.0, 0.1, 1.3}, {0.1, 0.1, 0.5}));
  scene.objects[1].ellipsoid.T_world_quadric.q = Quaternion::Identity();
  scene.objects.push_back(object_at(kOrange, {-1.0, 0.0, 1.3}, {0.2, 0.2, 0.2}));
  const SceneRenderer renderer(scene, box_room(), 1);
  const auto views = renderer.render(PixelRays(camera_fr2()), looking_along_x({0.0, 0.0, 1.3})).objects;
  ASSERT_TRUE(views[0] && views[1]);
  EXPECT_FALSE(views[2]) << "behind the camera";
  EXPECT_EQ(views[1]->visible, 1.0);
  EXPECT_LT(views[0]->visible, 0.75);
  EXPECT_GT(views[0]->visible, 0.3);
  EXPECT_GE(views[0]->box.x1, views[1]->box.x2 - 1.0) << "the box ends where the nearer object begins";
}

TEST(SceneRenderer, moving_objects_are_where_they_are_at_the_time) {
  Scene scene;
  scene.objects.push_back(object_at(kOrange, {1.5, 0.0, 1.3}, {0.2, 0.2, 0.2}));
  ObjectPhase moving, gone;
  moving.T_world_object = scene.objects[0].ellipsoid.T_world_quadric;
  moving.velocity = {0.0, 0.2, 0.0};
  gone.begin_s = 5.0;
  gone.is_present = false;
  scene.objects[0].phases = {moving, gone};
  const SceneRenderer renderer(scene, box_room(), 1);
  const PixelRays rays(camera_fr2());
  const auto view = [&](double time_s) {
    return renderer.render(rays, looking_along_x({0.0, 0.0, 1.3}), time_s).objects[0];
  };
  ASSERT_TRUE(view(0.0) && view(1.0));
  EXPECT_NEAR(view(0.0)->box.center().x() - view(1.0)->box.center().x(), 0.2 / 1.5 * 521.0, 5.0);
  EXPECT_FALSE(view(6.0));
}

TEST(SceneRenderer, textures_stay_on_their_surfaces) {
  const SceneRenderer renderer({}, box_room(), 1);
  const Camera camera = camera_fr2();
  const PixelRays rays(camera);
  const SE3 a = looking_along_x({0.0, 0.0, 1.3}),
            b = looking_along_x({0.6, 0.25, 1.2}) * SE3(so3_exp({0.0, 0.0, 0.2}), Vec3::Zero());
  const RenderedImage image_a = renderer.render(rays, a), image_b = renderer.render(rays, b);
  double difference = 0.0, spread = 0.0;
  int count = 0;
  for (int y = 0; y < camera.height; y += 5) {
    for (int x = 0; x < camera.width; x += 5) {
      const Vec3 point =
          a * (static_cast<double>(image_a.depth_m.at<float>(y, x)) * camera.ray(camera.undistort(Vec2(x, y))));
      const Vec3 seen = b.inverse() * point;
      const Vec2 pixel = camera.distort((camera.intrinsics() * seen).hnormalized());
      const int u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
      if (u < 0 || v < 0 || u >= camera.width || v >= camera.height) continue;
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

TEST(SceneRenderer, same_seed_same_picture) {
  const Scene scene = make_scene({}, 4);
  const auto picture = [&scene](std::uint64_t seed) {
    const HandheldTrajectory trajectory(scene, {}, 1);
    const Room room = room_around(scene, {{0, trajectory.T_world_camera(0.0)}});
    return SceneRenderer(scene, room, seed).render(PixelRays(camera_fr2()), trajectory.T_world_camera(0.0));
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
    const HandheldTrajectory trajectory(scene, {}, 3);
    StampedPoses poses;
    for (int i = 0; i < 40; ++i) poses.push_back({i, trajectory.T_world_camera(i)});
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

}  // namespace
}  // namespace semantic_topo_loop::core
