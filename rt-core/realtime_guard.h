// The guard of test builds: proves that the loop does nothing that could make it wait.
//
//   ASSERT_TRUE(guard::install());
//   loop.run(...);
//   EXPECT_TRUE(guard::report().clean()) << guard::report().text();
//
// Within a RealtimeScope (the executive opens one around its loop) it catches
//   - malloc, free and their family, new and delete     by standing in front of them
//   - pthread locks and conditions, contended or not    by standing in front of them
//   - every system call that may block or wait, from wherever it comes, libc's insides and inline assembly
//   included
//                                                       by the kernel's syscall user dispatch (Linux 5.11,
//                                                       x86-64)
//   - minor and major page faults                       by getrusage at both ends of the scope
//
// Reading clocks and the thread's own usage is allowed; so are trylock and waking another thread (futex
// wake). Link `rigor_rt_guard` into the test that wants it; it does not go together with sanitizers.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::guard {

enum class Violation : std::uint8_t { allocation, lock, page_fault, system_call };

struct Finding {
  Violation kind{};
  const char* what = "";          ///< function; for a system call see `number`
  long number = 0;                ///< of the system call; faults: how many
  std::array<void*, 16> stack{};  ///< return addresses, innermost first
  int depth = 0;
};

struct Report {
  std::uint64_t allocations = 0, locks = 0, page_faults = 0, system_calls = 0;
  std::vector<Finding> findings;  ///< the first 64
  [[nodiscard]] bool clean() const { return allocations + locks + page_faults + system_calls == 0; }
  [[nodiscard]] std::string text() const;
};

/// Setup thread, before the loop: hooks itself to RealtimeScope. Unavailable where the kernel cannot dispatch
/// system calls to their process; allocations, locks and faults are caught even then.
[[nodiscard]] Status install();
void uninstall() noexcept;
/// Forget what was found.
void clear() noexcept;
/// What was found so far; symbols are looked up here. Not within a RealtimeScope.
[[nodiscard]] Report report();

}  // namespace rigor::guard
