#include "semantic_topo_loop/io/loop_table.h"

#include <cmath>

#include "csv_row.h"
#include "semantic_topo_loop/io/stamp.h"
#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

constexpr char kColumns[] =
    "query_frame,match_frame,query_stamp,match_stamp,query_begin,query_end,match_begin,match_end,accepted,reason,"
    "score,inliers,x,y,z,qx,qy,qz,qw";

CsvRow row(const LoopClosure& loop) {
  constexpr int kScoreDecimals = 6;
  return CsvRow()
      .add(loop.query_frame)
      .add(loop.match_frame)
      .add(format_stamp(loop.query_stamp_ns))
      .add(format_stamp(loop.match_stamp_ns))
      .add(loop.query_begin)
      .add(loop.query_end)
      .add(loop.match_begin)
      .add(loop.match_end)
      .add(loop.accepted ? 1 : 0)
      .add(to_string(loop.reason))
      .add(loop.score, kScoreDecimals)
      .add(loop.inliers)
      .add(loop.T_match_query);
}

}  // namespace

std::string loop_table_header() { return std::string(kColumns) + "\n"; }

std::string loop_table_row(const LoopClosure& loop) { return row(loop).end(); }

bool write_given_loops(const std::string& path, const std::vector<LoopClosure>& loops, std::string* error) {
  constexpr int kSigmaDecimals = 6;
  std::string text = std::string(kColumns) + ",sigma_m,sigma_deg\n";
  for (const LoopClosure& loop : loops) {
    const Vec6 variances = loop.covariance.diagonal();
    text += row(loop)
                .add(std::sqrt(variances.head<3>().mean()), kSigmaDecimals)
                .add(degrees(std::sqrt(variances.tail<3>().mean())), kSigmaDecimals)
                .end();
  }
  return write_text_file(path, text, error);
}

}  // namespace semantic_topo_loop::core
