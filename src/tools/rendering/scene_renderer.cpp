#include "tools/rendering/scene_renderer.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace semantic_topo_loop::core {
namespace {

// --- shapes as rays meet them ---------------------------------------------------------------------------------------

/// A ray has z = 1, so that the distance in its lengths is the depth. Infinity if it misses.
constexpr float kMiss = std::numeric_limits<float>::infinity();

constexpr double kNear_m = 0.02;  ///< nearer corners of shapes count as behind the camera

const Box kEverywhere{-1e6, -1e6, 1e6, 1e6};

/// Around the corners; everywhere if the box reaches behind the camera; none if it is wholly behind.
std::optional<Box> box_bounds(const SE3& T_camera_shape, const Vec3& half) {
  Box bounds{1e6, 1e6, -1e6, -1e6};
  int behind = 0;
  for (int i = 0; i < 8; ++i) {
    const Vec3 corner((i & 1) != 0 ? half.x() : -half.x(), (i & 2) != 0 ? half.y() : -half.y(),
                      (i & 4) != 0 ? half.z() : -half.z());
    const Vec3 p = T_camera_shape * corner;
    if (p.z() < kNear_m) {
      ++behind;
      continue;
    }
    const Vec2 q = p.hnormalized();
    bounds = {std::min(bounds.x1, q.x()), std::min(bounds.y1, q.y()), std::max(bounds.x2, q.x()),
              std::max(bounds.y2, q.y())};
  }
  if (behind == 8) return std::nullopt;
  return behind > 0 ? kEverywhere : bounds;
}

std::optional<Box> ellipsoid_bounds(const SE3& T_camera_shape, const Vec3& half) {
  Mat34 P = Mat34::Identity();
  const std::optional<Box> bounds = project_box(Ellipsoid{T_camera_shape, half}, P);
  if (bounds) return bounds;
  return T_camera_shape.t.z() + half.maxCoeff() < kNear_m ? std::nullopt : std::optional<Box>(kEverywhere);
}

float enter_box(const Eigen::Vector3f& o, const Eigen::Vector3f& d) {
  float entry = -kMiss, exit = kMiss;
  for (int i = 0; i < 3; ++i) {
    const float inverse = 1.0F / d[i];
    const float a = (-1.0F - o[i]) * inverse, b = (1.0F - o[i]) * inverse;
    // A ray within a face gives 0 * infinity, which these comparisons ignore.
    entry = std::max(entry, std::min(a, b));
    exit = std::min(exit, std::max(a, b));
  }
  return entry <= exit && entry > 0.0F ? entry : kMiss;
}

float enter_sphere(const Eigen::Vector3f& o, const Eigen::Vector3f& d) {
  // By the point nearest to the centre: b^2 - a c would lose all digits of a small sphere far away.
  const float a = d.squaredNorm();
  const float middle = -o.dot(d) / a;
  const float rest = 1.0F - (o + middle * d).squaredNorm();
  if (rest <= 0.0F) return kMiss;
  const float depth = middle - std::sqrt(rest / a);
  return depth > 0.0F ? depth : kMiss;
}

/// A shape as the rays of one camera meet it: the unit cube or unit sphere after p_camera -> scale * p_camera + origin.
struct CastShape {
  Eigen::Matrix3f scale = Eigen::Matrix3f::Identity();
  Eigen::Vector3f origin = Eigen::Vector3f::Zero();
  Eigen::Matrix3f R_camera_shape = Eigen::Matrix3f::Identity();
  Eigen::Vector3f inverse_half = Eigen::Vector3f::Ones();
  bool is_box = true;
  int shape = -1;   ///< index of the drawn shape
  int object = -1;  ///< of that shape
  Box bounds;       ///< holds every ray (x, y, 1) that can hit

