// A network of the test's own: where the rights allow it, each test process has a network namespace with
// loopback alone, so that tests neither hear each other nor anybody else. Elsewhere they use the machine's
// loopback, each in a DDS domain of its own.
#pragma once

#include <cstdint>
#include <string>

namespace rigor::test {

/// Whether this process has a network of its own. Decided before the first test.
[[nodiscard]] bool own_network();
/// A DDS domain that no other test process on this machine uses at the same time, most likely.
[[nodiscard]] std::uint32_t free_domain();

}  // namespace rigor::test
