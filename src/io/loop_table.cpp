#include "semantic_topo_loop/io/loop_table.h"

#include <cmath>

#include "io/csv_row.h"
#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

constexpr char kColumns[] =
    "query_frame,match_frame,query_stamp,match_stamp,query_begin,query_end,match_begin,match_end,accepted,reason,"
    "score,inliers,x,y,z,qx,qy,qz,qw,labels,second_score,rms_m,spread_m,tilt_deg,reprojection_ratio,"
    "reprojected_objects,explained_share,refine_residual,refine_shift_m,refine_shift_deg,sigma_m,sigma_deg\n";

}  // namespace

std::string loop_table_header() { return kColumns; }

std::string loop_table_row(const LoopFigures& loop) {
  constexpr int kDecimals = 6;
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
      .add(loop.score, kDecimals)
      .add(loop.inliers)
      .add(loop.T_match_query)
      .add(loop.labels)
      .add(loop.second_score, kDecimals)
      .add(loop.rms_m, kDecimals)
      .add(loop.spread_m, kDecimals)
      .add(loop.tilt_deg, kDecimals)
      .add(loop.reprojection_ratio, kDecimals)
      .add(loop.reprojected_objects)
      .add(loop.explained_share, kDecimals)
      .add(loop.refine_residual, kDecimals)
      .add(loop.refine_shift_m, kDecimals)
      .add(loop.refine_shift_deg, kDecimals)
      .add(loop.sigma_m, kDecimals)
      .add(loop.sigma_deg, kDecimals)
      .end();
}

Status write_given_loops(const std::string& path, const std::vector<LoopClosure>& loops) {
  std::string text = loop_table_header();
  for (LoopClosure loop : loops) {
    const Vec6 variances = loop.covariance.diagonal();
    loop.sigma_m = std::sqrt(variances.head<3>().sum());
    loop.sigma_deg = degrees(std::sqrt(variances.tail<3>().sum()));
    text += loop_table_row(loop);
  }
  return write_text_file(path, text);
}

}  // namespace semantic_topo_loop::core
