#include "ros/tum_bag_reader.h"

#include <utility>

#include "ros/rgbd_conversion.h"
#include "ros/tum_bag_source.h"

namespace semantic_topo_loop {
namespace {

class TumBagReader : public core::RgbdRecording {
 public:
  TumBagReader(std::unique_ptr<TumBagSource> source, const core::Camera& camera, core::DepthOptions options)
      : source_(std::move(source)), camera_(camera), options_(std::move(options)) {}

  core::Result<std::optional<core::RgbdReading>> next() override {
    std::string problem;
    const std::optional<PlayerItem> item = source_->next(&problem);
    if (!item && !problem.empty()) return core::Error{problem};
    if (!item) return std::optional<core::RgbdReading>();
    if (!item->left_out.empty()) {
      return std::optional<core::RgbdReading>({core::Error{item->detail}, item->left_out});
    }
    std::optional<core::RgbdImage> image = make_rgbd_image(*item->color, *item->depth, camera_, options_, &problem);
    if (!image) return std::optional<core::RgbdReading>({core::Error{problem}, ""});
    return std::optional<core::RgbdReading>({std::move(*image), ""});
  }
  std::size_t total() const override { return source_->size(); }

 private:
  std::unique_ptr<TumBagSource> source_;
  core::Camera camera_;
  core::DepthOptions options_;
};

}  // namespace

std::unique_ptr<core::RgbdRecording> open_tum_bag(const std::string& file, const core::Camera& camera,
                                               const core::DepthOptions& options, std::string* error) {
  TumBagPlayback playback;
  playback.file = file;
  playback.with_images = true;
  std::unique_ptr<TumBagSource> source = TumBagSource::open(playback, std::nullopt, error);
  if (!source) return nullptr;
  return std::make_unique<TumBagReader>(std::move(source), camera, options);
}

}  // namespace semantic_topo_loop
