#include "bench/dataset/npy.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace rigor::npy {

std::string file_of(std::string_view descr, const std::vector<std::size_t>& shape, std::string_view bytes) {
  // A tuple of one has a comma behind it.
  std::string header = fmt::format("{{'descr': {}, 'fortran_order': False, 'shape': ({}{}), }}", descr,
                                   fmt::join(shape, ", "), shape.size() == 1 ? "," : "");
  constexpr std::size_t kBefore = 10, kAlignment = 64;
  header.append((kAlignment - (kBefore + header.size() + 1) % kAlignment) % kAlignment, ' ');
  header.push_back('\n');
  std::string file("\x93NUMPY\x01\x00", 8);
  file.push_back(static_cast<char>(header.size() & 0xFF));
  file.push_back(static_cast<char>(header.size() >> 8));
  return file + header + std::string(bytes);
}

}  // namespace rigor::npy
