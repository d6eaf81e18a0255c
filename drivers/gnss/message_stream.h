// A receiver's stream of bytes as messages: UBX, NMEA 0183 and RTCM 3 may be mixed, split across reads and
// interspersed with garbage.
//
//   stream.add(bytes);
//   while (const auto m = stream.next()) …      // views are valid until the next call
//
// A frame whose checksum does not match, or that never ends, costs its first byte and nothing else: what
// follows is searched again, so no message that came whole is lost by a length that lies.
#pragma once

#include <optional>
#include <string_view>

#include "drivers/gnss/ubx.h"

namespace rigor::gnss {

/// The longest sentence with its start and its end. NMEA 0183 allows 82 characters; receivers with more
/// digits and u-blox's own sentences go beyond that.
inline constexpr std::size_t kMaxSentence = 256;

struct Message {
  enum class Kind : std::uint8_t { ubx, nmea, rtcm } kind = Kind::ubx;
  UbxId ubx{};
  Bytes payload;          ///< of UBX; of RTCM without head and checksum
  std::string_view text;  ///< of NMEA: between `$` and `*`
  Bytes frame;            ///< all of it
};

class MessageStream {
 public:
  struct Counters {
    std::uint64_t bytes = 0, ubx = 0, nmea = 0, rtcm = 0;
    std::uint64_t bad_checksums = 0;  ///< frames and sentences whose checksum does not match, or has none
    std::uint64_t bad_lengths = 0;    ///< UBX frames that say more than any message has
    std::uint64_t garbage = 0;        ///< bytes that belong to no message
  };

  MessageStream();
  /// No allocation once the buffer has its size, for pieces of up to 4096 bytes.
  void add(Bytes bytes);
  [[nodiscard]] std::optional<Message> next() noexcept;
  /// The end of a recording: an incomplete frame may hide whole messages behind its start. True: call next().
  [[nodiscard]] bool finish() noexcept;
  void reset() noexcept;
  /// Bytes that are no whole message yet, once `next` gave none.
  [[nodiscard]] std::size_t pending() const noexcept { return data_.size() - begin_; }
  [[nodiscard]] const Counters& counters() const { return counters_; }

 private:
  enum class Found : std::uint8_t { message, incomplete, nothing };
  Found look_ubx(Bytes at, Message& out) noexcept;
  Found look_nmea(Bytes at, Message& out) noexcept;
  Found look_rtcm(Bytes at, Message& out) noexcept;

  Buffer data_;
  std::size_t begin_ = 0;
  bool ended_ = false;
  Counters counters_;
};

/// CRC-24Q, of RTCM 3.
[[nodiscard]] std::uint32_t crc24q(Bytes bytes) noexcept;
/// Appends an RTCM 3 frame. Precondition: at most 1023 bytes.
void append_rtcm(Buffer& out, Bytes payload);

}  // namespace rigor::gnss
