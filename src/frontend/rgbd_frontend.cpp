#include "semantic_topo_loop/frontend/rgbd_frontend.h"

#include <algorithm>
#include <cmath>
#include <future>
#include <limits>
#include <set>
#include <utility>

#include "frontend/bundle_adjustment.h"
#include "frontend/depth_registration.h"
#include "geometry/wide_image.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kFocalKeyframes = 6;                  ///< fewer have not turned enough to tell a focal length
constexpr std::int64_t kSoon_ns = 200'000'000;      ///< after which a sighting is another view of the same place
constexpr std::int64_t kEarly_ns = 15'000'000'000;  ///< so much of a recording is read twice, or lost of a live session
constexpr double kMaxGuess_s = 0.5;  ///< motion is not carried on for longer: a hand turns back within a second

/// Camera-frame points of an even grid of depth pixels.
class DepthGrid {
 public:
  /// @param vga_stride_px see FrontendOptions
  DepthGrid(const Camera& camera, int vga_stride_px) {
    const int stride_px = static_cast<int>(std::lround(vga_stride_px * pixel_factor(camera)));
    for (int v = stride_px / 2; v < camera.height; v += stride_px) {
      for (int u = stride_px / 2; u < camera.width; u += stride_px) {
        pixels_.push_back({u, v, camera.ray(camera.undistort(Vec2(u, v))).cast<float>()});
      }
    }
  }
  /// @param registration of the depth image   @param camera its focal lengths corrected
  std::shared_ptr<const std::vector<Vec3>> points(const cv::Mat& depth_m, const DepthRegistration& registration,
                                                  const Camera& camera) const {
    auto points = std::make_shared<std::vector<Vec3>>();
    points->reserve(pixels_.size());
    for (const Pixel& pixel : pixels_) {
      const float z = depth_m.at<float>(pixel.v, pixel.u);
      if (z <= 0.0F) continue;
      Eigen::Vector3f ray = pixel.ray;
      if (!registration.is_identity()) {
        const Vec2 in_color = registration.to_color(camera, Vec2(pixel.u, pixel.v), static_cast<double>(z));
        ray = camera.ray(camera.undistort(in_color)).cast<float>();
      }
      // The product of floats, as which the points travel: rounding a double to float and back is left out by GCC 12.
      const Eigen::Vector3f point = z * ray;
      points->push_back(point.cast<double>());
    }
    return points;
  }

 private:
  struct Pixel {
    int u, v;
    Eigen::Vector3f ray;
  };
  std::vector<Pixel> pixels_;
};

Mat6 rotated(const Mat6& covariance, const Mat3& R) {
  Mat6 turn = Mat6::Zero();
  turn.topLeftCorner<3, 3>() = R;
  turn.bottomRightCorner<3, 3>() = R;
  return turn * covariance * turn.transpose();
}

/// What is known of the camera. It outlives a new beginning.
struct Calibration {
  Camera camera;
  DepthRegistration registration;
  bool is_focal_given = true;  ///< not corrected here
  int restarts = 0;            ///< advised so far
  bool is_registration_known = false;
};

/// Whether a focal length should be changed.   @param is_given it is the user's, which is less readily changed
bool is_clear(const FocalEstimate& estimate, bool is_given) {
  // Where depth is off by per cents, or taken at other times, so is the best focal length.
  const double min_change = is_given ? 0.03 : 0.005, min_gain = is_given ? 0.02 : 0.005;
  // Keyframes that have hardly turned say anything: a given length counts like views that tell it this well.
  const double given_information = is_given ? 20.0 : 0.0;
  const double share = estimate.information / (estimate.information + given_information);
  return share * std::abs(estimate.log_factor) > min_change && estimate.gain() > min_gain;
}

/// What a keyframe's refinement gives.
struct Refined {
  BundleProblem problem;
  std::optional<FocalEstimate> focal;
};

/// What an image sees in a section of the map but is not followed by.
struct Sighting {
  MapSection section, seen_from;
  SE3 T_here_there;  ///< of the two sections, or across an offset within one
  std::int64_t stamp_ns = 0;
};

}  // namespace

