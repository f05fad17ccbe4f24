#pragma once

#include <sqlite3.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>

namespace semantic_topo_loop::core {

/// A SQLite database. The first problem is kept, with the file's name, so that a row of calls is made in one go and
/// checked once; what is read after it means nothing.
class SqliteFile {
 public:
  enum class Mode { kRead, kWrite };
  /// To read: from places where nothing may be written, too.
  SqliteFile(std::string path, Mode mode);

  const std::string& problem() const { return problem_; }
  bool is_fine() const { return problem_.empty(); }
  /// Whether the problem is that another session or program writes it.
  bool is_busy() const { return is_busy_; }
  void reject(const std::string& problem);
  /// Another one to read beside this, under a name, from wherever it can be read.
  void attach(const std::string& path, const std::string& as);
  /// Statements without a result.
  void run(const std::string& sql);
  /// The same, but where others use the file it is left undone.
  void run_if_free(const std::string& sql);
  /// First column of the first row; 0 without one.
  std::int64_t number(const std::string& sql);

 private:
  friend class SqliteStatement;
  struct Close {
    void operator()(sqlite3* database) const { sqlite3_close(database); }
  };
  struct Finalize {
    void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
  };
  void note(int code);
  int open(const std::string& name, int flags);

  std::string path_;
  std::string name_;  ///< for SQLite
  std::unique_ptr<sqlite3, Close> database_;
  /// Statements that are done with, by their text: to prepare one takes longer than to run it.
  std::multimap<std::string, std::unique_ptr<sqlite3_stmt, Finalize>> idle_;
  std::string problem_;
  bool is_busy_ = false;
};

/// CRC-32 of values one after the other, as they are read back: a number that is none is null, and zero has no sign.
class Checksum {
 public:
  void add(std::int64_t value);
  void add(double value);
  void add(const void* bytes, std::size_t size);
  void add_null();
  std::int64_t value() const { return static_cast<std::int64_t>(crc_); }

 private:
  void add_as(char type, const void* bytes, std::size_t size);
  unsigned long crc_ = 0;
};

/// A prepared statement: bind its parameters in order, or step through its rows.
class SqliteStatement {
 public:
  /// @param file outlives this
  SqliteStatement(SqliteFile* file, const std::string& sql);

  SqliteStatement& operator<<(std::int64_t value);
  SqliteStatement& operator<<(double value);
  SqliteStatement& operator<<(const std::string& text);
  SqliteStatement& operator<<(std::nullptr_t);
  /// Bytes, not text.
  SqliteStatement& blob(const std::string& bytes);
  /// Runs it with what was bound, to be bound anew.
  void run();
  /// The same of an insertion into a table whose last column is the checksum of those before (CRC-32), which is bound
  /// here.
  void run_with_checksum();

  /// To the next row. @return false if there is none
  bool next();
  /// Whether the row's last column is the checksum of those before, or null: not known.
  bool is_intact() const;
  int columns() const;
  bool is_null(int column) const;
  bool is_blob(int column) const;
  bool is_real(int column) const;
  std::int64_t integer(int column) const;
  double number(int column) const;
  std::string bytes(int column) const;

 private:
  struct Release {
    SqliteFile* file;
    void operator()(sqlite3_stmt* statement) const;
  };
  SqliteFile* file_;
  std::unique_ptr<sqlite3_stmt, Release> statement_;
  int bound_ = 0;
  Checksum checksum_;  ///< of what is bound
};

}  // namespace semantic_topo_loop::core
