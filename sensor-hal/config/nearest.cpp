#include <algorithm>
#include <array>
#include <cstddef>

#include "sensor-hal/config/yaml.h"

namespace rigor {
namespace {

constexpr std::size_t kMaxWord = 64;  // longer words are compared by their beginning

char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; }

/// Insertions, deletions, substitutions and swaps of neighbours (optimal string alignment).
std::size_t distance(std::string_view a, std::string_view b) {
  a = a.substr(0, kMaxWord);
  b = b.substr(0, kMaxWord);
  std::array<std::array<std::size_t, kMaxWord + 1>, 3> rows{};
  auto *before = &rows[0], *last = &rows[1], *now = &rows[2];
  for (std::size_t j = 0; j <= b.size(); ++j) (*last)[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    (*now)[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const bool same = lower(a[i - 1]) == lower(b[j - 1]);
      auto d = std::min({(*last)[j] + 1, (*now)[j - 1] + 1, (*last)[j - 1] + (same ? 0 : 1)});
      if (i > 1 && j > 1 && lower(a[i - 1]) == lower(b[j - 2]) && lower(a[i - 2]) == lower(b[j - 1]))
        d = std::min(d, (*before)[j - 2] + 1);
      (*now)[j] = d;
    }
    std::swap(before, last);
    std::swap(last, now);
  }
  return (*last)[b.size()];
}

}  // namespace

std::string nearest(std::string_view word, const std::vector<std::string>& candidates) {
  std::string best;
  std::size_t best_distance = 0;
  for (const auto& c : candidates) {
    if (c.empty() || word.empty()) continue;
    const auto d = distance(word, c);
    // A third of the letters may differ; a forgotten unit or ending (`rate` for `rate_hz`) is near as well.
    const auto shorter = std::min({word.size(), c.size(), kMaxWord});
    const auto longer = std::min(std::max(word.size(), c.size()), kMaxWord);
    const bool prefix = shorter >= 3 && (c.starts_with(word) || word.starts_with(c));
    const auto allowed = std::max<std::size_t>(1, longer / 3);
    if ((d <= allowed && d < shorter) || prefix) {
      if (best.empty() || d < best_distance) best = c, best_distance = d;
    }
  }
  return best;
}

std::string joined_or_none(const std::vector<std::string>& words) {
  std::string out;
  for (const std::string& w : words) out += (out.empty() ? "" : ", ") + w;
  return out.empty() ? "none" : out;
}

}  // namespace rigor