struct RgbdFrontend::Impl {
  Impl(const FrontendOptions& frontend_options, Calibration known)
      : options(frontend_options),
        calibration(std::move(known)),
        grid(calibration.camera, options.point_stride_px),
        map(options) {
    if (options.self_calibration && !calibration.is_registration_known) {
      registration_estimator.emplace(calibration.camera);
    }
  }

  /// Whether the image before has no pose. After a pause one alone may be bad.
  bool is_lost() const { return last_tracked_image != images - 1; }

  /// Whether the odometry is to start anew. What has just begun, with a blurred image, say, is waited for no longer
  /// than it is old.
  bool is_given_up(std::int64_t stamp_ns) const {
    const double age_s = 1e-9 * static_cast<double>(last->stamp_ns - first_stamp_ns);
    return 1e-9 * static_cast<double>(stamp_ns - last->stamp_ns) > std::min(options.restart_after_s, age_s);
  }

  SE3 guess(std::int64_t stamp_ns) const {
    const double dt_s = 1e-9 * static_cast<double>(stamp_ns - last->stamp_ns);
    if (motion_s <= 0.0 || dt_s > kMaxGuess_s || motion_s > kMaxGuess_s) return last->T_camera_map;
    const double ratio = dt_s / motion_s;
    const SE3 motion(so3_exp(ratio * so3_log(T_last_before.q)), ratio * T_last_before.t);
    return motion * last->T_camera_map;
  }

  bool start(TrackedFeatures* image) {
    const auto has_depth = [](const ImageFeature& feature) { return feature.has_depth(); };
    const auto depths = std::count_if(image->features.features.begin(), image->features.features.end(), has_depth);
    if (depths < 2 * options.min_inliers) return false;
    image->T_camera_map = last ? last->T_camera_map : SE3();
    image->inliers = image->matches = 0;
    image->section = {next_section, next_section};
    ++next_section;
    return true;
  }

  bool follow(TrackedFeatures* image) {
    if (is_lost()) return false;
    const int strong = strong_inliers(options);
    TrackedFeatures followed = *image;
    const bool is_followed = follow_points(*last, guess(image->stamp_ns), calibration.camera, &map, &followed) &&
                             track_local_map(calibration.camera, &map, &followed);
    // After wide motions few points are where they were guessed, and some of them by chance.
    if (is_followed && followed.inliers >= strong) {
      *image = std::move(followed);
      return true;
    }
    const bool is_found = find_again(image, false);
    if (is_followed && (!is_found || followed.inliers >= image->inliers)) {
      *image = std::move(followed);
    } else if (!is_found) {
      tell(followed, image);
    }
    return is_followed || is_found;
  }

  /// Of what fails it is told how far the best attempt came.
  static void tell(const TrackedFeatures& attempt, TrackedFeatures* image) {
    if (attempt.matches <= image->matches) return;
    image->matches = attempt.matches;
    image->inliers = attempt.inliers;
  }

  bool find_again(TrackedFeatures* image, bool in_all_sections) {
    // Bounds the time of a lost image.
    constexpr std::size_t kNewest = 3, kAlike = 3;
    const auto is_asked = [&](const TrackingKeyframe& keyframe) {
      return in_all_sections || keyframe.section == last->section;
    };
    std::vector<std::int64_t> tried;
    for (auto it = map.keyframes().rbegin(); it != map.keyframes().rend() && tried.size() < kNewest; ++it) {
      if (is_asked(it->second)) tried.push_back(it->first);
    }
    const std::int64_t oldest_tried = tried.empty() ? 0 : tried.back();
    const std::vector<std::int64_t> alike =
        most_alike(map.common_words(image->features.descriptors), kAlike,
                   [&](const TrackingKeyframe& keyframe) { return keyframe.id < oldest_tried && is_asked(keyframe); });
    tried.insert(tried.end(), alike.begin(), alike.end());
    // The pose that explains most: a wrong one is seldom that.
    const int strong = strong_inliers(options);
    std::optional<TrackedFeatures> best;
    for (const std::int64_t id : tried) {
      TrackedFeatures candidate = *image;
      if (!find_points(*map.keyframe(id), calibration.camera, &map, &candidate) ||
          !track_local_map(calibration.camera, &map, &candidate)) {
        tell(candidate, image);
        continue;
      }
      const int inliers = candidate.inliers;
      const bool is_strong = inliers >= strong;
      if (!is_strong && candidate.section.world != last->section.world) continue;
      if (is_strong && candidate.section != last->section) {
        candidate.source_loop = loop_to(*map.keyframe(id), candidate);
      }
      if (!best || inliers > best->inliers) best = std::move(candidate);
      if (is_strong) break;
    }
    if (best) *image = std::move(*best);
    return best.has_value();
  }

