#include "semantic_topo_loop/io/map_database.h"

#include <array>
#include <memory>
#include <mutex>
#include <pluginlib/class_list_macros.hpp>
#include <string>
#include <utility>

#include "pipeline/map_state.h"
#include "ros/frame_joiner.h"
#include "ros/stage.h"
#include "semantic_topo_loop/SaveMap.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/io/yaml_files.h"

namespace semantic_topo_loop {
/// Keeps the map in a file while it grows: what the stages say is new in their parts is written together.
class MapDatabaseNodelet : public StageWith<MapDatabaseParameters> {
 public:
  MapDatabaseNodelet() : StageWith("MapDatabase") {}
  ~MapDatabaseNodelet() override { stop(); }

 private:
  using Part = MapPartMessage::ConstPtr;
  using Joiner = FrameJoiner<Part, Part, Part>;
  static constexpr char kIncomplete[] = "saved without all stages";
  static constexpr char kStages[] = "stages";
  /// By MapPart::stage.
  static constexpr std::array<const char*, 3> kStageNames = {"PoseGraph", "QuadricMapping", "LoopDetection"};
  static constexpr double kWatchPeriodS = 0.5;

  void onInit() override {
    if (!start(3)) return;
    serve("save_map", &MapDatabaseNodelet::on_save);
    if (parameters_.save_map_file.empty()) return follow_sessions();
    if (options_.loop.mode != "graph") {
      fail("parameter 'save_map_file' = '" + parameters_.save_map_file + "' needs loop/mode graph");
      return;
    }
    const auto place = write_to(parameters_.save_map_file, core::check_map_place);
    if (!place) {
      fail(place.message());
      return;
    }
    path_ = *place;
    // A part that never comes does not hold up the others for long: they come twice a second.
    constexpr std::size_t kWaiting = 4;
    joiner_ = std::make_unique<Joiner>(kWaiting, [this](std::int64_t, const Joiner::Partial& parts) {
      std::apply([this](const auto&... part) { (add(part.value_or(nullptr)), ...); }, parts);
      write();
      const std::string missing = missing_stages();
      if (!missing.empty()) warn_while(kStages, "no map is written: nothing of it came from " + missing);
    });
    statistics().count(kIncomplete, 0);
    save_at_end([this] { close(); });
    subscribe("keyframe_points", Keep::kAlways, &MapDatabaseNodelet::on_points);
    start_timer(kWatchPeriodS, [this] { watch(); });
    follow_sessions();
  }

  void reset_session() override {
    if (!joiner_) return;
    // A stage tells all that it has to who hears it first, and who must know the session by then.
    if (!std::exchange(hears_parts_, true)) subscribe("map_parts", Keep::kAlways, &MapDatabaseNodelet::on_part);
    joiner_->clear();
    close();
    waiting_.clear();
    told_by_ = {};
    keeps_copy_ = false;
    warn_while(kStages, "");
    // What another session of this process mapped stays, unless this one has its images again.
    const auto before = database();
    if (before && before->is_made()) has_made_ = !session().rewind;
    const bool is_itself = session().frozen && is_map_of(path_, session().map_file);
    warn_while("frozen map",
               is_itself ? "no map is written: " + path_ + ": is the frozen map, which stays as it is" : std::string());
    const std::lock_guard<std::mutex> lock(mutex_);
    database_.reset();
    loaded_ = session().map_file;
    if (is_itself) return;
    database_ =
        std::make_shared<core::MapDatabase>(path_, classes(), core::format_options_yaml(core::list_options(options_)),
                                            session().frozen ? std::string() : session().map_file, has_made_);
  }

  void on_points(const KeyframePointsMessage::ConstPtr& message) {
    if (!message->keyframe_points) return complain("unusable points of keyframes", message->problem);
    if (!database() || session().localization) return;
    auto delta = std::make_shared<core::MapDelta>();
    const core::KeyframePoints points = core::reduced(*message->keyframe_points, options_.point_map);
    delta->points.push_back({message->keyframe_id, std::make_shared<const core::KeyframePoints>(points)});
    waiting_.push_back(std::move(delta));
  }

  void on_part(const Part& part) {
    if (!part->delta) return complain("unreadable parts of the map", "of frame " + std::to_string(part->frame_id));
    if (!database()) return;
    // The others were written without it.
    const bool is_late = joiner_->is_past(part->frame_id);
    std::optional<Joiner::Set> joined;
    switch (part->stage) {
      case MapPart::STAGE_POSE_GRAPH:
        joined = joiner_->add<MapPart::STAGE_POSE_GRAPH>(part->frame_id, part);
        break;
      case MapPart::STAGE_QUADRIC_MAPPING:
        joined = joiner_->add<MapPart::STAGE_QUADRIC_MAPPING>(part->frame_id, part);
        break;
      case MapPart::STAGE_LOOP_DETECTION:
        joined = joiner_->add<MapPart::STAGE_LOOP_DETECTION>(part->frame_id, part);
        break;
      default:
        return complain("parts of the map of no stage", "stage " + std::to_string(part->stage));
    }
    statistics().set(kIncomplete, joiner_->evicted());
    if (joined) {
      std::apply([this](const auto&... each) { (add(each), ...); }, *joined);
      count_processed();
    } else if (is_late) {
      add(part);
    } else {
      return;
    }
    write();
    if (part->is_end) close();
  }

