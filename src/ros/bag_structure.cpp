#include "ros/bag_structure.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string_view>
#include <vector>

namespace semantic_topo_loop {
namespace {

constexpr std::string_view kMagic = "#ROSBAG V2.0\n";
enum Op : char { kMessage = 2, kBagHeader = 3, kIndex = 4, kChunk = 5, kChunkInfo = 6, kConnection = 7 };

/// A file's bytes as memory: of a large bag the pages that are looked at are read, and no others.
class MappedFile {
 public:
  explicit MappedFile(const std::string& file) {
    const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
    struct stat status {};
    if (descriptor < 0 || ::fstat(descriptor, &status) != 0) {
      problem_ = std::strerror(errno);
    } else if (status.st_size > 0) {
      size_ = static_cast<std::size_t>(status.st_size);
      data_ = ::mmap(nullptr, size_, PROT_READ, MAP_PRIVATE, descriptor, 0);
      if (data_ == MAP_FAILED) problem_ = std::strerror(errno);
    }
    if (descriptor >= 0) ::close(descriptor);
  }
  ~MappedFile() {
    if (size_ > 0 && data_ != MAP_FAILED) ::munmap(data_, size_);
  }
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;

  std::string_view bytes() const { return {static_cast<const char*>(data_), size_}; }
  /// Empty if it could be opened.
  const std::string& problem() const { return problem_; }

 private:
  void* data_ = nullptr;
  std::size_t size_ = 0;
  std::string problem_;
};

/// A little-endian number; nothing if the text has another length.
template <class Number>
std::optional<Number> number(std::string_view text) {
  if (text.size() != sizeof(Number)) return std::nullopt;
  Number value = 0;
  for (std::size_t i = text.size(); i-- > 0;)
    value = static_cast<Number>(value << 8 | static_cast<unsigned char>(text[i]));
  return value;
}

/// Cuts a text off that has its length before it.
std::optional<std::string_view> cut_text(std::string_view* bytes) {
  const std::optional<std::uint32_t> length = number<std::uint32_t>(bytes->substr(0, sizeof(std::uint32_t)));
  if (!length || *length > bytes->size() - sizeof(std::uint32_t)) return std::nullopt;
  const std::string_view text = bytes->substr(sizeof(std::uint32_t), *length);
  bytes->remove_prefix(sizeof(std::uint32_t) + *length);
  return text;
}

/// The fields name=value of a header.
class Fields {
 public:
  /// @return nothing if they do not fill the header
  static std::optional<Fields> parse(std::string_view header) {
    Fields fields;
    while (!header.empty()) {
      const std::optional<std::string_view> field = cut_text(&header);
      const std::size_t equals = field ? field->find('=') : std::string_view::npos;
      if (equals == std::string_view::npos) return std::nullopt;
      fields.fields_.emplace_back(field->substr(0, equals), field->substr(equals + 1));
    }
    return fields;
  }
  std::string_view text(std::string_view name) const {
    const auto found = std::find_if(fields_.begin(), fields_.end(), [name](const auto& f) { return f.first == name; });
    return found == fields_.end() ? std::string_view() : found->second;
  }
  template <class Number>
  std::optional<Number> get(std::string_view name) const {
    return number<Number>(text(name));
  }

