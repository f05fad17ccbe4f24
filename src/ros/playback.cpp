#include "ros/playback.h"

#include <algorithm>
#include <iterator>

namespace semantic_topo_loop {
namespace {

/// Who publishes on each link after the front end.
constexpr std::array<const char*, PlayerLedger::kLinkCount - 1> kPublishers = {
    "DetectionIngestion", "ObjectAssociation", "QuadricMapping", "LoopDetection", "PoseGraph", "QuadricMapping"};
/// Reports a frame as done when it is complete.
constexpr char kLastStage[] = "ObjectAssociation";
constexpr char kRecorder[] = "Recorder";

}  // namespace

void PlayerLedger::take(const SessionControl& control) {
  if (control.command != SessionControl::COMMAND_LOCALIZATION) {
    is_paused_ = control.command == SessionControl::COMMAND_PAUSE;
  }
  const bool is_start = control.command == SessionControl::COMMAND_START;
  if (control.session_id == session_id_ && (!is_start || control.header.stamp == session_stamp_)) return;
  session_id_ = control.session_id;
  if (is_start) session_stamp_ = control.header.stamp;
  if (is_start && control.rewind && frames_sent_ > 0) {
    wants_rewind_ = true;
    frames_sent_ = frames_done_ = frames_without_pose_ = 0;
  }
  in_flight_.clear();
  last_seen_.fill(0);
  end_frame_id_ = kUnknownFrame;
}

std::vector<std::string> PlayerLedger::missing_stages() const {
  if (session_id_ == 0) return {frontend_};
  std::vector<std::string> missing;
  for (const std::string& stage : stages_) {
    const auto session = acknowledged_.find(stage);
    if (session == acknowledged_.end() || session->second != session_id_) missing.push_back(stage);
  }
  return missing;
}

void PlayerLedger::numbered(std::uint32_t session_id, std::int64_t stamp_ns, std::int64_t frame_id, bool is_end) {
  if (session_id != session_id_) return;
  if (is_end) {
    end_frame_id_ = frame_id;
  } else if (const auto frame = in_flight_.find(stamp_ns); frame != in_flight_.end()) {
    frame->second = frame_id;
  }
  seen(kFrames, session_id, frame_id);
}

void PlayerLedger::seen(Link link, std::uint32_t session_id, std::int64_t frame_id) {
  if (session_id != session_id_) return;
  last_seen_[link] = std::max(last_seen_[link], frame_id + 1);
}

void PlayerLedger::done(const FrameDone& done) {
  if (done.session_id != session_id_) return;
  if (done.status == FrameDone::STATUS_END) {
    is_end_done_ = true;
    in_flight_.clear();
    return;
  }
  const std::int64_t stamp_ns = static_cast<std::int64_t>(done.header.stamp.toNSec());
  // Images that were on their way when the recording began anew are answered, too.
  if (done.status != FrameDone::STATUS_PROCESSED && in_flight_.count(stamp_ns) == 0) return;
  ++frames_done_;
  if (done.status == FrameDone::STATUS_NO_POSE) ++frames_without_pose_;
  // Frames leave the chain in order: an older one that has not come was dropped, as stages may do in real time; and as
  // front ends may, an image that has no number when a later one has no pose.
  const bool answers_all = done.status == FrameDone::STATUS_PROCESSED;
  const bool answers_unnumbered = done.status == FrameDone::STATUS_NO_POSE;
  const auto last = in_flight_.upper_bound(stamp_ns);
  for (auto image = in_flight_.begin(); image != last;) {
    const bool is_dropped = answers_all || (answers_unnumbered && image->second == kUnknownFrame);
    const bool is_answered = is_dropped || image->first == stamp_ns;
    image = is_answered ? in_flight_.erase(image) : std::next(image);
  }
}

std::string PlayerLedger::silent_stage() const {
  if (is_end_done_) return kRecorder;
  // An image without a number before a frame was dropped by the front end.
  const auto frame = std::find_if(in_flight_.begin(), in_flight_.end(),
                                  [](const auto& image) { return image.second != kUnknownFrame; });
  const std::int64_t unnumbered = in_flight_.empty() ? end_frame_id_ : kUnknownFrame;
  const std::int64_t frame_id = frame != in_flight_.end() ? frame->second : unnumbered;
  if (frame_id == kUnknownFrame || last_seen_[kFrames] <= frame_id) return frontend_;
  for (std::size_t link = kDetections; link < kLinkCount; ++link) {
    if (last_seen_[link] <= frame_id) return kPublishers[link - kDetections];
  }
  return kLastStage;
}

}  // namespace semantic_topo_loop