  /// The keyframes asked for that look most like an image, best first; the newer of two that are equally alike.
  /// @param common_words with it, by keyframe   @param least of these
  template <typename Predicate>
  std::vector<std::int64_t> most_alike(const std::vector<int>& common_words, std::size_t count, Predicate is_asked,
                                       int least = 0) const {
    std::vector<std::pair<int, std::int64_t>> alike;
    for (const auto& [id, keyframe] : map.keyframes()) {
      if (!is_asked(keyframe)) continue;
      const int common = common_words.at(static_cast<std::size_t>(id));
      if (common >= least) alike.emplace_back(common, id);
    }
    std::sort(alike.rbegin(), alike.rend());
    alike.resize(std::min(alike.size(), count));
    std::vector<std::int64_t> ids(alike.size());
    std::transform(alike.begin(), alike.end(), ids.begin(), [](const auto& entry) { return entry.second; });
    return ids;
  }

  /// @param there this image, found by an earlier keyframe
  static SourceLoop loop_to(const TrackingKeyframe& earlier, const TrackedFeatures& there) {
    constexpr double kSigma_m = 0.01, kSigma_rad = 0.005;  // of what the map around the keyframe is bent
    SourceLoop loop;
    loop.stamp_ns = earlier.stamp_ns;
    loop.T_odom_camera = earlier.T_odom_camera * (earlier.T_camera_map * there.T_camera_map.inverse());
    loop.covariance = there.covariance;
    loop.covariance.diagonal().head<3>().array() += kSigma_m * kSigma_m;
    loop.covariance.diagonal().tail<3>().array() += kSigma_rad * kSigma_rad;
    loop.points = there.inliers;
    return loop;
  }

  /// Keyframes that an image is followed by: they share enough points with it.
  std::set<std::int64_t> followed_keyframes(const TrackedFeatures& image) const {
    std::set<std::int64_t> ids;
    for (const auto& [id, shared] : map.covisible(image.points)) {
      if (shared >= options.min_inliers) ids.insert(id);
    }
    return ids;
  }

  /// Keyframes that look like an image but are none of these, best first: of other sections, then older ones of its
  /// own, which look no less alike than those that it is followed by.
  std::vector<std::int64_t> unfollowed(const TrackedFeatures& image, const std::set<std::int64_t>& followed) const {
    constexpr std::size_t kTried = 3, kOwn = 1;  // bound the time of a keyframe
    const std::vector<int> words = map.common_words(image.features.descriptors);
    std::vector<std::int64_t> tried =
        most_alike(words, kTried, [&](const TrackingKeyframe& keyframe) { return keyframe.section != image.section; });
    int least_alike = std::numeric_limits<int>::max();
    for (const std::int64_t id : followed) {
      least_alike = std::min(least_alike, words.at(static_cast<std::size_t>(id)));
    }
    const auto is_across_offset = [&](const TrackingKeyframe& keyframe) {
      return keyframe.section == image.section && followed.count(keyframe.id) == 0;
    };
    const std::vector<std::int64_t> own =
        most_alike(words, std::max(kOwn, kTried - tried.size()), is_across_offset, least_alike);
    tried.insert(tried.end(), own.begin(), own.end());
    return tried;
  }