 private:
  std::vector<std::pair<std::string_view, std::string_view>> fields_;
};

struct Record {
  Fields fields;
  std::string_view data;
  char op() const { return number<char>(fields.text("op")).value_or(0); }
};

std::optional<Record> cut_record(std::string_view* bytes) {
  const std::optional<std::string_view> header = cut_text(bytes);
  std::optional<Fields> fields = header ? Fields::parse(*header) : std::nullopt;
  const std::optional<std::string_view> data = fields ? cut_text(bytes) : std::nullopt;
  if (!data) return std::nullopt;
  return Record{*std::move(fields), *data};
}

/// The chunk that index records speak of.
struct Chunk {
  std::uint32_t size = 0;  ///< uncompressed
  bool is_compressed = false;
  std::vector<std::uint32_t> offsets;  ///< of the messages in it, ascending; none if it is compressed
};

std::optional<Chunk> read_chunk(const Record& record) {
  const std::optional<std::uint32_t> size = record.fields.get<std::uint32_t>("size");
  if (!size) return std::nullopt;
  Chunk chunk;
  chunk.size = *size;
  chunk.is_compressed = record.fields.text("compression") != "none";
  if (chunk.is_compressed) return chunk;
  if (*size != record.data.size()) return std::nullopt;
  for (std::string_view rest = record.data; !rest.empty();) {
    const auto offset = static_cast<std::uint32_t>(record.data.size() - rest.size());
    const std::optional<Record> inner = cut_record(&rest);
    if (!inner) return std::nullopt;
    if (inner->op() == kMessage) chunk.offsets.push_back(offset);
    if (inner->op() == kConnection && !Fields::parse(inner->data)) return std::nullopt;
  }
  return chunk;
}

bool is_index_of(const Chunk& chunk, const Record& record) {
  constexpr std::size_t kTime = 8, kEntry = kTime + sizeof(std::uint32_t);
  const std::optional<std::uint32_t> count = record.fields.get<std::uint32_t>("count");
  if (!count || record.data.size() != kEntry * *count) return false;
  for (std::size_t at = kTime; at < record.data.size(); at += kEntry) {
    const auto offset = *number<std::uint32_t>(record.data.substr(at, sizeof(std::uint32_t)));
    const bool is_there = chunk.is_compressed ? offset + std::uint64_t{2 * sizeof(std::uint32_t)} <= chunk.size
                                              : std::binary_search(chunk.offsets.begin(), chunk.offsets.end(), offset);
    if (!is_there) return false;
  }
  return true;
}

/// @return the first byte of the first record that is not what it should be; nothing if there is none
std::optional<std::size_t> find_damage(std::string_view bag) {
  std::optional<Chunk> chunk;
  std::vector<std::uint64_t> chunks;  // where they begin, ascending
  std::uint64_t index_begin = 0;
  bool begins_index = false;  // some record does, or the bag ends there
  for (std::string_view rest = bag.substr(kMagic.size()); !rest.empty();) {
    const std::size_t at = bag.size() - rest.size();
    const std::optional<Record> record = cut_record(&rest);
    if (!record) return at;
    begins_index = begins_index || at == index_begin;
    bool is_right = true;
    switch (record->op()) {
      case kBagHeader:
        index_begin = record->fields.get<std::uint64_t>("index_pos").value_or(0);
        break;
      case kChunk:
        chunk = read_chunk(*record);
        chunks.push_back(at);
        is_right = chunk.has_value();
        break;
      case kIndex:
        is_right = chunk && is_index_of(*chunk, *record);
        break;
      case kChunkInfo: {
        const auto begin = record->fields.get<std::uint64_t>("chunk_pos");
        const auto count = record->fields.get<std::uint32_t>("count");
        is_right = begin && count && record->data.size() == 2 * sizeof(std::uint32_t) * *count &&
                   std::binary_search(chunks.begin(), chunks.end(), *begin);
        break;
      }
      case kConnection:
        is_right = Fields::parse(record->data).has_value();
        break;
      default:
        is_right = false;
    }
    if (!is_right) return at;
  }
  if (index_begin != 0 && !begins_index && index_begin != bag.size()) return kMagic.size();
  return std::nullopt;
}

}  // namespace

core::Status check_bag_structure(const std::string& file) {
  const MappedFile mapped(file);
  if (!mapped.problem().empty()) return core::Error{mapped.problem()};
  const std::string_view bag = mapped.bytes();
  if (bag.substr(0, kMagic.size()) != kMagic) return core::Error{"is no bag of format 2.0"};
  if (const std::optional<std::size_t> at = find_damage(bag)) {
    return core::Error{"is damaged or cut short, from byte " + std::to_string(*at) + " of " +
                       std::to_string(bag.size()) + "; `rosbag reindex` may repair it"};
  }
  return {};
}

}  // namespace semantic_topo_loop
