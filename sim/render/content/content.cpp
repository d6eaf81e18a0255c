#include "sim/render/content/content.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <numbers>
#include <thread>
#include <vector>

namespace rigor::render {

namespace {

std::atomic<std::uint64_t> last_serial{0};
/// Those that this thread takes first, from `next` on.
struct SerialsAside {
  std::uint64_t next = 0, end = 0;
};
thread_local SerialsAside serials_aside;

}  // namespace

std::uint64_t next_serial() noexcept {
  if (serials_aside.next != serials_aside.end) return serials_aside.next++;
  return last_serial.fetch_add(1, std::memory_order_relaxed) + 1;
}

void make_in_parallel(std::size_t count, const std::function<void(std::size_t)>& make) {
  constexpr std::uint64_t kSerialsOfEach = 1'000'000;
  const std::uint64_t first = last_serial.fetch_add(count * kSerialsOfEach, std::memory_order_relaxed) + 1;
  std::vector<std::exception_ptr> thrown(count);
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t i; (i = next.fetch_add(1)) < count;) {
      const SerialsAside before = serials_aside;
      serials_aside = {first + i * kSerialsOfEach, first + (i + 1) * kSerialsOfEach};
      try {
        make(i);
      } catch (...) {
        thrown[i] = std::current_exception();
      }
      serials_aside = before;
    }
  };
  {
    const std::size_t threads =
        std::min<std::size_t>({count, std::max(1U, std::thread::hardware_concurrency()), 8});
    std::vector<std::jthread> helpers;
    for (std::size_t i = 1; i < threads; ++i) helpers.emplace_back(work);
    work();
  }
  for (const std::exception_ptr& e : thrown)
    if (e) std::rethrow_exception(e);
}

Spectrum SkyMap::at(const Eigen::Vector3d& direction) const {
  if (width < 1 || height < 1) return {};
  const double azimuth = std::atan2(direction.x(), direction.y());  // from north over east
  const double elevation = std::asin(std::clamp(direction.z() / direction.norm(), 0.0, 1.0));
  const double u = azimuth / (2 * std::numbers::pi) * width - 0.5;
  const double v = std::clamp(elevation / (std::numbers::pi / 2) * height - 0.5, 0.0, height - 1.0);
  const double u0 = std::floor(u), v0 = std::floor(v);
  const auto column = [&](double x) {
    const int i = static_cast<int>(x) % width;
    return i < 0 ? i + width : i;
  };
  const int i0 = column(u0), i1 = column(u0 + 1);
  const int j0 = static_cast<int>(v0), j1 = std::min(j0 + 1, height - 1);
  const auto fu = static_cast<float>(u - u0), fv = static_cast<float>(v - v0);
  Spectrum s{};
  for (std::size_t b = 0; b < s.size(); ++b) {
    const auto texel = [&](int i, int j) { return radiance[static_cast<std::size_t>(j * width + i)][b]; };
    const float low = texel(i0, j0) * (1 - fu) + texel(i1, j0) * fu;
    const float high = texel(i0, j1) * (1 - fu) + texel(i1, j1) * fu;
    s[b] = low * (1 - fv) + high * fv;
  }
  return s;
}

}  // namespace rigor::render