  Eigen::Vector3f point(const Eigen::Vector3f& ray, float depth) const { return depth * (scale * ray) + origin; }
  /// Unit normal in the camera frame at a point of the surface (in units of `half`) and its face, outwards.
  Eigen::Vector3f normal(const Eigen::Vector3f& point, Face face) const {
    if (!is_box) return (R_camera_shape * point.cwiseProduct(inverse_half)).normalized();
    const Eigen::Vector3f axis = R_camera_shape.col(face / 2);
    return face % 2 == 0 ? axis : Eigen::Vector3f(-axis);
  }
  float depth_of_entry(const Eigen::Vector3f& ray) const {
    const Eigen::Vector3f direction = scale * ray;
    return is_box ? enter_box(origin, direction) : enter_sphere(origin, direction);
  }
  /// Where a ray leaves a box that it starts in.
  float depth_of_exit(const Eigen::Vector3f& ray) const {
    const Eigen::Vector3f direction = scale * ray;
    float exit = kMiss;
    for (int i = 0; i < 3; ++i) {
      if (direction[i] == 0.0F) continue;
      exit = std::min(exit, ((direction[i] > 0.0F ? 1.0F : -1.0F) - origin[i]) / direction[i]);
    }
    return exit;
  }
};

/// @return nullopt if no part of the shape lies in front of the camera
std::optional<CastShape> cast_shape(const DrawnShape& shape, const SE3& T_camera_shape, int index) {
  const std::optional<Box> bounds =
      shape.is_box ? box_bounds(T_camera_shape, shape.half) : ellipsoid_bounds(T_camera_shape, shape.half);
  if (!bounds) return std::nullopt;
  const Vec3 inverse_half = shape.half.cwiseInverse();
  const SE3 T_shape_camera = T_camera_shape.inverse();
  return CastShape{(inverse_half.asDiagonal() * T_shape_camera.rotation()).cast<float>(),
                   inverse_half.cwiseProduct(T_shape_camera.t).cast<float>(),
                   T_camera_shape.rotation().cast<float>(),
                   inverse_half.cast<float>(),
                   shape.is_box,
                   index,
                   shape.object,
                   *bounds};
}

/// @param p on the surface, in units of `half`
Face face_of(const Eigen::Vector3f& p) {
  const Eigen::Vector3f size = p.cwiseAbs();
  const int axis = size.x() >= size.y() ? (size.x() >= size.z() ? 0 : 2) : (size.y() >= size.z() ? 1 : 2);
  return static_cast<Face>(2 * axis + (p[axis] < 0.0F ? 1 : 0));
}

// --- one image ------------------------------------------------------------------------------------------------------

constexpr int kTile_px = 16;       ///< side of the squares for which the shapes in reach are collected
constexpr float kAmbient = 0.62F;  ///< share of the light that comes from everywhere

/// Towards the lamp, in the room.
Vec3 lamp_direction() { return Vec3(0.35, 0.55, 0.76).normalized(); }

Box pixel_ray_bounds(const cv::Mat& rays, const cv::Rect& tile) {
  Box bounds{1e6, 1e6, -1e6, -1e6};
  for (int y = tile.y; y < tile.y + tile.height; ++y) {
    const auto* row = rays.ptr<cv::Vec2f>(y);
    for (int x = tile.x; x < tile.x + tile.width; ++x) {
      const auto u = static_cast<double>(row[x][0]), v = static_cast<double>(row[x][1]);
      bounds = {std::min(bounds.x1, u), std::min(bounds.y1, v), std::max(bounds.x2, u), std::max(bounds.y2, v)};
    }
  }
  return bounds;
}

bool overlap(const Box& a, const Box& b, double margin) {
  return a.x1 <= b.x2 + margin && b.x1 <= a.x2 + margin && a.y1 <= b.y2 + margin && b.y1 <= a.y2 + margin;
}

/// What one ray meets first; cast -1 is the room.
struct Hit {
  float depth = kMiss;
  int cast = -1;
};

/// What is seen along a ray.
struct Look {
  Color color;
  float cosine = 1.0F;  ///< of the angle between ray and normal
  int surface = 0;      ///< a number for each face of a box and for each ellipsoid
};

/// Pixels of one object: all that it covers, and those that nothing hides.
struct Coverage {
  int covered = 0, seen = 0;
  int last_pixel = -1;  ///< an object of several shapes counts once a pixel
  cv::Rect extent;

