// What the files of the range fit share. Internal to calibration/tof.
#pragma once

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

namespace rigor::calibration {

/// f(0) … f(parts − 1) on all cores: the same parts on any number of threads, so that sums come out the same.
template <class F>
void in_parts(std::size_t parts, const F& f) {
  const std::size_t threads = std::min<std::size_t>(parts, std::max(1u, std::thread::hardware_concurrency()));
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t i = next++; i < parts; i = next++) f(i);
  };
  std::vector<std::jthread> pool;
  for (std::size_t t = 1; t < threads; ++t) pool.emplace_back(work);
  work();
}

/// Reorders `v`; 0 of none.
inline double median_of(std::vector<double>& v) {
  if (v.empty()) return 0;
  const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), middle, v.end());
  return *middle;
}

}  // namespace rigor::calibration
