#include "rviz_plugin/quadric_map_display.h"

#include <OgreCamera.h>
#include <OgreEntity.h>
#include <OgreManualObject.h>
#include <OgreMeshManager.h>
#include <OgreSceneManager.h>
#include <OgreSubEntity.h>
#include <OgreTechnique.h>
#include <OgreViewport.h>
#include <ros/package.h>
#include <rviz/ogre_helpers/movable_text.h>
#include <rviz/selection/selection_handler.h>
#include <rviz/view_controller.h>
#include <rviz/view_manager.h>

#include <QColor>
#include <algorithm>
#include <array>
#include <cmath>
#include <pluginlib/class_list_macros.hpp>
#include <string>
#include <utility>
#include <vector>

#include "ros/markers.h"
#include "semantic_topo_loop/io/yaml_files.h"

namespace semantic_topo_loop {
namespace {

constexpr int kMostSteps = 8;  // 512 triangles: round to the eye, a quarter of rviz's own sphere

/// The steps at which the outline of a sphere is off by about half a pixel at most.
/// @param radius_px of what is drawn, its longest semi-axis
int steps_of(float radius_px) {
  constexpr float kOutline = 0.7F, kOff_px = 0.5F;  // off by 0.7 / steps^2 radii where the edges are longest
  return static_cast<int>(std::clamp(std::ceil(std::sqrt(kOutline / kOff_px * radius_px)), 2.0F, 1.0F * kMostSteps));
}

std::string sphere_name(int steps) { return "semantic_topo_loop_sphere_" + std::to_string(steps); }

/// A unit sphere that ellipsoids share: an octahedron, each face divided into `steps` squared triangles.
void make_sphere(Ogre::SceneManager* scene, int steps) {
  if (Ogre::MeshManager::getSingleton().resourceExists(sphere_name(steps))) return;
  Ogre::ManualObject* sphere = scene->createManualObject();
  sphere->begin("BaseWhiteNoLighting", Ogre::RenderOperation::OT_TRIANGLE_LIST, resource_group());
  for (int octant = 0; octant < 8; ++octant) {
    const Ogre::Vector3 x(octant & 1 ? -1.0F : 1.0F, 0.0F, 0.0F), y(0.0F, octant & 2 ? -1.0F : 1.0F, 0.0F),
        z(0.0F, 0.0F, octant & 4 ? -1.0F : 1.0F);
    const bool is_mirrored = x.x * y.y * z.z < 0.0F;  // its triangles would be seen from within
    const auto begin = static_cast<std::uint32_t>(sphere->getCurrentVertexCount());
    const auto index = [begin](int i, int j) { return begin + static_cast<std::uint32_t>(i * (i + 1) / 2 + j); };
    for (int i = 0; i <= steps; ++i) {
      for (int j = 0; j <= i; ++j) {
        const Ogre::Vector3 point =
            (static_cast<float>(steps - i) * x + static_cast<float>(i - j) * y + static_cast<float>(j) * z)
                .normalisedCopy();
        sphere->position(point);
        sphere->normal(point);
      }
    }
    const auto add = [sphere, is_mirrored](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
      if (is_mirrored) std::swap(b, c);
      sphere->triangle(a, b, c);
    };
    for (int i = 0; i < steps; ++i) {
      for (int j = 0; j <= i; ++j) {
        add(index(i, j), index(i + 1, j), index(i + 1, j + 1));
        if (j < i) add(index(i, j), index(i + 1, j + 1), index(i, j + 1));
      }
    }
  }
  sphere->end();
  sphere->convertToMesh(sphere_name(steps), resource_group());
  scene->destroyManualObject(sphere);
}

/// Of the image.
float half_height_px(const Ogre::Camera& camera) {
  return 0.5F * static_cast<float>(camera.getViewport()->getActualHeight());
}

/// Name and value of each figure that a selected object tells.
std::vector<std::pair<QString, QString>> figures(const core::Landmark& landmark, const core::ClassTable& classes) {
  const core::Vec3 size = 2.0 * landmark.ellipsoid->semi_axes;
  const double sigma_m = std::sqrt(landmark.center_covariance.trace());
  const auto number = [](double value, int digits) { return QString::number(value, 'f', digits); };
  const auto name = [&classes](int class_id) { return QString::fromStdString(classes.name(class_id)); };
  QStringList boxes;
  for (const core::ClassCount& c : landmark.class_counts) boxes += name(c.class_id) + ' ' + QString::number(c.count);
  return {{"Class", name(landmark.class_id)},
          {"Boxes", boxes.join(", ")},
          {"State", core::to_string(landmark.state)},
          {"Observations", QString::number(landmark.observations)},
          {"Size", number(size.x(), 3) + " x " + number(size.y(), 3) + " x " + number(size.z(), 3) + " m"},
          {"Sigma of the centre", number(sigma_m, 3) + " m"},
          {"Quality", number(landmark.quality, 2)},
          {"IoU of its boxes", number(landmark.mean_iou, 2)},
          {"Seen from", number(landmark.baseline_deg, 0) + " deg"},
          {"Keyframe", QString::number(landmark.anchor_keyframe_id)}};
}

class ObjectSelection : public rviz::SelectionHandler {
 public:
  ObjectSelection(rviz::DisplayContext* context, const core::Landmark* landmark, const core::ClassTable* classes)
      : SelectionHandler(context), landmark_(landmark), classes_(classes) {}