  void see(int x, int y) {
    ++seen;
    extent |= cv::Rect(x, y, 1, 1);
  }
};

/// One image in the making.
class Picture {
 public:
  Picture(const SceneRenderer& painted, const PixelRays& rays, const SE3& T_world_camera, double time_s)
      : painted_(painted), rays_(rays), coverage_(painted.scene.objects.size()) {
    const SE3 T_camera_world = T_world_camera.inverse();
    std::vector<std::optional<SE3>> T_camera_object;
    for (const SceneObject& object : painted.scene.objects) {
      const std::optional<Ellipsoid> now = object.at(time_s);
      T_camera_object.push_back(now ? std::optional<SE3>(T_camera_world * now->T_world_quadric) : std::nullopt);
    }
    for (std::size_t i = 0; i < painted.shapes.size(); ++i) {
      const DrawnShape& shape = painted.shapes[i].shape();
      const std::optional<SE3> T_camera_base = shape.object < 0
                                                   ? std::optional<SE3>(T_camera_world)
                                                   : T_camera_object[static_cast<std::size_t>(shape.object)];
      if (!T_camera_base) continue;
      const std::optional<CastShape> cast = cast_shape(shape, *T_camera_base * shape.T_base_shape, static_cast<int>(i));
      if (cast) casts_.push_back(*cast);
    }
    const SE3 T_camera_room = T_camera_world * painted.room.T_world_room;
    room_ = *cast_shape(painted.walls.shape(), T_camera_room, -1);
    lamp_ = (T_camera_room.rotation() * lamp_direction()).cast<float>();
    focal_px_ = static_cast<float>(std::min(rays.camera.fx, rays.camera.fy));
  }

  RenderedImage render(bool with_color) {
    const cv::Size size = rays_.rays.size();
    image_.depth_m.create(size, CV_32FC1);
    image_.cosine.create(size, CV_32FC1);
    surfaces_.create(size, CV_32SC1);
    if (with_color) image_.color.create(size, CV_8UC3);
    for (int y = 0; y < size.height; y += kTile_px) {
      for (int x = 0; x < size.width; x += kTile_px) {
        render_tile({x, y, std::min(kTile_px, size.width - x), std::min(kTile_px, size.height - y)}, with_color);
      }
    }
    if (with_color) smooth_edges();
    measure_objects();
    return std::move(image_);
  }

 private:
  Eigen::Vector3f ray(int x, int y) const {
    const auto& p = rays_.rays.at<cv::Vec2f>(y, x);
    return {p[0], p[1], 1.0F};
  }
  const CastShape& cast_of(const Hit& hit) const {
    return hit.cast < 0 ? room_ : casts_[static_cast<std::size_t>(hit.cast)];
  }

  void find_candidates(const cv::Rect& tile) {
    const Box bounds = pixel_ray_bounds(rays_.rays, tile);
    candidates_.clear();
    // A pixel's margin, for the rays between pixels too.
    for (std::size_t i = 0; i < casts_.size(); ++i) {
      if (overlap(casts_[i].bounds, bounds, 1.0 / static_cast<double>(focal_px_))) {
        candidates_.push_back(static_cast<int>(i));
      }
    }
  }

  /// @param meet called for each shape that the ray meets, hidden or not
  template <class Meet>
  Hit cast(const Eigen::Vector3f& direction, const Meet& meet) const {
    Hit hit{room_.depth_of_exit(direction), -1};
    for (const int i : candidates_) {
      const CastShape& shape = casts_[static_cast<std::size_t>(i)];
      const float depth = shape.depth_of_entry(direction);
      if (depth == kMiss) continue;
      if (depth < hit.depth) hit = {depth, i};
      meet(shape);
    }
    return hit;
  }

