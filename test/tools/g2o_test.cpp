#include "tools/g2o/g2o.h"

#include <gtest/gtest.h>

#include <limits>

#include "geometry/relative_pose.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/text_file.h"
#include "support/random_motions.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr char kUnit[] = " 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n";

class G2o : public ::testing::Test {
 protected:
  Result<G2oGraph> read(const std::string& text) {
    EXPECT_EQ(write_text_file(path_, text).message(), "");
    return read_g2o(path_, &refusals_);
  }

  TestDirectory directory_;
  std::string path_ = directory_.path("graph.g2o");
  G2oRefusals refusals_;
};

/// A ring of poses, each seen from the next and from the one after it.
G2oGraph ring(int size, double noise_m, double noise_rad, std::uint64_t seed) {
  Random random(seed);
  G2oGraph graph;
  for (int i = 0; i < size; ++i) {
    const double phase = 2.0 * kPi * i / size;
    const SE3 T(so3_exp(Vec3(0.0, 0.0, phase)) * so3_exp(Vec3(0.2 * std::sin(phase), 0.0, 0.0)),
                Vec3(5.0 * std::cos(phase), 5.0 * std::sin(phase), std::sin(2.0 * phase)));
    graph.vertices.push_back({i, T, false});
  }
  for (int step : {1, 2}) {
    for (int i = 0; i < size; ++i) {
      const int j = (i + step) % size;
      G2oEdge edge;
      edge.from = i;
      edge.to = j;
      edge.T_from_to = graph.vertices[static_cast<std::size_t>(i)].T_world_vertex.inverse() *
                       graph.vertices[static_cast<std::size_t>(j)].T_world_vertex *
                       random_motion(&random, noise_m, noise_rad);
      edge.information = 100.0 * Mat6::Identity();
      graph.edges.push_back(edge);
    }
  }
  return graph;
}

TEST_F(G2o, WhatIsWrittenIsReadBack) {
  G2oGraph graph = ring(10, 0.1, 0.1, 1);
  graph.vertices[3].is_fixed = true;
  ASSERT_EQ(write_g2o(path_, graph).message(), "");
  const auto read = read_g2o(path_, &refusals_);
  ASSERT_TRUE(read) << read.message();
  EXPECT_TRUE(refusals_.empty());
  ASSERT_EQ(read->vertices.size(), 10U);
  ASSERT_EQ(read->edges.size(), 20U);
  EXPECT_TRUE(read->vertices[3].is_fixed);
  EXPECT_FALSE(read->vertices[4].is_fixed);
  for (std::size_t i = 0; i < 20; ++i) {
    EXPECT_EQ(read->edges[i].from, graph.edges[i].from);
    EXPECT_EQ(read->edges[i].T_from_to.t, graph.edges[i].T_from_to.t);
    EXPECT_LT(rotation_angle(read->edges[i].T_from_to.q, graph.edges[i].T_from_to.q), 1e-7);
    EXPECT_EQ(read->edges[i].information, graph.edges[i].information);
  }
}

TEST_F(G2o, PlanarGraphsKeepTheirAngles) {
  const std::string text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 1.5\nEDGE_SE2 0 1 1 0 1.5 10 1 2 20 3 30\n";
  const auto graph = read(text);
  ASSERT_TRUE(graph) << graph.message();
  EXPECT_TRUE(graph->is_planar);
  EXPECT_EQ(graph->edges[0].information(1, 5), 3.0);
  EXPECT_EQ(graph->edges[0].information(5, 5), 30.0);
  ASSERT_TRUE(write_g2o(path_, *graph));
  const auto again = read_g2o(path_, &refusals_);
  ASSERT_TRUE(again);
  EXPECT_NEAR(2.0 * std::atan2(again->vertices[1].T_world_vertex.q.z(), again->vertices[1].T_world_vertex.q.w()), 1.5,
              1e-12);
}

