// Arrays of NumPy over vectors that they keep.
#pragma once

#include <pybind11/numpy.h>

#include <utility>
#include <vector>

#include "sim/sensors/measurement.h"

namespace rigor::python {

/// An array over a vector that it keeps; None where it is empty. With the GIL.
template <class T>
pybind11::object array_of(std::vector<T> values, std::vector<pybind11::ssize_t> shape) {
  if (values.empty()) return pybind11::none();
  auto* owned = new std::vector<T>(std::move(values));
  const pybind11::capsule base(owned, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return pybind11::array_t<T>(std::move(shape), owned->data(), base);
}

/// What rigor.Truth is made from, or None: arrays (height, width), of `points` (n,). With the GIL.
[[nodiscard]] pybind11::object truth_of(GroundTruth truth, bool points);

}  // namespace rigor::python
