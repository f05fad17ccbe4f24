#include "rviz_plugin/loop_closures_display.h"

#include <OgreManualObject.h>
#include <OgreSceneManager.h>
#include <rviz/ogre_helpers/billboard_line.h>

#include <pluginlib/class_list_macros.hpp>
#include <string>
#include <utility>
#include <vector>

#include "ros/map_view.h"
#include "semantic_topo_loop/LoopClosure.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop {
namespace {

core::Vec3 from_point(const geometry_msgs::Point& point) { return {point.x, point.y, point.z}; }

/// Loops between two cameras in one colour.
struct Line {
  core::Vec3 from, to;
  Ogre::ColourValue colour;
};

Ogre::ColourValue with_alpha(Ogre::ColourValue colour, float alpha) {
  colour.a = alpha;
  return colour;
}

}  // namespace

LoopClosuresDisplay::LoopClosuresDisplay() : MapDisplay("loop_map") {
  const auto make_alpha = [this](const char* description, float alpha, rviz::Property* parent) {
    auto* property = new rviz::FloatProperty("Alpha", alpha, description, parent);
    property->setMin(0.0F);
    property->setMax(1.0F);
    redraw_on_change(property);
    return property;
  };
  line_width_ = new rviz::FloatProperty("Line width", 0.008F, "Of the lines between cameras, m.", this);
  line_width_->setMin(0.0001F);
  alpha_ = make_alpha("Of the lines between cameras.", 0.7F, this);
  distinct_ = new rviz::BoolProperty("Only distinct", true, "Of loops whose ends lie together draw one.", this);
  kept_colour_ = new rviz::ColorProperty("Kept", QColor(60, 230, 90), "Loops that the optimiser believes.", this);
  rejected_colour_ =
      new rviz::ColorProperty("Rejected", QColor(255, 50, 50), "Loops that the optimiser does not believe.", this);
  objects_ = new rviz::BoolProperty("Objects", true, "Join both cameras to the objects that matched.", this);
  objects_colour_ = new rviz::ColorProperty("Color", QColor(120, 200, 255), "Of the lines to objects.", objects_);
  objects_alpha_ = make_alpha("Of the lines to objects.", 0.25F, objects_);
  refused_ = new rviz::BoolProperty("Refused candidates", false, "Draw candidates that verification refused.", this);
  constexpr std::uint8_t kReasons = LoopClosure::REASON_FOUND_BY_SOURCE;  // the last one, which refuses nothing
  for (std::uint8_t reason = LoopClosure::REASON_ACCEPTED + 1; reason < kReasons; ++reason) {
    constexpr int kHueStep = 47;  // neighbours in number far apart in hue
    const QColor colour = QColor::fromHsv(reason * kHueStep % 360, 200, 230);
    const char* name = core::to_string(static_cast<core::LoopReason>(reason));
    auto* property = new rviz::ColorProperty(name, colour, "Candidates refused for this reason.", refused_);
    refused_colours_[reason] = property;
    redraw_on_change(property);
  }
  for (rviz::Property* property : std::initializer_list<rviz::Property*>{
           line_width_, distinct_, kept_colour_, rejected_colour_, objects_, objects_colour_, refused_}) {
    redraw_on_change(property);
  }
}

LoopClosuresDisplay::~LoopClosuresDisplay() {
  if (thin_lines_ == nullptr) return;
  scene_manager_->destroyManualObject(thin_lines_);
  Ogre::MaterialManager::getSingleton().remove(thin_material_->getHandle());
}

void LoopClosuresDisplay::onInitialize() {
  thin_material_ = make_material();
  thin_material_->setReceiveShadows(false);
  thin_material_->setLightingEnabled(false);
  thin_material_->setSceneBlending(Ogre::SBT_TRANSPARENT_ALPHA);
  thin_material_->setDepthWriteEnabled(false);
  thin_lines_ = scene_manager_->createManualObject();
  scene_node_->attachObject(thin_lines_);
}

void LoopClosuresDisplay::draw(const LoopMap* message) {
  loops_.reset();
  thin_lines_->clear();
  if (message == nullptr) return;
  std::vector<Line> loops, thin;
  DistinctLoops distinct_kept, distinct_rejected;
  std::size_t kept = 0, rejected = 0, refused = 0;
  for (const LoopPlace& loop : message->loops) {
    const core::Vec3 query = from_point(loop.query), match = from_point(loop.match);
    if (loop.reason != LoopClosure::REASON_ACCEPTED) {
      ++refused;
      const auto property = refused_colours_.find(loop.reason);
      if (!refused_->getBool() || property == refused_colours_.end()) continue;
      thin.push_back({query, match, with_alpha(property->second->getOgreColor(), alpha_->getFloat())});
      continue;
    }
    ++(loop.kept ? kept : rejected);
    if (distinct_->getBool() && !(loop.kept ? distinct_kept : distinct_rejected).add(query, match)) continue;
    const rviz::ColorProperty* colour = loop.kept ? kept_colour_ : rejected_colour_;
    loops.push_back({query, match, with_alpha(colour->getOgreColor(), alpha_->getFloat())});
    if (!objects_->getBool()) continue;
    for (const geometry_msgs::Point& object : loop.objects) {
      const Ogre::ColourValue object_colour = with_alpha(objects_colour_->getOgreColor(), objects_alpha_->getFloat());
      thin.push_back({query, from_point(object), object_colour});
      thin.push_back({match, from_point(object), object_colour});
    }
  }
  if (!loops.empty()) {
    loops_ = std::make_unique<rviz::BillboardLine>(scene_manager_, scene_node_);
    loops_->setMaxPointsPerLine(2);
    loops_->setNumLines(static_cast<std::uint32_t>(loops.size()));
    loops_->setLineWidth(line_width_->getFloat());
    // The points bring their own colours, which alone would not make rviz blend.
    loops_->setColor(1.0F, 1.0F, 1.0F, alpha_->getFloat());
    for (std::size_t i = 0; i < loops.size(); ++i) {
      if (i > 0) loops_->newLine();
      loops_->addPoint(to_ogre(loops[i].from), loops[i].colour);
      loops_->addPoint(to_ogre(loops[i].to), loops[i].colour);
    }
  }
  if (!thin.empty()) {
    thin_lines_->estimateVertexCount(2 * thin.size());
    thin_lines_->begin(thin_material_->getName(), Ogre::RenderOperation::OT_LINE_LIST, resource_group());
    for (const Line& line : thin) {
      for (const core::Vec3& end : {line.from, line.to}) {
        thin_lines_->position(to_ogre(end));
        thin_lines_->colour(line.colour);
      }
    }
    thin_lines_->end();
  }
  setStatus(rviz::StatusProperty::Ok, "Loops",
            QString("%1 kept, %2 rejected by the optimiser, %3 refused").arg(kept).arg(rejected).arg(refused));
}

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::LoopClosuresDisplay, rviz::Display)
