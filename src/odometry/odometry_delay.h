#pragma once

#include <string>

namespace semantic_topo_loop::core {

/// How late an odometry's poses are against the images: that of stamp t is where the camera was at t - delay. Clocks
/// are apart, drivers stamp what they have received, filters lag.
class OdometryDelay {
 public:
  /// Adds what a window tells.
  /// @param seconds the most likely delay by it alone   @param information 1/s^2, of what it has beside the last one
  /// @param elapsed_s since that
  void add(double seconds, double information, double elapsed_s);
  /// Negative: poses come early. 0 unless the delay is evident, and 250 ms at most.
  double seconds() const { return is_evident_ ? mean_s_ : 0.0; }
  /// The most likely one, evident or not, and its sigma.
  double likely_s() const { return mean_s_; }
  double sigma_s() const;

 private:
  double mean_s_ = 0.0, information_ = 0.0;  ///< the second in 1/s^2
  bool is_evident_ = false;
};

/// For whoever can set the clocks right; empty without a delay.
std::string describe_delay(double delay_s);

}  // namespace semantic_topo_loop::core
