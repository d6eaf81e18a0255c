// Reads the fields of MCAP records out of bytes that nobody vouches for: every length is checked against what
// is there before it is used. A field that does not fit turns the reader bad; it then yields zeros until it
// is asked for ok().
#pragma once

#include <optional>
#include <type_traits>

#include "sensor-hal/record/mcap_format.h"

namespace rigor::record {

/// Any thread; allocates only for strings and maps that are there in full.
class FieldReader {
 public:
  explicit FieldReader(Bytes bytes) : bytes_(bytes) {}
  [[nodiscard]] bool ok() const { return ok_; }
  [[nodiscard]] std::size_t position() const { return at_; }
  [[nodiscard]] std::size_t left() const { return bytes_.size() - at_; }

  template <class Integer>
  requires std::is_integral_v<Integer> Integer get() {
    Integer value{};
    const Bytes field = take(sizeof value);
    if (ok_) std::memcpy(&value, field.data(), sizeof value);
    return value;
  }
  std::string_view text() {
    const Bytes field = take(get<std::uint32_t>());
    return {reinterpret_cast<const char*>(field.data()), field.size()};
  }
  StringMap map();
  /// The next `size` bytes; none, and bad, where there are fewer.
  Bytes take(std::uint64_t size) {
    if (!ok_ || size > left()) {
      ok_ = false;
      return {};
    }
    const Bytes field = bytes_.subspan(at_, static_cast<std::size_t>(size));
    at_ += static_cast<std::size_t>(size);
    return field;
  }

 private:
  Bytes bytes_;
  std::size_t at_ = 0;
  bool ok_ = true;
};

struct RecordView {
  Opcode op{};
  Bytes body;
  std::size_t offset = 0;  ///< of the record header within the bytes that were walked
};

/// The next whole record, or none: `bytes` end here, or end within a record (then something is left()).
[[nodiscard]] std::optional<RecordView> next_record(FieldReader& in);

[[nodiscard]] std::optional<Schema> parse_schema(Bytes body);
[[nodiscard]] std::optional<Channel> parse_channel(Bytes body);
[[nodiscard]] std::optional<Metadata> parse_metadata(Bytes body);
/// Checks the attachment's CRC too.
[[nodiscard]] std::optional<Attachment> parse_attachment(Bytes body);

struct ChunkHeader {
  std::uint64_t start_ns = 0;
  std::uint64_t end_ns = 0;
  std::uint64_t uncompressed = 0;
  std::uint32_t crc = 0;
  std::string compression;
  std::uint64_t stored = 0;
};
/// The fields before a chunk's records; afterwards `in` stands at the records, of which there may be too few.
[[nodiscard]] std::optional<ChunkHeader> parse_chunk_header(FieldReader& in);

/// Fills `out`, whose size is what the file says. Errors (protocol): another size comes out, damaged data, or
/// a compression other than "", lz4 and zstd.
[[nodiscard]] Status decompress(const std::string& compression, Bytes in, std::span<std::byte> out);
/// Whether data of this compression can possibly grow to that size: refuses absurd claims before memory is
/// taken.
[[nodiscard]] bool plausible_size(const std::string& compression, Bytes in, std::uint64_t uncompressed);

}  // namespace rigor::record
