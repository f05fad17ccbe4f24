#include "tools/report/report.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "support/program_test.h"
#include "tools/report/chart.h"
#include "tools/report/page.h"

namespace semantic_topo_loop::core {
namespace {

std::size_t count(const std::string& text, const std::string& part) {
  std::size_t n = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + part.size())) ++n;
  return n;
}

std::vector<std::string> labels(const std::vector<Tick>& ticks) {
  std::vector<std::string> texts;
  for (const Tick& tick : ticks) texts.push_back(tick.label);
  return texts;
}

using Texts = std::vector<std::string>;

TEST(Chart, TicksAreRoundNumbers) {
  EXPECT_EQ(labels(ticks({"", -0.04, 1.04}, 5)), (Texts{"0.0", "0.2", "0.4", "0.6", "0.8", "1.0"}));
  EXPECT_EQ(labels(ticks({"", 0.0, 98.8}, 5)), (Texts{"0", "20", "40", "60", "80"}));
  EXPECT_EQ(labels(ticks({"", -1.7e3, 1.2e3}, 3)), (Texts{"-1000", "0", "1000"}));
  EXPECT_EQ(labels(ticks({"", 0.004, 30000.0, true}, 3)), (Texts{"0.01", "0.1", "1", "10", "100", "1000", "10000"}));
  EXPECT_EQ(labels(ticks({"", 0.8, 12.0, true}, 3)), (Texts{"1", "2", "5", "10"}));
}

TEST(Chart, AxesHoldEveryValueAndAreNeverEmpty) {
  const Axis one = axis_over("x", {3.0});
  EXPECT_LT(one.min, 3.0);
  EXPECT_GT(one.max, 3.0);
  const Axis none = axis_over("x", {});
  EXPECT_LT(none.min, none.max);
  const Axis zeros = axis_over("x", {0.0, 0.0}, true);
  EXPECT_GT(zeros.min, 0.0);
  EXPECT_LT(zeros.min, zeros.max);
  const Axis decades = axis_over("x", {0.0, 0.001, 10.0}, true);
  EXPECT_GT(decades.min, 0.0);
  EXPECT_LT(decades.min, 0.001);
  EXPECT_GT(decades.max, 10.0);
}

TEST(Chart, APlanHasOneScaleAndShowsItsExtent) {
  Extent extent;
  extent.add({1.0, -2.0}, {0.5, 0.5});
  extent.add({9.0, 2.0});
  for (const double height_max : {0.6, 1.0}) {
    const Chart chart = Chart::plan(600.0, height_max, extent);
    const Vec2 low = chart.to_px({0.5, -2.5}), high = chart.to_px({9.0, 2.0});
    EXPECT_NEAR((high.x() - low.x()) / 8.5, chart.px_per_m(), 1e-9);
    EXPECT_NEAR((low.y() - high.y()) / 4.5, chart.px_per_m(), 1e-9) << "y is up";
    EXPECT_GE(low.x(), 0.0);
    EXPECT_LE(high.x(), chart.inner().x());
    EXPECT_GE(high.y(), 0.0);
    EXPECT_LE(low.y(), chart.inner().y());
  }
  EXPECT_GT(Chart::plan(600.0, 1.0, {}).px_per_m(), 0.0) << "nothing to be seen";
}

TEST(Chart, ALineKeepsItsEndsAndStopsAtBreaks) {
  Chart chart({400.0, 200.0}, {"x, s", 0.0, 1.0}, {"y, m", 0.0, 1.0});
  std::vector<Vec2> values;
  for (int i = 0; i <= 100000; ++i) values.emplace_back(1e-5 * i, 0.5);
  chart.line(values, "#123456");
  const std::string dense = chart.svg("dense");
  EXPECT_LT(dense.size(), 10000u);
  EXPECT_NE(dense.find("points=\"0,68 "), std::string::npos) << dense;
  EXPECT_NE(dense.find("334,68\""), std::string::npos) << dense;
  chart.line({{0.0, 0.0}, {0.1, 0.1}, line_break(), {0.5, 0.5}, {0.6, 0.6}}, "#654321");
  EXPECT_EQ(count(chart.svg("broken"), "stroke=\"#654321\""), 2u);
}

