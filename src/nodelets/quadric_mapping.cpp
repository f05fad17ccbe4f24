#include <algorithm>
#include <memory>
#include <optional>
#include <pluginlib/class_list_macros.hpp>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "map/mapper_state.h"
#include "ros/frame_joiner.h"
#include "ros/map_part_sender.h"
#include "ros/stage.h"
#include "semantic_topo_loop/QueryObjects.h"
#include "semantic_topo_loop/map/quadric_mapper.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/types/map_unit.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop {
/// Keeps the quadric map and publishes its deltas, and the whole of it now and then for late listeners.
class QuadricMappingNodelet : public StageWith<QuadricMappingParameters> {
 public:
  QuadricMappingNodelet() : StageWith("QuadricMapping") {}
  ~QuadricMappingNodelet() override { stop(); }

 private:
  using Joiner = FrameJoiner<FrameMessage::ConstPtr, AssociationsMessage::ConstPtr>;
  static constexpr double kFullMapPeriodS = 1.0;  ///< how long a late listener waits for the map
  static constexpr char kIncomplete[] = "dropped, frame or associations missing";

  void onInit() override {
    if (!start(2)) return;
    // A break, and the keyframe that later boxes hang on, are told by one frame alone, whose boxes may get lost.
    joiner_ = std::make_unique<Joiner>(queue_capacity(), [this](std::int64_t id, const Joiner::Partial& partial) {
      if (const auto& frame = std::get<0>(partial)) integrate(**frame, core::AssociationFrame::without_answer(id));
    });
    update_publisher_ = advertise<MapUpdateMessage>("quadric_map_updates");
    map_publisher_ = advertise<MapMessage>("quadric_map", true);
    statistics().count(kIncomplete, 0);
    map_parts_.open(getNodeHandle(), queue_capacity());
    serve("query_objects", &QuadricMappingNodelet::on_query);
    reset_session();
    serve_settings(&options_.mapping, [this] { mapper_->set_options(options_.mapping); });
    subscribe("map_corrections", Keep::kAlways, &QuadricMappingNodelet::on_correction);
    subscribe("associations", Keep::kDroppable, &QuadricMappingNodelet::on_associations);
    subscribe("frames", Keep::kAlways, &QuadricMappingNodelet::on_frame);
    start_timer(kFullMapPeriodS, [this] { publish_map(); });
    follow_sessions();
  }

  void reset_session() override {
    mapper_ = std::make_unique<core::QuadricMapper>(options_.mapping, classes());
    joiner_->clear();
    published_version_.reset();
    last_stamp_ = ros::Time();  // of no data yet: tf takes it for the latest
    map_parts_.reset_session();
    if (const auto map = session_map({true})) core::restore_objects(*map, mapper_.get());
    show_objects({});
    publish_map();
  }

  void set_localization(bool localization) override { mapper_->set_fixed(localization); }

  bool on_query(QueryObjects::Request& request, QueryObjects::Response& response) {
    const core::Vec3 low(request.low.x, request.low.y, request.low.z);
    const core::Vec3 high(request.high.x, request.high.y, request.high.z);
    if (!(low.array() <= high.array()).all()) {
      response.message = "low must not be above high, nor anything but a number";
      return true;
    }
    for (const std::uint8_t state : request.states) {
      if (state <= static_cast<std::uint8_t>(core::LandmarkState::kRetired)) continue;
      response.message = "states: " + std::to_string(state) + " is no state";
      return true;
    }
    std::set<int> class_ids;
    for (const std::string& label : request.labels) {
      const core::ObjectClass* object_class = classes()->find(label);
      if (object_class == nullptr) {
        response.message = "label '" + label + "' is none of the class table";
        return true;
      }
      class_ids.insert(object_class->id);
    }
    const auto found = ask("query_objects", [this, request, class_ids] {
      std::vector<core::Landmark> objects;
      for (core::Landmark& landmark : mapper_->landmarks()) {
        if (is_asked_for(landmark, request, class_ids)) objects.push_back(std::move(landmark));
      }
      return objects;
    });
    if (!found) response.message = "the map is busy: ask again";
    for (const core::Landmark& landmark : found.value_or(std::vector<core::Landmark>())) {
      response.objects.push_back(to_generated<Quadric>(landmark));
      response.labels.push_back(classes()->name(landmark.class_id));
    }
    return true;
  }

