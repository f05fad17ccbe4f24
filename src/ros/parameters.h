#pragma once

#include <XmlRpcValue.h>
#include <ros/node_handle.h>

#include <string>
#include <vector>

#include "semantic_topo_loop/pipeline/options.h"

namespace semantic_topo_loop {

/// Parameters that every stage has; a stage's own struct inherits it.
struct StageParameters {
  int queue_size = 60;

  void visit(core::OptionVisitor& visitor) {
    visitor("queue_size", queue_size, core::at_least(2),
            "frames held before the oldest is dropped; more than the player's credit, so that it loses none");
  }
};

/// The same for stages that need the detector's classes.
struct ClassStageParameters : StageParameters {
  std::string class_table;

  void visit(core::OptionVisitor& visitor) {
    StageParameters::visit(visitor);
    visitor("class_table", class_table, core::given(), "file with the detector's classes, config/classes_*.yaml");
  }
};

/// The same for stages that publish in the frame of the corrected map.
struct MapStageParameters : ClassStageParameters {
  std::string map_frame = "map";

  void visit(core::OptionVisitor& visitor) {
    ClassStageParameters::visit(visitor);
    visitor("map_frame", map_frame, core::any(), "frame of the corrected map");
  }
};

/// The same for stages with services that name files. @tparam Base what they are else
template <class Base>
struct FileStageParameters : Base {
  std::string save_dir;
  bool allow_any_path = false;

  void visit(core::OptionVisitor& visitor) {
    Base::visit(visitor);
    visitor("save_dir", save_dir, core::any(),
            "directory below which the files lie that services name; empty: the process's own, ~/.ros under roslaunch");
    visitor("allow_any_path", allow_any_path, "services may name files anywhere");
  }
};

/// What every front end has: its calibration, its frames, and the map that a session begins with.
struct FrontendParameters : FileStageParameters<ClassStageParameters> {
  std::string camera_file;
  std::string odom_frame = "odom";
  std::string base_frame, camera_frame;
  bool publish_odom_tf = false;
  std::string map_file;
  bool frozen = false;

  void visit(core::OptionVisitor& visitor) {
    FileStageParameters::visit(visitor);
    visitor("camera_file", camera_file, core::any(),
            "calibration that replaces camera_info's, see config/camera; empty: none");
    visitor("odom_frame", odom_frame, core::given(), "tf frame of the odometry");
    visitor("base_frame", base_frame, core::any(),
            "tf frame that publish_odom_tf moves (empty: the root of the camera's tree in tf, which may be the "
            "camera), and of which odometry is whose child_frame_id names none (empty: the camera's optical frame)");
    visitor("camera_frame", camera_frame, core::any(), "tf frame of the camera's optical frame; empty: camera_info's");
    visitor("publish_odom_tf", publish_odom_tf, "send odom_frame -> base_frame, for poses that are not in tf");
    visitor("map_file", map_file, core::any(), "map of earlier sessions that this one goes on with; empty: none");
    visitor("frozen", frozen, "with map_file: the place in the map is looked for, and the map stays as it is");
  }
};

/// Where PoseFrontend finds poses and image stamps.
struct PoseFrontendParameters : FrontendParameters {
  std::string pose_source = "tf";
  std::string trigger = "camera_info";
  std::string trajectory_file;
  double max_pose_gap_s = 0.1;
  double pose_timeout_s = 0.5;
  bool use_points = false;

