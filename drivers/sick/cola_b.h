// CoLa-B, SICK's binary dialogue over TCP: what stands between telegrams.
//
//   02 02 02 02 | length (uint32, big-endian) | body of that many bytes | checksum: XOR of the body's bytes
//
// The parser takes a stream as it comes, in pieces of any size. What is no telegram (garbage, a wrong
// checksum, a length that nobody sends) is counted and skipped; the next start mark is looked for from the
// byte after the wrong one's, so that a telegram behind garbage is found although the garbage looked like a
// beginning.
//
// Source: SICK, "Telegram Listing LiDAR sensors" 8014631, section 2.1; recordings of a LMS511 and a TiM781S.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace rigor::sick {

using Bytes = std::span<const std::uint8_t>;
using Buffer = std::vector<std::uint8_t>;

inline constexpr std::size_t kFrameOverhead = 9;  ///< start mark, length and checksum
/// Ten channels of 65535 values in 16 bits do not fit; no device sends them. A LMS5xx with five echoes and
/// their RSSI sends 23 KiB.
inline constexpr std::size_t kMaxScanBody = 512 * 1024;

/// Appends the telegram with this body.
void append_frame(Bytes body, Buffer& out);
/// Wraps what was appended to `out` from `begin` on, which is kept free for it: see `begin_frame`.
[[nodiscard]] std::size_t begin_frame(Buffer& out);
void end_frame(Buffer& out, std::size_t begin);

/// One thread. Keeps at most one telegram beyond what was taken out of it, and takes memory as telegrams need
/// it: no more than `max_body` plus one piece.
class FrameParser {
 public:
  explicit FrameParser(std::size_t max_body = kMaxScanBody) : max_body_(max_body) {}

  /// More of the stream.
  void add(Bytes piece);
  /// Room for the next `size` bytes of the stream, to be filled and then told by `added`. Saves a copy.
  [[nodiscard]] std::span<std::uint8_t> room(std::size_t size);
  void added(std::size_t size);
  /// The next telegram's body, valid until the next call of any of these; empty optional-like: data() is
  /// null.
  [[nodiscard]] Bytes next();
  void reset();

  [[nodiscard]] std::uint64_t skipped_bytes() const { return skipped_; }
  [[nodiscard]] std::uint64_t bad_checksums() const { return bad_checksums_; }
  [[nodiscard]] std::uint64_t bad_lengths() const { return bad_lengths_; }
  /// Bytes that wait for the rest of their telegram.
  [[nodiscard]] std::size_t pending() const { return end_ - begin_; }

 private:
  void compact();

  std::size_t max_body_;
  Buffer data_;
  std::size_t begin_ = 0, end_ = 0;
  std::uint64_t skipped_ = 0, bad_checksums_ = 0, bad_lengths_ = 0;
};

}  // namespace rigor::sick
