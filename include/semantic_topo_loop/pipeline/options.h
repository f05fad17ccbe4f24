#pragma once

#include "semantic_topo_loop/association/associator_options.h"
#include "semantic_topo_loop/frontend/frontend_options.h"
#include "semantic_topo_loop/frontend/object_detector.h"
#include "semantic_topo_loop/frontend/rgbd_image.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/map/point_map.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"
#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

/// Every parameter of the core, one struct a module. The defaults are the package's one configuration.
struct Options {
  DepthOptions depth;
  FrontendOptions frontend;
  ObjectDetectorOptions detector;
  KeyframeOptions keyframe;
  AssociatorOptions association;
  QuadricMapperOptions mapping;
  PointMapOptions point_map;
  LoopOptions loop;
  PoseGraphOptions pose_graph;

  void visit(OptionVisitor& visitor) {
    depth.visit(visitor);
    frontend.visit(visitor);
    detector.visit(visitor);
    keyframe.visit(visitor);
    association.visit(visitor);
    mapping.visit(visitor);
    point_map.visit(visitor);
    loop.visit(visitor);
    pose_graph.visit(visitor);
  }
};

}  // namespace semantic_topo_loop::core