  void visit(core::OptionVisitor& visitor) {
    FrontendParameters::visit(visitor);
    visitor("pose_source", pose_source, core::one_of({"file", "tf", "odometry"}),
            "where poses come from: tf, odometry (nav_msgs/Odometry) or file");
    visitor("trigger", trigger, core::one_of({"camera_info", "detections"}),
            "whose stamps make frames: camera_info or detections (detections_in)");
    visitor("trajectory_file", trajectory_file, core::any(), "file: camera poses in the odometry frame, TUM format");
    visitor("max_pose_gap_s", max_pose_gap_s, core::positive(), "poses farther apart are not interpolated between");
    visitor("pose_timeout_s", pose_timeout_s, core::not_negative(), "how long an image waits for its pose, wall time");
    visitor("use_points", use_points, "join the cloud on `points` that has the image's stamp");
    visitor.require("trajectory_file", pose_source != "file" || !trajectory_file.empty(),
                    "given with pose_source file");
    visitor.require("publish_odom_tf", !publish_odom_tf || pose_source != "tf",
                    "false with pose_source tf, where somebody else sends it");
  }
  /// Whether anything of tf is needed: only poses of a file are found without.
  bool needs_tf() const { return pose_source != "file" || publish_odom_tf; }
};

/// How colour and depth images of two topics are joined.
struct PairingParameters {
  int queue_size = 10;
  double max_delay_s = 0.02;
  double pair_timeout_s = 1.0;
  double starvation_s = 3.0;
  std::string color_topic = "color", depth_topic = "depth";  ///< as warnings name them; no parameters
};

/// How RgbdFrontend takes its images.
struct RgbdFrontendParameters : FrontendParameters {
  std::string color_transport = "raw";
  std::string depth_transport = "raw";
  int color_queue_size = 10;
  int depth_queue_size = 10;
  PairingParameters pairing;
  double max_lag_s = 0.5;
  bool lockstep = false;

  void visit(core::OptionVisitor& visitor) {
    FrontendParameters::visit(visitor);
    visitor("color_transport", color_transport, core::given(), "image_transport of color: raw, compressed, ...");
    visitor("depth_transport", depth_transport, core::given(), "image_transport of depth: raw, compressedDepth, ...");
    visitor("color_queue_size", color_queue_size, core::at_least(1), "color images that wait for the callback");
    visitor("depth_queue_size", depth_queue_size, core::at_least(1), "depth images that wait for the callback");
    visitor("sync_queue_size", pairing.queue_size, core::at_least(1), "images of a topic that wait for the other one");
    visitor("max_depth_delay_s", pairing.max_delay_s, core::positive(),
            "color and depth farther apart in stamp do not belong together");
    visitor("pair_timeout_s", pairing.pair_timeout_s, core::positive(),
            "how long a color image waits for its depth, wall time");
    visitor("starvation_s", pairing.starvation_s, core::positive(),
            "a topic that is silent for longer is reported, wall time");
    visitor("max_lag_s", max_lag_s, core::positive(),
            "without lockstep: images that have waited for longer are left out, but for the newest; wall time");
    visitor("lockstep", lockstep,
            "a Player in lockstep gives the images: none is left out for having waited, and self-calibration asks for "
            "them from the first one on again");
  }
};

/// How ObjectDetector takes its images.
struct ObjectDetectorParameters : ClassStageParameters {
  std::string color_transport = "raw";
  bool lockstep = false;

  void visit(core::OptionVisitor& visitor) {
    ClassStageParameters::visit(visitor);
    visitor("color_transport", color_transport, core::given(), "image_transport of color: raw, compressed, ...");
    visitor("lockstep", lockstep, "look at every image, however long it takes; false: at the newest");
  }
};

/// Where DetectionIngestion finds detections.
struct DetectionParameters : ClassStageParameters {
  std::string source = "topic";
  std::string detections_file;
  double detection_timeout_s = 1.0;

  void visit(core::OptionVisitor& visitor) {
    ClassStageParameters::visit(visitor);
    visitor("source", source, core::one_of({"topic", "file", "none"}),
            "where detections come from: topic (detections_in), file, or none");
    visitor("detections_file", detections_file, core::any(),
            "file: JSON as OA-SLAM's or COCO's results, or a directory of YOLO text files");
    visitor("detection_timeout_s", detection_timeout_s, core::not_negative(),
            "topic: how long a frame waits for its detections, wall time");
    visitor.require("detections_file", source != "file" || !detections_file.empty(), "given with source file");
  }
};

struct LoopDetectionParameters : ClassStageParameters {
  std::string earlier_map_frame = "earlier_map";

  void visit(core::OptionVisitor& visitor) {
    ClassStageParameters::visit(visitor);
    visitor("earlier_map_frame", earlier_map_frame, core::any(),
            "name of the earlier run's map frame in earlier_map_from_odom");
  }
};

/// How a bag in the layout of the official TUM RGB-D bags is read.
struct TumBagPlayback {
  std::string file;
  std::string stamps = "image";  ///< of the images: image or camera_info
  bool with_images = false;      ///< the colour images themselves; needs stamps image
  bool with_depth = true;        ///< and their depth
  double max_depth_delay_s = 0.02;
  std::string mocap_tf = "drop";  ///< the motion capture's edge in /tf: drop, or odom (its parent becomes odom_frame)
  std::string odom_frame = "odom";
  double lookahead_s = 0.3;  ///< transforms recorded up to this long after an image go before it

