#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace semantic_topo_loop::core {

// CBOR (RFC 8949), written and read without a tree in memory. Of its kinds those are written and read that JSON has:
// null, true and false, integers, floating point of 32 and 64 bits, text, arrays and maps of known size.

/// What a value begins with.
struct CborHead {
  int kind = 0, info = 0;
  std::uint64_t argument = 0;
};

class CborWriter {
 public:
  void null();
  void flag(bool value);
  void integer(std::int64_t value);
  /// In 32 bits where they keep all of it.
  void number(double value);
  void text(std::string_view value);
  /// So many values follow.
  void array(std::size_t size);
  /// So many pairs of a text and a value follow.
  void map(std::size_t size);
  std::string take() { return std::move(bytes_); }

 private:
  void head(int kind, int info, std::uint64_t argument);
  /// In as few bytes as `argument` needs.
  void counted(int kind, std::uint64_t argument);

  std::string bytes_;
};

/// Reads values one after the other. The first problem is kept, and names its place, "submap 4.frames[3].image"; what
/// is read after it means nothing.
class CborReader {
  struct Step {
    const char* member;  ///< null: an element
    std::size_t number;
  };

 public:
  /// Damaged bytes are a problem: what is not one value of the kinds above, or nests deeper than ours do.
  /// @param name of the whole, for messages   @param begin, end outlive this
  CborReader(std::string name, const std::uint8_t* begin, const std::uint8_t* end);

  const std::string& problem() const { return problem_; }
  bool is_fine() const { return problem_.empty(); }

  /// @return whether the next value is null, which is then read
  bool null();
  bool flag();
  std::int64_t integer();
  double number();  ///< finite
  std::string text();
  /// An array whose elements are asked for one by one; what is left at the end is passed over.
  class Row {
   public:
    explicit Row(CborReader* reader) : reader_(*reader), place_(reader->at_), left_(reader->array()) {}
    Row(const Row&) = delete;
    Row& operator=(const Row&) = delete;
    ~Row() {
      for (; left_ > 0; --left_) reader_.skip();
    }
    /// @return whether there is another element, which `read` has read
    template <class Read>
    bool next(const Read& read) {
      return next({nullptr, number_++}, read);
    }
    /// The next element, which has a name.
    template <class Read>
    void member(const char* name, const Read& read) {
      if (!next({name, 0}, read)) reader_.reject(place_, std::string("has no '") + name + "'");
    }

   private:
    template <class Read>
    bool next(const Step& step, const Read& read) {
      if (left_ == 0 || !reader_.is_fine()) return false;
      reader_.step(step, read);
      --left_;
      return true;
    }

    CborReader& reader_;
    const std::uint8_t* const place_;
    std::size_t left_, number_ = 0;
  };
  /// @param read called for each element of an array in turn, and reads it   @return how many there were
  template <class Read>
  std::size_t elements(const Read& read) {
    Row row(this);
    std::size_t count = 0;
    while (row.next(read)) ++count;
    return count;
  }

  /// A map whose members are asked for by name: in any order, fastest in theirs. The reader is behind it at the end.
  class Members {
   public:
    explicit Members(CborReader* reader)
        : reader_(*reader),
          place_(reader->at_),
          size_(reader->map()),
          begin_(reader->at_),
          next_(begin_),
          left_(size_) {}
    Members(const Members&) = delete;
    Members& operator=(const Members&) = delete;
    ~Members() {
      reader_.at_ = next_;
      for (; left_ > 0; --left_) {
        reader_.skip();
        reader_.skip();
      }
    }
    bool has(const char* name) { return find(name); }
    template <class Read>
    void member(const char* name, const Read& read) {
      if (!reader_.is_fine()) return;
      if (!find(name)) return reader_.reject(place_, std::string("has no '") + name + "'");
      reader_.step({name, 0}, read);
      if (!is_next_) return;
      next_ = reader_.at_;
      --left_;
    }

   private:
    bool find(const char* name);

    CborReader& reader_;
    const std::uint8_t* const place_;
    const std::size_t size_;
    const std::uint8_t* const begin_;  ///< of the first
    const std::uint8_t* next_;         ///< behind those that were asked for in order
    std::size_t left_;                 ///< from there on
    bool is_next_ = false;             ///< what was found last
  };

  /// Where the next value begins.
  const std::uint8_t* at() const { return at_; }
  /// @param at where the value begins that breaks the rule; it is told if it is a single one
  void reject(const std::uint8_t* at, const std::string& rule);

 private:
  template <class Read>
  void step(const Step& step, const Read& read) {
    steps_.push_back(step);
    read();
    steps_.pop_back();
  }
  /// Of a value that is sound; of none after a problem.
  CborHead take();
  /// Begins one. @return its size, 0 if there is none
  std::size_t size_of(int kind, const char* rule);
  std::size_t array();
  std::size_t map();
  /// Passes over a value.
  void skip();

  std::string name_;
  const std::uint8_t* at_;
  const std::uint8_t* end_;
  std::vector<Step> steps_;  ///< from the whole to the value at hand
  std::string problem_;
};

/// @return discarded if CborReader calls it damaged
nlohmann::json from_cbor(const std::string& bytes);

}  // namespace semantic_topo_loop::core
