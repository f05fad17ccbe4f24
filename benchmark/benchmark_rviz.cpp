// Frames per second of rviz with one of the package's rviz files on a synthetic map, while the view turns and the
// messages come anew each second. benchmark/rviz_frame_rate starts it with what it needs.
#include <OgreFrameListener.h>
#include <OgreRoot.h>
#include <nav_msgs/Path.h>
#include <rviz/properties/property_tree_model.h>
#include <rviz/view_controller.h>
#include <rviz/view_manager.h>
#include <rviz/yaml_config_reader.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include "../test/support/rviz_host.h"
#include "ros/conversions.h"
#include "ros/markers.h"
#include "semantic_topo_loop/LoopMap.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/ros/messages.h"

namespace semantic_topo_loop {
namespace {

constexpr std::int64_t kObjects = 500, kKeyframes = 5000, kLoops = 2000;
constexpr std::size_t kMatches = 8;  // of a loop

struct FrameCounter : Ogre::FrameListener {
  bool frameEnded(const Ogre::FrameEvent& /*event*/) override {
    ++frames;
    return true;
  }

  int frames = 0;
};

/// Rooms of 5 m with objects, which a camera passes in rounds, z up: in each round after the first it closes loops.
class SyntheticMap {
 public:
  SyntheticMap() {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    core::MapUpdate update;
    update.map_version = 1;
    for (std::int64_t id = 0; id < kObjects; ++id) {
      core::Landmark& landmark = update.changed.emplace_back();
      landmark.id = id;
      landmark.class_id = 24 + static_cast<int>(id % 56);  // COCO's indoor classes
      landmark.state = core::LandmarkState::kConfirmed;
      landmark.observations = 50;
      landmark.quality = uniform(random);
      const core::Vec3 place(kSide_m * uniform(random), kSide_m * uniform(random), uniform(random));
      const core::Vec3 axes(0.1 + 0.3 * uniform(random), 0.1 + 0.3 * uniform(random), 0.1 + 0.3 * uniform(random));
      landmark.ellipsoid = core::Ellipsoid{core::SE3(core::Quaternion::Identity(), place), axes};
    }
    view_.apply(update);
    map_.map_version = 1;
    map_.changed = update.changed;
    core::MapCorrection correction;
    correction.changed = true;
    correction.valid_to_keyframe_id = kKeyframes;
    for (std::int64_t id = 0; id < kKeyframes; ++id) {
      core::KeyframePose& pose = correction.keyframes.emplace_back();
      pose.keyframe_id = id;
      pose.T_map_camera = pose_of(id);
      core::SE3 T_odom_camera = pose.T_map_camera;
      T_odom_camera.t += 2e-4 * static_cast<double>(id) * core::Vec3::UnitX();
      view_.add_keyframe(id, T_odom_camera);
      odometry_.push_back(T_odom_camera.t);
      corrected_.push_back(pose.T_map_camera.t);
    }
    view_.apply(correction);
    std::vector<core::LoopClosure> loops(kLoops);
    for (std::int64_t i = 0; i < kLoops; ++i) {
      core::LoopClosure& loop = loops[static_cast<std::size_t>(i)];
      loop.query_keyframe_id = kRound + i * (kKeyframes - kRound) / kLoops;
      loop.match_keyframe_id = loop.query_keyframe_id % kRound;
      loop.accepted = true;
      const core::Vec3 place = pose_of(loop.query_keyframe_id).t;
      std::vector<std::pair<double, std::int64_t>> nearest;
      for (const core::Landmark& landmark : map_.changed) {
        nearest.emplace_back((landmark.ellipsoid->center() - place).norm(), landmark.id);
      }
      std::sort(nearest.begin(), nearest.end());
      for (std::size_t k = 0; k < kMatches; ++k) loop.matches.push_back({nearest[k].second, nearest[k].second});
    }
    view_.add_loops(loops);
    core::Frame frame;
    frame.camera = {500.0, 500.0, 320.0, 240.0, 640, 480, {}};
    frame.T_odom_camera.t = odometry_.back();
    view_.set_frame(frame);
  }

  const MapView& view() const { return view_; }
  const FullMap& map() const { return map_; }
  const std::vector<core::Vec3>& odometry() const { return odometry_; }
  const std::vector<core::Vec3>& corrected() const { return corrected_; }

 private:
  static constexpr double kSide_m = 40.0;
  static constexpr std::int64_t kRound = 1000;  // keyframes

  /// Up and down through the rooms, a little beside the last round.
  static core::SE3 pose_of(std::int64_t id) {
    const double way = static_cast<double>(id % kRound) / static_cast<double>(kRound);
    const double beside_m = 0.7 * static_cast<double>(id / kRound);
    core::Mat3 R;
    R << 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0;
    return {R, core::Vec3(kSide_m * way + beside_m, 0.5 * kSide_m * (1.0 + std::sin(8.0 * core::kPi * way)), 1.5)};
  }

  MapView view_;
  FullMap map_;
  std::vector<core::Vec3> odometry_, corrected_;
};

nav_msgs::PathPtr make_path(const std::vector<core::Vec3>& places, const std_msgs::Header& header) {
  auto path = boost::make_shared<nav_msgs::Path>();
  path->header = header;
  for (const core::Vec3& place : places) {
    geometry_msgs::PoseStamped& pose = path->poses.emplace_back();
    pose.header = header;
    pose.pose = to_msg(core::SE3(core::Quaternion::Identity(), place));
  }
  return path;
}

/// Says on every topic of the rviz files what the stages would.
class Speaker {
 public:
  explicit Speaker(core::ClassTable classes) : classes_(std::move(classes)) {}

