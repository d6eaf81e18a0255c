// CRC-32 as MCAP (and zlib) count it: polynomial 0xEDB88320 reflected, start and end inverted.
//
// A recorder spends a large part of its time here, so carry-less multiplication is used where the CPU has it,
// and slicing by eight where not. combine() joins the checksums of two neighbouring blocks, so that bytes
// which already count for a chunk need not be read again for the whole file.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace rigor::record {

/// CRC-32 of `bytes`, continuing from `crc` (0 for a fresh start). Any thread, no allocation.
[[nodiscard]] std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t crc = 0) noexcept;

/// The same, without special instructions: the reference that the fast way is tested against.
[[nodiscard]] std::uint32_t crc32_portable(std::span<const std::byte> bytes, std::uint32_t crc = 0) noexcept;

/// CRC-32 of A followed by B, from that of A, that of B, and the length of B in bytes. O(log length).
[[nodiscard]] std::uint32_t crc32_combine(std::uint32_t crc_a, std::uint32_t crc_b,
                                          std::uint64_t length_b) noexcept;

}  // namespace rigor::record
