#pragma once

#include <diagnostic_msgs/DiagnosticArray.h>
#include <gtest/gtest.h>
#include <nodelet/loader.h>
#include <ros/ros.h>
#include <std_msgs/String.h>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>

#include "semantic_topo_loop/io/yaml_files.h"
#include "support/test_files.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop {

/// @return whether it is so, at the latest after the time
inline bool wait_until(const std::function<bool()>& is_so, double timeout_s = 30.0) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(timeout_s);
  while (!is_so() && std::chrono::steady_clock::now() < deadline) {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return is_so();
}

/// The last word of each stage on /diagnostics.
class Diagnostics {
 public:
  Diagnostics() { subscriber_ = node_.subscribe("/diagnostics", 100, &Diagnostics::take, this); }
  ~Diagnostics() { subscriber_.shutdown(); }

  std::map<std::string, std::string> of(const std::string& stage) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return values_[stage];
  }
  std::uint64_t count(const std::string& stage, const std::string& key) {
    const auto values = of(stage);
    const auto found = values.find(key);
    return found == values.end() ? 0 : std::stoull(found->second);
  }
  /// Of all stages, of all causes that begin so.
  std::uint64_t sum(const std::string& begin) {
    const std::lock_guard<std::mutex> lock(mutex_);
    std::uint64_t sum = 0;
    for (const auto& [stage, values] : values_) {
      for (const auto& [key, value] : values) sum += key.rfind(begin, 0) == 0 ? std::stoull(value) : 0;
    }
    return sum;
  }
  int reports() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return reports_;
  }

 private:
  void take(const diagnostic_msgs::DiagnosticArray::ConstPtr& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++reports_;
    for (const diagnostic_msgs::DiagnosticStatus& status : message->status) {
      auto& values = values_[status.name.substr(status.name.rfind(' ') + 1)];
      values.clear();
      values["summary"] = status.message;
      for (const diagnostic_msgs::KeyValue& value : status.values) values[value.key] = value.value;
    }
  }

  ros::NodeHandle node_;
  ros::Subscriber subscriber_;
  std::mutex mutex_;  ///< guards both below
  std::map<std::string, std::map<std::string, std::string>> values_;
  int reports_ = 0;
};

/// Simulates a sequence into a directory, as the simulate program does.
inline void write_simulation(const std::map<std::string, std::string>& options, const std::string& directory) {
  const auto parsed = core::make_options<core::SimulationOptions>(options);
  ASSERT_TRUE(parsed) << parsed.message();
  const auto camera = core::read_camera(STL_CONFIG_DIR "/camera/tum_fr2.yaml");
  ASSERT_TRUE(camera) << camera.message();
  const auto classes = core::read_class_table(STL_CONFIG_DIR "/classes_coco.yaml");
  ASSERT_TRUE(classes) << classes.message();
  const auto sequence = core::simulate(*parsed, *camera, *classes);
  ASSERT_TRUE(sequence) << sequence.message();
  ASSERT_EQ(core::write_sequence(*sequence, *classes, directory).message(), "");
}

/// The whole chain in this process, which plays the nodelet manager, so that a test sees what the stages exchange.
class InProcessChain {
 public:
  using Remappings = std::map<std::string, std::string>;

  InProcessChain() : loader_(false) {
    status_ = node_.subscribe<std_msgs::String>("player_status", 10, &InProcessChain::take_status, this);
  }

  template <class Value>
  void set(const std::string& nodelet, const std::string& key, const Value& value) {
    ros::param::set("/" + nodelet + "/" + key, value);
  }
  /// Everything but the player, on the files of a simulation.
  void load_stages(const std::string& data, const std::string& output, const Remappings& mapping_remappings = {}) {
    configure(data, output);
    load("recorder", "Recorder", {});
    load("pose_graph", "PoseGraph", {});
    load("loop_detection", "LoopDetection", {});
    load("quadric_mapping", "QuadricMapping", mapping_remappings);
    load("object_association", "ObjectAssociation", {});
    load("detection_ingestion", "DetectionIngestion", {});
    load("pose_frontend", "PoseFrontend", {});
  }
  /// The parameters of the stages, on the files of a simulation.
  void configure(const std::string& data, const std::string& output) {
    set("pose_frontend", "pose_source", "file");
    set("pose_frontend", "trajectory_file", data + "/odometry.txt");
    set("detection_ingestion", "source", "file");
    set("detection_ingestion", "detections_file", data + "/detections.json");
    set("recorder", "output_dir", output);
  }
  /// Who only looks on.
  void load_viewers() {
    set("visualization", "rate_hz", 50.0);
    load("visualization", "Visualization", {});
    load("point_mapping", "PointMapping", {});
  }
  /// The pose graph and the map that follows it; the test plays the other stages.
  void load_correction() {
    load("pose_graph", "PoseGraph", {});
    load("quadric_mapping", "QuadricMapping", {});
  }
  /// The points of the map alone; the test plays the front end and the pose graph.
  void load_point_mapping(double rate_hz, const std::string& save_dir) {
    set("point_mapping", "rate_hz", rate_hz);
    set("point_mapping", "save_dir", save_dir);
    load("point_mapping", "PointMapping", {});
  }
  void load_player(const std::string& data, bool lockstep) {
    configure_player(data, lockstep);
    load("player", "Player", {});
  }
  void configure_player(const std::string& data, bool lockstep) {
    set("player", "mode", "files");
    set("player", "trajectory_file", data + "/odometry.txt");
    set("player", "camera_file", data + "/camera.yaml");
    set("player", "lockstep", lockstep);
    set("player", "await_results", true);
    set("player", "stages", "DetectionIngestion ObjectAssociation QuadricMapping LoopDetection PoseGraph Recorder");
  }
  void load(const std::string& name, const std::string& type, const Remappings& remappings = {}) {
    Remappings resolved;
    if (type != "Player" && !ros::param::has("/" + name + "/class_table")) {
      set(name, "class_table", STL_CONFIG_DIR "/classes_coco.yaml");
    }
    for (const auto& [from, to] : remappings) resolved[ros::names::resolve(from)] = ros::names::resolve(to);
    ASSERT_TRUE(loader_.load("/" + name, "semantic_topo_loop/" + type, resolved, {})) << name;
  }
  void unload(const std::string& name) { ASSERT_TRUE(loader_.unload("/" + name)) << name; }
  void unload_all() { loader_.clear(); }

  /// What the player said at its end; empty if it did not end in time.
  std::string wait_for_end(double timeout_s) {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait_for(lock, std::chrono::duration<double>(timeout_s), [this] { return !end_.empty(); });
    return end_;
  }

 private:
  void take_status(const std_msgs::String::ConstPtr& status) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (status->data != "playing") end_ = status->data;
    changed_.notify_all();
  }

  ros::NodeHandle node_;
  nodelet::Loader loader_;
  ros::Subscriber status_;
  std::mutex mutex_;  ///< guards end_
  std::condition_variable changed_;
  std::string end_;
};

}  // namespace semantic_topo_loop
