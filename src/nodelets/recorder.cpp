#include <std_msgs/String.h>

#include <filesystem>
#include <memory>
#include <mutex>
#include <pluginlib/class_list_macros.hpp>
#include <string>

#include "pipeline/map_state.h"
#include "ros/frame_joiner.h"
#include "ros/stage.h"
#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/pipeline/object_slam.h"

namespace semantic_topo_loop {
namespace {

/// DIR~ or, where that is taken, DIR~2, DIR~3 and so on.
std::string place_beside(std::string directory) {
  while (directory.size() > 1 && directory.back() == '/') directory.pop_back();
  std::string place = directory + "~";
  std::error_code code;
  for (int i = 2; std::filesystem::exists(place, code); ++i) place = directory + "~" + std::to_string(i);
  return place;
}

}  // namespace

/// Collects what the stages say and writes the files of the offline program.
class RecorderNodelet : public StageWith<RecorderParameters> {
 public:
  RecorderNodelet() : StageWith("Recorder") {}
  ~RecorderNodelet() override { stop(); }

 private:
  /// The END frame is complete when every stage has spoken of it.
  struct Heard {};
  using Joiner = FrameJoiner<FrameMessage::ConstPtr, Heard, Heard, Heard, Heard, Heard>;
  enum Kind : std::size_t { kFrame, kAssociations, kObservation, kLoops, kCorrection, kCompletion };

  void onInit() override {
    if (!start(6)) return;
    joiner_ = std::make_unique<Joiner>(queue_capacity());
    reset_session();
    written_publisher_ = advertise<std_msgs::String>("results_written", true);
    serve_trigger("save_results", [this] {
      const core::Error nowhere{"parameter 'output_dir' is empty: nothing was recorded"};
      return parameters_.output_dir.empty() ? nowhere : write();
    });
    if (parameters_.output_dir.empty()) return follow_sessions();
    const auto place = write_to(parameters_.output_dir, [](const std::string& path) {
      const core::Status made = core::make_directory(path);
      return made ? core::check_writable(path + "/") : made;
    });
    if (!place) {
      fail(place.message());
      return;
    }
    subscribe("map_corrections", Keep::kAlways, &RecorderNodelet::on_correction);
    subscribe("loop_closures", Keep::kAlways, &RecorderNodelet::on_loops);
    subscribe("quadric_map_updates", Keep::kAlways, &RecorderNodelet::on_update);
    subscribe("tracking_report", Keep::kAlways, &RecorderNodelet::on_tracking);
    subscribe("associations", Keep::kAlways, &RecorderNodelet::on_associations);
    subscribe("frames", Keep::kAlways, &RecorderNodelet::on_frame);
    save_at_end([this] { write_results(); });
    follow_sessions();
  }

  void reset_session() override {
    joiner_->clear();
    const std::lock_guard<std::mutex> lock(mutex_);
    // The files will be those of the new session. One with `rewind` has the images of the last one again.
    if (has_recorded_ && !session().rewind) {
      report_written("results of the session before", write_files(place_beside(parameters_.output_dir)));
    }
    has_recorded_ = false;
    set_unsaved(false);
    recorder_ = core::make_run_recorder(classes(), parameters_.output_dir);
    if (parameters_.output_dir.empty()) return;
    if (const auto map = session_map({true})) recorder_->record(core::objects_of(*map, options_, classes()));
  }

  /// @return absolute path of the directory
  core::Result<std::string> write() {
    const std::lock_guard<std::mutex> lock(mutex_);
    core::Result<std::string> written = write_files(parameters_.output_dir);
    if (written) set_unsaved(false);
    return written;
  }

  /// To be called with the lock.
  core::Result<std::string> write_files(const std::string& directory) const {
    return write_to(directory, [this](const std::string& path) { return recorder_->write(path); });
  }

  void on_frame(const FrameMessage::ConstPtr& frame) {
    record(*frame);
    add<kFrame>(frame->frame_id, frame);
  }

  void on_tracking(const TrackingMessage::ConstPtr& report) { record(*report); }

  void on_associations(const AssociationsMessage::ConstPtr& associations) {
    record(*associations);
    add<kAssociations>(associations->frame_id, {});
  }

  void on_update(const MapUpdateMessage::ConstPtr& update) {
    record(*update);
    if (update->phase == core::MapUpdatePhase::kObservation) {
      add<kObservation>(update->frame_id, {});
    } else {
      add<kCompletion>(update->frame_id, {});
    }
  }

  void on_loops(const LoopsMessage::ConstPtr& loops) {
    record(loops->frame_id, loops->closures, loops->duration_us);
    record(loops->relocalisation);
    add<kLoops>(loops->frame_id, {});
  }

  void on_correction(const CorrectionMessage::ConstPtr& correction) {
    record(*correction);
    add<kCorrection>(correction->frame_id, {});
  }

  template <class... Record>
  void record(const Record&... record) {
    const std::lock_guard<std::mutex> lock(mutex_);
    set_unsaved(true);
    has_recorded_ = true;
    recorder_->record(record...);
  }

  template <Kind kind>
  void add(std::int64_t frame_id, std::tuple_element_t<kind, Joiner::Set> item) {
    const std::optional<Joiner::Set> joined = joiner_->template add<kind>(frame_id, item);
    if (!joined) return;
    count_processed();
    if (std::get<kFrame>(*joined)->is_end) write_results();
  }

  void write_results() {
    const core::Result<std::string> written = write();
    if (!report_written("results", written)) return;
    auto message = boost::make_shared<std_msgs::String>();
    message->data = *written;
    written_publisher_.publish(message);
  }

  ros::Publisher written_publisher_;
  std::unique_ptr<Joiner> joiner_;
  std::mutex mutex_;           ///< guards all below, which the worker fills, and the service and the end read
  bool has_recorded_ = false;  ///< something of this session
  std::unique_ptr<core::RunRecorder> recorder_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::RecorderNodelet, nodelet::Nodelet)
