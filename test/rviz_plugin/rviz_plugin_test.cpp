// The displays as rviz loads them, on a display without a screen.
#include <OgreBillboardChain.h>
#include <OgreEntity.h>
#include <OgreManualObject.h>
#include <OgreMesh.h>
#include <OgreRenderable.h>
#include <OgreSceneNode.h>
#include <OgreSubEntity.h>
#include <OgreTechnique.h>
#include <OgreViewport.h>
#include <gtest/gtest.h>
#include <rviz/display_group.h>
#include <rviz/failed_display.h>
#include <rviz/ogre_helpers/movable_text.h>
#include <rviz/properties/property_tree_model.h>
#include <rviz/selection/selection_manager.h>
#include <rviz/view_controller.h>
#include <rviz/view_manager.h>
#include <rviz/yaml_config_reader.h>

#include <memory>
#include <set>
#include <string>
#include <vector>

#include "ros/conversions.h"
#include "ros/markers.h"
#include "semantic_topo_loop/LoopClosure.h"
#include "semantic_topo_loop/LoopMap.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/rviz_host.h"
#include "support/test_files.h"

namespace semantic_topo_loop {
namespace {

constexpr double kPatience_s = 20.0;
constexpr int kWidth = 320, kHeight = 240;
constexpr int kCup = 41, kTv = 62;

std::string default_file;  ///< what launch files show

core::Landmark make_landmark(std::int64_t id, int class_id, core::LandmarkState state, const core::Vec3& center) {
  core::Landmark landmark;
  landmark.id = id;
  landmark.class_id = class_id;
  landmark.state = state;
  landmark.observations = 12;
  landmark.quality = 1.0;
  landmark.center_covariance = 1e-4 * core::Mat3::Identity();
  landmark.ellipsoid = core::Ellipsoid{core::SE3(core::Quaternion::Identity(), center), {0.1, 0.2, 0.3}};
  return landmark;
}

/// Everything of one type below a node.
template <class Movable>
void collect(Ogre::SceneNode* node, std::vector<Movable*>* found) {
  for (unsigned short i = 0; i < node->numAttachedObjects(); ++i) {
    if (auto* movable = dynamic_cast<Movable*>(node->getAttachedObject(i))) found->push_back(movable);
  }
  for (unsigned short i = 0; i < node->numChildren(); ++i) {
    collect(static_cast<Ogre::SceneNode*>(node->getChild(i)), found);
  }
}

struct VertexCounter : Ogre::Renderable::Visitor {
  void visit(Ogre::Renderable* renderable, Ogre::ushort /*lod*/, bool /*is_debug*/, Ogre::Any* /*any*/) override {
    Ogre::RenderOperation operation;
    renderable->getRenderOperation(operation);
    count += operation.vertexData->vertexCount;
  }

  std::size_t count = 0;
};

class RvizPlugin : public ::testing::Test {
 protected:
  // rviz can be there once in a process.
  static void SetUpTestSuite() { host_ = std::make_unique<RvizHost>(kWidth, kHeight); }
  static void TearDownTestSuite() { host_.reset(); }
  void SetUp() override { host_->manager().setFixedFrame("map"); }
  void TearDown() override {
    host_->manager().removeAllDisplays();
    node_.deleteParam(kClassTable);
  }

  rviz::Display* add(const char* type) {
    rviz::Display* display = host_->manager().createDisplay(type, "display", true);
    EXPECT_EQ(dynamic_cast<rviz::FailedDisplay*>(display), nullptr) << type << " cannot be loaded";
    return display;
  }
  template <class Movable>
  std::vector<Movable*> drawn(const rviz::Display* display) const {
    std::vector<Movable*> found;
    collect(display->getSceneNode(), &found);
    return found;
  }
  bool wait_for_objects(const rviz::Display* display, std::size_t n) {
    return RvizHost::spin_until([&] { return drawn<Ogre::Entity>(display).size() == n; }, kPatience_s);
  }
  void publish_map(std::vector<core::Landmark> landmarks) {
    FullMap map;
    map.map_version = 1;
    map.changed = std::move(landmarks);
    maps_.publish(boost::make_shared<MapMessage>(make_header(ros::Time(1.0), "map"), 1, std::move(map)));
  }
  /// A straight look along x at the origin, from 2 m.
  void look_at_origin() {
    rviz::Property* view = host_->manager().getViewManager()->getCurrent();
    view->subProp("Distance")->setValue(2.0);
    view->subProp("Pitch")->setValue(0.0);
    view->subProp("Yaw")->setValue(0.0);
  }