  void speak() {
    const std_msgs::Header header = make_header(ros::Time::now(), "map");
    map_.publish(boost::make_shared<MapMessage>(header, 1, synthetic_.map()));
    loops_.publish(make_loop_map(synthetic_.view(), header, 1));
    quadric_markers_.publish(make_quadric_markers(synthetic_.view(), header));
    label_markers_.publish(make_label_markers(synthetic_.view(), header, classes_, {}));
    loop_markers_.publish(make_loop_markers(synthetic_.view(), header, {}));
    keyframe_markers_.publish(make_keyframe_markers(synthetic_.view(), header, {}));
    odometry_.publish(make_path(synthetic_.odometry(), header));
    corrected_.publish(make_path(synthetic_.corrected(), header));
  }

 private:
  core::ClassTable classes_;
  SyntheticMap synthetic_;
  ros::NodeHandle node_;
  ros::Publisher map_ = node_.advertise<MapMessage>("quadric_map", 1);
  ros::Publisher loops_ = node_.advertise<LoopMap>("loop_map", 1);
  ros::Publisher quadric_markers_ = node_.advertise<visualization_msgs::MarkerArray>("markers/quadrics", 1);
  ros::Publisher label_markers_ = node_.advertise<visualization_msgs::MarkerArray>("markers/labels", 1);
  ros::Publisher loop_markers_ = node_.advertise<visualization_msgs::MarkerArray>("markers/loops", 1);
  ros::Publisher keyframe_markers_ = node_.advertise<visualization_msgs::MarkerArray>("markers/keyframes", 1);
  ros::Publisher odometry_ = node_.advertise<nav_msgs::Path>("path_odometry", 1);
  ros::Publisher corrected_ = node_.advertise<nav_msgs::Path>("path_corrected", 1);
};

/// Of this process on all processors, s.
double processor_time() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  constexpr double kMicro = 1e-6;
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         kMicro * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

void set_view(rviz::VisualizationManager* manager) {
  rviz::Property* view = manager->getViewManager()->getCurrent();
  view->subProp("Distance")->setValue(45.0);
  view->subProp("Pitch")->setValue(0.7);
  view->subProp("Focal Point")->subProp("X")->setValue(20.0);
  view->subProp("Focal Point")->subProp("Y")->setValue(20.0);
  rviz::Property* options = manager->getDisplayTreeModel()->getRoot()->subProp("Global Options");
  options->subProp("Frame Rate")->setValue(1000);  // as many as there can be
}

int run(const std::string& rviz_file, double seconds, const std::string& picture) {
  const auto classes = core::read_class_table(STL_CONFIG_DIR "/classes_coco.yaml");
  rviz::Config config;
  rviz::YamlConfigReader reader;
  reader.readFile(config, QString::fromStdString(rviz_file));
  if (!classes || reader.error()) {
    std::fprintf(stderr, "benchmark_rviz: %s\n",
                 classes ? reader.errorMessage().toStdString().c_str() : classes.message().c_str());
    return 1;
  }
  constexpr int kWidth = 1280, kHeight = 720;
  RvizHost host(kWidth, kHeight);
  host.manager().load(config.mapGetChild("Visualization Manager"));
  host.manager().setFixedFrame("map");
  set_view(&host.manager());
  Speaker speaker(*classes);
  FrameCounter counter;
  Ogre::Root::getSingleton().addFrameListener(&counter);
  rviz::Property* yaw = host.manager().getViewManager()->getCurrent()->subProp("Yaw");
  constexpr double kWarmUp_s = 5.0, kTurn_s = 20.0;
  const double begin = ros::WallTime::now().toSec();
  double next_message = begin, now = begin;
  int counted_before = 0;
  double worked_before = 0.0;
  while (now < begin + kWarmUp_s + seconds) {
    if (now >= next_message) {
      speaker.speak();
      next_message = now + 1.0;
    }
    if (now < begin + kWarmUp_s) {
      counted_before = counter.frames;
      worked_before = processor_time();
    }
    yaw->setValue(2.0 * core::kPi * (now - begin) / kTurn_s);
    QApplication::processEvents();
    now = ros::WallTime::now().toSec();
  }
  Ogre::Root::getSingleton().removeFrameListener(&counter);
  const int frames = counter.frames - counted_before;
  const double worked_ms = 1e3 * (processor_time() - worked_before);
  std::printf("%s: %.1f frames/s, %.0f ms of a processor a frame\n", rviz_file.c_str(), frames / seconds,
              worked_ms / std::max(1, frames));
  if (!picture.empty()) host.panel().getRenderWindow()->writeContentsToFile(picture);
  return 0;
}

}  // namespace
}  // namespace semantic_topo_loop

int main(int argc, char** argv) {
  ros::init(argc, argv, "benchmark_rviz", ros::init_options::AnonymousName);
  const QApplication application(argc, argv);
  if (argc < 3) {
    std::fprintf(stderr, "usage: benchmark_rviz FILE.rviz SECONDS [PICTURE.png]\n");
    return 2;
  }
  return semantic_topo_loop::run(argv[1], std::stod(argv[2]), argc > 3 ? argv[3] : "");
}