TEST_F(G2o, BadLinesAreNamedAndTheRestIsRead) {
  const std::string edge = " 1 0 0 0 0 0 1";
  const auto graph = read("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n" +
                          ("EDGE_SE3:QUAT 0 1" + edge + kUnit) +   // 3
                          "VERTEX_SE3:QUAT 1 2 0 0 0 0 0 1\n" +    // 4: twice
                          "VERTEX_SE3:QUAT 2 nan 0 0 0 0 0 1\n" +  // 5
                          "VERTEX_SE3:QUAT 3 0 0 0 0 0 0 0\n" +    // 6: no rotation
                          "VERTEX_SE3:QUAT 4 0 0\n" +              // 7
                          ("EDGE_SE3:QUAT 0 9" + edge + kUnit) +   // 8: unknown
                          ("EDGE_SE3:QUAT 1 1" + edge + kUnit) +   // 9: itself
                          "EDGE_SE3:QUAT 0 1" + edge + " -1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n" +        // 10
                          "EDGE_POINT 0 1 2\nFIX 7\nFIX x\n" + "EDGE_SE3:QUAT 1 0 1e308 0 0 0 0 0 1" + kUnit);  // 14
  ASSERT_TRUE(graph) << graph.message();
  EXPECT_EQ(graph->vertices.size(), 2U);
  ASSERT_EQ(graph->edges.size(), 1U);
  std::string all;
  for (const std::string& refusal : refusals_) all += refusal + "\n";
  for (const std::string part :
       {":4: vertex 1 is given twice", ":5: VERTEX_SE3:QUAT 2: 'nan' is no finite number", ":6: quaternion of norm 0",
        ":7: VERTEX_SE3:QUAT has 3 values instead of 8", ":8: edge 0 9 leads to the unknown vertex 9",
        ":9: edge 1 1 joins a vertex to itself", ":10: edge 0 1: its information matrix is not positive definite",
        ":11: unknown tag 'EDGE_POINT'", ":12: FIX of the unknown vertex 7", ":13: id 'x' is no number >= 0",
        ":14: EDGE_SE3:QUAT 1 0: '1e308' is no finite number below 1e30"}) {
    EXPECT_NE(all.find(part), std::string::npos) << part << "\n" << all;
  }
}

TEST_F(G2o, FilesWithoutAnyEdgeOrOfBothKindsAreErrors) {
  EXPECT_NE(read("VERTEX_SE2 0 0 0 0\n").message().find("no usable edge"), std::string::npos);
  EXPECT_NE(read("VERTEX_SE2 0 0 0 0\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n").message().find("both SE2 and SE3"),
            std::string::npos);
  EXPECT_FALSE(read_g2o(path_ + ".none", nullptr));
}

TEST_F(G2o, EdgesAlonePlaceTheirVertices) {
  const auto graph = read("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n");
  ASSERT_TRUE(graph) << graph.message();
  ASSERT_EQ(graph->vertices.size(), 3U);
  EXPECT_DOUBLE_EQ(graph->vertices[2].T_world_vertex.t.x(), 2.0);
}

TEST(QuaternionPose, JacobiansAgreeWithNumericOnes) {
  Random random(3);
  for (int trial = 0; trial < 20; ++trial) {
    const SE3 T_from = random_motion(&random, 3.0, 2.0), T_z = random_motion(&random, 1.0, 0.6);
    const SE3 T_to = T_from * T_z * random_motion(&random, 0.5, 0.7);
    const RelativePoseTerms terms = quaternion_pose_terms(T_from, T_to, T_z);
    for (int i = 0; i < 6; ++i) {
      constexpr double kStep = 1e-6;
      const auto residual = [&](double step) {
        const Vec6 d = step * Vec6::Unit(i);
        const SE3 moved(so3_exp(d.tail<3>()) * T_to.q, T_to.t + d.head<3>());
        return quaternion_pose_terms(T_from, moved, T_z).residual;
      };
      EXPECT_LT((terms.J_to.col(i) - (residual(kStep) - residual(-kStep)) / (2.0 * kStep)).cwiseAbs().maxCoeff(), 1e-6);
    }
  }
}

