#pragma once

#include <topic_tools/shape_shifter.h>

#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop {

/// What a detector publishes of an image, whichever type it has.
using DetectorMessage = topic_tools::ShapeShifter;

/// The boxes of an image, with the image's stamp: from our own DetectionArray and, where their packages were installed
/// when this was built, from vision_msgs/Detection2DArray and darknet_ros_msgs/BoundingBoxes. Boxes are not checked.
/// @param on_left_out hears of boxes whose class has no id, because the table does not have its name
/// @return an error that names the type if it is none of these or of another version, or if the message is cut short
core::Result<core::DetectionFrame> read_detector_message(const DetectorMessage& message,
                                                         const core::ClassTable& classes,
                                                         const core::OnLeftOut& on_left_out);

}  // namespace semantic_topo_loop
