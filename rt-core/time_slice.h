// How long a thread may go on before the kernel looks who else waits for its CPU.
//
// Under Linux's ordinary policy a thread that wakes up interrupts one that computes only at the end of the
// latter's time slice, unless its own slice is shorter (Linux 6.12 and later). So that a command leaves at
// its instant while pictures are drawn, threads that compute for milliseconds ask for long slices, and
// threads that wait for instants for short ones. Each keeps its share of the machine. Measured with the demo
// on two cores: 1.0 % of commands more than 1 ms late without, 0.15 % with both.
#pragma once

#include "rt-core/time.h"

namespace rigor {

inline constexpr Duration kLongTimeSlice = milliseconds(20);
inline constexpr Duration kShortTimeSlice = microseconds(100);

/// The calling thread, for itself. Without effect under a real-time policy, and on kernels before 6.12, which
/// give all threads the same slice. The kernel takes 0.1 to 100 ms.
void ask_for_time_slice(Duration slice) noexcept;

}  // namespace rigor
