#include "semantic_topo_loop/io/map_database.h"

#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <exception>
#include <filesystem>
#include <iterator>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "io/map_tables.h"
#include "io/sqlite_file.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::chrono::seconds kRetry(1), kLongestRetry(60);  // twice as long each time: what fails may be costly
// What follows a map's name: of the one that a session goes on with, before numbers, and of what is not in the file
// yet.
constexpr char kLoaded[] = ".loaded-";
constexpr const char* kJournals[] = {"-wal", "-shm"};

Status status_of(const SqliteFile& file) { return file.is_fine() ? Status() : Error{file.problem()}; }

bool is_there(const std::string& path) {
  std::error_code code;
  return std::filesystem::exists(path, code) && std::filesystem::file_size(path, code) > 0;
}

std::filesystem::file_time_type written_at(const std::string& path) {
  std::error_code code;
  return std::filesystem::last_write_time(path, code);
}

/// Files beside `stem` whose names are its own, a process id, '-', a number and `end`, where no such process is any
/// more.
void remove_files_of_the_dead(const std::filesystem::path& stem, const std::string& end_of_name) {
  std::error_code code;
  const std::string name = stem.filename().string();
  const std::filesystem::path folder = stem.has_parent_path() ? stem.parent_path() : std::filesystem::path(".");
  for (std::filesystem::directory_iterator it(folder, code), end; !code && it != end; it.increment(code)) {
    const std::string other = it->path().filename().string();
    if (other.size() <= name.size() + end_of_name.size() || other.compare(0, name.size(), name) != 0) continue;
    const std::size_t end_at = other.size() - end_of_name.size();
    if (other.compare(end_at, end_of_name.size(), end_of_name) != 0) continue;
    const std::string numbers = other.substr(name.size(), end_at - name.size());
    if (numbers.find_first_not_of("0123456789-") != numbers.npos) continue;
    const int process = std::atoi(numbers.c_str());
    if (process > 0 && numbers.find('-') != numbers.npos && ::kill(process, 0) != 0 && errno == ESRCH)
      std::filesystem::remove(it->path(), code);
  }
}

using Identity = std::pair<dev_t, ino_t>;
std::optional<Identity> identity_of(const std::string& path) {
  struct stat status;
  if (::stat(path.c_str(), &status) != 0) return std::nullopt;
  return Identity{status.st_dev, status.st_ino};
}

/// FILE~, FILE~2 and so on: the last that is there, empty if none is, and the first that is free.
std::pair<std::string, std::string> names_beside(const std::string& path) {
  std::pair<std::string, std::string> names{"", path + "~"};
  for (int next = 2; is_there(names.second); ++next) {
    names.first = std::exchange(names.second, path + "~" + std::to_string(next));
  }
  return names;
}

/// Gives a map and its journals the next free name; under its own it stays, too, until another file takes that.
Status put_aside(const std::string& path) {
  const auto [last, aside] = names_beside(path);
  std::error_code code, none;
  if (!last.empty() && std::filesystem::equivalent(path, last, none)) return {};  // by an attempt that went wrong later
  for (const char* journal : kJournals) std::filesystem::remove(aside + journal, none);
  std::filesystem::create_hard_link(path, aside, code);
  if (code) std::filesystem::rename(path, aside, code);
  if (code) return Error{path + ": cannot be renamed to " + aside + ": " + code.message()};
  for (const char* journal : kJournals) std::filesystem::rename(path + journal, aside + journal, none);
  return {};
}

/// What is committed, though another connection writes on.
Status copy_map(const std::string& from, const std::string& to) {
  std::error_code code;
  // Tried again and again, it would keep a disk full that others write to.
  const std::uintmax_t size = std::filesystem::file_size(from, code);
  if (!code && std::filesystem::space(std::filesystem::path(to).parent_path(), code).available < size) {
    return Error{to + ": no room for a copy of " + from};
  }
  SqliteFile file(from, SqliteFile::Mode::kRead);
  (SqliteStatement(&file, "VACUUM INTO ?") << to).run();
  return status_of(file);
}