TEST(Chart, ASeriesKeepsPeaks) {
  Chart chart({400.0, 200.0}, {"time, s", 0.0, 1000.0}, {"y", 0.0, 1.0});
  std::vector<Vec2> values;
  for (int i = 0; i <= 100000; ++i) values.emplace_back(0.01 * i, i == 54321 ? 1.0 : 0.0);
  chart.series(values, "#123456");
  const std::string svg = chart.svg("peak");
  EXPECT_LT(svg.size(), 20000u);
  EXPECT_NE(svg.find(",0 "), std::string::npos) << "the highest value is at the top";
}

TEST(Chart, NamesAvoidEachOtherAndWhatIsBesideTheirSpace) {
  constexpr double kLeft_px = 135.0;
  LabelPlacer placer({kLeft_px, 0.0}, {300.0, 100.0});
  std::set<std::string> places;
  for (int i = 0; i < 5; ++i) {
    const std::string text = placer.place("cup", {150.0, 50.0}, {8.0, 8.0}, "class=\"name\"");
    places.insert(text.substr(0, text.find("class")));
    EXPECT_GT(std::stod(text.substr(text.find('"') + 1)), kLeft_px) << text;
  }
  EXPECT_EQ(places.size(), 5u);
}

TEST(Page, WhatHasAMeaningForHtmlIsReplaced) {
  EXPECT_EQ(escaped("<b>&\"'"), "&lt;b&gt;&amp;&quot;&#39;");
  HtmlTable table({"<i>", "n"});
  table.add({"<script>", "1.5"});
  table.add({"b", ""});
  EXPECT_EQ(table.html().find("<script>"), std::string::npos);
  EXPECT_NE(table.html().find("<th>&lt;i&gt;</th><th class=\"number\">n</th>"), std::string::npos) << table.html();
  EXPECT_NE(tile("<1>", "&").find("<b>&lt;1&gt;</b><span>&amp;</span>"), std::string::npos);
}

/// A run of some frames along a curve, as the recorder writes it.
class Report : public ProgramTest {
 protected:
  static constexpr std::int64_t kStart_ns = 1'000'000'000'000, kPeriod_ns = 100'000'000;
  static constexpr const char* kLabel = "<b>&\"";

  Report() : ProgramTest(STL_PROGRAM_DIR "/report") {}

  static SE3 pose(int i) {
    return {Quaternion(Eigen::AngleAxisd(-0.1 * i, Vec3::UnitY())), Vec3(0.1 * i, 0.0, 0.001 * i * i)};
  }

  static LoopClosure loop(int query, int inliers) {
    LoopClosure loop;
    loop.query_frame = loop.query_end = query;
    loop.match_frame = loop.match_end = 1;
    loop.query_keyframe_id = query;
    loop.match_keyframe_id = 1;
    loop.query_stamp_ns = kStart_ns + query * kPeriod_ns;
    loop.match_stamp_ns = kStart_ns + kPeriod_ns;
    loop.accepted = true;
    loop.reason = LoopReason::kAccepted;
    loop.inliers = inliers;
    for (int k = 0; k < inliers; ++k) {
      loop.matches.push_back({k, k + 10});
      loop.query_objects.push_back({k, 41, Vec3(0.2 * k, 0.1, 1.0), 0.05});
      loop.match_objects.push_back({k + 10, 41, Vec3(0.2 * k, 0.1, 1.0), 0.05});
    }
    loop.match_objects.push_back({99, 41, Vec3(0.5, 0.1, 2.0), 0.05});
    return loop;
  }