  /// Looks for what a keyframe sees where it is not followed: in the sections that were left by a loss, and across an
  /// offset within its own. What another section shows twice alike joins the keyframe's: its poses go on as they are.
  std::optional<SourceLoop> look_back(const TrackedFeatures& image) {
    const std::set<std::int64_t> followed = followed_keyframes(image);
    for (const std::int64_t id : unfollowed(image, followed)) {
      const TrackingKeyframe& keyframe = *map.keyframe(id);
      TrackedFeatures there = image;
      if (!find_points(keyframe, calibration.camera, &map, &there)) continue;
      const bool is_other_section = there.section != image.section;
      // In its own section there are points of this side of the offset around.
      const std::set<std::int64_t>* apart_from = is_other_section ? nullptr : &followed;
      if (!track_local_map(calibration.camera, &map, &there, apart_from)) continue;
      if (there.inliers < strong_inliers(options)) continue;
      const SourceLoop found = loop_to(keyframe, there);
      const SE3 T_here_there = image.T_camera_map.inverse() * there.T_camera_map;
      if (is_seen_again(image, there)) {
        if (is_other_section) {
          refinement = {};  // it has its keyframes where they were
          map.join(there.section, image.section, T_here_there);
        }
        sighting.reset();
        return found;
      }
      sighting = Sighting{there.section, image.section, T_here_there, image.stamp_ns};
      // In its own section what is moving looks like an offset, too.
      return is_other_section ? std::optional(found) : std::nullopt;
    }
    return std::nullopt;
  }

  /// Whether the last sighting had the two places lie to each other as this one.
  bool is_seen_again(const TrackedFeatures& image, const TrackedFeatures& there) const {
    constexpr double kAlike_m = 0.05, kAlike_rad = 0.05;  // of two sightings: the drift of a second or so
    if (!sighting || sighting->section != there.section || sighting->seen_from != image.section) return false;
    if (image.stamp_ns - sighting->stamp_ns <= kSoon_ns) return false;
    const SE3 again = sighting->T_here_there * there.T_camera_map.inverse();
    return (again.t - image.center()).norm() < kAlike_m &&
           rotation_angle(again.q.conjugate(), image.T_camera_map.q) < kAlike_rad;
  }

  /// Whether something was seen that is worth a second look.
  bool is_sighting_open(const TrackedFeatures& image) const {
    constexpr std::int64_t kLate_ns = 1'000'000'000;  // not yet another place
    if (!sighting) return false;
    const std::int64_t age_ns = image.stamp_ns - sighting->stamp_ns;
    return age_ns > kSoon_ns && age_ns < kLate_ns;
  }

  Mat6 motion_covariance(const TrackedFeatures& image) const {
    constexpr double kShare = 0.01;  // of the motion: what the points' common errors, as of the focal length, give
    constexpr double kFloor_m = 5e-4, kFloor_rad = 2e-4;  // a tenth of a pixel: 0.1 / 525, and at 2.5 m
    constexpr double kMost_m = 0.2, kMost_rad = 0.2;      // of an image's motion: more than it ever is
    // Over a second as much adds up at any rate of images, those of 30 Hz were measured; over a gap there is no more.
    constexpr double kInterval_s = 1.0 / 30.0, kLeast_s = 1e-3, kGap_s = 0.2;
    const double dt_s = 1e-9 * static_cast<double>(image.stamp_ns - last->stamp_ns);
    const double intervals = std::clamp(dt_s, kLeast_s, kGap_s) / kInterval_s;
    const SE3 motion = image.T_camera_map * last->T_camera_map.inverse();
    Mat6 covariance = intervals * (image.covariance + rotated(last->covariance, motion.rotation()));
    // A trace beyond the bound says that hardly anything is known; it is scaled down to be of use in a graph.
    const double translation = covariance.topLeftCorner<3, 3>().trace(),
                 rotation = covariance.bottomRightCorner<3, 3>().trace();
    const double excess = std::max({1.0, translation / (kMost_m * kMost_m), rotation / (kMost_rad * kMost_rad)});
    covariance /= excess;
    const double step_m = motion.t.norm(), step_rad = rotation_angle(motion.q, Quaternion::Identity());
    const double share = kShare * kShare / intervals;
    covariance.diagonal().head<3>().array() += intervals * kFloor_m * kFloor_m + share * step_m * step_m;
    covariance.diagonal().tail<3>().array() += intervals * kFloor_rad * kFloor_rad + share * step_rad * step_rad;
    return covariance;
  }

