#include "semantic_topo_loop/frontend/rgbd_frontend.h"

#include <atomic>
#include <mutex>
#include <pluginlib/class_list_macros.hpp>
#include <tuple>

#include "ros/frontend_stage.h"
#include "ros/rgbd_images.h"

namespace semantic_topo_loop {

/// Finds the camera's poses from its colour and depth images.
class RgbdFrontendNodelet : public StageWith<RgbdFrontendParameters, FrontendStage> {
 public:
  RgbdFrontendNodelet() : StageWith("RgbdFrontend") {}
  ~RgbdFrontendNodelet() override {
    unsubscribe();
    stop();
  }

 private:
  using ImageConstPtr = sensor_msgs::ImageConstPtr;
  using Clock = RgbdSynchronizer::Clock;
  static constexpr char kSingle[] = "colour images without depth";
  static constexpr char kLate[] = "dropped, late";

  void onInit() override {
    if (!start(1)) return;
    std::shared_ptr<TfPoses> transforms;
    if (parameters_.publish_odom_tf) {
      // Only the camera's place on the robot is asked for: a rigid part, whose gaps do not matter.
      constexpr double kMaxGapS = 1.0;
      transforms = std::make_shared<TfPoses>(parameters_.odom_frame, kMaxGapS);
    }
    // First, as without its images there is no session to open.
    if (!subscribe_images() || !open(options_.keyframe, parameters_, transforms)) return unsubscribe();
    statistics().count(kSingle, 0);
    statistics().count(kLate, 0);
    report_publisher_ = advertise<TrackingMessage>("tracking_report");
    take_images();
    constexpr double kWatchPeriodS = 0.25;  // a fraction of pair_timeout_s and starvation_s
    start_timer(kWatchPeriodS, [this] { watch(); });
    follow_stream();
  }

  /// @return false after fail()
  bool subscribe_images() {
    using Add = void (RgbdSynchronizer::*)(const ImageConstPtr&, Clock::time_point);
    const auto hear = [this](const char* topic, const std::string& transport, int queue_size, Add add,
                             image_transport::Subscriber* subscriber) {
      const auto take = [this, topic, add](const ImageConstPtr& image) {
        statistics().count_input(topic);
        const std::lock_guard<std::mutex> lock(mutex_);
        if (synchronizer_) ((*synchronizer_).*add)(image, Clock::now());
      };
      auto subscribed = subscribe_to_images(subscriber_node(), getPrivateNodeHandle(), topic, transport,
                                            static_cast<std::uint32_t>(queue_size), take);
      if (!subscribed) return fail(subscribed.message());
      *subscriber = *std::move(subscribed);
      return true;
    };
    const RgbdFrontendParameters& p = parameters_;
    return hear("color", p.color_transport, p.color_queue_size, &RgbdSynchronizer::add_color, &color_) &&
           hear("depth", p.depth_transport, p.depth_queue_size, &RgbdSynchronizer::add_depth, &depth_);
  }

  void unsubscribe() {
    color_.shutdown();
    depth_.shutdown();
  }

  /// From now on: those that came before the session was there are nobody's.
  void take_images() {
    PairingParameters pairing = parameters_.pairing;
    pairing.color_topic = getNodeHandle().resolveName("color");
    pairing.depth_topic = getNodeHandle().resolveName("depth");
    const std::lock_guard<std::mutex> lock(mutex_);
    synchronizer_ = std::make_unique<RgbdSynchronizer>(
        pairing,
        [this](const ImageConstPtr& color, const ImageConstPtr& depth) {
          newest_pair_ns_ = to_stamp_ns(color->header.stamp);
          push("pairs of images", Keep::kDroppable, [this, color, depth] { on_pair(color, depth); });
        },
        [this](std::int64_t stamp_ns) { push(kSingle, Keep::kAlways, [this, stamp_ns] { on_single(stamp_ns); }); });
  }

  /// Once in a while: images that wait for too long, topics that are silent.
  void watch() {
    const Clock::time_point now = Clock::now();
    const std::lock_guard<std::mutex> lock(mutex_);
    synchronizer_->expire(now);
    if (!awaits_images()) synchronizer_->excuse(now);
    warn_while("topics", synchronizer_->starvation(now));
  }

  void forget() override {
    if (is_for_another_camera()) frontend_.reset();
    if (frontend_) frontend_->begin_anew();
    image_ = {};
    report_ = {};
    depth_range_ = {};
    warn_while("depth", "");
  }

