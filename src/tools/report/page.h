#pragma once

#include <string>
#include <utility>
#include <vector>

namespace semantic_topo_loop::core {

/// A whole HTML page, which needs no other file: style and script are in it.
std::string page(const std::string& title, const std::string& body);

/// A part of the page under a heading. @param note HTML below the heading, may be empty
std::string section(const std::string& id, const std::string& heading, const std::string& note,
                    const std::string& content);

/// A table that a click on a column's name sorts. Cells are texts, those that are numbers stand to the right.
class HtmlTable {
 public:
  explicit HtmlTable(std::vector<std::string> columns) : columns_(std::move(columns)) {}
  /// @param cells one a column
  void add(std::vector<std::string> cells) { rows_.push_back(std::move(cells)); }
  std::string html() const;

 private:
  std::vector<std::string> columns_;
  std::vector<std::vector<std::string>> rows_;
};

/// A large figure with what it is below it.
std::string tile(const std::string& figure, const std::string& meaning);

}  // namespace semantic_topo_loop::core