/// What a writer that was killed left in its journal goes into the file, and the journal with it.
void take_in_journal(SqliteFile* file) { file->run("BEGIN IMMEDIATE; COMMIT; PRAGMA journal_mode = DELETE"); }

/// A stage that could not read the map that the session goes on with tells nothing of it: a file without its part must
/// not take that map's place.
void require_earlier(SqliteFile* file) {
  for (const char* table : {"keyframe", "observation", "submap"}) {
    const auto count = [&](const char* schema) {
      return file->number(std::string("SELECT count(*) FROM ") + schema + "." + table +
                          " WHERE frame <= (SELECT max(frame) FROM earlier.keyframe)");
    };
    if (file->is_fine() && count("earlier") > 0 && count("main") == 0) {
      file->reject(std::string("not replaced by a map without any ") + table +
                   " of the one that the session goes on with");
    }
  }
}

/// A database that this program writes from now on: who else tries is told so.
class OpenMap {
 public:
  OpenMap(const std::string& path, const ClassTable& classes)
      : file_(path, SqliteFile::Mode::kWrite), tables_(&file_, classes) {
    file_.run("PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE");
  }
  Status write(const MapDatabase::Parts& parts) {
    for (const auto& part : parts) tables_.write(*part);
    file_.run("COMMIT; BEGIN IMMEDIATE");
    return status_of(file_);
  }
  Status close() {
    file_.run("COMMIT");
    file_.run_if_free("PRAGMA journal_mode = DELETE");  // who reads it leaves the journal to the next one
    return status_of(file_);
  }
  /// The file has another name now: what is in the journal, which has not, goes into it.
  void leave() { file_.run("COMMIT; PRAGMA wal_checkpoint(TRUNCATE)"); }

 private:
  SqliteFile file_;
  MapTables tables_;
};

}  // namespace

Status check_map_place(const std::string& path) {
  if (is_there(path)) {
    SqliteFile file(path, SqliteFile::Mode::kWrite);
    const std::int64_t application = file.number("PRAGMA application_id");
    if (file.is_fine() && application != kMapApplicationId) file.reject("is there already, and is no map");
    take_in_journal(&file);
    if (!file.is_fine()) return status_of(file);
  }
  return check_writable(path);  // of a file that is there, too: another one is to take its place
}

Status replace_map(const std::string& path, const std::function<Status(const std::string&)>& write) {
  remove_files_of_the_dead(behind_links(path) + ".", ".tmp");
  if (!is_there(path)) {
    // Whose journal this is went elsewhere; the new file must not be taken for it.
    std::error_code code;
    for (const char* journal : kJournals) std::filesystem::rename(path + journal, path + journal + "~", code);
  }
  if (const Status place = check_map_place(path); !place) return place;
  return replace_file(path, write);
}

void append(MapDatabase::Parts parts, MapDatabase::Parts* waiting) {
  for (auto& part : parts) {
    for (auto& before : *waiting) {
      if (!part->graph || !before->graph) continue;
      auto both = std::make_shared<MapDelta>(*part), rest = std::make_shared<MapDelta>(*before);
      put_before(*before->graph, &*both->graph);
      rest->graph.reset();
      part = std::move(both);
      before = std::move(rest);
    }
    waiting->push_back(std::move(part));
  }
}

Result<std::string> link_loaded_map(const std::string& path) {
  if (!is_there(path)) return path;
  SqliteFile file(path, SqliteFile::Mode::kWrite);
  take_in_journal(&file);
  std::error_code code;
  // A link to a symbolic link would lead to whatever takes the map's place.
  const std::string map = std::filesystem::canonical(path, code).string();
  if (code) return path;
  // Under another name it would be read without what is in its journal.
  if (!file.is_fine() && (file.is_busy() || is_there(map + kJournals[0]))) return Error{file.problem()};
  for (const char* end : {"", kJournals[0], kJournals[1]}) remove_files_of_the_dead(map + kLoaded, end);
  // Other programs, and the session before, may still read theirs.
  static std::atomic<int> next{1};
  std::string link;
  do {  // a process that was killed may have had the same number
    link = map + kLoaded + std::to_string(::getpid()) + "-" + std::to_string(next++);
    std::filesystem::create_hard_link(map, link, code);
  } while (code == std::errc::file_exists);
  if (!code || copy_map(map, link)) return link;
  std::filesystem::remove(link, code);
  return path;  // where nothing can be written, nothing takes its place
}