  void on_end() override {
    publish<TrackingMessage>(report_publisher_, std_msgs::Header(), report_);
    emit_end();
  }

  std::shared_ptr<const core::KeyframePoints> keyframe_points() override {
    return std::make_shared<const core::KeyframePoints>(
        frontend_->keyframe_points(image_, options_.point_map.semi_dense_max));
  }

  void on_single(std::int64_t stamp_ns) {
    fail_image(stamp_ns, kSingle,
               "none on 'depth' within " + std::to_string(parameters_.pairing.max_delay_s) + " s of stamp " +
                   std::to_string(stamp_ns) + " ns");
  }

  void on_pair(const ImageConstPtr& color, const ImageConstPtr& depth) {
    const std::int64_t stamp_ns = to_stamp_ns(color->header.stamp);
    // Who is slower than the camera would else follow it by as many images as the queue holds, for good.
    const std::chrono::duration<double> lag = Clock::now() - task_arrival();
    if (!parameters_.lockstep && stamp_ns != newest_pair_ns_ && lag.count() > parameters_.max_lag_s) {
      statistics().count_lost(kLate);
      return;
    }
    on_image_frame(color->header.frame_id);
    if (!accept(stamp_ns) || !prepare(stamp_ns)) return;
    const core::Result<core::RgbdImage> image = make_rgbd_image(*color, *depth, *frontend_camera_, options_.depth);
    if (image) {
      depth_range_.add(image->depth_range);
      warn_while("depth", depth_range_.warning(options_.depth));
      return track(*image);
    }
    report_.add_unreadable(image.message());
    fail_image(stamp_ns, "unusable images", image.message());
  }

  /// The front end of this session's camera; null, and the image answered, while there is no calibration.
  bool prepare(std::int64_t stamp_ns) {
    if (!camera()) {
      fail_image(stamp_ns, "images without a calibration", "neither camera_file nor a usable camera_info");
      return false;
    }
    if (is_for_another_camera()) begin_session("another calibration came");
    if (!frontend_) {
      frontend_camera_ = known_camera();
      frontend_.emplace(options_.frontend, *frontend_camera_);
    }
    return true;
  }

  /// What the front end begins with: the camera that was given, as earlier sessions of the map corrected it.
  core::Camera known_camera() const {
    return options_.frontend.self_calibration ? camera()->with_focal_lengths_of(map_camera()) : *camera();
  }
  bool is_for_another_camera() const {
    const auto fields = [](const core::Camera& c) {
      return std::tie(c.fx, c.fy, c.cx, c.cy, c.width, c.height, c.distortion);
    };
    return frontend_ && camera() && fields(*frontend_camera_) != fields(known_camera());
  }

  void track(const core::RgbdImage& image) {
    image_ = image;
    const core::TrackedImage tracked = frontend_->track(image);
    if (tracked.is_recalibrated) {
      // The image is of the session that ends here, and has no answer. Who is not rewound goes on with the next one.
      const core::Camera& found = frontend_->camera();
      return begin_session("self-calibration: depth registered anew, or fx = " + std::to_string(found.fx),
                           parameters_.lockstep && is_played());
    }
    report_.add(tracked);
    if (tracked.sample) {
      emit(*tracked.sample, frontend_->camera());
      return;
    }
    const bool is_lost = tracked.state == core::TrackingState::kLost;
    fail_image(image.stamp_ns, is_lost ? "images lost track of" : "images with nothing to follow",
               "stamp " + std::to_string(image.stamp_ns) + " ns: " + std::to_string(tracked.matches) + " matches, " +
                   std::to_string(tracked.inliers) + " of them agree on a pose",
               FrameDone::STATUS_NO_POSE);
  }

  image_transport::Subscriber color_, depth_;
  ros::Publisher report_publisher_;
  std::optional<core::RgbdFrontend> frontend_;  ///< what it found out about the camera outlives the session
  std::optional<core::Camera> frontend_camera_;
  core::RgbdImage image_;  ///< the last one
  core::TrackingReport report_;
  core::DepthRange depth_range_;
  std::atomic<std::int64_t> newest_pair_ns_{0};

  std::mutex mutex_;                                ///< guards synchronizer_, which the callbacks share
  std::unique_ptr<RgbdSynchronizer> synchronizer_;  ///< null until images are taken
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::RgbdFrontendNodelet, nodelet::Nodelet)
