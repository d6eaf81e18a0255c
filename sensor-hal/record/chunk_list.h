// Where the chunks of a recording are, until its summary is written: packed, because a run of many hours has
// thousands of chunks an hour. A chunk that holds 15 topics takes some 60 bytes here, 220 in the summary.
//
// One thread at a time; allocates.
#pragma once

#include <cstdint>
#include <deque>
#include <utility>
#include <vector>

namespace rigor::record {

/// What the summary says of one chunk.
struct ChunkPlace {
  std::uint64_t start_ns = 0;
  std::uint64_t end_ns = 0;
  std::uint64_t offset = 0;
  std::uint64_t length = 0;                                            ///< with its record header
  std::vector<std::pair<std::uint16_t, std::uint64_t>> index_offsets;  ///< of its message indexes, by channel
  std::uint64_t index_length = 0;
  std::uint64_t compressed = 0;
  std::uint64_t uncompressed = 0;
};

class ChunkList {
 public:
  void add(const ChunkPlace& chunk);
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] std::size_t packed_bytes() const { return packed_.size(); }

  /// Goes through the chunks in the order in which they were added; none may be added meanwhile.
  class Cursor {
   public:
    explicit Cursor(const ChunkList& list) : list_(&list) {}
    /// Null after the last one. Valid until the next call.
    [[nodiscard]] const ChunkPlace* next();

   private:
    [[nodiscard]] std::uint64_t number();
    [[nodiscard]] std::uint64_t after(std::uint64_t before);
    const ChunkList* list_;
    std::size_t at_ = 0;
    ChunkPlace place_;
  };

 private:
  void put(std::uint64_t number);
  void put_after(std::uint64_t before, std::uint64_t number);

  std::deque<std::uint8_t> packed_;  // grows without moving, which would leave holes of its size in the heap
  std::size_t size_ = 0;
  std::uint64_t last_start_ns_ = 0, last_end_ = 0;
};

}  // namespace rigor::record
