// A failed system call on a device, as a user is told of it.
#pragma once

#include <cerrno>
#include <cstring>
#include <string>

#include "rt-core/result.h"

namespace rigor::v4l2 {

inline tl::unexpected<Error> system_error(const std::string& path, const char* what, int negative_errno) {
  const ErrorCode code = negative_errno == -EBUSY ? ErrorCode::unavailable : ErrorCode::io;
  std::string message = std::string(what) + ": " + std::strerror(-negative_errno);
  if (negative_errno == -EBUSY) message += "; another program holds the device (fuser " + path + " names it)";
  return fail(code, path, std::move(message));
}

}  // namespace rigor::v4l2
