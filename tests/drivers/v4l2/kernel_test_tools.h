// Where the kernel's video devices are, and what tests do without them.
#pragma once

#include <cstdlib>
#include <fstream>

#include "drivers/v4l2/v4l2_device.h"
#include "tests/drivers/v4l2/v4l2_test_tools.h"

/// A device that this kernel lacks skips the test; in the guest, which has them all, it fails it.
#define NEEDS_DEVICE(there, what)                                                         \
  do {                                                                                    \
    if (!(there)) {                                                                       \
      if (std::getenv("RIGOR_GUEST") != nullptr) FAIL() << "this kernel has no " << what; \
      GTEST_SKIP() << "this kernel has no " << what;                                      \
    }                                                                                     \
  } while (false)

namespace rigor::v4l2::test {

inline std::string node_of(const std::string& driver, bool output) {
  for (const DeviceTable& t : list_nodes(false))
    if (t.driver == driver && (output ? t.outputs : t.captures)) return t.path;
  return {};
}
inline std::string vivid() { return node_of("vivid", false); }
/// The loop-back node that is both sides at once (exclusive_caps=0).
inline std::string loopback() {
  for (const DeviceTable& t : list_nodes(false)) {
    if (t.driver != "v4l2 loopback") continue;
    auto fd = open_node(t.path);
    const auto output = fd ? read_table(fd->get(), t.path, true, false) : Result<DeviceTable>(t);
    if (output && output->outputs) return t.path;
  }
  return {};
}
inline bool write_file(const std::string& file, const std::string& text) {
  std::ofstream out(file);
  out << text << std::flush;
  return out.good();
}

}  // namespace rigor::v4l2::test
