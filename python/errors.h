// Errors of Rigor as exceptions of Python: rigor.Error and what derives from it (rigor/_errors.py).
#pragma once

#include <pybind11/pybind11.h>

#include <utility>

#include "rt-core/result.h"

namespace rigor::python {

namespace py = pybind11;

/// Throws what becomes the exception of Python. With the GIL.
[[noreturn]] void raise(const Error& error);

inline void check(const Status& status) {
  if (!status) raise(status.error());
}
template <class T>
[[nodiscard]] T value_of(Result<T> result) {
  if (!result) raise(result.error());
  return std::move(*result);
}

}  // namespace rigor::python
