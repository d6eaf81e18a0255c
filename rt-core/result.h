// How setup code says that something went wrong: what kind, where, and a sentence that tells the user what
// was expected, what came, and what to do. The real-time loop never makes one; it returns status bytes and
// counters.
#pragma once

#include <cstdint>
#include <string>
#include <tl/expected.hpp>
#include <utility>

namespace rigor {

enum class ErrorCode : std::uint8_t {
  bad_input,     ///< the user's file, option or value is wrong: exit status 2
  not_found,     ///< a file, device or channel that was named does not exist: exit status 2
  not_writable,  ///< an output that was named cannot be written: exit status 2
  unavailable,   ///< the machine lacks something (a driver, a right, a library): exit status 1
  timeout,       ///< a peer did not answer in time
  protocol,      ///< a peer or a file broke its format
  disk_full,     ///< no space left for an output
  io,            ///< any other failed system call
  wrong_state,   ///< a call that the lifecycle does not allow in this state
  internal       ///< a defect of Rigor
};

/// An error on its way to the user. Setup context; allocates.
struct Error {
  ErrorCode code = ErrorCode::internal;
  std::string where;    ///< `file:line:column`, a channel's name, a path; may be empty
  std::string message;  ///< what was expected, what came, what to do

  [[nodiscard]] std::string text() const { return where.empty() ? message : where + ": " + message; }
  /// 2 where the user's input is at fault and nothing was touched, 1 otherwise.
  [[nodiscard]] int exit_status() const {
    return code == ErrorCode::bad_input || code == ErrorCode::not_found || code == ErrorCode::not_writable
               ? 2
               : 1;
  }
};

template <class T>
using Result = tl::expected<T, Error>;
using Status = tl::expected<void, Error>;

[[nodiscard]] inline tl::unexpected<Error> fail(ErrorCode code, std::string where, std::string message) {
  return tl::unexpected<Error>(Error{code, std::move(where), std::move(message)});
}

}  // namespace rigor
