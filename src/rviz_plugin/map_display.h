#pragma once

#include <OgreMaterialManager.h>
#include <OgreQuaternion.h>
#include <OgreResourceGroupManager.h>
#include <OgreSceneNode.h>
#include <ros/ros.h>
#include <rviz/display.h>
#include <rviz/display_context.h>
#include <rviz/frame_manager.h>
#include <rviz/properties/ros_topic_property.h>

#include <string>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop {

inline Ogre::Vector3 to_ogre(const core::Vec3& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}
inline Ogre::Quaternion to_ogre(const core::Quaternion& q) {
  return {static_cast<float>(q.w()), static_cast<float>(q.x()), static_cast<float>(q.y()), static_cast<float>(q.z())};
}

/// Of the meshes and materials that displays make.
inline const Ogre::String& resource_group() { return Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME; }

/// A new material, by a name that no other display has. Whoever makes it removes it.
inline Ogre::MaterialPtr make_material() {
  static int number = 0;
  const std::string name = "semantic_topo_loop_" + std::to_string(number++);
  return Ogre::MaterialManager::getSingleton().create(name, resource_group());
}

/// A display of a message that holds everything there is to show. The last one is drawn where tf has the frame of its
/// header now, whatever its stamp: a latched map stays right. Everything runs in rviz's own thread.
template <class Message>
class MapDisplay : public rviz::Display {
 public:
  void setTopic(const QString& topic, const QString& /*datatype*/) override { topic_->setString(topic); }
  void reset() override {
    Display::reset();
    message_.reset();
    has_frame_ = false;  // whose status is gone
    frame_.clear();
    if (isEnabled()) subscribe();  // what is latched comes to new subscribers alone
    redraw();
  }
  void update(float /*wall_dt*/, float /*ros_dt*/) override {
    if (message_) find_frame();
    if (!needs_drawing_) return;
    needs_drawing_ = false;
    draw(message_.get());
    context_->queueRender();
  }

 protected:
  /// @param topic its default name
  explicit MapDisplay(const char* topic)
      : topic_(new rviz::RosTopicProperty("Topic", topic,
                                          QString::fromStdString(ros::message_traits::datatype<Message>()),
                                          "Topic of the message.", this)) {
    connect(topic_, &rviz::Property::changed, this, [this] {
      if (isEnabled()) subscribe();
    });
  }
  void onEnable() override { subscribe(); }
  void onDisable() override {
    subscriber_.shutdown();
    message_.reset();
    draw(nullptr);
  }

  /// Draws anew before the next frame.
  void redraw() { needs_drawing_ = true; }
  void redraw_on_change(rviz::Property* property) {
    connect(property, &rviz::Property::changed, this, [this] { redraw(); });
  }
  /// The up of the fixed frame, in the frame of the message.
  core::Vec3 up() const {
    const Ogre::Vector3 up = scene_node_->getOrientation().Inverse() * Ogre::Vector3::UNIT_Z;
    return {up.x, up.y, up.z};
  }
  /// @param message null: nothing is to be seen
  virtual void draw(const Message* message) = 0;
  /// Whether something of it is drawn upright, which hangs on how the fixed frame is turned.
  virtual bool has_upright() const { return false; }

 private:
  void subscribe() {
    message_.reset();
    redraw();
    try {
      subscriber_ = update_nh_.subscribe<Message>(
          topic_->getTopicStd(), 1,
          boost::function<void(const boost::shared_ptr<const Message>&)>([this](const auto& message) {
            message_ = message;
            redraw();
          }));
      setStatus(rviz::StatusProperty::Ok, "Topic", "subscribed");
    } catch (const ros::Exception& error) {
      setStatus(rviz::StatusProperty::Error, "Topic", QString("cannot subscribe: ") + error.what());
    }
  }

  void find_frame() {
    Ogre::Vector3 position;
    Ogre::Quaternion orientation;
    const std::string& frame = message_->header.frame_id;
    const bool is_known = context_->getFrameManager()->getTransform(frame, ros::Time(), position, orientation);
    if (is_known != has_frame_ || frame != frame_) {
      const QString from_to = QString::fromStdString(frame) + " to " + fixed_frame_;
      if (is_known) {
        setStatus(rviz::StatusProperty::Ok, "Transform", from_to);
      } else {
        setStatus(rviz::StatusProperty::Error, "Transform", "none from " + from_to);
      }
      has_frame_ = is_known;
      frame_ = frame;
    }
    if (!is_known) return;
    if (has_upright() && !(orientation == scene_node_->getOrientation())) redraw();
    scene_node_->setPosition(position);
    scene_node_->setOrientation(orientation);
  }

  rviz::RosTopicProperty* topic_;
  ros::Subscriber subscriber_;
  boost::shared_ptr<const Message> message_;
  bool needs_drawing_ = false;
  bool has_frame_ = false;
  std::string frame_;
};

}  // namespace semantic_topo_loop