  /// The same, counting what the pixel's ray meets.
  Hit cast_pixel(int x, int y) {
    const int pixel = y * rays_.rays.cols + x;
    const Hit hit = cast(ray(x, y), [&](const CastShape& shape) {
      if (shape.object < 0) return;
      Coverage& coverage = coverage_[static_cast<std::size_t>(shape.object)];
      if (coverage.last_pixel != pixel) ++coverage.covered;
      coverage.last_pixel = pixel;
    });
    const int object = cast_of(hit).object;
    if (object >= 0) coverage_[static_cast<std::size_t>(object)].see(x, y);
    return hit;
  }

  void render_tile(const cv::Rect& tile, bool with_color) {
    find_candidates(tile);
    for (int y = tile.y; y < tile.y + tile.height; ++y) {
      for (int x = tile.x; x < tile.x + tile.width; ++x) {
        const Hit hit = cast_pixel(x, y);
        const Look seen = look(ray(x, y), hit, with_color);
        image_.depth_m.at<float>(y, x) = hit.depth;
        image_.cosine.at<float>(y, x) = seen.cosine;
        surfaces_.at<int>(y, x) = seen.surface;
        if (with_color) image_.color.at<cv::Vec3b>(y, x) = to_pixel(seen.color);
      }
    }
  }

  static cv::Vec3b to_pixel(const Color& c) {
    return {cv::saturate_cast<std::uint8_t>(c.b), cv::saturate_cast<std::uint8_t>(c.g),
            cv::saturate_cast<std::uint8_t>(c.r)};
  }

  Look look(const Eigen::Vector3f& direction, const Hit& hit, bool with_color) const {
    const CastShape& shape = cast_of(hit);
    const Eigen::Vector3f point = shape.point(direction, hit.depth);
    const Face face = face_of(point);
    const Eigen::Vector3f outward = shape.normal(point, face);
    const Eigen::Vector3f normal = hit.cast < 0 ? Eigen::Vector3f(-outward) : outward;
    Look seen;
    seen.cosine = std::max(1e-3F, -normal.dot(direction) / direction.norm());
    seen.surface = kFaces * hit.cast + (shape.is_box ? face : 0);
    if (!with_color) return seen;
    // Between the footprint's width across and along the slope.
    const float footprint_m = hit.depth / (focal_px_ * std::sqrt(seen.cosine));
    const PaintedShape& painted =
        hit.cast < 0 ? painted_.walls : painted_.shapes[static_cast<std::size_t>(shape.shape)];
    const Color color = painted.color(point, face, footprint_m);
    const float light = kAmbient + (1.0F - kAmbient) * std::max(0.0F, normal.dot(lamp_));
    seen.color = {light * color.b, light * color.g, light * color.r};
    return seen;
  }

