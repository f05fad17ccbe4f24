#pragma once

#include <string>
#include <vector>

#include "ros/stage.h"

namespace semantic_topo_loop {

/// What the player plays, and how.
struct PlayerParameters : StageParameters {
  std::string mode = "files";
  std::string trajectory_file, camera_file, bag_file;
  std::string camera_frame = "camera_optical_frame";
  std::string stamps = "image";
  bool images = false;
  double max_depth_delay_s = 0.02;
  std::string mocap_tf = "drop";
  std::string odom_frame = "odom";
  double max_pose_gap_s = 0.1;
  bool lockstep = true;
  int credit = 1;
  double rate = 1.0;
  std::string stages = "DetectionIngestion ObjectAssociation QuadricMapping LoopDetection PoseGraph";
  bool await_results = false;
  double startup_timeout_s = 30.0;
  double stall_timeout_s = 20.0;

  template <class Visitor>
  void visit(Visitor& visitor) {
    StageParameters::visit(visitor);
    visitor("mode", mode, "what is played: files, or bag (in the layout of the TUM RGB-D bags)");
    visitor("trajectory_file", trajectory_file, "files: a TUM trajectory, whose stamps are played");
    visitor("camera_file", camera_file, "calibration to publish; bag: empty for the recorded camera_info");
    visitor("camera_frame", camera_frame, "files: tf frame of the camera's optical frame");
    visitor("bag_file", bag_file, "bag: what is played");
    visitor("stamps", stamps, "bag: which stamps are played, image or camera_info");
    visitor("images", images, "bag: play the colour and depth images too, for RgbdFrontend; left out without depth");
    visitor("max_depth_delay_s", max_depth_delay_s, "bag, images: depth farther from colour in stamp is none of it");
    visitor("mocap_tf", mocap_tf, "bag: drop the motion capture's transform, or odom to take it as the odometry");
    visitor("odom_frame", odom_frame, "bag: parent of the motion capture's transform if mocap_tf is odom");
    visitor("max_pose_gap_s", max_pose_gap_s, "bag: transforms go at least this long ahead of the images");
    visitor("lockstep", lockstep, "play as fast as the stages can, and let them drop nothing");
    visitor("credit", credit, "lockstep: images on their way at a time; 1 gives the offline program's bytes");
    visitor("rate", rate, "without lockstep: 1 is real time");
    visitor("stages", stages, "stages that must be there before the first image, separated by blanks");
    visitor("await_results", await_results, "end only when the recorder has written its files");
    visitor("startup_timeout_s", startup_timeout_s, "how long the stages may take to come up");
    visitor("stall_timeout_s", stall_timeout_s, "how long an image may take through the chain");
  }
  bool is_valid(std::string* error) const;
  std::vector<std::string> stage_names() const;
};

}  // namespace semantic_topo_loop
