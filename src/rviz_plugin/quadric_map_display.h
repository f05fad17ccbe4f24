#pragma once

#include <OgreMaterial.h>
#include <rviz/properties/bool_property.h>
#include <rviz/properties/color_property.h>
#include <rviz/properties/enum_property.h>
#include <rviz/properties/float_property.h>
#include <rviz/properties/int_property.h>
#include <rviz/properties/string_property.h>

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "rviz_plugin/map_display.h"
#include "semantic_topo_loop/ros/messages.h"
#include "semantic_topo_loop/types/class_table.h"

namespace Ogre {
class Camera;
}

namespace semantic_topo_loop {

class MapObject;

/// The objects of a QuadricMap as lit ellipsoids with the names of their classes; a selected one tells its figures.
class QuadricMapDisplay : public MapDisplay<MapMessage> {
 public:
  QuadricMapDisplay();
  ~QuadricMapDisplay() override;

  void reset() override;
  void update(float wall_dt, float ros_dt) override;

 protected:
  void onInitialize() override;
  void draw(const MapMessage* message) override;
  bool has_upright() const override { return true; }

 private:
  enum ColourBy { kClass = 0, kState = 1, kQuality = 2 };

  /// Reads the class table if it is another one than it was.
  void update_classes();
  bool is_shown(const core::Landmark& landmark) const;
  Ogre::ColourValue colour(const core::Landmark& landmark) const;
  /// One for all objects of a colour.
  const Ogre::MaterialPtr& material(const Ogre::ColourValue& colour);
  QString label(const core::Landmark& landmark) const;
  /// Draws each object as finely as the view shows.
  void set_details(const Ogre::Camera& camera);
  /// Of labels that cover each other in the view the nearest stays; none does of which no letter can be read.
  void choose_labels(const Ogre::Camera& camera);

  rviz::EnumProperty* colour_by_;
  rviz::FloatProperty* alpha_;
  rviz::BoolProperty* candidates_;
  rviz::BoolProperty* retired_;
  rviz::IntProperty* min_observations_;
  rviz::BoolProperty* labels_;
  rviz::BoolProperty* label_ids_;
  rviz::BoolProperty* labels_apart_;
  rviz::FloatProperty* label_size_;
  rviz::ColorProperty* label_colour_;
  rviz::StringProperty* class_table_;
  std::optional<std::string> class_file_;  ///< empty: COCO
  core::ClassTable classes_;
  std::map<std::uint32_t, Ogre::MaterialPtr> materials_;  ///< by colour
  std::map<std::int64_t, std::unique_ptr<MapObject>> objects_;
};

}  // namespace semantic_topo_loop