  /// Several rays a pixel where a neighbour shows another surface.
  void smooth_edges() {
    const cv::Size size = surfaces_.size();
    cv::Mat is_edge = cv::Mat::zeros(size, CV_8UC1);
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        for (const cv::Point& next : {cv::Point(x + 1, y), cv::Point(x, y + 1)}) {
          if (next.x >= size.width || next.y >= size.height) continue;
          if (surfaces_.at<int>(y, x) == surfaces_.at<int>(next)) continue;
          is_edge.at<std::uint8_t>(y, x) = is_edge.at<std::uint8_t>(next) = 1;
        }
      }
    }
    for (int y = 0; y < size.height; y += kTile_px) {
      for (int x = 0; x < size.width; x += kTile_px) smooth_tile(is_edge, {x, y, kTile_px, kTile_px});
    }
  }

  void smooth_tile(const cv::Mat& is_edge, const cv::Rect& whole) {
    const cv::Rect tile = whole & cv::Rect(0, 0, rays_.rays.cols, rays_.rays.rows);
    bool has_candidates = false;
    for (int y = tile.y; y < tile.y + tile.height; ++y) {
      for (int x = tile.x; x < tile.x + tile.width; ++x) {
        if (is_edge.at<std::uint8_t>(y, x) == 0) continue;
        if (!has_candidates) find_candidates(tile);
        has_candidates = true;
        image_.color.at<cv::Vec3b>(y, x) = to_pixel(average_color(x, y));
      }
    }
  }

  Color average_color(int x, int y) const {
    const float step = 0.25F / focal_px_;
    Color sum;
    for (const auto& [dx, dy] :
         {std::pair(-0.5F, -1.0F), std::pair(1.0F, -0.5F), std::pair(0.5F, 1.0F), std::pair(-1.0F, 0.5F)}) {
      const Eigen::Vector3f direction = ray(x, y) + Eigen::Vector3f(dx * step, dy * step, 0.0F);
      const Color c = look(direction, cast(direction, [](const CastShape&) {}), true).color;
      sum = {sum.b + 0.25F * c.b, sum.g + 0.25F * c.g, sum.r + 0.25F * c.r};
    }
    return sum;
  }

  /// Undistorted pixels around all shapes of an object, not clipped.
  Box pinhole_box(int object) const {
    Box bounds{1e6, 1e6, -1e6, -1e6};
    for (const CastShape& shape : casts_) {
      if (shape.object != object) continue;
      bounds = {std::min(bounds.x1, shape.bounds.x1), std::min(bounds.y1, shape.bounds.y1),
                std::max(bounds.x2, shape.bounds.x2), std::max(bounds.y2, shape.bounds.y2)};
    }
    const Camera& camera = rays_.camera;
    return {camera.fx * bounds.x1 + camera.cx, camera.fy * bounds.y1 + camera.cy, camera.fx * bounds.x2 + camera.cx,
            camera.fy * bounds.y2 + camera.cy};
  }

  void measure_objects() {
    const Camera& camera = rays_.camera;
    image_.objects.resize(coverage_.size());
    for (std::size_t i = 0; i < coverage_.size(); ++i) {
      const Coverage& coverage = coverage_[i];
      if (coverage.seen == 0) continue;
      const cv::Rect& extent = coverage.extent;
      ObjectView view;
      view.whole = pinhole_box(static_cast<int>(i));
      // A pixel's coordinates are those of its middle.
      view.box = clip({extent.x - 0.5, extent.y - 0.5, extent.x + extent.width - 0.5, extent.y + extent.height - 0.5},
                      camera.width, camera.height);
      const Box image = camera.undistort(Box{0.0, 0.0, camera.width + 0.0, camera.height + 0.0});
      view.inside = std::clamp(intersection_area(view.whole, image) / view.whole.area(), 0.0, 1.0);
      view.visible = static_cast<double>(coverage.seen) / coverage.covered;
      image_.objects[i] = view;
    }
  }

  const SceneRenderer& painted_;
  const PixelRays& rays_;
  std::vector<CastShape> casts_;
  CastShape room_;
  Eigen::Vector3f lamp_ = Eigen::Vector3f::UnitZ();
  float focal_px_ = 1.0F;
  std::vector<int> candidates_;
  cv::Mat surfaces_;  ///< CV_32SC1, see Look
  std::vector<Coverage> coverage_;
  RenderedImage image_;
};

}  // namespace

PixelRays::PixelRays(const Camera& of_camera) : camera(of_camera), rays(camera.height, camera.width, CV_32FC2) {
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const Vec3 ray = camera.ray(camera.undistort(Vec2(x, y)));
      rays.at<cv::Vec2f>(y, x) = {static_cast<float>(ray.x()), static_cast<float>(ray.y())};
    }
  }
}

SceneRenderer::SceneRenderer(const Scene& of_scene, const Room& of_room, std::uint64_t seed)
    : scene(of_scene), room(of_room), walls({true, -1, {}, room.half, Paint::kWalls}, true, seed, 0) {
  const std::vector<DrawnShape> drawn = drawn_shapes(scene);
  for (std::size_t i = 0; i < drawn.size(); ++i) shapes.emplace_back(drawn[i], false, seed, 1 + i);
}

RenderedImage SceneRenderer::render(const PixelRays& rays, const SE3& T_world_camera, double time_s,
                                    bool with_color) const {
  return Picture(*this, rays, T_world_camera, time_s).render(with_color);
}

}  // namespace semantic_topo_loop::core
