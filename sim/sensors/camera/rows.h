// Rows of a picture, some at a time, on all threads.
#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace rigor::sensor_stage {

template <class F>
void for_rows(int rows, const F& body) {
  constexpr int kRowsPerTask = 8;
  tbb::parallel_for(tbb::blocked_range<int>(0, rows, kRowsPerTask), [&](const tbb::blocked_range<int>& r) {
    for (int y = r.begin(); y < r.end(); ++y) body(y);
  });
}

}  // namespace rigor::sensor_stage