  void take_in(const TrackedFeatures& image, const std::vector<Vec3>& points_camera) {
    const std::int64_t id = add_keyframe(image, points_camera, calibration.camera, &map);
    if (map.keyframes().size() < 2) return;
    BundleProblem around = local_bundle(map, id, options);
    // Blurred images with few points, and few keyframes, would explain their errors by any focal length.
    const bool checks_focal = image.inliers >= strong_inliers(options) &&
                              static_cast<int>(around.poses.size()) >= kFocalKeyframes && is_focal_check_due();
    refinement = std::async(std::launch::async, [this, checks_focal, problem = std::move(around)]() mutable {
      solve(calibration.camera, options.window_iterations, false, &problem);
      Refined refined;
      if (checks_focal) refined.focal = estimate_focal_length(calibration.camera, problem);
      refined.problem = std::move(problem);
      return refined;
    });
  }

  void take_refinement() {
    if (!refinement.valid()) return;
    const Refined refined = refinement.get();
    apply(refined.problem, &map);
    if (refined.focal) {
      focal_estimate += *refined.focal;
      if (is_clear(focal_estimate, calibration.is_focal_given)) new_focal_factor = std::exp(focal_estimate.log_factor);
    }
    const TrackingKeyframe& newest = map.keyframes().rbegin()->second;
    last->T_camera_map = newest.T_camera_map;
    last->points = newest.points;
  }

  void look_for_registration(const RgbdImage& image) {
    // Twelve images of three seconds: six of one were wrong of some parts of fr1_xyz, either way.
    constexpr std::int64_t kInterval_ns = 270'000'000;
    constexpr int kImages = 12;
    if (!registration_estimator) return;
    if (registration_estimator->images() > 0 && image.stamp_ns - last_registration_ns < kInterval_ns) return;
    registration_estimator->add(image);
    last_registration_ns = image.stamp_ns;
    if (registration_estimator->images() < kImages) return;
    is_registration_judged = true;
    if (const std::optional<DepthRegistration> found = registration_estimator->estimate()) {
      calibration.registration = *found;
      has_new_registration = true;
    } else if (!registration_estimator->is_telling() && image.stamp_ns - first_stamp_ns < kEarly_ns) {
      registration_estimator.emplace(calibration.camera);  // the next images may tell
      return;
    }
    calibration.is_registration_known = true;
    registration_estimator.reset();
  }

  bool is_focal_check_due() {
    if (!options.self_calibration || (registration_estimator && !is_registration_judged)) return false;
    const auto keyframes = static_cast<int>(map.keyframes().size());
    if (keyframes < next_focal_check) return false;
    next_focal_check = keyframes + keyframes / 2;  // of half as much again: 6, 9, 13, ...
    return true;
  }

  /// Begins the map anew at an image that has a pose, if the calibration turned out to be wrong.
  /// @return whether every pose should be found anew
  bool correct_calibration(const RgbdImage& rgbd, TrackedFeatures* image) {
    constexpr int kMostRestarts = 4;  // registration, then focal lengths that converge
    if (!has_new_registration && new_focal_factor == 1.0) return false;
    if (new_focal_factor != 1.0) calibration.is_focal_given = false;
    Camera& camera = calibration.camera;
    camera.fx *= new_focal_factor;
    camera.fy *= new_focal_factor;
    has_new_registration = false;
    new_focal_factor = 1.0;
    focal_estimate = {};
    next_focal_check = kFocalKeyframes;
    grid = DepthGrid(camera, options.point_stride_px);
    map = TrackingMap(options);
    sighting.reset();
    ++starts;
    look_at(rgbd, image);
    if (image->stamp_ns - first_stamp_ns > kEarly_ns || calibration.restarts == kMostRestarts) return false;
    ++calibration.restarts;
    return true;
  }

