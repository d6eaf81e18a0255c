// The parts of the MCAP file format that writer and reader share (https://mcap.dev/spec): opcodes,
// little-endian fields, and the plain structs in which records are handed to users of this library.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <string_view>

#include "sensor-hal/record/byte_io.h"

namespace rigor::record {

static_assert(std::endian::native == std::endian::little,
              "MCAP and CDR are written in the byte order of the host");

enum class Opcode : std::uint8_t {
  header = 0x01,
  footer = 0x02,
  schema = 0x03,
  channel = 0x04,
  message = 0x05,
  chunk = 0x06,
  message_index = 0x07,
  chunk_index = 0x08,
  attachment = 0x09,
  attachment_index = 0x0A,
  statistics = 0x0B,
  metadata = 0x0C,
  metadata_index = 0x0D,
  summary_offset = 0x0E,
  data_end = 0x0F
};

inline constexpr std::string_view kMagic{"\x89MCAP0\r\n", 8};
inline constexpr std::size_t kRecordHeaderBytes = 9;    ///< opcode, u64 length
inline constexpr std::size_t kMessageHeaderBytes = 22;  ///< channel, sequence, log time, publish time
inline constexpr std::size_t kFooterBytes = 20;         ///< summary start, summary offset start, CRC

enum class Compression : std::uint8_t { none, lz4, zstd };
[[nodiscard]] constexpr std::string_view to_string(Compression c) {
  return c == Compression::lz4 ? "lz4" : c == Compression::zstd ? "zstd" : "";
}

using StringMap = std::map<std::string, std::string>;

struct Schema {
  std::uint16_t id = 0;
  std::string name;      ///< e.g. `sensor_msgs/msg/Image`
  std::string encoding;  ///< e.g. `ros2msg`
  std::string text;
};

struct Channel {
  std::uint16_t id = 0;
  std::uint16_t schema = 0;  ///< id; 0 for none
  std::string topic;
  std::string message_encoding;  ///< e.g. `cdr`
  StringMap metadata;
};

struct Metadata {
  std::string name;
  StringMap values;
};

struct Attachment {
  std::string name;
  std::string media_type;
  std::uint64_t log_time_ns = 0;
  std::uint64_t create_time_ns = 0;
  std::vector<std::byte> data;
};

/// A growing block of bytes that, unlike a vector, does not zero what is about to be overwritten.
class ByteBuffer {
 public:
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] bool empty() const { return size_ == 0; }
  [[nodiscard]] std::byte* data() { return data_.get(); }
  [[nodiscard]] Bytes bytes() const { return {data_.get(), size_}; }
  void clear() { size_ = 0; }
  void reserve(std::size_t capacity) {
    if (capacity <= capacity_) return;
    capacity = std::max(capacity, capacity_ * 2);
    auto bigger = std::make_unique_for_overwrite<std::byte[]>(capacity);
    if (size_ > 0) std::memcpy(bigger.get(), data_.get(), size_);
    data_ = std::move(bigger);
    capacity_ = capacity;
  }
  /// Room for `size` bytes in all; those beyond the old size are undefined.
  void resize(std::size_t size) {
    reserve(size);
    size_ = size;
  }
  void append(const void* bytes, std::size_t size) {
    if (size == 0) return;
    reserve(size_ + size);
    std::memcpy(data_.get() + size_, bytes, size);
    size_ += size;
  }
  void append(Bytes bytes) { append(bytes.data(), bytes.size()); }
  template <class Integer>
  requires std::is_integral_v<Integer>
  void put(Integer value) { append(&value, sizeof value); }
  void put(Opcode op) { put(static_cast<std::uint8_t>(op)); }
  void put(std::string_view text) {
    put(static_cast<std::uint32_t>(text.size()));
    append(text.data(), text.size());
  }
  void put(const StringMap& map) {
    const std::size_t at = size_;
    put(std::uint32_t{0});
    for (const auto& [key, value] : map) put(std::string_view(key)), put(std::string_view(value));
    const auto length = static_cast<std::uint32_t>(size_ - at - 4);
    std::memcpy(data_.get() + at, &length, 4);
  }

 private:
  std::unique_ptr<std::byte[]> data_;
  std::size_t size_ = 0;
  std::size_t capacity_ = 0;
};

}  // namespace rigor::record
