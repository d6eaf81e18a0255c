// Where the bytes of samples lie: on the heap, or, from `share` on, in memory that another process can map.
// So a picture that a program of its own works on is not copied: the program is told where in that memory it
// lies.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "rt-core/result.h"

namespace rigor::sample_memory {

/// From now on all bytes of samples are taken from one anonymous file (memfd) of this process, which other
/// processes may map; samples that have their memory already keep it. Calling it again changes nothing.
/// io: the kernel gives no such file. Setup context.
[[nodiscard]] Status share();

/// A descriptor of that file, for reading only where the kernel allows it, closed on exec; the caller closes
/// it. -1: not shared, or no descriptor is left. Setup context.
[[nodiscard]] int open_for_reader();
/// Gives memory back to where it came from.
struct Free {
  static constexpr std::int64_t kOnHeap = -1;
  std::size_t size_bytes = 0;
  std::int64_t offset = kOnHeap;  ///< in the file
  void operator()(std::byte* memory) const noexcept;
};
using Block = std::unique_ptr<std::byte[], Free>;
/// Zeroed and touched. Setup context; throws std::bad_alloc.
[[nodiscard]] Block take(std::size_t size_bytes);

}  // namespace rigor::sample_memory