  /// Only what follows a stage's whole part can be written. One that was loaded anew no longer knows what it told
  /// before, which its whole part is to take the place of: a copy of the map still has it.
  void add(const Part& part) {
    if (!part) return;
    const core::MapDelta& delta = *part->delta;
    const bool is_whole = (delta.graph && delta.graph->is_whole) || (delta.objects && delta.objects->is_whole) ||
                          (delta.submaps && delta.submaps->is_whole);
    std::optional<ros::Time>& told_by = told_by_.at(part->stage);
    if (is_whole) {
      const bool is_anew = missing_stages().empty() && *told_by != part->loaded;
      if (is_anew)
        complain("stages loaded anew", kStageNames.at(part->stage) + ("; the map so far stays beside " + path_));
      keeps_copy_ = keeps_copy_ || is_anew;
      told_by = part->loaded;
    }
    if (told_by == part->loaded) core::append({part->delta}, &waiting_);
  }

  std::string missing_stages() const {
    std::string missing;
    for (std::size_t stage = 0; stage < told_by_.size(); ++stage) {
      if (!told_by_[stage]) missing += (missing.empty() ? "" : ", ") + std::string(kStageNames[stage]);
    }
    return missing;
  }

  void write() {
    if (!missing_stages().empty()) return;
    warn_while(kStages, "");
    database()->write(std::exchange(waiting_, {}), std::exchange(keeps_copy_, false));
    set_unsaved(true);
  }

  std::shared_ptr<core::MapDatabase> database() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return database_;
  }

  bool is_loaded(const std::string& path) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return is_map_of(path, loaded_);
  }
  /// @param loaded as the session reads it: a link, or a copy
  static bool is_map_of(const std::string& path, const std::string& loaded) {
    return core::is_same_file(path, loaded) || core::is_same_file(path, core::loaded_map(loaded));
  }

  void watch() {
    if (const auto database = this->database()) warn_while("map", database->problem().message());
  }

  /// What is written by then is a map, and one file.
  void close() {
    const auto database = this->database();
    if (!database) return;
    const core::Status closed = database->close();
    set_unsaved(false);
    if (closed && !database->is_made()) return;  // nothing has come
    report_written("map", closed ? core::Result<std::string>(path_) : closed.error());
  }

  bool on_save(SaveMap::Request& request, SaveMap::Response& response) {
    const auto database = this->database();
    if (!database || !database->is_made()) {
      response.message = parameters_.save_map_file.empty() ? "parameter 'save_map_file' is empty: no map is kept"
                                                           : "nothing is written yet";
      return true;
    }
    const core::Result<std::string> place = path_below(parameters_.save_dir, request.path, parameters_.allow_any_path);
    answer(place, &response);
    if (!place) return true;
    if (is_loaded(*place)) {
      answer(core::Result<std::string>(core::Error{*place + ": is the map that the session goes on with"}), &response);
      return true;
    }
    const core::Status problem = database->problem();
    const core::Result<core::MapCounts> copied = database->copy_to(*place);
    if (!copied) {
      answer(core::Result<std::string>(copied.error()), &response);
      return true;
    }
    if (!problem) {
      const std::string lacks = *place + ": saved without what came since the map cannot be written: ";
      answer(core::Result<std::string>(core::Error{lacks + problem.message()}), &response);
    }
    response.sessions = copied->sessions;
    response.keyframes = copied->keyframes;
    response.objects = copied->objects;
    response.submaps = copied->submaps;
    response.loops = copied->loops;
    return true;
  }

  std::string path_;  ///< absolute
  std::unique_ptr<Joiner> joiner_;
  bool hears_parts_ = false;
  std::array<std::optional<ros::Time>, 3> told_by_;  ///< by stage: when the one was loaded that sent its whole part
  core::MapDatabase::Parts waiting_;                 ///< until each stage has sent its part as a whole
  bool keeps_copy_ = false;                          ///< of what was written before those
  bool has_made_ = false;     ///< the file is of a session of before, whose images are not this one's
  mutable std::mutex mutex_;  ///< guards what follows, which services use
  std::shared_ptr<core::MapDatabase> database_;
  std::string loaded_;  ///< file of the map that the session goes on with or looks at
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::MapDatabaseNodelet, nodelet::Nodelet)