  /// @param loops accepted ones, with so many objects, each with a candidate that is refused; of the accepted ones the
  /// second is not believed; if there are any, two more are from outside
  /// @param first frame of this run: a later one than the first of all goes on with a map, to which the loops lead
  void write_run(int frames, const std::vector<int>& loops, bool with_object, int first = 0) {
    const auto classes =
        std::make_shared<const ClassTable>(*ClassTable::create({{41, kLabel, ClassRole::kMovable, "", 0.1}}));
    const auto recorder = make_run_recorder(classes, directory_.path(""));
    StampedPoses truth;
    for (int i = first; i < first + frames; ++i) {
      Frame frame;
      frame.frame_id = frame.keyframe_id = i;
      frame.is_keyframe = true;
      frame.stamp_ns = kStart_ns + i * kPeriod_ns;
      frame.T_odom_camera = pose(i);
      recorder->record(frame);
      truth.push_back({frame.stamp_ns, pose(i)});
    }
    MapUpdate update;
    Landmark landmark;
    landmark.id = 7;
    landmark.class_id = 41;
    landmark.state = LandmarkState::kConfirmed;
    landmark.ellipsoid = Ellipsoid{SE3(Quaternion::Identity(), Vec3(1.0, 0.0, 2.0)), Vec3(0.3, 0.1, 0.2)};
    if (with_object) update.changed = {landmark};
    recorder->record(update);
    std::int64_t query = first + 5;
    MapCorrection correction;
    correction.changed = true;
    for (const int inliers : loops) {
      LoopClosure refused = loop(static_cast<int>(query), inliers);
      refused.accepted = false;
      refused.reason = LoopReason::kTilt;
      recorder->record(query, {loop(static_cast<int>(query), inliers), refused}, 10.0);
      const bool kept = query != first + 6;
      correction.loops.push_back({query, query, 1, kept, kept ? "" : "it is wrong: by 3 m", false});
      ++query;
    }
    if (!loops.empty()) {
      correction.loops.push_back({query, first + 6, 1, true, "", true});
      correction.loops.push_back({query + 1, first + 5, 1, false, "it is wrong: by 4 m", true});
    }
    if (first > 0) correction.loops.push_back({3, 3, 1, false, "another one now: by 5 m", true});
    recorder->record(correction);
    ASSERT_TRUE(recorder->write(directory_.path("run")));
    ASSERT_TRUE(write_tum_trajectory(directory_.path("gt.txt"), truth));
    directory_.write("reference.csv",
                     "id,label_id,label,x,y,z,a,b,c,certainty\n0,41,cup,1,0,2,0.1,0.1,0.1,certain\n"
                     "1,41,cup,3,0,2,0.1,0.1,0.1,certain\n");
  }

  std::string html() const { return read_whole(directory_.path("run/report.html")); }
  /// What stands between the page's parts of these names.
  std::string part(const std::string& id) const {
    const std::string text = html();
    const std::size_t begin = text.find("<section id=\"" + id);
    return begin == std::string::npos ? "" : text.substr(begin, text.find("</section>", begin) - begin);
  }
};

TEST_F(Report, ShowsEveryPartOfARun) {
  write_run(12, {5, 8, 6}, true);
  ASSERT_EQ(run("@run --groundtruth @gt.txt --reference @reference.csv --odometry @gt.txt"), 0) << err_;
  for (const char* id : {"trajectories", "objects", "loops", "timing", "memory"}) {
    EXPECT_GE(count(part(id), "<svg class=\"chart\""), 1u) << id;
  }
  EXPECT_NE(part("trajectories").find("<td>odometry</td><td class=\"number\">12</td>"), std::string::npos);
  EXPECT_NE(part("objects").find("certain references found: 1 of 2"), std::string::npos);
  EXPECT_EQ(count(part("objects"), "<circle"), 1u) << "the missed one";
  EXPECT_NE(part("loops").find("<td>accepted</td><td class=\"number\">3</td>"), std::string::npos);
  EXPECT_NE(part("loops").find("<td>accepted, but not believed: it is wrong</td><td class=\"number\">1</td>"),
            std::string::npos);
  EXPECT_NE(part("loops").find("<td>tilt</td><td class=\"number\">3</td>"), std::string::npos);
  EXPECT_NE(part("loops").find("<td>from outside</td><td class=\"number\">2</td>"), std::string::npos);
  EXPECT_NE(part("loops").find("<td>from outside, but not believed: it is wrong</td><td class=\"number\">1</td>"),
            std::string::npos);
  EXPECT_EQ(count(html(), "http"), 0u) << "nothing is fetched";
}

