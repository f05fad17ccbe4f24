#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "io/sqlite_file.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop::core {

constexpr std::int64_t kMapApplicationId = 0x53544c6d;  ///< "STLm"
/// 2: points; 3: refused_loop; 4: merge; 5: live poses; 6: checksums; 7: keyframes placed by vertices. Of earlier
/// versions all is read.
constexpr std::int64_t kMapVersion = 7;

/// Makes the empty tables of a map (docs/files.md).
void create_map_tables(SqliteFile* file);

/// Fills them, within a transaction of the caller's. Of the graph's edges and loops, which are given as a whole, only
/// rows that are other than what this object wrote last are touched.
class MapTables {
 public:
  /// @param file outlives this
  MapTables(SqliteFile* file, const ClassTable& classes);

  /// @param is_whole its keyframes are all there are
  void write(const GraphState& graph, bool is_whole);
  void write_configuration(const std::string& text);
  void write(const Camera& camera);
  /// @param first number of the first of the observations; what there is from it on is replaced
  void write(const LandmarkRecord& record, const std::vector<Observation>& observations, std::size_t first);
  void write(const LoggedMerge& merge);
  void write(const LocalMap& submap);
  void write_refused(const LoopFigures& loop);
  void write(const PointsOfKeyframe& keyframe);
  void write(const MapDelta& delta);

 private:
  /// The rows of a table that is given as a whole, each time.
  struct Mirror {
    struct Row {
      std::string body;        ///< what was written last
      std::int64_t given = 0;  ///< when it was last
    };
    std::map<std::int64_t, Row> rows;  ///< by key
    std::int64_t time = 1;             ///< counts how often the table is given
    /// @return what to write; null if the row has it already
    const std::string* take(std::int64_t key, const std::string& body);
  };
  /// Removes the rows that were not given again.
  void finish(const char* table, const char* key, Mirror* mirror);
  void write_meta(const std::string& key, const std::string& value);
  void name_class(int class_id);

  SqliteFile* file_;
  const ClassTable& classes_;
  bool has_graph_ = false;  ///< what the tables hold of edges and loops is what this object wrote
  Mirror edges_, loops_;
  std::set<int> named_;  ///< classes that are in the table
};

/// A delta as bytes (CBOR), to be sent to another process, without the labels of submaps' objects.
std::vector<std::uint8_t> pack(const MapDelta& delta);
/// @return null if the bytes are none
std::shared_ptr<const MapDelta> unpack_map_delta(const std::vector<std::uint8_t>& bytes);

}  // namespace semantic_topo_loop::core
