#pragma once

#include <OgreRenderWindow.h>
#include <ros/ros.h>
#include <rviz/display.h>
#include <rviz/render_panel.h>
#include <rviz/visualization_manager.h>

#include <QApplication>
#include <functional>

namespace semantic_topo_loop {

/// rviz's scene in a window of its own, without rviz's panels. Needs a QApplication, a display and a master.
class RvizHost {
 public:
  RvizHost(int width, int height) : manager_(&panel_) {
    panel_.resize(width, height);
    panel_.initialize(manager_.getSceneManager(), &manager_);
    manager_.initialize();
    panel_.show();
    manager_.startUpdate();
  }
  ~RvizHost() { manager_.removeAllDisplays(); }

  rviz::VisualizationManager& manager() { return manager_; }
  rviz::RenderPanel& panel() { return panel_; }

  /// Lets rviz run until something is the case. @return whether it was, in time
  static bool spin_until(const std::function<bool()>& is_so, double timeout_s) {
    const ros::WallTime deadline = ros::WallTime::now() + ros::WallDuration(timeout_s);
    while (!is_so()) {
      if (ros::WallTime::now() > deadline) return false;
      constexpr int kWait_ms = 5;
      QApplication::processEvents(QEventLoop::AllEvents, kWait_ms);
    }
    return true;
  }

 private:
  rviz::RenderPanel panel_;
  rviz::VisualizationManager manager_;
};

}  // namespace semantic_topo_loop
