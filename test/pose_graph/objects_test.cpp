#include <gtest/gtest.h>

#include <functional>
#include <optional>
#include <set>

#include "pose_graph/graph_state.h"
#include "pose_graph/solver/graph_objects.h"
#include "pose_graph/solver/graph_solver.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "support/synthetic_run.h"

namespace semantic_topo_loop::core {
namespace {

const Camera kCamera{520.0, 520.0, 320.0, 240.0, 640, 480, {}};
constexpr std::int64_t kOtherIds = 1000;  ///< added to the ids of the second round where it has its own

/// The synthetic run's camera looks up: lamps that hang over it.
std::vector<Ellipsoid> lamps(int count = 40) {
  Random random(5);
  std::vector<Ellipsoid> result;
  for (int i = 0; i < count; ++i) {
    const Vec3 center(random.uniform(-3.5, 3.5), random.uniform(-2.5, 2.5), random.uniform(1.5, 3.0));
    const Vec3 axes(random.uniform(0.1, 0.2), random.uniform(0.1, 0.2), random.uniform(0.1, 0.2));
    result.push_back({SE3(so3_exp(random.normal3()), center), axes});
  }
  return result;
}

struct Observer {
  SyntheticRun run;
  std::vector<Ellipsoid> objects = lamps();
  bool has_other_ids = false;  ///< in the second round
  std::function<bool(int object, int keyframe)> sees = [](int, int) { return true; };
  std::function<void(int keyframe, MapUpdate*)> edit = [](int, MapUpdate*) {};
  std::function<double(int object, int keyframe)> box_error_px = [](int, int) { return 0.0; };  ///< to the right
  std::vector<LoopClosure> loops = {};

  std::int64_t id(int object, int keyframe) const {
    return object + (has_other_ids && keyframe >= run.round() ? kOtherIds : 0);
  }

  AssociationFrame associations(int k) const {
    AssociationFrame result;
    result.frame_id = k;
    for (int i = 0; i < static_cast<int>(objects.size()); ++i) {
      auto box = project_box(objects[static_cast<std::size_t>(i)], projection_matrix(kCamera, run.truth(k)));
      if (!box || !sees(i, k)) continue;
      box->x1 += box_error_px(i, k);
      box->x2 += box_error_px(i, k);
      Association association;
      association.landmark_id = id(i, k);
      association.truncated = truncated_sides(*box, kCamera.width, kCamera.height, 8.0);
      association.box = clip(*box, kCamera.width, kCamera.height);
      if (association.box.width() > 10.0 && association.box.height() > 10.0) result.associations.push_back(association);
    }
    return result;
  }

  /// Landmarks that hang on the keyframe in which they are seen first.
  MapUpdate map(int k, const AssociationFrame& seen, std::set<std::int64_t>* known) const {
    MapUpdate update;
    for (const Association& association : seen.associations) {
      if (!known->insert(association.landmark_id).second) continue;
      const Ellipsoid& object = objects[static_cast<std::size_t>(association.landmark_id % kOtherIds)];
      Landmark landmark;
      landmark.id = association.landmark_id;
      landmark.state = LandmarkState::kConfirmed;
      landmark.anchor_keyframe_id = k;
      landmark.ellipsoid =
          Ellipsoid{run.odometry(k) * run.truth(k).inverse() * object.T_world_quadric, object.semi_axes};
      update.changed.push_back(landmark);
    }
    edit(k, &update);
    return update;
  }

  /// @param changed options that the graph is given before the end
  std::vector<KeyframePose> finish(const PoseGraphOptions& options,
                                   const std::optional<PoseGraphOptions>& changed = std::nullopt) const {
    PoseGraph graph(options);
    run_through(&graph);
    if (changed) graph.set_options(*changed);
    graph.process(run.end_frame(), {});
    return graph.keyframes();
  }

  void run_through(PoseGraph* graph) const {
    std::set<std::int64_t> known;
    run_through(0, run.size(), &known, graph);
  }

  void run_through(int begin, int end, std::set<std::int64_t>* known, PoseGraph* graph) const {
    for (int k = begin; k < end; ++k) {
      Frame frame = run.frame(k);
      frame.camera = kCamera;
      const AssociationFrame seen = associations(k);
      graph->observe(frame, seen);
      graph->process(frame, loops_at(k, loops));
      graph->apply(map(k, seen, known));
    }
  }

