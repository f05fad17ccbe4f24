#include "geometry/statistics.h"

#include <gtest/gtest.h>

namespace semantic_topo_loop::core {
namespace {

TEST(Quantile, IsTheSmallestValueThatTheShareIsNotAbove) {
  const std::vector<double> values = {4.0, 1.0, 3.0, 2.0};
  EXPECT_EQ(quantile(values, 0.0), 1.0);
  EXPECT_EQ(quantile(values, 0.25), 1.0);
  EXPECT_EQ(quantile(values, 0.26), 2.0);
  EXPECT_EQ(quantile(values, 0.5), 2.0);
  EXPECT_EQ(quantile(values, 0.95), 4.0);
  EXPECT_EQ(quantile(values, 1.0), 4.0);
  EXPECT_EQ(quantile({}, 0.5), 0.0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
