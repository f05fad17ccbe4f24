#include "io/sqlite_file.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <utility>

namespace semantic_topo_loop::core {
namespace {

/// A file's name for SQLite, as of one that nobody changes.
std::string unchanging(const std::string& path) {
  constexpr char kHex[] = "0123456789abcdef";
  std::string name = "file:";
  for (const char character : std::filesystem::absolute(path).lexically_normal().string()) {
    const auto byte = static_cast<unsigned char>(character);
    name += {'%', kHex[byte / 16], kHex[byte % 16]};
  }
  return name + "?immutable=1";
}

}  // namespace

SqliteFile::SqliteFile(std::string path, Mode mode) : path_(std::move(path)) {
  std::error_code code;
  name_ = std::filesystem::absolute(path_, code).string();  // one that begins as a URI is none
  if (mode == Mode::kRead) {
    if (std::filesystem::is_directory(path_, code)) reject("is a directory, not a file");
    if (!std::filesystem::exists(path_, code)) reject("cannot open the file");
    if (!is_fine()) return;
  }
  note(open(name_, mode == Mode::kRead ? SQLITE_OPEN_READONLY : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE));
  if (mode == Mode::kWrite || !is_fine()) return;
  // A file that its writer did not close is read by a journal beside it, which SQLite wants to make if there is none.
  const int read = sqlite3_exec(database_.get(), "PRAGMA schema_version", nullptr, nullptr, nullptr);
  if (read != SQLITE_READONLY && read != SQLITE_CANTOPEN) return;
  for (const char* journal : {"-wal", "-journal"}) {
    if (!std::filesystem::exists(path_ + journal, code)) continue;
    reject("its last part is in " + path_ + journal + ", which is only read where files can be written beside it");
    return;
  }
  name_ = unchanging(path_);
  note(open(name_, SQLITE_OPEN_READONLY));
}

int SqliteFile::open(const std::string& name, int flags) {
  sqlite3* database = nullptr;
  const int opened = sqlite3_open_v2(name.c_str(), &database, flags | SQLITE_OPEN_URI, nullptr);
  database_.reset(database);
  constexpr int kPatience_ms = 1000;  // for who only takes a look; a writer stays
  if (opened == SQLITE_OK) sqlite3_busy_timeout(database, kPatience_ms);
  return opened;
}

void SqliteFile::reject(const std::string& problem) {
  if (!problem_.empty()) return;
  problem_ = path_ + ": " + problem;
  std::replace(problem_.begin(), problem_.end(), '\n', ' ');
}

void SqliteFile::attach(const std::string& path, const std::string& as) {
  const SqliteFile readable(path, Mode::kRead);
  if (is_fine()) problem_ = readable.problem_;
  (SqliteStatement(this, "ATTACH ? AS " + as) << readable.name_).run();
}

void SqliteFile::note(int code) {
  if (code == SQLITE_OK || code == SQLITE_ROW || code == SQLITE_DONE) return;
  is_busy_ = is_busy_ || (is_fine() && code == SQLITE_BUSY);
  if (code == SQLITE_BUSY) return reject("is being written by another session or program");
  reject(database_ ? sqlite3_errmsg(database_.get()) : sqlite3_errstr(code));
}

void SqliteFile::run(const std::string& sql) {
  if (is_fine()) note(sqlite3_exec(database_.get(), sql.c_str(), nullptr, nullptr, nullptr));
}

void SqliteFile::run_if_free(const std::string& sql) {
  if (!is_fine()) return;
  const int code = sqlite3_exec(database_.get(), sql.c_str(), nullptr, nullptr, nullptr);
  if (code != SQLITE_BUSY) note(code);
}

std::int64_t SqliteFile::number(const std::string& sql) {
  SqliteStatement statement(this, sql);
  return statement.next() ? statement.integer(0) : 0;
}

void Checksum::add_as(char type, const void* bytes, std::size_t size) {
  const auto add = [this](const void* data, std::size_t count) {
    crc_ = ::crc32(crc_, static_cast<const Bytef*>(data), static_cast<uInt>(count));
  };
  const auto count = static_cast<std::uint64_t>(size);
  std::array<char, 1 + sizeof(count) + sizeof(double)> head{type};  // of a number all of it
  std::memcpy(&head[1], &count, sizeof(count));
  const std::size_t with = size <= sizeof(double) ? size : 0;
  if (with > 0) std::memcpy(&head[1 + sizeof(count)], bytes, with);
  add(head.data(), 1 + sizeof(count) + with);
  if (size > with) add(static_cast<const char*>(bytes) + with, size - with);
}
void Checksum::add(std::int64_t value) { add_as('i', &value, sizeof(value)); }
void Checksum::add(double value) {
  if (std::isnan(value)) return add_null();
  value += 0.0;  // of -0 is 0
  add_as('r', &value, sizeof(value));
}
void Checksum::add(const void* bytes, std::size_t size) { add_as('b', bytes, size); }
void Checksum::add_null() { add_as('n', nullptr, 0); }

void SqliteStatement::Release::operator()(sqlite3_stmt* statement) const {
  sqlite3_reset(statement);
  sqlite3_clear_bindings(statement);
  file->idle_.emplace(sqlite3_sql(statement), statement);
}

SqliteStatement::SqliteStatement(SqliteFile* file, const std::string& sql)
    : file_(file), statement_(nullptr, Release{file}) {
  if (!file_->is_fine()) return;
  if (auto idle = file_->idle_.extract(sql); !idle.empty()) {
    statement_.reset(idle.mapped().release());
    return;
  }
  sqlite3_stmt* statement = nullptr;
  file_->note(sqlite3_prepare_v2(file_->database_.get(), sql.c_str(), -1, &statement, nullptr));
  statement_.reset(statement);
}

SqliteStatement& SqliteStatement::operator<<(std::int64_t value) {
  if (file_->is_fine()) file_->note(sqlite3_bind_int64(statement_.get(), ++bound_, value));
  checksum_.add(value);
  return *this;
}
SqliteStatement& SqliteStatement::operator<<(double value) {
  if (file_->is_fine()) file_->note(sqlite3_bind_double(statement_.get(), ++bound_, value));
  checksum_.add(value);
  return *this;
}
SqliteStatement& SqliteStatement::operator<<(const std::string& text) {
  if (file_->is_fine()) {
    file_->note(
        sqlite3_bind_text64(statement_.get(), ++bound_, text.data(), text.size(), SQLITE_TRANSIENT, SQLITE_UTF8));
  }
  checksum_.add(text.data(), text.size());
  return *this;
}
SqliteStatement& SqliteStatement::operator<<(std::nullptr_t) {
  ++bound_;  // null is what a parameter is that is not bound
  checksum_.add_null();
  return *this;
}
SqliteStatement& SqliteStatement::blob(const std::string& bytes) {
  if (file_->is_fine()) {
    file_->note(sqlite3_bind_blob64(statement_.get(), ++bound_, bytes.data(), bytes.size(), SQLITE_TRANSIENT));
  }
  checksum_.add(bytes.data(), bytes.size());
  return *this;
}

void SqliteStatement::run() {
  next();
  if (!file_->is_fine()) return;
  file_->note(sqlite3_reset(statement_.get()));
  sqlite3_clear_bindings(statement_.get());
  bound_ = 0;
  checksum_ = {};
}

void SqliteStatement::run_with_checksum() {
  if (!file_->is_fine()) return;
  while (bound_ + 1 < sqlite3_bind_parameter_count(statement_.get())) *this << nullptr;
  *this << checksum_.value();
  run();
}

bool SqliteStatement::is_intact() const {
  const int last = columns() - 1;
  if (is_null(last)) return true;
  Checksum checksum;
  for (int column = 0; column < last; ++column) {
    switch (sqlite3_column_type(statement_.get(), column)) {
      case SQLITE_INTEGER:
        checksum.add(integer(column));
        break;
      case SQLITE_FLOAT:
        checksum.add(number(column));
        break;
      case SQLITE_NULL:
        checksum.add_null();
        break;
      default:
        // A text and a blob have the same checksum; which it is the table says.
        const char* const declared = sqlite3_column_decltype(statement_.get(), column);
        if (declared != nullptr && std::string(declared) == (is_blob(column) ? "TEXT" : "BLOB")) return false;
        const void* bytes = sqlite3_column_blob(statement_.get(), column);
        checksum.add(bytes, static_cast<std::size_t>(sqlite3_column_bytes(statement_.get(), column)));
    }
  }
  return checksum.value() == integer(last);
}

bool SqliteStatement::next() {
  if (!file_->is_fine()) return false;
  const int code = sqlite3_step(statement_.get());
  file_->note(code);
  return code == SQLITE_ROW;
}

bool SqliteStatement::is_null(int column) const { return sqlite3_column_type(statement_.get(), column) == SQLITE_NULL; }
bool SqliteStatement::is_blob(int column) const { return sqlite3_column_type(statement_.get(), column) == SQLITE_BLOB; }
bool SqliteStatement::is_real(int column) const {
  return sqlite3_column_type(statement_.get(), column) == SQLITE_FLOAT;
}
int SqliteStatement::columns() const { return sqlite3_column_count(statement_.get()); }
std::int64_t SqliteStatement::integer(int column) const { return sqlite3_column_int64(statement_.get(), column); }
double SqliteStatement::number(int column) const { return sqlite3_column_double(statement_.get(), column); }
std::string SqliteStatement::bytes(int column) const {
  const void* data = sqlite3_column_blob(statement_.get(), column);
  const auto size = static_cast<std::size_t>(sqlite3_column_bytes(statement_.get(), column));
  return data == nullptr ? std::string() : std::string(static_cast<const char*>(data), size);
}

}  // namespace semantic_topo_loop::core
