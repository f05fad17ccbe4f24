#pragma once

#include <OgreMaterial.h>
#include <rviz/properties/bool_property.h>
#include <rviz/properties/color_property.h>
#include <rviz/properties/float_property.h>

#include <cstdint>
#include <map>
#include <memory>

#include "rviz_plugin/map_display.h"
#include "semantic_topo_loop/LoopMap.h"

namespace Ogre {
class ManualObject;
}
namespace rviz {
class BillboardLine;
}

namespace semantic_topo_loop {

/// The loops of a LoopMap: a line between their cameras, thin ones to the objects that both have seen, and if wanted
/// the refused candidates, coloured by reason.
class LoopClosuresDisplay : public MapDisplay<LoopMap> {
 public:
  LoopClosuresDisplay();
  ~LoopClosuresDisplay() override;

 protected:
  void onInitialize() override;
  void draw(const LoopMap* message) override;

 private:
  rviz::FloatProperty* line_width_;
  rviz::FloatProperty* alpha_;
  rviz::BoolProperty* distinct_;
  rviz::ColorProperty* kept_colour_;
  rviz::ColorProperty* rejected_colour_;
  rviz::BoolProperty* objects_;
  rviz::ColorProperty* objects_colour_;
  rviz::FloatProperty* objects_alpha_;
  rviz::BoolProperty* refused_;
  std::map<std::uint8_t, rviz::ColorProperty*> refused_colours_;  ///< by reason
  std::unique_ptr<rviz::BillboardLine> loops_;
  Ogre::ManualObject* thin_lines_ = nullptr;
  Ogre::MaterialPtr thin_material_;
};

}  // namespace semantic_topo_loop
