#include <chrono>
#include <deque>
#include <memory>
#include <optional>
#include <pluginlib/class_list_macros.hpp>
#include <string>
#include <vector>

#include "ros/detection_watch.h"
#include "ros/detector_messages.h"
#include "ros/frame_joiner.h"
#include "ros/stage.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {

/// Gives each Frame its detections: exactly one DetectionArray a Frame, in order, empty if there are none.
class DetectionIngestionNodelet : public StageWith<DetectionParameters> {
 public:
  DetectionIngestionNodelet() : StageWith("DetectionIngestion") {}
  ~DetectionIngestionNodelet() override { stop(); }

 private:
  using Clock = std::chrono::steady_clock;
  struct Waiting {
    FrameMessage::ConstPtr frame;
    Clock::time_point deadline;
  };
  static constexpr char kMissing[] = "frames without an answer of the detector";
  static constexpr char kUnmatched[] = "detections without a frame";
  static constexpr char kApart[] = "times that frames and detections did not meet";

  void onInit() override {
    if (!start(2)) return;
    is_file_ = parameters_.source == "file";
    if (is_file_ && !load_file()) return;
    for (const char* counter : {kMissing, kUnmatched, kApart}) statistics().count(counter, 0);
    make_matcher();
    publisher_ = advertise<DetectionsMessage>("detections");
    if (parameters_.source == "topic") {
      watch_.emplace(getNodeHandle().resolveName("frames"), getNodeHandle().resolveName("detections_in"));
      listen("detections_in", Keep::kDroppable, 100, &DetectionIngestionNodelet::on_input);
      constexpr double kDeadlinePeriodS = 0.02;  // below the time between two frames
      start_timer(kDeadlinePeriodS, [this] {
        resolve();
        if (warn_while("topics", watch_->starvation(Clock::now()))) statistics().count(kApart);
      });
    }
    subscribe("frames", Keep::kDroppable, &DetectionIngestionNodelet::on_frame);
    follow_sessions();
  }

  bool load_file() {
    core::Result<core::DetectionRecording> detections =
        core::read_detections(parameters_.detections_file, *classes(), boxes_max());
    if (!detections) return fail(detections.message());
    const core::DetectionReport& report = detections->report;
    for (const std::string& warning : report.warnings()) NODELET_WARN("%s", warning.c_str());
    for (std::size_t i = 0; i < core::kDetectionProblemCount; ++i) {
      const auto problem = static_cast<core::DetectionProblem>(i);
      const int count = report.cause(problem).count;
      if (count > 0) statistics().count(core::to_string(problem), static_cast<std::uint64_t>(count));
    }
    file_ = std::move(detections->frames);
    return true;
  }

  void reset_session() override {
    waiting_.clear();
    matched_ = 0;
    // Answers of the first pass would pass for those of later images.
    if (session().rewind) make_matcher();
  }

  void make_matcher() {
    // A detector that is late must find its frames still waiting, and one that is ahead its detections still kept.
    constexpr std::size_t kKeptPerFrame = 10;
    matcher_ = std::make_unique<DetectionMatcher>(queue_capacity() * kKeptPerFrame);
  }

  void on_frame(const FrameMessage::ConstPtr& frame) {
    const std::chrono::duration<double> timeout(parameters_.detection_timeout_s);
    waiting_.push_back({frame, Clock::now() + std::chrono::duration_cast<Clock::duration>(timeout)});
    if (watch_ && !frame->is_end) watch_->hear_frame(frame->stamp_ns, Clock::now());
    resolve();
  }

  void on_input(const DetectorMessage::ConstPtr& message) {
    core::Result<core::DetectionFrame> detections = read_detector_message(*message, *classes(), leave_out());
    if (!detections) return complain("messages that are no detections", "on detections_in: " + detections.message());
    if (!detections->unanswered) watch_->hear_detections(detections->stamp_ns, Clock::now());
    matcher_->add(*std::move(detections));
    resolve();
  }

  void resolve() {
    while (!waiting_.empty() && resolve(waiting_.front())) waiting_.pop_front();
    if (!is_file_) statistics().set(kUnmatched, matcher_->unmatched());
  }

  /// @return false if the frame must wait on
  bool resolve(const Waiting& waiting) {
    const FrameMessage& frame = *waiting.frame;
    const bool has_detections = !frame.is_end && parameters_.source != "none";
    std::optional<std::vector<core::Detection>> answer;
    if (has_detections && is_file_) {
      answer = from_file(frame);
    } else if (has_detections) {
      const std::optional<core::DetectionFrame> found = matcher_->take(frame.stamp_ns);
      if (!found && !matcher_->is_past(frame.stamp_ns) && Clock::now() < waiting.deadline) return false;
      matcher_->forget_before(frame.stamp_ns);
      if (!found) {
        complain(kMissing, "nothing on detections_in for stamp " + std::to_string(frame.stamp_ns) + " ns within " +
                               std::to_string(parameters_.detection_timeout_s) + " s, or not before a later one's");
      } else if (found->unanswered) {
        watch_->meet_unanswered();
        statistics().count(kMissing);
      } else {
        watch_->meet();
        answer = core::usable_boxes(found->detections, *classes(), boxes_max(), leave_out());
      }
    }
    const bool unanswered = !answer;
    publish<DetectionsMessage>(
        publisher_, make_header(frame.header.stamp, frame.camera_frame),
        {frame.frame_id, unanswered, std::move(answer).value_or(std::vector<core::Detection>())});
    count_processed();
    if (frame.is_end && is_file_) report_unused();
    return true;
  }

  std::optional<std::vector<core::Detection>> from_file(const FrameMessage& frame) {
    const std::int64_t stamp_ns = frame.stamp_ns;
    const core::DetectionFrame* found = core::find_stamp(file_, stamp_ns, kStampTolerance_ns);
    if (found == nullptr) {
      complain(kMissing, parameters_.detections_file + " has no image with stamp " + std::to_string(stamp_ns) + " ns");
      return std::nullopt;
    }
    ++matched_;
    return found->detections;
  }

  core::OnLeftOut leave_out() {
    return [this](std::size_t, core::DetectionProblem problem, const std::string& value) {
      complain(core::to_string(problem), "a box on detections_in is left out: " + value);
    };
  }

  std::size_t boxes_max() const { return static_cast<std::size_t>(options_.association.boxes_max); }

  void report_unused() {
    const std::size_t unused = file_.size() - matched_;
    statistics().set(kUnmatched, unused);
    if (unused == 0) return;
    NODELET_WARN(
        "%zu of %zu images in %s had no frame: the odometry has no pose there, or the frame was dropped on the way, "
        "see the diagnostics",
        unused, file_.size(), parameters_.detections_file.c_str());
  }

  ros::Publisher publisher_;
  bool is_file_ = false;
  std::vector<core::DetectionFrame> file_;
  std::size_t matched_ = 0;  ///< images of the file that met a frame, this session
  std::deque<Waiting> waiting_;
  std::unique_ptr<DetectionMatcher> matcher_;
  std::optional<DetectionWatch> watch_;  ///< of source topic
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::DetectionIngestionNodelet, nodelet::Nodelet)