  static constexpr char kClassTable[] = "visualization/class_table";
  static std::unique_ptr<RvizHost> host_;
  ros::NodeHandle node_;
  ros::Publisher maps_ = node_.advertise<MapMessage>("quadric_map", 1, true);
  ros::Publisher loops_ = node_.advertise<LoopMap>("loop_map", 1, true);
};

std::unique_ptr<RvizHost> RvizPlugin::host_;

TEST_F(RvizPlugin, IsWhatLaunchFilesShow) {
  rviz::Config config;
  rviz::YamlConfigReader reader;
  reader.readFile(config, QString::fromStdString(default_file));
  ASSERT_FALSE(reader.error()) << reader.errorMessage().toStdString();
  rviz::DisplayGroup* displays = host_->manager().getRootDisplayGroup();
  displays->load(config.mapGetChild("Visualization Manager"));
  std::set<std::string> shown;
  for (int i = 0; i < displays->numDisplays(); ++i) {
    const rviz::Display* display = displays->getDisplayAt(i);
    EXPECT_EQ(dynamic_cast<const rviz::FailedDisplay*>(display), nullptr) << display->getNameStd();
    if (display->isEnabled()) shown.insert(display->getClassId().toStdString());
  }
  EXPECT_EQ(shown.count("semantic_topo_loop/QuadricMap"), 1u);
  EXPECT_EQ(shown.count("semantic_topo_loop/LoopClosures"), 1u);
}

TEST_F(RvizPlugin, DrawsAsManyObjectsAsTheMessageHas) {
  rviz::Display* display = add("semantic_topo_loop/QuadricMap");
  using core::LandmarkState;
  std::vector<core::Landmark> landmarks = {make_landmark(1, kTv, LandmarkState::kConfirmed, {1.0, 2.0, 3.0}),
                                           make_landmark(2, kCup, LandmarkState::kConfirmed, {0.0, 1.0, 0.0}),
                                           make_landmark(3, kCup, LandmarkState::kCandidate, {0.0, 2.0, 0.0}),
                                           make_landmark(4, kCup, LandmarkState::kRetired, {0.0, 3.0, 0.0}),
                                           make_landmark(5, kCup, LandmarkState::kConfirmed, {0.0, 4.0, 0.0})};
  landmarks[4].ellipsoid.reset();
  landmarks[1].observations = 3;
  publish_map(landmarks);
  ASSERT_TRUE(wait_for_objects(display, 3)) << "two confirmed ones and a candidate";
  const Ogre::Entity* tv = drawn<Ogre::Entity>(display).front();
  const Ogre::Node* node = tv->getParentNode();
  EXPECT_LT((node->_getDerivedPosition() - Ogre::Vector3(1.0F, 2.0F, 3.0F)).length(), 1e-5F);
  EXPECT_LT((node->_getDerivedScale() - Ogre::Vector3(0.1F, 0.2F, 0.3F)).length(), 1e-5F);
  ASSERT_EQ(drawn<rviz::MovableText>(display).size(), 2u) << "the confirmed ones are named";
  EXPECT_EQ(drawn<rviz::MovableText>(display).front()->getCaption(), "tv");

  display->subProp("Retired")->setValue(true);
  EXPECT_TRUE(wait_for_objects(display, 4));
  display->subProp("Candidates")->setValue(false);
  EXPECT_TRUE(wait_for_objects(display, 3));
  display->subProp("Min observations")->setValue(4);
  EXPECT_TRUE(wait_for_objects(display, 2));
  display->subProp("Labels")->setValue(false);
  EXPECT_TRUE(RvizHost::spin_until([&] { return drawn<rviz::MovableText>(display).empty(); }, kPatience_s));
  publish_map({landmarks[0]});
  EXPECT_TRUE(wait_for_objects(display, 1)) << "what the map has no longer is gone";
}

TEST_F(RvizPlugin, ShowsTheLatchedMapAgainAfterAReset) {
  rviz::Display* display = add("semantic_topo_loop/QuadricMap");
  publish_map({make_landmark(1, kTv, core::LandmarkState::kConfirmed, {1.0, 2.0, 3.0})});
  ASSERT_TRUE(wait_for_objects(display, 1));
  display->reset();
  EXPECT_TRUE(drawn<Ogre::Entity>(display).size() == 1 || wait_for_objects(display, 1));
  RvizHost::spin_until([] { return false; }, 0.2);
  EXPECT_EQ(drawn<Ogre::Entity>(display).size(), 1u);
}

TEST_F(RvizPlugin, DrawsWhatLooksSmallWithFewerVertices) {
  rviz::Display* display = add("semantic_topo_loop/QuadricMap");
  look_at_origin();
  publish_map({make_landmark(1, kTv, core::LandmarkState::kConfirmed, {0.0, 0.0, 0.0})});
  ASSERT_TRUE(wait_for_objects(display, 1));
  const auto vertices = [&] {
    VertexCounter counter;
    drawn<Ogre::Entity>(display).front()->visitRenderables(&counter);
    return counter.count;
  };
  constexpr std::size_t kFinest = 8 * 45, kCoarsest = 8 * 6;
  EXPECT_TRUE(RvizHost::spin_until([&] { return vertices() == kFinest; }, kPatience_s)) << vertices();
  rviz::Property* distance = host_->manager().getViewManager()->getCurrent()->subProp("Distance");
  distance->setValue(100.0);
  EXPECT_TRUE(RvizHost::spin_until([&] { return vertices() == kCoarsest; }, kPatience_s)) << vertices();
  distance->setValue(2.0);
  EXPECT_TRUE(RvizHost::spin_until([&] { return vertices() == kFinest; }, kPatience_s)) << vertices();
}

TEST_F(RvizPlugin, ColoursByClassStateOrQuality) {
  rviz::Display* display = add("semantic_topo_loop/QuadricMap");
  publish_map({make_landmark(1, kTv, core::LandmarkState::kConfirmed, {0.0, 0.0, 0.0})});
  ASSERT_TRUE(wait_for_objects(display, 1));
  const auto colour = [&] {
    const Ogre::Entity* object = drawn<Ogre::Entity>(display).front();
    return object->getSubEntity(0)->getMaterial()->getTechnique(0)->getPass(0)->getDiffuse();
  };
  const std_msgs::ColorRGBA of_class = class_color(kTv, 1.0);
  EXPECT_EQ(colour().r, of_class.r);
  EXPECT_EQ(colour().g, of_class.g);
  EXPECT_EQ(colour().b, of_class.b);
  const auto becomes_green = [&](const char* property) {
    display->subProp("Color by")->setValue(property);
    return RvizHost::spin_until([&] { return colour().g > 1.4F * colour().r && colour().g > 1.4F * colour().b; },
                                kPatience_s);
  };
  EXPECT_TRUE(becomes_green("State"));
  display->subProp("Color by")->setValue("Class");
  EXPECT_TRUE(RvizHost::spin_until([&] { return colour().r == of_class.r; }, kPatience_s));
  EXPECT_TRUE(becomes_green("Quality")) << "which is 1";
}

TEST_F(RvizPlugin, NamesAreOfTheChainsClassTable) {
  const core::TestDirectory directory;
  const std::string own =
      directory.write("own.yaml", "classes:\n  - {id: 62, name: own, role: static, group: own, size_prior_m: 1}\n");
  rviz::Display* display = add("semantic_topo_loop/QuadricMap");
  const auto becomes = [&](const char* name) {
    publish_map({make_landmark(1, kTv, core::LandmarkState::kConfirmed, {0.0, 0.0, 0.0})});
    return RvizHost::spin_until(
        [&] {
          const auto labels = drawn<rviz::MovableText>(display);
          return !labels.empty() && labels.front()->getCaption() == name;
        },
        kPatience_s);
  };
  EXPECT_TRUE(becomes("tv")) << "without a chain";
  node_.setParam(kClassTable, own);
  EXPECT_TRUE(becomes("own"));
  node_.setParam(kClassTable, directory.path("of_another_machine.yaml"));
  EXPECT_TRUE(becomes("tv"));
  display->subProp("Class table")->setValue(QString::fromStdString(own));
  EXPECT_TRUE(becomes("own"));
}

TEST_F(RvizPlugin, NamesThatCoverEachOtherAreShownOnce) {
  rviz::Display* display = add("semantic_topo_loop/QuadricMap");
  look_at_origin();
  publish_map({make_landmark(1, kTv, core::LandmarkState::kConfirmed, {0.0, 0.0, 0.0}),
               make_landmark(2, kCup, core::LandmarkState::kConfirmed, {0.5, 0.0, -0.075}),  // its top in line
               make_landmark(3, kCup, core::LandmarkState::kConfirmed, {0.0, 0.7, 0.0})});
  const auto shown = [&] {
    std::string names;
    for (const rviz::MovableText* label : drawn<rviz::MovableText>(display)) {
      if (label->getVisible()) names += label->getCaption() + " ";
    }
    return names;
  };
  EXPECT_TRUE(RvizHost::spin_until([&] { return shown() == "cup cup "; }, kPatience_s)) << shown();
  display->subProp("Labels")->subProp("Keep apart")->setValue(false);
  EXPECT_TRUE(RvizHost::spin_until([&] { return shown() == "tv cup cup "; }, kPatience_s)) << shown();
  host_->manager().getViewManager()->getCurrent()->subProp("Distance")->setValue(20.0);
  EXPECT_TRUE(RvizHost::spin_until([&] { return shown().empty(); }, kPatience_s)) << "too small to read: " << shown();
}

TEST_F(RvizPlugin, ASelectedObjectTellsItsFigures) {
  rviz::Display* display = add("semantic_topo_loop/QuadricMap");
  look_at_origin();
  core::Landmark tv = make_landmark(7, kTv, core::LandmarkState::kConfirmed, {0.0, 0.0, 0.0});
  tv.count_class(kTv, 10);
  tv.count_class(kCup, 2);
  rviz::Property* distance = host_->manager().getViewManager()->getCurrent()->subProp("Distance");
  distance->setValue(3.0);  // where it is not the finest sphere any more
  publish_map({tv, make_landmark(8, kCup, core::LandmarkState::kConfirmed, {0.0, 5.0, 0.0})});
  ASSERT_TRUE(wait_for_objects(display, 2));
  const std::uint64_t frame = host_->manager().getFrameCount();
  ASSERT_TRUE(RvizHost::spin_until([&] { return host_->manager().getFrameCount() > frame + 5; }, kPatience_s));
  rviz::SelectionManager* selection = host_->manager().getSelectionManager();
  selection->select(host_->panel().getViewport(), kWidth / 2 - 2, kHeight / 2 - 2, kWidth / 2 + 2, kHeight / 2 + 2,
                    rviz::SelectionManager::Replace);
  const rviz::Property* root = selection->getPropertyModel()->getRoot();
  ASSERT_EQ(root->numChildren(), 1);
  const rviz::Property* object = root->childAt(0);
  EXPECT_EQ(object->getName().toStdString(), "Object 7");
  const auto figure = [object](const char* name) {
    return const_cast<rviz::Property*>(object)->subProp(name)->getValue().toString().toStdString();
  };
  EXPECT_EQ(figure("Class"), "tv");
  EXPECT_EQ(figure("Boxes"), "cup 2, tv 10");
  EXPECT_EQ(figure("State"), "confirmed");
  EXPECT_EQ(figure("Observations"), "12");
  EXPECT_EQ(figure("Size"), "0.200 x 0.400 x 0.600 m");
  EXPECT_EQ(figure("Sigma of the centre"), "0.017 m");
  const std::string sphere = drawn<Ogre::Entity>(display).front()->getMesh()->getName();
  distance->setValue(30.0);
  EXPECT_TRUE(RvizHost::spin_until([&] { return drawn<Ogre::Entity>(display).front()->getMesh()->getName() != sphere; },
                                   kPatience_s));
  ASSERT_EQ(root->numChildren(), 1) << "it stays selected";
  EXPECT_EQ(figure("Class"), "tv");
}

TEST_F(RvizPlugin, DrawsLoopsToTheirObjectsAndRefusedOnesIfAsked) {
  rviz::Display* display = add("semantic_topo_loop/LoopClosures");
  auto map = boost::make_shared<LoopMap>();
  map->header.frame_id = "map";
  map->loops.resize(4);
  for (std::size_t i = 0; i < map->loops.size(); ++i) map->loops[i].query.x = 10.0 * static_cast<double>(i);
  map->loops[0].kept = true;
  map->loops[0].objects.resize(3);
  map->loops[1].kept = true;  // looks as the first one
  map->loops[1].query.x = 0.1;
  map->loops[2].kept = false;
  map->loops[3].reason = LoopClosure::REASON_RESIDUAL;
  loops_.publish(map);
  const auto loops = [&] {
    std::size_t points = 0;
    for (const Ogre::BillboardChain* chain : drawn<Ogre::BillboardChain>(display)) {
      for (std::size_t i = 0; i < chain->getNumberOfChains(); ++i) points += chain->getNumChainElements(i);
    }
    return points / 2;
  };
  const auto thin_lines = [&] {
    VertexCounter vertices;
    drawn<Ogre::ManualObject>(display).front()->visitRenderables(&vertices);
    return vertices.count / 2;
  };
  EXPECT_TRUE(RvizHost::spin_until([&] { return loops() == 2 && thin_lines() == 6; }, kPatience_s))
      << loops() << ' ' << thin_lines();
  EXPECT_TRUE(drawn<Ogre::BillboardChain>(display).front()->getMaterial()->isTransparent());
  display->subProp("Only distinct")->setValue(false);
  EXPECT_TRUE(RvizHost::spin_until([&] { return loops() == 3; }, kPatience_s)) << loops();
  display->subProp("Refused candidates")->setValue(true);
  EXPECT_TRUE(RvizHost::spin_until([&] { return thin_lines() == 7; }, kPatience_s)) << thin_lines();
  display->subProp("Objects")->setValue(false);
  EXPECT_TRUE(RvizHost::spin_until([&] { return thin_lines() == 1; }, kPatience_s)) << thin_lines();
}

}  // namespace
}  // namespace semantic_topo_loop

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "rviz_plugin_test");
  if (argc > 1) semantic_topo_loop::default_file = argv[1];
  const QApplication application(argc, argv);
  return RUN_ALL_TESTS();
}
