// Another package's use of the core: ten frames of a camera that slides past a cup on a table.
#include <cstdio>
#include <memory>

#include "semantic_topo_loop/pipeline/object_slam.h"

namespace core = semantic_topo_loop::core;

int main() {
  constexpr int kCup = 41;
  core::ObjectClass cup;
  cup.id = kCup;
  cup.name = "cup";
  cup.size_prior_m = 0.1;
  const auto classes = core::ClassTable::create({cup});
  if (!classes) return std::fprintf(stderr, "%s\n", classes.message().c_str()), 1;

  core::ObjectSlam slam(core::Options(), std::make_shared<const core::ClassTable>(*classes));
  core::Frame frame;
  frame.camera.fx = frame.camera.fy = 500.0;
  frame.camera.cx = 320.0;
  frame.camera.cy = 240.0;
  frame.camera.width = 640;
  frame.camera.height = 480;
  for (int i = 0; i < 10; ++i) {
    const double x = 0.01 * i;
    frame.frame_id = frame.keyframe_id = i;
    frame.is_keyframe = true;
    frame.stamp_ns = 1'000'000'000 + i * 100'000'000;
    frame.T_odom_camera.t = {x, 0.0, 0.0};
    // The cup is 1 m ahead of the middle of the way, 0.1 m wide.
    const double u = 320.0 + 500.0 * (0.045 - x);
    core::Detection detection;
    detection.class_id = kCup;
    detection.score = 0.9;
    detection.box = {u - 25.0, 215.0, u + 25.0, 265.0};
    const std::vector<core::Detection> detections = {detection};
    const core::FrameResult result = slam.process(frame, &detections);
    if (result.associations.associations.size() != 1) return std::fprintf(stderr, "frame %d: no association\n", i), 1;
  }
  const auto landmarks = slam.mapper().landmarks();
  std::printf("%zu landmarks\n", landmarks.size());
  return landmarks.size() == 1 ? 0 : 1;
}