std::string loaded_map(const std::string& link) {
  const std::size_t begin = link.rfind(kLoaded);
  const bool is_link =
      begin != std::string::npos && link.find_first_not_of("0123456789-", begin + std::strlen(kLoaded)) == link.npos;
  return is_link ? link.substr(0, begin) : link;
}

class MapDatabase::Impl {
 public:
  Impl(const std::string& path, std::shared_ptr<const ClassTable> classes, std::string configuration,
       std::string earlier, bool sets_aside)
      : path_(behind_links(path)),  // a link that is set aside would lead to what takes the map's place
        classes_(std::move(classes)),
        configuration_(std::move(configuration)),
        earlier_(std::move(earlier)),
        sets_aside_(sets_aside),
        found_(written_at(path_)),
        thread_([this] { run(); }) {}

  void write(Parts parts, bool keeps_copy) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (waiting_.empty() || keeps_copy) waiting_.push_back({{}, keeps_copy});
    append(std::move(parts), &waiting_.back().parts);
    wake_.notify_one();
  }

  bool is_behind() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return is_writing_ || !waiting_.empty();
  }

  Status problem() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return problem_;
  }

  Status close() {
    const std::lock_guard<std::mutex> closing(closing_);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      is_closed_ = true;
      wake_.notify_one();
    }
    if (thread_.joinable()) thread_.join();
    return problem_;
  }

  bool is_made() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return is_made_;
  }

  Result<MapCounts> copy_to(const std::string& path) const {
    for (const std::string& own : {path_, path_ + kJournals[0], path_ + kJournals[1], earlier_, loaded_map(earlier_)}) {
      if (is_same_file(path, own)) return Error{path + ": is a file of the map that is being written"};
    }
    if (!is_made()) return Error{path_ + ": nothing is written yet"};
    MapCounts counts;
    const auto copy = [&](const std::string& temporary) -> Status {
      if (const Status done = copy_map(path_, temporary); !done) return done;
      SqliteFile copied(temporary, SqliteFile::Mode::kRead);
      const auto count = [&copied](const char* table) {
        return copied.number(std::string("SELECT count(*) FROM ") + table);
      };
      counts = {count("session"), count("keyframe"), count("object"), count("submap"), count("loop")};
      return status_of(copied);
    };
    if (const Status written = replace_map(path, copy); !written) return written.error();
    return counts;
  }

 private:
  /// What is one transaction.
  struct Batch {
    Parts parts;
    bool keeps_copy = false;  ///< of the file as it was before
  };

  void run() {
    std::unique_lock<std::mutex> lock(mutex_);
    std::chrono::seconds retry = kRetry;
    for (;;) {
      wake_.wait(lock, [this] { return is_closed_ || !waiting_.empty(); });
      if (waiting_.empty()) break;
      Batch batch = std::move(waiting_.front());
      waiting_.pop_front();
      is_writing_ = true;
      const bool is_first = !is_made_;
      lock.unlock();
      const Status written = write_now(&batch, is_first);
      lock.lock();
      is_writing_ = false;
      problem_ = written;
      is_made_ = is_made_ || written;
      if (written) {
        retry = kRetry;
        continue;
      }
      waiting_.push_front(std::move(batch));
      if (is_closed_) return;
      wake_.wait_for(lock, retry, [this] { return is_closed_; });
      retry = std::min(2 * retry, kLongestRetry);
    }
    if (!map_) return;
    lock.unlock();
    Status closed = check_identity();
    if (closed) closed = map_->close();
    map_.reset();
    lock.lock();
    problem_ = closed;
  }

  /// What throws (memory that is not there) is a problem as any other, not the end of the process.
  Status write_now(Batch* batch, bool is_first) try {
    if (is_first) {
      Status made = make(batch->parts);
      if (made) map_.emplace(path_, *classes_);  // from now on nobody else writes it
      identity_ = identity_of(path_);
      return made;
    }
    if (const Status own = check_identity(); !own) return own;
    if (!map_) map_.emplace(path_, *classes_);
    if (batch->keeps_copy) {
      const auto copy = [this](const std::string& temporary) { return copy_map(path_, temporary); };
      if (const Status kept = replace_map(names_beside(path_).second, copy); !kept) return kept;
      batch->keeps_copy = false;
    }
    const Status written = map_->write(batch->parts);
    if (!written) map_.reset();  // what was begun is undone
    return written;
  } catch (const std::exception& exception) {
    map_.reset();
    return Error{path_ + ": " + exception.what()};
  }

  /// What was renamed or removed could be written on; SQLite would begin an empty file in its place, and put our
  /// journal into another one that took it.
  Status check_identity() {
    const auto now = identity_of(path_);
    if (now == identity_) return {};
    if (map_) map_->leave();
    map_.reset();
    return Error{path_ + (now ? ": another file is there now" : ": is not there any more")};
  }

  /// The file with all there is: later ones change rows of it.
  Status make(const Parts& whole) {
    if (!earlier_.empty() && !is_there(earlier_)) return Error{earlier_ + ": is not there any more"};
    // Another program may have written, and ended, since.
    const bool keeps_other = sets_aside_ || written_at(path_) != found_;
    return replace_map(path_, [&](const std::string& temporary) -> Status {
      SqliteFile file(temporary, SqliteFile::Mode::kWrite);
      file.run("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF");
      if (!earlier_.empty()) file.attach(earlier_, "earlier");
      file.run("BEGIN");
      create_map_tables(&file);
      const std::int64_t version = earlier_.empty() ? 0 : file.number("PRAGMA earlier.user_version");
      // Those of keyframes that the map never got would be the new session's. Before version 2, maps had none.
      if (version > 1) {
        file.run(std::string("INSERT INTO points SELECT keyframe, sparse, semi_dense, body, ") +
                 (version > 5 ? "checksum" : "NULL") +
                 " FROM earlier.points WHERE keyframe IN (SELECT id FROM earlier.keyframe)");
      }
      MapTables tables(&file, *classes_);
      tables.write_configuration(configuration_);
      for (const auto& part : whole) tables.write(*part);
      if (!earlier_.empty()) require_earlier(&file);
      file.run("COMMIT");
      if (file.is_fine() && keeps_other && is_there(path_)) return put_aside(path_);
      return status_of(file);
    });
  }

  const std::string path_;
  const std::shared_ptr<const ClassTable> classes_;
  const std::string configuration_, earlier_;
  const bool sets_aside_;
  const std::filesystem::file_time_type found_;  ///< when what was there at the begin was written
  std::mutex closing_;                           ///< held while the thread is waited for
  mutable std::mutex mutex_;                     ///< guards all below but map_, which is the thread's alone
  std::condition_variable wake_;
  std::deque<Batch> waiting_;
  Status problem_;
  bool is_writing_ = false, is_closed_ = false;
  bool is_made_ = false;  ///< the file is this one's
  std::optional<OpenMap> map_;
  std::optional<Identity> identity_;  ///< of the file that was made; the thread's alone
  std::thread thread_;
};

MapDatabase::MapDatabase(const std::string& path, std::shared_ptr<const ClassTable> classes, std::string configuration,
                         std::string earlier, bool sets_aside)
    : impl_(
          std::make_unique<Impl>(path, std::move(classes), std::move(configuration), std::move(earlier), sets_aside)) {}
MapDatabase::~MapDatabase() { static_cast<void>(close()); }
void MapDatabase::write(Parts parts, bool keeps_copy) { impl_->write(std::move(parts), keeps_copy); }
bool MapDatabase::is_behind() const { return impl_->is_behind(); }
Status MapDatabase::close() { return impl_->close(); }
bool MapDatabase::is_made() const { return impl_->is_made(); }
Status MapDatabase::problem() const { return impl_->problem(); }
Result<MapCounts> MapDatabase::copy_to(const std::string& path) const { return impl_->copy_to(path); }

}  // namespace semantic_topo_loop::core
