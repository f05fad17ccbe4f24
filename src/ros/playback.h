#pragma once

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_msgs/TFMessage.h>

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/FrameDone.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop {

/// What the player publishes for one image: first the transforms, then the camera_info that stands for the image, then
/// the image itself, where a front end is to track it.
struct PlayerItem {
  std::vector<tf2_msgs::TFMessage> transforms;  ///< recorded up to a little after the image, so that none is awaited
  std::vector<geometry_msgs::TransformStamped> static_transforms;
  sensor_msgs::CameraInfo camera_info;      ///< stamped as the image
  sensor_msgs::ImageConstPtr color, depth;  ///< both stamped as camera_info; null where none are played
  std::string left_out;                     ///< if not empty: no image after all, and why
  std::string detail;                       ///< of left_out
};

/// A recording, image by image.
struct PlayerSource {
  std::function<std::optional<PlayerItem>()> next;  ///< nullopt at the end
  std::function<core::Status()> end;  ///< how the recording ended, or the fault in it; once `next` gave nullopt
  std::size_t size = 0;               ///< images in the recording, for the progress shown
};

/// The player's book on the chain: which stages are there, which frames are on their way, and who was the last to
/// touch them. Not thread-safe.
class PlayerLedger {
 public:
  /// The topics of the chain in the order in which a frame appears on them.
  enum Link { kFrames, kDetections, kAssociations, kObservations, kLoopClosures, kCorrections, kCompletions };
  static constexpr std::size_t kLinkCount = 7;

  /// @param frontend name of the stage that opens the session and makes the frames   @param stages that must
  /// acknowledge the session before the first frame   @param expects_results the stream has only ended when the
  /// recorder has written its files
  PlayerLedger(std::string frontend, std::vector<std::string> stages, bool expects_results)
      : frontend_(std::move(frontend)), stages_(std::move(stages)), expects_results_(expects_results) {}

  /// A new session forgets the frames on their way: the stages have dropped them.
  void take(const SessionControl& control);
  void take(const SessionAck& ack) { acknowledged_[ack.stage] = ack.session_id; }
  /// Whether the front end wants the recording from its first image; asked once, it is granted.
  bool take_rewind() { return std::exchange(wants_rewind_, false); }
  /// The front end if it has opened no session, else the stages that have not acknowledged it.
  std::vector<std::string> missing_stages() const;
  bool is_paused() const { return is_paused_; }

  void sent(std::int64_t stamp_ns) {
    in_flight_[stamp_ns] = kUnknownFrame;
    ++frames_sent_;
  }
  void end_sent() { is_end_sent_ = true; }
  /// A frame as the front end numbered it.
  void numbered(std::uint32_t session_id, std::int64_t stamp_ns, std::int64_t frame_id, bool is_end);
  void seen(Link link, std::uint32_t session_id, std::int64_t frame_id);
  void done(const FrameDone& done);
  void results_written() { has_results_ = is_end_sent_; }

  std::size_t in_flight() const { return in_flight_.size(); }
  bool is_end_done() const { return is_end_done_ && (!expects_results_ || has_results_); }
  bool awaits_end() const { return is_end_sent_ && !is_end_done(); }
  std::uint64_t frames_sent() const { return frames_sent_; }
  /// Frames that the chain answered for; the others sent were dropped on their way, as stages may do in real time.
  std::uint64_t frames_done() const { return frames_done_; }
  std::uint64_t frames_without_pose() const { return frames_without_pose_; }
  /// The stage that the oldest frame on its way, or the end of the stream, waits for.
  std::string silent_stage() const;

 private:
  static constexpr std::int64_t kUnknownFrame = -1;

  std::string frontend_;
  std::vector<std::string> stages_;
  bool expects_results_;
  std::uint32_t session_id_ = 0;  ///< 0: none yet
  ros::Time session_stamp_;       ///< of its START, which the front end may repeat
  bool is_paused_ = false;
  bool wants_rewind_ = false;
  std::map<std::string, std::uint32_t> acknowledged_;  ///< last session_id by stage
  std::map<std::int64_t, std::int64_t> in_flight_;     ///< frame_id by stamp
  std::int64_t end_frame_id_ = kUnknownFrame;
  bool is_end_sent_ = false, is_end_done_ = false, has_results_ = false;
  std::array<std::int64_t, kLinkCount> last_seen_{};  ///< largest frame_id + 1 of each link, this session
  std::uint64_t frames_sent_ = 0, frames_done_ = 0, frames_without_pose_ = 0;
};

}  // namespace semantic_topo_loop