TEST_F(Report, LoopsIntoTheMapThatTheRunGoesOnWithAreJudgedAndDrawn) {
  write_run(12, {5, 8, 6}, true, 100);
  ASSERT_EQ(run("@run --loop 3"), 0) << err_;
  const std::string loops = part("loops");
  EXPECT_NE(loops.find("<td>accepted</td><td class=\"number\">3</td>"), std::string::npos);
  EXPECT_EQ(count(loops, "<td>accepted, but not believed"), 1u);
  EXPECT_NE(loops.find("<td>accepted, but not believed: it is wrong</td><td class=\"number\">1</td>"),
            std::string::npos);
  EXPECT_NE(loops.find("<td>from outside</td><td class=\"number\">2</td>"), std::string::npos)
      << "those of the session before are not of this run";
  EXPECT_NE(loops.find("frames 1 (earlier session) and 107 (0.7 s); believed.</p>"), std::string::npos);
  EXPECT_NE(loops.find("6 match an earlier session"), std::string::npos);
  EXPECT_EQ(count(loops, " class=\"pick\""), 3u);
  double cy = 0.0;
  const std::size_t at = loops.rfind("<circle cx=", loops.find(" class=\"pick\""));
  ASSERT_EQ(std::sscanf(loops.c_str() + at, "<circle cx=\"%*f\" cy=\"%lf\"", &cy), 1);
  EXPECT_LT(cy, 400.0) << "in the picture";
}

TEST_F(Report, TheSameFilesGiveTheSameBytes) {
  write_run(12, {5, 8}, true);
  ASSERT_EQ(run("@run"), 0) << err_;
  const std::string first = html();
  ASSERT_EQ(run("@run/"), 0) << err_;
  EXPECT_EQ(first, html());
}

TEST_F(Report, TheLoopOfMostObjectsIsShownUnlessAnotherIsAskedFor) {
  write_run(12, {5, 8, 6}, true);
  ASSERT_EQ(run("@run"), 0) << err_;
  EXPECT_NE(part("loops").find("<div id=\"loop-picture\">\n<p>Loop 2: 8 matched objects of 9 and 8"),
            std::string::npos);
  EXPECT_EQ(count(part("loops"), "<template"), 3u);
  ASSERT_EQ(run("@run --loop 3"), 0) << err_;
  EXPECT_NE(part("loops").find("<div id=\"loop-picture\">\n<p>Loop 3: 6 matched objects"), std::string::npos);
  expect_failure("@run --loop 4", 1, "run/loops.csv: loop 4 is none of the 3 accepted ones");
}

/// Lines that join pairs: between the submaps, and where both are on top of each other.
TEST_F(Report, ALoopsPictureJoinsWhatWasMatched) {
  write_run(12, {8}, true);
  ASSERT_EQ(run("@run"), 0) << err_;
  const std::string loops = part("loops"), picture = loops.substr(loops.find("<div id=\"loop-picture\">"));
  const std::string shown = picture.substr(0, picture.find("<template"));
  const auto lines_of = [&shown](const std::string& name) {
    const std::size_t begin = shown.find("<g class=\"" + name + "\">");
    return count(shown.substr(begin, shown.find("</g>", begin) - begin), "<line");
  };
  EXPECT_EQ(lines_of("pairs"), 8u);
  EXPECT_EQ(lines_of("off"), 8u);
  EXPECT_EQ(count(shown, "<circle"), 2u * (9u + 8u));
  EXPECT_EQ(count(shown, "class=\"alone\""), 2u);
}