  void look_at(const RgbdImage& rgbd, TrackedFeatures* image) const {
    image->features = extract_features(rgbd, options, calibration.camera, calibration.registration);
    image->points.assign(image->features.size(), -1);
  }

  /// The map's points that an image shows, camera frame.
  std::shared_ptr<const std::vector<PointFeature>> features_of(const TrackedFeatures& image) {
    auto features = std::make_shared<std::vector<PointFeature>>();
    for (const std::int64_t id : image.points) {
      const MapPoint* point = id >= 0 ? map.point(id) : nullptr;
      if (point == nullptr) continue;
      const Vec3 point_camera = image.T_camera_map * point->position;
      features->push_back({lasting_id(id), point_camera.cast<float>(), point->descriptor});
    }
    return features;
  }

  /// Of a point, also over maps that follow each other.
  std::int64_t lasting_id(std::int64_t point) const {
    constexpr int kPointBits = 40;  // of an id within its map: a year of 1000 new points an image; leaves 2^23 maps
    return (starts << kPointBits) + point;
  }

  void accept(TrackedFeatures image) {
    const bool is_next = last && !is_lost();
    motion_s = is_next ? 1e-9 * static_cast<double>(image.stamp_ns - last->stamp_ns) : 0.0;
    if (is_next) T_last_before = image.T_camera_map * last->T_camera_map.inverse();
    last_tracked_image = images;
    last = std::move(image);
  }

  TrackedImage track(const RgbdImage& rgbd) {
    TrackedFeatures image;
    image.id = images;
    image.stamp_ns = rgbd.stamp_ns;
    if (images == 0) first_stamp_ns = rgbd.stamp_ns;
    look_for_registration(rgbd);
    look_at(rgbd, &image);
    if (last) image.section = last->section;
    take_refinement();
    TrackedImage result;
    bool is_break = false;
    if (static_cast<int>(image.features.size()) < options.min_inliers) {
      result.state = TrackingState::kUnusable;
    } else if (!last) {
      result.state = start(&image) ? TrackingState::kStarted : TrackingState::kUnusable;
    } else if (follow(&image)) {
      result.state = TrackingState::kTracked;
    } else if (is_lost() && find_again(&image, true)) {
      result.state = TrackingState::kRelocalised;
      is_break = image.section.world != last->section.world;
    } else if (is_lost() && is_given_up(image.stamp_ns) && start(&image)) {
      result.state = TrackingState::kStarted;
      is_break = true;
    }
    result.matches = image.matches;
    result.inliers = image.inliers;
    const bool has_pose = result.state != TrackingState::kLost && result.state != TrackingState::kUnusable;
    if (has_pose) {
      count_views(image, &map);
      PoseSample sample;
      sample.stamp_ns = image.stamp_ns;
      sample.T_odom_camera = image.T_camera_map.inverse();
      sample.is_break = is_break;
      sample.is_continuous = !is_break;
      sample.features = features_of(image);
      if (last && !is_break) sample.covariance = motion_covariance(image);
      sample.source_loop = image.source_loop;
      result.sample = std::move(sample);
      result.is_recalibrated = correct_calibration(rgbd, &image);
      result.sample->points_camera = grid.points(rgbd.depth_m, calibration.registration, calibration.camera);
      if (map.keyframes().empty() || needs_keyframe(image, map)) {
        // What hangs on a weak pose may lie wrong against the rest: it is looked for there as after a loss.
        const bool is_weak = result.state != TrackingState::kStarted && image.inliers < strong_inliers(options);
        if (is_weak) image.section.number = next_section++;
        take_in(image, *result.sample->points_camera);
        image.points = map.keyframes().rbegin()->second.points;
        if (!image.source_loop) result.sample->source_loop = look_back(image);
      } else if (!image.source_loop && is_sighting_open(image)) {
        result.sample->source_loop = look_back(image);
      }
      accept(std::move(image));
    }
    ++images;
    return result;
  }

