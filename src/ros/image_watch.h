#pragma once

#include <string>

namespace semantic_topo_loop {

/// Notices when no image comes, or images that give no frame. It counts its ticks in place of time: while the thread
/// that it is on is busy, nothing can be heard. Not thread-safe.
class ImageWatch {
 public:
  static constexpr double kPeriodS = 1.0;  ///< of `tick`, wall time
  static constexpr int kPatience = 5;      ///< ticks

  void hear_image() { has_image_ = true; }
  /// An image has given a frame.
  void hear_frame() { has_frame_ = true; }
  /// An image has given none. @param why for the warning
  void hear_failure(const std::string& why) {
    has_image_ = true;
    failure_ = why;
    has_failure_ = true;
  }
  /// @param awaited topic on which an image should have come; empty: none   @return what is wrong now; empty: nothing
  std::string tick(const std::string& awaited) {
    quiet_ = has_image_ || awaited.empty() ? 0 : quiet_ + 1;
    fruitless_ = has_frame_ ? 0 : fruitless_ + (has_failure_ ? 1 : 0);
    has_image_ = has_frame_ = has_failure_ = false;
    if (quiet_ >= kPatience) {
      fruitless_ = 0;
      return "no image for " + std::to_string(kPatience) + " s: nothing on '" + awaited + "'";
    }
    return fruitless_ >= kPatience ? "images, but no frame for " + std::to_string(kPatience) + " s: " + failure_ : "";
  }

 private:
  bool has_image_ = false, has_frame_ = false, has_failure_ = false;  ///< since the last tick
  std::string failure_;                                               ///< of the last image that gave no frame
  int quiet_ = 0;      ///< ticks since an image came, or none was awaited
  int fruitless_ = 0;  ///< ticks with such images since one gave a frame
};

}  // namespace semantic_topo_loop
