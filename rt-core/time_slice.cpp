#include "rt-core/time_slice.h"

#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdint>

namespace rigor {

void ask_for_time_slice(Duration slice) noexcept {
  // The kernel's `sched_attr`, whose header cannot stand beside glibc's <sched.h>.
  struct {
    std::uint32_t size, policy;
    std::uint64_t flags;
    std::int32_t nice;
    std::uint32_t priority;
    std::uint64_t runtime_ns, deadline_ns, period_ns;
  } attr{};
  if (syscall(SYS_sched_getattr, 0, &attr, sizeof attr, 0U) != 0) return;
  if (attr.policy != SCHED_OTHER && attr.policy != SCHED_BATCH) return;
  attr.size = sizeof attr;
  attr.runtime_ns = static_cast<std::uint64_t>(slice.ns());  // of an ordinary thread: its slice
  (void)syscall(SYS_sched_setattr, 0, &attr, 0U);
}

}  // namespace rigor
