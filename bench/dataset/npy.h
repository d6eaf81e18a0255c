// Arrays as files of NumPy (format 1.0): np.load reads them, and maps them with mmap_mode.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace rigor::npy {

/// The header and the bytes. `descr` is NumPy's name of the element: '<f4', or a list of fields as Python
/// writes it; the shape goes row by row. Precondition: as many bytes as descr and shape say.
[[nodiscard]] std::string file_of(std::string_view descr, const std::vector<std::size_t>& shape,
                                  std::string_view bytes);

template <class T>
[[nodiscard]] std::string_view bytes_of(std::span<const T> values) {
  return {reinterpret_cast<const char*>(values.data()), values.size_bytes()};
}
[[nodiscard]] inline std::string floats(std::span<const float> values,
                                        const std::vector<std::size_t>& shape) {
  return file_of("'<f4'", shape, bytes_of(values));
}

}  // namespace rigor::npy