  /// The second round as a later session, which goes on with the graph of the first.
  std::vector<KeyframePose> in_two_sessions(const PoseGraphOptions& options) const {
    std::set<std::int64_t> known;
    PoseGraph first(options), second(options);
    run_through(0, run.round(), &known, &first);
    second.restore(first.state());
    known.clear();
    for (int k = 0; k < run.round(); ++k) {
      second.recall(k, kCamera, associations(k));
      second.apply(map(k, associations(k), &known));
    }
    run_through(run.round(), run.size(), &known, &second);
    second.process(run.end_frame(), {});
    return second.keyframes();
  }

  double worst_error_m(const PoseGraphOptions& options) const { return run.worst_error_m(finish(options)); }
};

PoseGraphOptions with_objects() {
  PoseGraphOptions options;
  options.objects = "on";
  // The odometry and the exact boxes of drifting_observer().
  options.object_sigma_px = 0.5;
  options.object_sigma_share = 0.0;
  options.translation_noise_m = 0.01;
  options.rotation_noise_deg = 0.25;
  return options;
}

Observer drifting_observer() {
  Observer observer;
  observer.run.drift(0.003, 0.001, 3);
  return observer;
}

double largest_difference_m(const std::vector<KeyframePose>& a, const std::vector<KeyframePose>& b) {
  double worst = a.size() == b.size() ? 0.0 : 1e9;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    worst = std::max(worst, (a[i].T_map_camera.t - b[i].T_map_camera.t).norm());
  }
  return worst;
}

/// Figures of a view by a step of (camera t, camera rotation, centre, log axes).
template <int n>
void expect_numeric(const ObjectTerms<n>& terms,
                    const std::function<ObjectTerms<n>(const SE3&, const Ellipsoid&)>& evaluate, const SE3& T,
                    const Ellipsoid& ellipsoid) {
  constexpr double kStep = 1e-6;
  for (int block = 0; block < 4; ++block) {
    for (int axis = 0; axis < 3; ++axis) {
      const auto moved = [&](double step) {
        const Vec3 d = step * Vec3::Unit(axis);
        SE3 camera = T;
        Ellipsoid object = ellipsoid;
        if (block == 0) camera.t += d;
        if (block == 1) camera.q = so3_exp(d) * camera.q;
        if (block == 2) object.T_world_quadric.t += d;
        if (block == 3) object.semi_axes = object.semi_axes.array() * d.array().exp();
        return evaluate(camera, object).error;
      };
      const auto* jacobians = &terms.camera_t;
      const Eigen::Matrix<double, n, 1> numeric = (moved(kStep) - moved(-kStep)) / (2.0 * kStep);
      EXPECT_LT((jacobians[block].col(axis) - numeric).norm(), 1e-5 * (1.0 + numeric.norm())) << block << " " << axis;
    }
  }
}

TEST(ObjectTerms, DerivativesAgreeWithNumericOnes) {
  Random random(1);
  for (int trial = 0; trial < 20; ++trial) {
    const SE3 T_world_camera = random_motion(&random, 2.0, 2.0);
    const Vec3 center = T_world_camera * Vec3(random.uniform(-0.4, 0.4), random.uniform(-0.3, 0.3), 2.0);
    const Ellipsoid ellipsoid{SE3(so3_exp(random.normal3()), center), Vec3(0.1, 0.2, 0.35)};
    GraphObjectView view;
    view.intrinsics = {520.0, 500.0, 320.0, 240.0};
    view.box = {300.0, 200.0, 350.0, 260.0};
    view.truncated = trial % 2 == 0 ? 0 : kRight;
    view.depth = SurfaceDepth{Vec3(0.1, -0.05, 1.0).normalized(), 1.8};
    const auto box = [&view](const SE3& T, const Ellipsoid& e) { return *box_terms(view, T, e); };
    const auto depth = [&view](const SE3& T, const Ellipsoid& e) { return depth_terms(*view.depth, T, e); };
    expect_numeric<4>(box(T_world_camera, ellipsoid), box, T_world_camera, ellipsoid);
    expect_numeric<1>(depth(T_world_camera, ellipsoid), depth, T_world_camera, ellipsoid);
  }
}

TEST(ObjectTerms, ABoxOfTheEllipsoidItselfHasNoError) {
  const Ellipsoid ellipsoid{SE3(so3_exp(Vec3(0.3, 0.2, 0.1)), Vec3(0.1, 0.2, 2.0)), Vec3(0.1, 0.2, 0.3)};
  GraphObjectView view;
  view.intrinsics = {520.0, 520.0, 320.0, 240.0};
  view.box = *project_box(ellipsoid, projection_matrix(kCamera, SE3()));
  EXPECT_LT(box_terms(view, SE3(), ellipsoid)->error.norm(), 1e-9);
  EXPECT_FALSE(box_terms(view, SE3(Quaternion::Identity(), Vec3(0.0, 0.0, 5.0)), ellipsoid).has_value());
}

TEST(ObjectTerms, TheVisibleSideOfASphereIsSeenBeforeItsCentre) {
  const Ellipsoid sphere{SE3(Quaternion::Identity(), Vec3(0.0, 0.0, 2.0)), Vec3::Constant(0.1)};
  EXPECT_NEAR(depth_terms({Vec3::UnitZ(), 1.93}, SE3(), sphere).error(0), 0.0, 1e-12);
}

TEST(ObjectsInThePoseGraph, ReduceTheErrorWithoutAnyLoop) {
  const Observer observer = drifting_observer();
  PoseGraphOptions off = with_objects();
  off.objects = "off";
  const double before = observer.worst_error_m(off), after = observer.worst_error_m(with_objects());
  EXPECT_NEAR(before, observer.run.worst_odometry_error_m(), 1e-9);
  ASSERT_GT(before, 0.03);
  EXPECT_LT(after, 0.3 * before);
}

TEST(ObjectsInThePoseGraph, OffMeansThatNothingIsChanged) {
  const Observer observer = drifting_observer();
  PoseGraphOptions off;
  off.objects = "off";
  EXPECT_EQ(largest_difference_m(observer.finish(off), finish(observer.run, {}).graph.keyframes()), 0.0);
}

TEST(ObjectsInThePoseGraph, TheirNoiseMayChangeMeanwhile) {
  const Observer observer = drifting_observer();
  PoseGraphOptions light = with_objects();
  light.object_sigma_px = 100.0;
  const auto after = observer.finish(with_objects(), light);
  EXPECT_EQ(largest_difference_m(after, observer.finish(light)), 0.0);
  EXPECT_GT(largest_difference_m(after, observer.finish(with_objects())), 1e-3);
}

TEST(ObjectsInThePoseGraph, AutoLeavesOdometryWithoutLoopsAlone) {
  const Observer observer = drifting_observer();
  PoseGraphOptions options = with_objects();
  options.objects = "auto";
  EXPECT_EQ(largest_difference_m(observer.finish(options), finish(observer.run, {}).graph.keyframes()), 0.0);
  EXPECT_TRUE(validate(options)) << validate(options).message();
  options.objects = "always";
  EXPECT_EQ(validate(options).message(), "parameter 'pose_graph.objects' = 'always' must be off, auto or on");
}

TEST(ObjectsInThePoseGraph, AutoCorrectsOdometryThatLoopsFindWrongAndNoOther) {
  for (const double drift_m : {0.0, 0.02}) {
    Observer observer;
    if (drift_m > 0.0) observer.run.drift(drift_m, 0.005, 3);
    observer.loops = noisy_loops(observer.run, 7);
    PoseGraphOptions options = with_objects();
    options.objects = PoseGraphOptions().objects;
    ASSERT_EQ(options.objects, "auto");
    const double with_objects_m = observer.worst_error_m(options);
    options.objects = "off";
    const double loops_alone_m = observer.worst_error_m(options);
    if (drift_m > 0.0) {
      EXPECT_LT(with_objects_m, 0.8 * loops_alone_m);
    } else {
      EXPECT_EQ(with_objects_m, loops_alone_m);
    }
  }
}

TEST(ObjectsInThePoseGraph, TakePartWhileTheRobotRuns) {
  Observer observer;
  observer.run.drift(0.02, 0.005, 3);
  observer.loops = noisy_loops(observer.run, 7);
  const auto worst_error_m = [&observer](const char* objects) {
    PoseGraphOptions options = with_objects();
    options.objects = objects;
    PoseGraph graph(options);
    observer.run_through(&graph);
    return observer.run.worst_error_m(graph.keyframes());
  };
  EXPECT_LT(worst_error_m("auto"), 0.8 * worst_error_m("off"));
}

/// Exact odometry of two sessions, loops between them that are all off alike, and boxes that err by where they are seen
/// from: in both rounds the same.
Observer two_biased_sessions() {
  Observer observer;
  observer.run.restart(observer.run.round(), SE3(so3_exp(Vec3(0.3, -0.2, 1.0)), Vec3(4.0, -2.0, 1.0)));
  const int round = observer.run.round();
  observer.box_error_px = [round](int object, int keyframe) {
    return 6.0 * std::sin(2.0 * object + 2.0 * kPi * 4.0 * keyframe / round);
  };
  Vec6 bias;
  bias << 0.05, -0.03, 0.04, 0.02, 0.01, -0.02;
  for (int k = round + 10; k < observer.run.size(); k += 5) {
    observer.loops.push_back(observer.run.loop(k, k - round, bias, 0.06, 0.03));
  }
  return observer;
}

TEST(ObjectsInThePoseGraph, BoxesFromTheSamePlacesSayHowTwoSessionsStandToEachOther) {
  const Observer observer = two_biased_sessions();
  PoseGraphOptions options, off;
  off.objects = "off";
  const double loops_alone_m = observer.run.worst_error_m(observer.in_two_sessions(off));
  EXPECT_GT(loops_alone_m, 0.05);
  EXPECT_LT(observer.run.worst_error_m(observer.in_two_sessions(options)), 0.3 * loops_alone_m);
}

/// Cameras in three groups look at a ball from three sides; its boxes are shifted by one amount in each group, so that
/// no place of the ball fits all three. What one box errs by must not become six times as sure by six of them.
TEST(ObjectsInThePoseGraph, ErrorsThatViewsFromOneSideShareCountOnce) {
  constexpr int kGroups = 3, kInGroup = 6;
  const double shifts_px[kGroups] = {8.0, -8.0, 8.0};
  const Ellipsoid ball{SE3(), Vec3::Constant(0.15)};
  std::vector<SE3> truth;
  GraphObject object{0, SE3(), ball.semi_axes, {}};
  for (int i = 0; i < kGroups * kInGroup; ++i) {
    const double angle = radians(50.0 * (i / kInGroup) + 1.0 * (i % kInGroup));
    truth.emplace_back(so3_exp(Vec3(0.0, angle, 0.0)), -2.0 * Vec3(std::sin(angle), 0.0, std::cos(angle)));
    GraphObjectView view;
    view.vertex = i;
    view.intrinsics = {kCamera.fx, kCamera.fy, kCamera.cx, kCamera.cy};
    view.box = *project_box(ball, projection_matrix(kCamera, truth.back()));
    view.box.x1 += shifts_px[i / kInGroup];
    view.box.x2 += shifts_px[i / kInGroup];
    object.views.push_back(view);
  }
  object.T_anchor_quadric = truth.front().inverse() * ball.T_world_quadric;
  std::vector<GraphEdge> edges;
  for (int i = 1; i < static_cast<int>(truth.size()); ++i) {
    const SE3 motion = truth[static_cast<std::size_t>(i - 1)].inverse() * truth[static_cast<std::size_t>(i)];
    Mat6 sqrt_info = Mat6::Identity();
    sqrt_info.topLeftCorner<3, 3>() *= 1.0 / 0.02;
    sqrt_info.bottomRightCorner<3, 3>() *= 1.0 / 0.01;
    edges.push_back({i - 1, i, motion, sqrt_info, 1.0, false});
  }
  std::vector<SE3> poses = truth;
  ASSERT_TRUE(solve_graph(edges, {}, &poses, {{}, {object}}).usable);
  double worst_m = 0.0, worst_rad = 0.0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    worst_m = std::max(worst_m, (poses[i].t - truth[i].t).norm());
    worst_rad = std::max(worst_rad, rotation_angle(poses[i].q, truth[i].q));
  }
  EXPECT_LT(worst_m, 0.06);
  EXPECT_LT(worst_rad, 0.007);
}

