#include "ros/player_source.h"

#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

/// Half a second of colour and depth images, 32 MB.
constexpr std::size_t kItemsAhead = 15;

}  // namespace

std::optional<PlayerItem> FileStamps::next(std::string* /*error*/) {
  if (index_ == trajectory_.size()) return std::nullopt;
  PlayerItem item;
  item.camera_info = camera_info_;
  item.camera_info.header.stamp = to_ros_time(trajectory_[index_++].stamp_ns);
  return item;
}

ReadAheadSource::ReadAheadSource(std::unique_ptr<PlayerSource> source)
    : source_(std::move(source)),
      size_(source_->size()),
      items_([this] { return source_->next(&fault_); }, kItemsAhead) {}

std::optional<PlayerItem> ReadAheadSource::next(std::string* error) {
  std::optional<PlayerItem> item = items_.next();
  if (!item && !fault_.empty() && error != nullptr) *error = fault_;
  return item;
}

}  // namespace semantic_topo_loop