  void createProperties(const rviz::Picked& /*picked*/, rviz::Property* parent) override {
    auto* object = new rviz::Property("Object " + QString::number(landmark_->id), QVariant(), "", parent);
    properties_.push_back(object);
    for (const auto& [name, value] : figures(*landmark_, *classes_)) {
      (new rviz::Property(name, value, "", object))->setReadOnly(true);
    }
    object->expand();
  }
  void updateProperties() override {
    const auto now = figures(*landmark_, *classes_);
    for (rviz::Property* object : properties_) {
      for (int i = 0; i < object->numChildren(); ++i) {
        object->childAt(i)->setValue(now[static_cast<std::size_t>(i)].second);
      }
    }
  }

 private:
  const core::Landmark* landmark_;
  const core::ClassTable* classes_;
};

}  // namespace

/// What stands for a landmark in the scene.
class MapObject {
 public:
  MapObject(rviz::DisplayContext* context, Ogre::SceneNode* parent, core::Landmark landmark,
            const core::ClassTable* classes)
      : landmark_(std::move(landmark)),
        node_(parent->createChildSceneNode()),
        shape_(node_->createChildSceneNode()),
        selection_(context, &landmark_, classes) {
    create_entity(kMostSteps);
  }
  ~MapObject() {
    remove_label();
    destroy_entity();
    Ogre::SceneManager* scene = node_->getCreator();
    scene->destroySceneNode(shape_);
    scene->destroySceneNode(node_);
  }
  MapObject(const MapObject&) = delete;
  MapObject& operator=(const MapObject&) = delete;

  void set(const core::Landmark& landmark, const Ogre::MaterialPtr& material) {
    landmark_ = landmark;
    node_->setPosition(to_ogre(landmark.ellipsoid->center()));
    shape_->setOrientation(to_ogre(landmark.ellipsoid->T_world_quadric.q));
    shape_->setScale(to_ogre(landmark.ellipsoid->semi_axes));
    entity_->setMaterial(material);
  }
  /// Draws it with no more triangles than can be told apart.
  /// @param pixels_per_m of the image at the distance of the object
  void set_detail(float pixels_per_m) {
    const int steps = steps_of(pixels_per_m * static_cast<float>(landmark_.ellipsoid->semi_axes.maxCoeff()));
    if (steps == steps_) return;
    const Ogre::MaterialPtr material = entity_->getSubEntity(0)->getMaterial();
    destroy_entity();
    create_entity(steps);
    entity_->setMaterial(material);
  }
  /// Of the centre, in the fixed frame.
  Ogre::Vector3 place() const { return node_->_getDerivedPosition(); }
  /// @param text above the object; empty: none   @param up unit, in the frame of the map
  void set_label(const std::string& text, float size_m, const core::Vec3& up) {
    if (text.empty()) return remove_label();
    if (!label_) {
      label_ = std::make_unique<rviz::MovableText>(text);
      label_->setTextAlignment(rviz::MovableText::H_CENTER, rviz::MovableText::V_ABOVE);
      label_->showOnTop();
      node_->attachObject(label_.get());
    }
    label_->setCaption(text);
    label_->setCharacterHeight(size_m);
    label_height_m_ = static_cast<float>(std::sqrt(up.dot(landmark_.ellipsoid->shape() * up)));
    label_->setGlobalTranslation({0.0F, 0.0F, label_height_m_});
  }
  void remove_label() {
    if (label_) node_->detachObject(label_.get());
    label_.reset();
  }
  rviz::MovableText* label() { return label_.get(); }
  /// Where the label stands, in the fixed frame.
  Ogre::Vector3 label_place() const { return place() + Ogre::Vector3(0.0F, 0.0F, label_height_m_); }