  FrontendOptions options;
  Calibration calibration;
  DepthGrid grid;
  TrackingMap map;
  std::optional<RegistrationEstimator> registration_estimator;  ///< until it has decided
  std::int64_t last_registration_ns = 0;                        ///< stamp of the last image it took
  bool is_registration_judged = false;                          ///< for the first time
  bool has_new_registration = false;
  FocalEstimate focal_estimate;            ///< of all checks of this map
  double new_focal_factor = 1.0;           ///< to be applied
  int next_focal_check = kFocalKeyframes;  ///< keyframes of the map
  std::int64_t first_stamp_ns = 0;
  std::future<Refined> refinement;  ///< of the map around the last image, a keyframe
  std::int64_t images = 0;
  std::int64_t starts = 1;  ///< maps begun: each counts its points from 0
  int next_section = 0;
  std::optional<Sighting> sighting;     ///< the last one
  std::optional<TrackedFeatures> last;  ///< the last image that has a pose
  std::int64_t last_tracked_image = -1;
  SE3 T_last_before;  ///< motion of the camera over the last two images, in the camera frame
  double motion_s = 0.0;
};

RgbdFrontend::RgbdFrontend(const FrontendOptions& options, const Camera& camera)
    : impl_(new Impl(options, Calibration{camera, {}, true, 0}), [](Impl* impl) { delete impl; }) {}

TrackedImage RgbdFrontend::track(const RgbdImage& image) { return impl_->track(image); }

void RgbdFrontend::begin_anew() { impl_.reset(new Impl(impl_->options, impl_->calibration)); }

const Camera& RgbdFrontend::camera() const { return impl_->calibration.camera; }

KeyframePoints RgbdFrontend::keyframe_points(const RgbdImage& image, int semi_dense_max) const {
  const Calibration& known = impl_->calibration;
  KeyframePoints points{{}, semi_dense_points(image, known.camera, known.registration, semi_dense_max)};
  if (!impl_->last) return points;
  const auto features = impl_->features_of(*impl_->last);
  for (const PointFeature& feature : *features) points.sparse.push_back({feature.id, feature.position});
  const auto by_id = [](const SparsePoint& a, const SparsePoint& b) { return a.id < b.id; };
  std::sort(points.sparse.begin(), points.sparse.end(), by_id);
  return points;
}

void TrackingReport::add(const TrackedImage& image) {
  ++images;
  const auto is = [&image](TrackingState state) { return image.state == state ? 1 : 0; };
  tracked += is(TrackingState::kTracked);
  relocalised += is(TrackingState::kRelocalised);
  lost += is(TrackingState::kLost);
  unusable += is(TrackingState::kUnusable);
  // What was found again in an older part of the map has a break, too.
  if (image.sample && image.sample->is_break) restarts += is(TrackingState::kStarted);
}

void TrackingReport::add_unreadable(const std::string& problem) {
  ++images;
  if (++unreadable == 1) first_unreadable = problem;
}

std::string TrackingReport::warning() const {
  if (lost + unusable + unreadable + restarts == 0) return "";
  std::string text = "of " + std::to_string(images) + " images:";
  const char* separator = " ";
  for (const auto& [count, what] :
       {std::pair(lost, "lost"), std::pair(unusable, "with nothing to follow"), std::pair(unreadable, "unreadable"),
        std::pair(relocalised, "found again after a loss"), std::pair(restarts, "starts anew")}) {
    if (count == 0) continue;
    text += separator + std::to_string(count) + " " + what;
    separator = ", ";
  }
  if (unreadable > 0) text += " (first unreadable: " + first_unreadable + ")";
  return text;
}

}  // namespace semantic_topo_loop::core
