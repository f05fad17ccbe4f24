#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

struct MapDelta;

/// How much a map's file holds.
struct MapCounts {
  std::int64_t sessions = 0, keyframes = 0, objects = 0, submaps = 0, loops = 0;
};

/// A map's file (io/map_file.h) while the map grows: what is new is written by a thread of its own, each time as one
/// transaction, so that whatever ends the program, what was written before is a map. The first one, which holds all
/// there is, takes the place of a map that was there; not of the one that the session goes on with, if it lacks a part
/// of that. What cannot be written (a full disk) is kept and tried again. Thread-safe.
class MapDatabase {
 public:
  /// @param configuration kept for who wonders how the map came about
  /// @param earlier map's file with which the session goes on, whose points stay, or empty
  /// @param sets_aside what is there by then stays as FILE~, or FILE~2 if that is there, with what is in its journal
  /// yet
  MapDatabase(const std::string& path, std::shared_ptr<const ClassTable> classes, std::string configuration = {},
              std::string earlier = {}, bool sets_aside = false);
  /// As `close`.
  ~MapDatabase();
  MapDatabase(const MapDatabase&) = delete;
  MapDatabase& operator=(const MapDatabase&) = delete;

  /// What is written together.
  using Parts = std::vector<std::shared_ptr<const MapDelta>>;
  /// Returns at once. What comes while the last cannot be written is written with it.
  /// @param parts of the first call: whole, and of every stage
  /// @param keeps_copy what is written by then stays likewise: these take its place
  void write(Parts parts, bool keeps_copy = false);
  /// Whether something waits to be written: who can tell more at once later may wait with it.
  bool is_behind() const;
  /// Writes what waits, leaves one file without a journal beside it, and ends. @return what could not be written, and
  /// why
  Status close();
  /// Whether the file is this one's: before the first writing it may be another map's.
  bool is_made() const;
  /// What keeps it from writing now.
  Status problem() const;
  /// A copy of what is written, which takes the place of what was there in one go.
  /// @return an error if nothing is written yet, or the copy would take the place of the map itself
  Result<MapCounts> copy_to(const std::string& path) const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// @return an error if a map cannot be written there: no place, another program writes it, or it is no map's file
Status check_map_place(const std::string& path);

/// Adds what is to be written after what waits. Of graphs only the last one is kept, with what those before had new.
void append(MapDatabase::Parts parts, MapDatabase::Parts* waiting);

/// As replace_file, for a map. @return also an error where check_map_place has one
Status replace_map(const std::string& path, const std::function<Status(const std::string&)>& write);

/// A name under which a map stays as it is now, although another takes its place: a link beside it, FILE.loaded-..., a
/// copy where no link can be made, or its own name where nothing can be written. Removes such links of programs that
/// are no more.
/// @return an error if another session or program writes it
Result<std::string> link_loaded_map(const std::string& path);
/// The map whose link or copy, by such a name, that is; any other name as it is.
std::string loaded_map(const std::string& link);

}  // namespace semantic_topo_loop::core