TEST(ObjectsInThePoseGraph, AnObjectOfOneViewIsLeftOut) {
  Observer observer = drifting_observer();
  const auto without = observer.finish(with_objects());
  const auto seen_first = observer.associations(0).associations.front().landmark_id;
  observer.objects.push_back(observer.objects[static_cast<std::size_t>(seen_first)]);
  const int added = static_cast<int>(observer.objects.size()) - 1;
  observer.sees = [added](int object, int keyframe) { return object != added || keyframe == 0; };
  ASSERT_EQ(observer.associations(0).associations.back().landmark_id, added);
  EXPECT_EQ(largest_difference_m(observer.finish(with_objects()), without), 0.0);
}

TEST(ObjectsInThePoseGraph, WithoutAnyThatCountTheSolutionIsThatOfTheLoops) {
  Observer observer = drifting_observer();
  observer.loops = noisy_loops(observer.run, 7);
  observer.sees = [](int, int keyframe) { return keyframe == 0; };
  PoseGraphOptions off = with_objects();
  off.objects = "off";
  EXPECT_EQ(largest_difference_m(observer.finish(with_objects()), observer.finish(off)), 0.0);
}

TEST(ObjectsInThePoseGraph, AnObjectWithHardlyAnyParallaxDoesNotDisturb) {
  Observer observer = drifting_observer();
  const auto without = observer.finish(with_objects());
  Ellipsoid far = observer.objects.front();
  far.T_world_quadric.t.z() += 50.0;
  far.semi_axes *= 20.0;
  observer.objects.push_back(far);
  const int added = static_cast<int>(observer.objects.size()) - 1;
  observer.sees = [added](int object, int keyframe) { return object != added || keyframe < 6; };
  EXPECT_LT(largest_difference_m(observer.finish(with_objects()), without), 0.005);
}

