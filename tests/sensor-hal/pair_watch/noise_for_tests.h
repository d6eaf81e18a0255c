// Random numbers of the tests in this folder: fast, and the same on every machine.
#pragma once

#include <cmath>
#include <cstdint>

namespace rigor::pair_watch::testing {

class Random {
 public:
  /// Streams of neighbouring seeds do not overlap: the state starts at a scrambled place.
  explicit Random(std::uint64_t seed) : state_(seed + 0x1234567ULL) {
    state_ = bits() ^ 0xD1B54A32D192ED03ULL;
  }
  std::uint64_t bits() {  // SplitMix64
    std::uint64_t z = (state_ += 0x9E3779B97F4A7C15ULL);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return z ^ (z >> 31);
  }
  double uniform() { return static_cast<double>(bits() >> 11) * 0x1p-53 + 0x1p-54; }
  /// Standard normal (Box-Muller).
  double normal() {
    if (has_) {
      has_ = false;
      return next_;
    }
    const double r = std::sqrt(-2 * std::log(uniform())), a = 6.283185307179586 * uniform();
    next_ = r * std::sin(a), has_ = true;
    return r * std::cos(a);
  }
  /// Nearly: four uniform numbers, of variance 1; for millions of pixels.
  double quick_normal() {
    const std::uint64_t b = bits();
    const double sum =
        static_cast<double>((b & 0xffff) + (b >> 16 & 0xffff) + (b >> 32 & 0xffff) + (b >> 48));
    return (sum - 131070) / 37837.2275;
  }

 private:
  std::uint64_t state_;
  bool has_ = false;
  double next_ = 0;
};

}  // namespace rigor::pair_watch::testing
