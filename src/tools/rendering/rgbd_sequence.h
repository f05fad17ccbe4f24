#pragma once

#include <opencv2/core.hpp>
#include <string>

#include "semantic_topo_loop/types/class_table.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {

/// Pose of the depth camera in the color camera.
SE3 color_from_depth(const RenderingOptions& options);

/// Lets a directory, made if missing, be filled with a simulated sequence. If it has images, now or from before, its
/// `manifest.txt` says that they are simulated ones, of a sequence that is not whole yet; those from before go, and
/// sequence.bag with them.
/// @return an error if it holds another recording: images or lists of them without such a manifest, or what every
/// sequence has without the camera.yaml of a simulated one
Status begin_sequence(const std::string& directory, bool with_images);
/// Says what the directory's whole sequence was made from.
Status finish_sequence(const std::string& directory, const std::string& manifest);
/// Whether the directory holds what this manifest says.
bool has_rendered_sequence(const std::string& directory, const std::string& manifest);

/// Renders the images of a sequence into a directory, as the TUM benchmark lays them out: rgb/<stamp>.png (8 bit),
/// depth/<stamp>.png (16 bit), rgb.txt, depth.txt and associations.txt ("stamp rgb/.. stamp depth/.."). The sequence's
/// detections are made anew, from the shapes that are drawn. Frames are rendered on several threads and never kept; the
/// result does not depend on how many.
/// @return an error that names path and cause if a file cannot be written, or that of begin_sequence
Status render_sequence(const SimulationOptions& options, const ClassTable& classes, int threads,
                       const std::string& directory, SimulatedSequence* sequence);

/// Images that render_sequence wrote: CV_8UC3 as BGR, and CV_32FC1 in metres, NaN where there is no depth.
/// @return an error that names the path if the file is missing or no such image
Result<cv::Mat> read_rendered_color(const SimulatedSequence& sequence, const std::string& directory, std::size_t frame);
Result<cv::Mat> read_rendered_depth(const SimulatedSequence& sequence, const RenderingOptions& rendering,
                                    const std::string& directory, std::size_t frame);

/// What a directory of a simulated sequence is made from, for its `manifest.txt`.
/// @param class_table text of its file   @param outputs which files were asked for
std::string sequence_manifest(const SimulationOptions& options, const Camera& camera, const std::string& class_table,
                              const std::string& outputs);

}  // namespace semantic_topo_loop::core