  bool plays_depth() const { return with_images && with_depth; }
};

/// What the player plays, and how.
struct PlayerParameters : StageParameters {
  std::string mode = "files";
  std::string trajectory_file, camera_file;
  TumBagPlayback bag;
  std::string camera_frame = "camera_optical_frame";
  double max_pose_gap_s = 0.1;
  bool lockstep = true;
  int credit = 1;
  double rate = 1.0;
  std::string stages = "DetectionIngestion ObjectAssociation QuadricMapping LoopDetection PoseGraph";
  bool await_results = false;
  double startup_timeout_s = 30.0;
  double stall_timeout_s = 20.0;

  void visit(core::OptionVisitor& visitor) {
    StageParameters::visit(visitor);
    visitor("mode", mode, core::one_of({"files", "bag"}),
            "what is played: files, or bag (in the layout of the TUM RGB-D bags)");
    visitor("trajectory_file", trajectory_file, core::any(), "files: a TUM trajectory, whose stamps are played");
    visitor("camera_file", camera_file, core::any(), "calibration to publish; bag: empty for the recorded camera_info");
    visitor("camera_frame", camera_frame, core::any(), "files: tf frame of the camera's optical frame");
    visitor("bag_file", bag.file, core::any(), "bag: what is played");
    visitor("stamps", bag.stamps, core::one_of({"image", "camera_info"}), "bag: which stamps are played");
    visitor("images", bag.with_images, "bag: play the color images too, for RgbdFrontend and ObjectDetector");
    visitor(
        "depth_images", bag.with_depth,
        "bag, images: and depth, for RgbdFrontend, which is given no image without; false: poses come from elsewhere");
    visitor("max_depth_delay_s", bag.max_depth_delay_s, core::positive(),
            "bag, images: depth farther from color in stamp is none of it");
    visitor("mocap_tf", bag.mocap_tf, core::one_of({"drop", "odom"}),
            "bag: drop the motion capture's transform, or odom to take it as the odometry");
    visitor("odom_frame", bag.odom_frame, core::any(),
            "bag: parent of the motion capture's transform if mocap_tf is odom");
    visitor("max_pose_gap_s", max_pose_gap_s, core::positive(),
            "bag: transforms go at least this long ahead of the images");
    visitor("lockstep", lockstep, "play as fast as the stages can, and let them drop nothing");
    visitor("credit", credit, core::at_least(1),
            "lockstep: images on their way at a time; 1 gives the offline program's bytes");
    visitor("rate", rate, core::positive(), "without lockstep: 1 is real time");
    visitor("stages", stages, core::any(), "stages that must be there before the first image, separated by blanks");
    visitor("await_results", await_results, "end only when the recorder has written its files");
    visitor("startup_timeout_s", startup_timeout_s, core::positive(), "how long the stages may take to come up");
    visitor("stall_timeout_s", stall_timeout_s, core::positive(),
            "how long an image may wait in the chain while no stage works");
    visitor.require("trajectory_file", mode != "files" || !trajectory_file.empty(), "given in mode files");
    visitor.require("camera_file", mode != "files" || !camera_file.empty(), "given in mode files");
    visitor.require("bag_file", mode != "bag" || !bag.file.empty(), "given in mode bag");
    visitor.require("images", !bag.with_images || (mode == "bag" && bag.stamps == "image"),
                    "false unless mode is bag and stamps is image");
    visitor.require("credit", credit < queue_size, "less than queue_size");
  }
  std::vector<std::string> stage_names() const;
};

struct PoseGraphParameters : FileStageParameters<MapStageParameters> {
  bool publish_tf = true;
  bool map_below_odom = false;
  double tf_rate_hz = 20.0;
  double tf_tolerance_s = 0.1;

  void visit(core::OptionVisitor& visitor) {
    FileStageParameters::visit(visitor);
    visitor("publish_tf", publish_tf, "send the transform from map_frame to the odometry's frame");
    visitor("map_below_odom", map_below_odom,
            "send it the other way round, map_frame as a child of the odometry's frame, above which another program's "
            "map is");
    visitor("tf_rate_hz", tf_rate_hz, core::positive(), "rate of that transform (wall time)");
    visitor("tf_tolerance_s", tf_tolerance_s, core::not_negative(),
            "how far the transform is dated ahead of the last pose");
  }
};

struct PointMappingParameters : FileStageParameters<MapStageParameters> {
  double rate_hz = 1.0;