TEST(OptimizeGraph, EveryGuessLeadsToTheSameMinimum) {
  const G2oGraph graph = ring(40, 0.05, 0.05, 2);
  double chi2 = 0.0;
  for (const std::string initial : {"file", "odometry", "spanning_tree", "chordal"}) {
    G2oGraph solved = graph;
    GraphOptimizerOptions options;
    options.initial = initial;
    const auto report = optimize_graph(&solved, options);
    ASSERT_TRUE(report) << report.message();
    EXPECT_GT(report->final_chi2, 0.0);
    EXPECT_LE(report->final_chi2, report->initial_chi2);
    if (initial == "file") chi2 = report->final_chi2;
    EXPECT_NEAR(report->final_chi2, chi2, 1e-3 * chi2) << initial;
    EXPECT_EQ(solved.vertices[0].T_world_vertex.t, graph.vertices[0].T_world_vertex.t);
  }
}

TEST(OptimizeGraph, AWrongGuessInTheFileDoesNotMatter) {
  G2oGraph graph = ring(40, 0.0, 0.0, 3);
  Random random(4);
  for (std::size_t i = 1; i < graph.vertices.size(); ++i) {
    graph.vertices[i].T_world_vertex = SE3(random.rotation(), 5.0 * random.normal3());
  }
  const auto report = optimize_graph(&graph, {});
  ASSERT_TRUE(report) << report.message();
  EXPECT_LT(report->final_chi2, 1e-6);
}

TEST(OptimizeGraph, AScrambledGuessReachesTheMinimumOfAGoodOne) {
  for (const double noise : {0.1, 0.2, 0.3}) {
    const G2oGraph truth = ring(60, noise, noise, 8);
    Random random(9);
    G2oGraph good = truth, scrambled = truth;
    for (G2oVertex& vertex : scrambled.vertices) {
      if (random.chance(0.5)) vertex.T_world_vertex = SE3(random.rotation(), 5.0 * random.normal3());
    }
    const auto from_good = optimize_graph(&good, {});
    ASSERT_TRUE(from_good) << from_good.message();
    const auto from_scrambled = optimize_graph(&scrambled, {});
    ASSERT_TRUE(from_scrambled) << from_scrambled.message();
    EXPECT_GT(from_scrambled->initial_chi2, 100.0 * from_scrambled->final_chi2);
    EXPECT_NEAR(from_scrambled->final_chi2, from_good->final_chi2, 1e-3 * from_good->final_chi2) << noise;
  }
}

TEST_F(G2o, TheRestOfABadFileIsOptimised) {
  const std::string x = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1", y = "EDGE_SE3:QUAT 0 1 1.2 0 0 0 0 0 1";
  auto graph = read("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 5 0 0 0 0 0 1\n" + (x + kUnit) + (y + kUnit) +
                    "EDGE_SE3:QUAT 0 1 9 0 0 0 0 0 1 nan 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n" +
                    ("EDGE_SE3:QUAT 0 7 9 0 0 0 0 0 1" + std::string(kUnit)));
  ASSERT_TRUE(graph) << graph.message();
  ASSERT_EQ(refusals_.size(), 2U);
  EXPECT_NE(refusals_[0].find("EDGE_SE3:QUAT 0 1: 'nan'"), std::string::npos) << refusals_[0];
  EXPECT_NE(refusals_[1].find("edge 0 7 leads to the unknown vertex 7"), std::string::npos) << refusals_[1];
  const auto report = optimize_graph(&*graph, {});
  ASSERT_TRUE(report) << report.message();
  EXPECT_NEAR(graph->vertices[1].T_world_vertex.t.x(), 1.1, 1e-9);
  EXPECT_NEAR(report->final_chi2, 0.02, 1e-9);
  EXPECT_NEAR(report->final_cost, 0.01, 1e-9);
}

TEST(OptimizeGraph, PartsThatNothingJoinsAreSolvedEach) {
  G2oGraph graph = ring(20, 0.02, 0.02, 5);
  const G2oGraph other = ring(10, 0.02, 0.02, 6);
  for (G2oVertex vertex : other.vertices) {
    vertex.id += 100;
    vertex.is_fixed = vertex.id == 104;
    graph.vertices.push_back(vertex);
  }
  for (G2oEdge edge : other.edges) {
    edge.from += 100;
    edge.to += 100;
    graph.edges.push_back(edge);
  }
  graph.vertices.push_back({500, SE3(), false});
  const G2oGraph before = graph;
  const auto report = optimize_graph(&graph, {});
  ASSERT_TRUE(report) << report.message();
  EXPECT_EQ(report->components, 3);
  EXPECT_LT(report->final_chi2, report->initial_chi2);
  EXPECT_EQ(graph.vertices[0].T_world_vertex.t, before.vertices[0].T_world_vertex.t);
  EXPECT_EQ(graph.vertices[24].T_world_vertex.t, before.vertices[24].T_world_vertex.t) << "fixed";
  EXPECT_NE(graph.vertices[20].T_world_vertex.t, before.vertices[20].T_world_vertex.t);
}