TEST(ObjectsInThePoseGraph, ConfirmedObjectsTakePartAndRetiredOnesDoNot) {
  Observer observer = drifting_observer();
  observer.edit = [&observer](int keyframe, MapUpdate* update) {
    if (keyframe != observer.run.size() - 1) return;
    for (int i = 0; i < static_cast<int>(observer.objects.size()); ++i) {
      Landmark landmark;
      landmark.id = i;
      landmark.state = LandmarkState::kRetired;
      update->changed.push_back(landmark);
    }
  };
  EXPECT_EQ(largest_difference_m(observer.finish(with_objects()), finish(observer.run, {}).graph.keyframes()), 0.0);
}

TEST(ObjectsInThePoseGraph, MergesLinkTwoRounds) {
  Observer observer = drifting_observer();
  observer.has_other_ids = true;
  const double apart = observer.worst_error_m(with_objects());
  observer.edit = [&observer](int keyframe, MapUpdate* update) {
    if (keyframe != observer.run.size() - 1) return;
    for (int i = 0; i < static_cast<int>(observer.objects.size()); ++i) update->merged.push_back({i + kOtherIds, i});
  };
  EXPECT_LT(observer.worst_error_m(with_objects()), 0.7 * apart);
}

TEST(ObjectsInThePoseGraph, AMergeThatIsTakenBackLeavesNoTrace) {
  Observer observer = drifting_observer();
  observer.has_other_ids = true;
  const auto never_merged = observer.finish(with_objects());
  const int last = observer.run.size() - 1;
  Landmark merged;
  observer.edit = [&merged, last](int keyframe, MapUpdate* update) {
    for (const Landmark& landmark : update->changed) {
      if (landmark.id >= kOtherIds && merged.id < 0) merged = landmark;
    }
    if (keyframe == last - 1) update->merged.push_back({merged.id, merged.id - kOtherIds});
    if (keyframe != last) return;
    update->unmerged.push_back({merged.id, merged.id - kOtherIds});
    update->changed.push_back(merged);
  };
  EXPECT_EQ(largest_difference_m(observer.finish(with_objects()), never_merged), 0.0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
