#include "python/errors.h"

namespace rigor::python {
namespace {

const char* name_of(ErrorCode code) {
  switch (code) {
    case ErrorCode::bad_input:
      return "bad_input";
    case ErrorCode::not_found:
      return "not_found";
    case ErrorCode::not_writable:
      return "not_writable";
    case ErrorCode::unavailable:
      return "unavailable";
    case ErrorCode::timeout:
      return "timeout";
    case ErrorCode::protocol:
      return "protocol";
    case ErrorCode::disk_full:
      return "disk_full";
    case ErrorCode::io:
      return "io";
    case ErrorCode::wrong_state:
      return "wrong_state";
    case ErrorCode::internal:
      break;
  }
  return "internal";
}

}  // namespace

void raise(const Error& error) {
  const py::object made =
      py::module_::import("rigor._errors").attr("make")(name_of(error.code), error.where, error.message);
  PyErr_SetObject(reinterpret_cast<PyObject*>(Py_TYPE(made.ptr())), made.ptr());
  throw py::error_already_set();
}

}  // namespace rigor::python
