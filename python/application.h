// An object of Python as the application of a rig in virtual time, called within the loop.
#pragma once

#include <pybind11/pybind11.h>

#include <exception>
#include <memory>

#include "bench/application/turn_application.h"

namespace rigor::python {

/// What the loop calls, and what came of it. Made and destroyed with the GIL.
class ApplicationCalls {
 public:
  /// `called` has start(str) -> str, turn(memoryview) -> bytes and finish() (rigor/_application.py).
  explicit ApplicationCalls(pybind11::object called) : called_(std::move(called)) {}

  /// What it raised is raised again, once. With the GIL.
  void rethrow();

  // Any thread without the GIL or with it.
  [[nodiscard]] Result<std::string> start(const std::string& setup);
  [[nodiscard]] std::optional<std::span<const std::byte>> turn(std::span<const std::byte> body) noexcept;
  [[nodiscard]] Status finish();

 private:
  void keep_exception();
  pybind11::object called_;
  pybind11::bytes answer_;
  std::exception_ptr raised_;
  std::string said_;  ///< of what was raised
};

[[nodiscard]] std::unique_ptr<application::TurnHandler> python_handler(
    std::shared_ptr<ApplicationCalls> calls);

}  // namespace rigor::python