  void visit(core::OptionVisitor& visitor) {
    FileStageParameters::visit(visitor);
    visitor("rate_hz", rate_hz, core::positive(), "most often that the points are published (wall time)");
  }
};

/// Where MapDatabase keeps the map.
struct MapDatabaseParameters : FileStageParameters<ClassStageParameters> {
  std::string save_map_file;

  void visit(core::OptionVisitor& visitor) {
    FileStageParameters::visit(visitor);
    visitor("save_map_file", save_map_file, core::any(),
            "file that the map is written to, twice a second of data; it may be the map that the session goes on with; "
            "empty: none");
  }
};

using QuadricMappingParameters = MapStageParameters;

struct RecorderParameters : ClassStageParameters {
  std::string output_dir;

  void visit(core::OptionVisitor& visitor) {
    ClassStageParameters::visit(visitor);
    visitor("output_dir", output_dir, core::any(),
            "where a run's files go at its end, also by Ctrl-C, or by ~save_results; empty: nothing is kept");
  }
};

/// Sizes of markers that have none of their own, m.
struct MarkerSizes {
  double label_m = 0.08;   ///< height of a capital letter
  double line_m = 0.008;   ///< width of lines
  double camera_m = 0.06;  ///< depth of a keyframe's frustum; the current camera's is twice as deep
};

struct VisualizationParameters : MapStageParameters {
  std::string upright_frame = "map_upright";
  std::string color_transport = "raw";
  double rate_hz = 5.0;
  MarkerSizes sizes;

  void visit(core::OptionVisitor& visitor) {
    MapStageParameters::visit(visitor);
    visitor("upright_frame", upright_frame, core::any(),
            "z-up child frame of map_frame at the first camera, for viewers; empty: none");
    visitor("color_transport", color_transport, core::given(),
            "for annotated_image: image_transport of color: raw, compressed, ...");
    visitor("rate_hz", rate_hz, core::positive(), "most often that markers are published (wall time)");
    visitor.live("label_size_m", sizes.label_m, core::positive(), "height of the labels' letters");
    visitor.live("line_width_m", sizes.line_m, core::positive(), "width of the lines of topology and loops");
    visitor.live("camera_size_m", sizes.camera_m, core::positive(), "depth of the keyframes' frusta");
  }
};

/// What every nodelet has beside the options of the core, for the documentation. Parameters that several have are
/// listed once.
std::vector<core::OptionRow> list_nodelet_parameters();

/// The shortest text that gives the same number back.
std::string exact_text(double value);

/// Flattens nested parameters into `module.field` -> text; numbers keep every digit.
/// @return an error that names the key for a list, a binary or a date
core::Result<core::OptionTexts> flatten_parameters(const XmlRpc::XmlRpcValue& tree);

/// Leaves out what others read and write in a nodelet's namespace: roscpp's own tools (diagnostic_period,
/// num_worker_threads), and image_transport's plugins, in groups named after the transports.
core::OptionTexts own_parameters(core::OptionTexts texts);

/// Reads everything below the handle's namespace but what is others'; none set gives an empty map.
core::Result<core::OptionTexts> read_parameters(const ros::NodeHandle& private_handle);

/// Parameters of a nodelet: the options of the core and its own, whose keys are at top level ("map_frame").
template <class Own>
struct NodeletParameters {
  core::Options options;
  Own own;
};

/// Strict, as core::make_options.
template <class Own>
core::Result<NodeletParameters<Own>> make_nodelet_parameters(core::OptionTexts texts) {
  core::OptionTexts own_texts;
  for (const core::OptionRow& row : core::list_options<Own>()) {
    if (auto text = texts.extract(row.key)) own_texts.insert(std::move(text));
  }
  core::Result<core::Options> options = core::make_options<core::Options>(texts);
  if (!options) return options.error();
  core::Result<Own> own = core::make_options<Own>(own_texts);
  if (!own) return own.error();
  return NodeletParameters<Own>{*std::move(options), *std::move(own)};
}

}  // namespace semantic_topo_loop
