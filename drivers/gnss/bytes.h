// The bytes of messages, before and after they are read. Header only.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace rigor::gnss {

using Bytes = std::span<const std::uint8_t>;
using Buffer = std::vector<std::uint8_t>;

inline void append_zeros(Buffer& out, std::size_t count) { out.insert(out.end(), count, 0); }

}  // namespace rigor::gnss