TEST(OptimizeGraph, APartThatCannotBeSolvedIsNamedAndTheRestIsOptimised) {
  const G2oGraph good = ring(20, 0.02, 0.02, 5);
  for (const char* robust : {"none", "gnc"}) {
    G2oGraph graph = good, alone = good;
    GraphOptimizerOptions options;
    options.robust = robust;
    const auto report_alone = optimize_graph(&alone, options);
    ASSERT_TRUE(report_alone) << report_alone.message();
    for (const std::int64_t id : {100, 101}) graph.vertices.push_back({id, SE3(), false});
    G2oEdge edge = graph.edges.front();
    edge.from = 100;
    edge.to = 101;
    edge.T_from_to.t.x() = std::numeric_limits<double>::quiet_NaN();
    graph.edges.push_back(edge);
    const auto report = optimize_graph(&graph, options);
    ASSERT_TRUE(report) << report.message();
    ASSERT_EQ(report->unsolved.size(), 1U) << robust;
    EXPECT_NE(report->unsolved[0].find("the part of vertex 100"), std::string::npos) << report->unsolved[0];
    EXPECT_EQ(report->final_chi2, report_alone->final_chi2);
    EXPECT_EQ(report->initial_chi2, report_alone->initial_chi2);
    for (std::size_t i = 0; i < 20; ++i) {
      EXPECT_EQ(graph.vertices[i].T_world_vertex.t, alone.vertices[i].T_world_vertex.t) << i;
    }
    EXPECT_EQ(graph.vertices[21].T_world_vertex.t, Vec3(Vec3::Zero()));
    graph.vertices.erase(graph.vertices.begin(), graph.vertices.begin() + 20);
    graph.edges.erase(graph.edges.begin(), graph.edges.end() - 1);
    EXPECT_FALSE(optimize_graph(&graph, options)) << "nothing is left";
  }
}

TEST(OptimizeGraph, GncNamesTheOutliers) {
  G2oGraph graph = ring(40, 0.01, 0.01, 7);
  G2oEdge wrong = graph.edges.back();
  wrong.from = 5;
  wrong.to = 25;
  wrong.T_from_to = SE3();
  graph.edges.push_back(wrong);
  for (G2oEdge& edge : graph.edges) edge.information *= 100.0;  // a sigma of 1 cm
  GraphOptimizerOptions options;
  options.robust = "gnc";
  const auto report = optimize_graph(&graph, options);
  ASSERT_TRUE(report) << report.message();
  ASSERT_EQ(report->outliers.size(), 1U);
  EXPECT_EQ(report->outliers[0]->from, 5);
  EXPECT_EQ(report->outliers[0]->to, 25);
}

TEST(OptimizeGraph, WrongOptionsAreNamed) {
  G2oGraph graph = ring(10, 0.01, 0.01, 7);
  GraphOptimizerOptions options;
  options.initial = "guess";
  EXPECT_EQ(optimize_graph(&graph, options).message(),
            "parameter 'initial' = 'guess' must be file, odometry, spanning_tree or chordal");
}

TEST(OptimizeGraph, KnownMinimaOfPublicGraphs) {
  const auto data = shared_data("pose_graphs");
  if (!data) GTEST_SKIP() << "no pose_graphs in SEMANTIC_TOPO_LOOP_DATA";
  const std::pair<const char*, double> known[] = {{"sphere2500", 727.15}, {"parking-garage", 1.2387}};
  for (const auto& [name, chi2] : known) {
    auto graph = read_g2o(*data + "/" + name + ".g2o", nullptr);
    ASSERT_TRUE(graph) << graph.message();
    const auto report = optimize_graph(&*graph, {});
    ASSERT_TRUE(report) << report.message();
    EXPECT_LE(report->final_chi2, 1.01 * chi2) << name;
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