TEST_F(Report, LabelsAreTextsWhateverIsInThem) {
  write_run(12, {5}, true);
  ASSERT_EQ(run("@run"), 0) << err_;
  EXPECT_EQ(html().find("<b>&\""), std::string::npos);
  EXPECT_NE(part("objects").find("&lt;b&gt;&amp;&quot; 7</text>"), std::string::npos);
  EXPECT_NE(part("loops").find("&lt;b&gt;&amp;&quot;</text>"), std::string::npos);
}

TEST_F(Report, ARunOfOneFrameWithoutObjectsAndLoopsHasAPage) {
  write_run(1, {}, false);
  ASSERT_EQ(run("@run"), 0) << err_;
  EXPECT_NE(part("objects").find("The run has no object."), std::string::npos);
  EXPECT_NE(part("loops").find("There was no candidate for a loop."), std::string::npos);
  EXPECT_NE(part("trajectories").find("<svg"), std::string::npos);
  EXPECT_EQ(html().find("nan"), std::string::npos);
  EXPECT_EQ(html().find("inf"), std::string::npos);
}

TEST_F(Report, FilesThatAreMissingOrDamagedAreOneClearError) {
  write_run(12, {5}, true);
  for (const char* name : {"trajectory_live.txt", "trajectory.txt", "keyframes.csv", "objects.csv", "loops.csv",
                           "loop_verdicts.csv", "loop_objects.csv", "timing.csv", "memory.csv"}) {
    const std::string path = directory_.path(std::string("run/") + name), text = read_whole(path);
    std::filesystem::remove(path);
    expect_failure("@run", 1, std::string("run/") + name + ": cannot open the file");
    const auto line = std::to_string(std::count(text.begin(), text.end(), '\n'));
    directory_.write(std::string("run/") + name,
                     text.substr(0, text.rfind(name[0] == 't' && name[1] == 'r' ? ' ' : ',')));
    expect_failure("@run", 1, std::string("run/") + name + ":" + line + ": ");
    directory_.write(std::string("run/") + name, text);
  }
  const std::string timing = read_whole(directory_.path("run/timing.csv"));
  directory_.write("run/timing.csv", timing.substr(0, timing.rfind('\n', timing.size() - 2) + 1));
  expect_failure("@run", 1, "run/timing.csv: 11 frames, but trajectory.txt has 12");
}

TEST_F(Report, ArgumentsThatDoNotFitAreOneClearError) {
  expect_failure("", 2, "RUN_DIR");
  expect_failure("@run --reference @reference.csv", 2, "argument --reference needs --groundtruth");
  expect_failure("@run --scale", 2, "argument --scale needs --groundtruth");
  expect_failure("@run --loop 0", 2, "--loop");
  expect_failure("@none", 1, "none/keyframes.csv: cannot open the file");
}

/// Seen from above: the map's y axis is down, as of a trajectory that began with a level camera.
TEST_F(Report, UpIsFoundFromTheCamerasOfARunWithoutGroundTruth) {
  write_run(40, {}, true);
  ASSERT_EQ(run("@run"), 0) << err_;
  EXPECT_EQ(part("trajectories").find("hardly turned"), std::string::npos);
  // The ellipsoid's axes along x and z are seen, 0.3 and 0.2 m.
  const std::string objects = part("objects"), rx = "<ellipse rx=\"";
  const std::size_t at = objects.find(rx);
  ASSERT_NE(at, std::string::npos);
  double a = 0.0, b = 0.0;
  ASSERT_EQ(std::sscanf(objects.c_str() + at, "<ellipse rx=\"%lf\" ry=\"%lf\"", &a, &b), 2);
  EXPECT_NEAR(a / b, 1.5, 0.01);
}

}  // namespace
}  // namespace semantic_topo_loop::core