  bool is_asked_for(const core::Landmark& landmark, const QueryObjects::Request& request,
                    const std::set<int>& class_ids) const {
    if (!class_ids.empty() && class_ids.count(landmark.class_id) == 0) return false;
    const auto state = static_cast<std::uint8_t>(landmark.state);
    const auto& states = request.states;
    if (!states.empty() && std::find(states.begin(), states.end(), state) == states.end()) return false;
    const core::Vec3 low(request.low.x, request.low.y, request.low.z);
    const core::Vec3 high(request.high.x, request.high.y, request.high.z);
    if (low != high) {
      if (!landmark.ellipsoid) return false;
      const core::Vec3& center = landmark.ellipsoid->center();
      if ((center.array() < low.array()).any() || (center.array() > high.array()).any()) return false;
    }
    return request.since.isZero() || mapper_->last_seen_ns(landmark.id) >= to_stamp_ns(request.since);
  }

  void on_frame(const FrameMessage::ConstPtr& frame) {
    if (frame->is_end) map_parts_.set_end(frame->frame_id);
    take(joiner_->add<0>(frame->frame_id, frame));
  }

  void on_associations(const AssociationsMessage::ConstPtr& associations) {
    take(joiner_->add<1>(associations->frame_id, associations));
  }

  void take(const std::optional<Joiner::Set>& joined) {
    statistics().set_lost(kIncomplete, joiner_->evicted());
    if (joined) integrate(*std::get<0>(*joined), *std::get<1>(*joined));
  }

  void integrate(const FrameMessage& frame, const core::AssociationFrame& associations) {
    publish(mapper_->integrate(frame, associations), frame.header.stamp);
    count_processed();
  }

  void on_correction(const CorrectionMessage::ConstPtr& correction) {
    publish(mapper_->apply(*correction), correction->header.stamp);
    map_parts_.follow(correction->header, session_id(), correction->frame_id,
                      [this](bool whole, core::MapDelta* delta) { delta->objects = mapper_->take_delta(whole); });
    if (correction->changed) publish_map();
  }

  void publish(core::MapUpdate update, const ros::Time& stamp) {
    last_stamp_ = stamp;
    Stage::publish<MapUpdateMessage>(update_publisher_, make_header(stamp, parameters_.map_frame), std::move(update));
  }

  /// The whole map, unless that version is out already. A session begins with one, which replaces the latched one of
  /// the session before.
  void publish_map() {
    if (session_id() == 0 || published_version_ == mapper_->map_version()) return;
    FullMap map;
    map.map_version = mapper_->map_version();
    published_version_ = map.map_version;
    map.T_map_odom = mapper_->T_map_odom();
    map.changed = mapper_->landmarks();
    show_objects(map.changed);
    Stage::publish<MapMessage>(map_publisher_, make_header(last_stamp_, parameters_.map_frame), std::move(map));
  }

  /// In the diagnostics: how many are in which state, and how long the unit of length is by their sizes.
  void show_objects(const std::vector<core::Landmark>& objects) {
    using core::LandmarkState;
    for (const auto state : {LandmarkState::kCandidate, LandmarkState::kConfirmed, LandmarkState::kRetired}) {
      const auto n = std::count_if(objects.begin(), objects.end(),
                                   [state](const core::Landmark& object) { return object.state == state; });
      statistics().set(std::string("objects ") + core::to_string(state), static_cast<std::uint64_t>(n));
    }
    const std::optional<core::MapUnit> unit = core::map_unit(objects, *classes());
    statistics().set_text("unit of length by sizes", unit ? core::format_fixed(unit->metres, 2) + " m, 1 sigma " +
                                                                core::format_fixed(100.0 * unit->sigma, 0) + " %"
                                                          : "not known");
  }

  ros::Publisher update_publisher_, map_publisher_;
  MapPartSender map_parts_{MapPart::STAGE_QUADRIC_MAPPING};
  std::unique_ptr<Joiner> joiner_;
  std::unique_ptr<core::QuadricMapper> mapper_;
  std::optional<std::uint64_t> published_version_;  ///< of this session
  ros::Time last_stamp_;
};

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::QuadricMappingNodelet, nodelet::Nodelet)
