#include "ros/tum_bag_reader.h"

#include <utility>

#include "ros/rgbd_conversion.h"
#include "ros/tum_bag_source.h"

namespace semantic_topo_loop {
namespace {

class TumBagReader : public core::RgbdReader {
 public:
  TumBagReader(std::unique_ptr<TumBagSource> source, const core::Camera& camera, core::DepthOptions options)
      : source_(std::move(source)), camera_(camera), options_(std::move(options)) {}

  std::optional<core::RgbdReading> next(std::string* fault) override {
    const std::optional<PlayerItem> item = source_->next(fault);
    if (!item) return std::nullopt;
    core::RgbdReading reading;
    if (!item->left_out.empty()) {
      reading.left_out = item->left_out;
      reading.error = item->detail;
    } else {
      reading.image = make_rgbd_image(*item->color, *item->depth, camera_, options_, &reading.error);
    }
    return reading;
  }
  std::size_t total() const override { return source_->size(); }

 private:
  std::unique_ptr<TumBagSource> source_;
  core::Camera camera_;
  core::DepthOptions options_;
};

}  // namespace

std::unique_ptr<core::RgbdReader> open_tum_bag(const std::string& file, const core::Camera& camera,
                                               const core::DepthOptions& options, std::string* error) {
  TumBagPlayback playback;
  playback.file = file;
  playback.with_images = true;
  std::unique_ptr<TumBagSource> source = TumBagSource::open(playback, std::nullopt, error);
  if (!source) return nullptr;
  return std::make_unique<TumBagReader>(std::move(source), camera, options);
}

}  // namespace semantic_topo_loop
