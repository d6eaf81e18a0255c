// A network of the test's own: where the rights allow it, each test process has a network namespace with
// loopback alone, so that tests neither hear each other nor anybody else. Elsewhere they use the machine's
// loopback, each in a DDS domain of its own.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <thread>

namespace rigor::test {

/// Whether this process has a network of its own. Decided before the first test.
[[nodiscard]] bool own_network();
/// A DDS domain that no other test process on this machine uses at the same time, most likely.
[[nodiscard]] std::uint32_t free_domain();

/// Until it holds, at most half a minute: discovery takes milliseconds, and a test that waits for it ends all
/// the same.
template <class F>
[[nodiscard]] bool holds_soon(F&& what) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  while (!what()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace rigor::test