 private:
  void create_entity(int steps) {
    steps_ = steps;
    entity_ = node_->getCreator()->createEntity(sphere_name(steps));
    shape_->attachObject(entity_);
    selection_.addTrackedObject(entity_);
  }
  void destroy_entity() {
    selection_.removeTrackedObject(entity_);
    node_->getCreator()->destroyEntity(entity_);
  }

  core::Landmark landmark_;
  Ogre::SceneNode* node_;
  Ogre::SceneNode* shape_;
  int steps_ = 0;  ///< of the sphere
  Ogre::Entity* entity_ = nullptr;
  std::unique_ptr<rviz::MovableText> label_;
  float label_height_m_ = 0.0F;
  ObjectSelection selection_;
};

QuadricMapDisplay::QuadricMapDisplay() : MapDisplay("quadric_map") {
  colour_by_ = new rviz::EnumProperty("Color by", "Class", "What an object's colour tells.", this);
  colour_by_->addOption("Class", kClass);
  colour_by_->addOption("State", kState);
  colour_by_->addOption("Quality", kQuality);
  alpha_ = new rviz::FloatProperty("Alpha", 0.85F, "Of confirmed objects; others are fainter.", this);
  alpha_->setMin(0.0F);
  alpha_->setMax(1.0F);
  candidates_ = new rviz::BoolProperty("Candidates", true, "Show objects that are not confirmed yet.", this);
  retired_ = new rviz::BoolProperty("Retired", false, "Show objects that are gone.", this);
  min_observations_ =
      new rviz::IntProperty("Min observations", 0, "Objects that fewer boxes were seen of are left out.", this);
  min_observations_->setMin(0);
  labels_ = new rviz::BoolProperty("Labels", true, "Name the confirmed objects, where the letters can be read.", this);
  label_ids_ = new rviz::BoolProperty("With ids", false, "Add the ids to the names.", labels_);
  labels_apart_ = new rviz::BoolProperty("Keep apart", true, "Hide labels that a nearer one covers.", labels_);
  label_size_ = new rviz::FloatProperty("Size", 0.08F, "Height of a capital letter, m.", labels_);
  label_size_->setMin(0.001F);
  label_colour_ = new rviz::ColorProperty("Color", Qt::white, "Of the letters.", labels_);
  class_table_ = new rviz::StringProperty(
      "Class table", "", "File with the detector's classes; empty: that of the chain in rviz's namespace, else COCO.",
      this);
  for (rviz::Property* property :
       std::initializer_list<rviz::Property*>{colour_by_, alpha_, candidates_, retired_, min_observations_, labels_,
                                              label_ids_, label_size_, label_colour_, class_table_}) {
    redraw_on_change(property);
  }
}

QuadricMapDisplay::~QuadricMapDisplay() {
  objects_.clear();
  for (const auto& [colour, material] : materials_) {
    Ogre::MaterialManager::getSingleton().remove(material->getHandle());
  }
}

void QuadricMapDisplay::onInitialize() {
  for (int steps = 2; steps <= kMostSteps; ++steps) make_sphere(scene_manager_, steps);
}

void QuadricMapDisplay::reset() {
  class_file_.reset();
  MapDisplay::reset();
}

void QuadricMapDisplay::update_classes() {
  std::string file = class_table_->getStdString();
  const bool is_given = !file.empty();
  if (!is_given) update_nh_.getParamCached("visualization/class_table", file);
  if (class_file_ == file) return;
  class_file_ = file;
  const std::string coco = ros::package::getPath("semantic_topo_loop") + "/config/classes_coco.yaml";
  if (file.empty()) file = coco;
  core::Result<core::ClassTable> classes = core::read_class_table(file);
  if (classes) {
    setStatusStd(rviz::StatusProperty::Ok, "Class table", file);
  } else if (is_given) {
    setStatusStd(rviz::StatusProperty::Error, "Class table", classes.message());
  } else {  // the chain may run on another machine
    setStatusStd(rviz::StatusProperty::Warn, "Class table", classes.message() + "; the names are COCO's");
    classes = core::read_class_table(coco);
  }
  if (classes) classes_ = *std::move(classes);
}

bool QuadricMapDisplay::is_shown(const core::Landmark& landmark) const {
  if (!landmark.ellipsoid || landmark.observations < min_observations_->getInt()) return false;
  switch (landmark.state) {
    case core::LandmarkState::kCandidate:
      return candidates_->getBool();
    case core::LandmarkState::kRetired:
      return retired_->getBool();
    default:
      return true;
  }
}

Ogre::ColourValue QuadricMapDisplay::colour(const core::Landmark& landmark) const {
  constexpr float kUnconfirmed = 0.3F;
  const bool is_confirmed = landmark.state == core::LandmarkState::kConfirmed;
  const float alpha = alpha_->getFloat() * (is_confirmed ? 1.0F : kUnconfirmed);
  switch (colour_by_->getOptionInt()) {
    case kState:
      if (is_confirmed) return Ogre::ColourValue(0.25F, 0.8F, 0.4F, alpha);
      if (landmark.state == core::LandmarkState::kCandidate) return Ogre::ColourValue(0.95F, 0.75F, 0.2F, alpha);
      return Ogre::ColourValue(0.6F, 0.6F, 0.6F, alpha);
    case kQuality: {
      constexpr double kGreen = 1.0 / 3.0, kShades = 16.0;  // few, so that objects share materials
      const double quality = std::round(kShades * std::clamp(landmark.quality, 0.0, 1.0)) / kShades;
      const QColor colour = QColor::fromHsvF(kGreen * quality, 0.85, 0.95);
      return Ogre::ColourValue(static_cast<float>(colour.redF()), static_cast<float>(colour.greenF()),
                               static_cast<float>(colour.blueF()), alpha);
    }
    default: {
      const std_msgs::ColorRGBA colour = class_color(landmark.class_id, alpha);
      return Ogre::ColourValue(colour.r, colour.g, colour.b, colour.a);
    }
  }
}

const Ogre::MaterialPtr& QuadricMapDisplay::material(const Ogre::ColourValue& colour) {
  const auto [entry, is_new] = materials_.try_emplace(colour.getAsRGBA());
  if (!is_new) return entry->second;
  Ogre::MaterialPtr material = make_material();
  constexpr float kAmbient = 0.5F;
  material->setReceiveShadows(false);
  material->setLightingEnabled(true);
  material->setAmbient(kAmbient * colour);
  material->setDiffuse(colour);
  if (colour.a < 1.0F) {
    material->setSceneBlending(Ogre::SBT_TRANSPARENT_ALPHA);
    material->setDepthWriteEnabled(false);
  }
  return entry->second = material;
}

QString QuadricMapDisplay::label(const core::Landmark& landmark) const {
  if (!labels_->getBool() || landmark.state != core::LandmarkState::kConfirmed) return {};
  const QString name = QString::fromStdString(classes_.name(landmark.class_id));
  return label_ids_->getBool() ? name + ' ' + QString::number(landmark.id) : name;
}

void QuadricMapDisplay::draw(const MapMessage* message) {
  std::map<std::int64_t, std::unique_ptr<MapObject>> former;
  former.swap(objects_);
  if (message == nullptr) return;
  update_classes();
  for (const core::Landmark& landmark : message->changed) {
    if (!is_shown(landmark)) continue;
    std::unique_ptr<MapObject> object = std::move(former[landmark.id]);
    if (!object) object = std::make_unique<MapObject>(context_, scene_node_, landmark, &classes_);
    object->set(landmark, material(colour(landmark)));
    object->set_label(label(landmark).toStdString(), label_size_->getFloat(), up());
    if (object->label() != nullptr) object->label()->setColor(label_colour_->getOgreColor());
    objects_[landmark.id] = std::move(object);
  }
  setStatus(rviz::StatusProperty::Ok, "Objects",
            QString::number(objects_.size()) + " shown of " + QString::number(message->changed.size()));
}

void QuadricMapDisplay::update(float wall_dt, float ros_dt) {
  MapDisplay::update(wall_dt, ros_dt);
  const rviz::ViewController* view = context_->getViewManager()->getCurrent();
  if (view == nullptr || view->getCamera()->getViewport() == nullptr) return;
  set_details(*view->getCamera());
  choose_labels(*view->getCamera());
}

void QuadricMapDisplay::set_details(const Ogre::Camera& camera) {
  const Ogre::Matrix4 projection = camera.getProjectionMatrix() * camera.getViewMatrix();
  const float focal_px = half_height_px(camera) * camera.getProjectionMatrix()[1][1];
  constexpr float kNearest_m = 0.001F;
  for (const auto& [id, object] : objects_) {
    const Ogre::Vector3 place = object->place();
    const float depth = (projection * Ogre::Vector4(place.x, place.y, place.z, 1.0F)).w;  // 1 in an orthographic view
    object->set_detail(focal_px / std::max(depth, kNearest_m));
  }
}

void QuadricMapDisplay::choose_labels(const Ogre::Camera& camera) {
  struct Label {
    rviz::MovableText* text;
    float depth;
    float x, y, half_width, height;  // in the view, whose sides are 2 long
  };
  const Ogre::Matrix4 projection = camera.getProjectionMatrix();
  std::vector<Label> labels;
  for (const auto& [id, object] : objects_) {
    if (object->label() == nullptr) continue;
    const Ogre::Vector3 place = object->label_place();
    const Ogre::Vector4 seen = camera.getViewMatrix() * Ogre::Vector4(place.x, place.y, place.z, 1.0F);
    const Ogre::Vector4 clip = projection * seen;
    constexpr float kReadable_px = 3.0F, kHalfLetter = 0.25F;  // the latter of its height
    const float size = label_size_->getFloat() / clip.w;
    const bool is_readable = clip.w > 0.0F && size * projection[1][1] * half_height_px(camera) > kReadable_px;
    object->label()->setVisible(is_readable);
    if (!is_readable || !labels_apart_->getBool()) continue;
    const auto letters = static_cast<float>(object->label()->getCaption().size());
    labels.push_back({object->label(), -seen.z, clip.x / clip.w, clip.y / clip.w,
                      kHalfLetter * letters * size * projection[0][0], size * projection[1][1]});
  }
  std::stable_sort(labels.begin(), labels.end(), [](const Label& a, const Label& b) { return a.depth < b.depth; });
  std::vector<const Label*> shown;
  for (const Label& label : labels) {
    const auto covers = [&label](const Label* other) {
      return std::abs(other->x - label.x) < other->half_width + label.half_width && other->y < label.y + label.height &&
             label.y < other->y + other->height;
    };
    const bool is_covered = std::any_of(shown.begin(), shown.end(), covers);
    label.text->setVisible(!is_covered);
    if (!is_covered) shown.push_back(&label);
  }
}

}  // namespace semantic_topo_loop

PLUGINLIB_EXPORT_CLASS(semantic_topo_loop::QuadricMapDisplay, rviz::Display)
