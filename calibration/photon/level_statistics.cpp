#include "calibration/photon/level_statistics.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "calibration/photon/pattern_split.h"

namespace rigor::calibration {
namespace {

constexpr double kMadToSigma = 1.4826022185056018;
/// A pixel that a normal distribution gives once in 1e9: millions of pixels lose none of their own.
constexpr double kOutlierSigmas = 6;
/// Clipped samples that bias a variance by less than its uncertainty.
constexpr double kClippedShare = 1e-4;

double median(std::vector<double>& v) {
  if (v.empty()) return 0;
  const auto m = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), m, v.end());
  return *m;
}

struct Centre {
  double value = 0, sigma = 0;
};
/// Middle and width of those that are not outliers; a third of them on one side does no harm.
Centre robust_centre(const std::vector<double>& all, double floor) {
  std::vector<double> v = all, d;
  Centre c;
  for (int round = 0; round < 20; ++round) {
    c.value = median(v);
    d.clear();
    for (const double x : v) d.push_back(std::abs(x - c.value));
    c.sigma = std::max(floor, kMadToSigma * median(d));
    const std::size_t before = v.size();
    // Narrow first: outliers on one side shift the median towards them.
    const double cut = round < 6 ? 3 * c.sigma : kOutlierSigmas * c.sigma;
    std::vector<double> next;
    for (const double x : all)
      if (std::abs(x - c.value) <= cut) next.push_back(x);
    if (next.empty()) break;
    v = std::move(next);
    if (round > 7 && v.size() == before) break;
  }
  return c;
}

/// Upper bound of χ²/ν that is passed once in 1e9 (Wilson & Hilferty 1931; for ν = 1 exact enough: 37).
double chi_square_limit(double dof) {
  const double z = 6.0, a = 2 / (9 * dof);
  const double cube = 1 - a + z * std::sqrt(a);
  return 1.3 * cube * cube * cube;
}

class Grid {
 public:
  Grid(const FrameStacks& s, bool mosaic) : w_(s.width_px()), h_(s.height_px()), mosaic_(mosaic) {}
  [[nodiscard]] int phase(std::size_t i) const {
    if (!mosaic_) return 0;
    const auto x = static_cast<int>(i % static_cast<std::size_t>(w_));
    const auto y = static_cast<int>(i / static_cast<std::size_t>(w_));
    return (y & 1) * 2 + (x & 1);
  }
  [[nodiscard]] int phases() const { return mosaic_ ? 4 : 1; }
  [[nodiscard]] int stride() const { return mosaic_ ? 2 : 1; }
  [[nodiscard]] int width() const { return w_; }
  [[nodiscard]] int height() const { return h_; }

 private:
  int w_, h_;
  bool mosaic_;
};

double pixel_mean(const PhotonLevel& l, std::size_t i, double step) {
  return static_cast<double>(l.sum[i]) / l.count() / step;
}
double pixel_variance(const PhotonLevel& l, std::size_t i, double step) {
  const double n = l.count(), s = static_cast<double>(l.sum[i]);
  return (static_cast<double>(l.square[i]) - s * s / n) / (n - 1) / (step * step);
}

std::string pixel_name(std::size_t i, int width, const char* what) {
  char text[64];
  std::snprintf(text, sizeof text, "pixel (%d, %d), %s", static_cast<int>(i) % width,
                static_cast<int>(i) / width, what);
  return text;
}

void judge_pixels(const FrameStacks& stacks, StackStatistics& out) {
  const auto& levels = stacks.levels();
  const Grid grid(stacks, out.mosaic);
  const std::size_t n = levels.front().sum.size();
  OutlierPixels& o = out.outliers;
  o.bad.assign(n, false);
  const double step = out.step;
  std::vector<std::pair<double, Rejected>> named;
  const auto judge = [&](const std::vector<double>& value, double floor, const char* what, bool upper_only) {
    for (int phase = 0; phase < grid.phases(); ++phase) {
      std::vector<double> v;
      for (std::size_t i = 0; i < n; ++i)
        if (!o.bad[i] && grid.phase(i) == phase && std::isfinite(value[i])) v.push_back(value[i]);
      if (v.size() < 30) continue;
      const Centre c = robust_centre(v, floor);
      for (std::size_t i = 0; i < n; ++i) {
        if (o.bad[i] || grid.phase(i) != phase || !std::isfinite(value[i])) continue;
        const double d = value[i] - c.value;
        if ((upper_only ? d : std::abs(d)) <= kOutlierSigmas * c.sigma) continue;
        o.bad[i] = true;
        named.push_back({d / c.sigma, {pixel_name(i, grid.width(), what), d, std::abs(d) / c.sigma}});
      }
    }
  };

  // Hot: what grows in the dark.
  const PhotonLevel *shortest = nullptr, *longest = nullptr, *brightest = nullptr;
  for (const PhotonLevel& l : levels) {
    if (l.settings.light) continue;
    if (!shortest || l.settings.exposure_s < shortest->settings.exposure_s) shortest = &l;
    if (!longest || l.settings.exposure_s > longest->settings.exposure_s) longest = &l;
  }
  if (longest) {
    std::vector<double> value(n);
    const bool growth = longest->settings.exposure_s > 1.5 * shortest->settings.exposure_s;
    const double span = longest->settings.exposure_s - (growth ? shortest->settings.exposure_s : 0);
    for (std::size_t i = 0; i < n; ++i)
      value[i] = pixel_mean(*longest, i, step) - (growth ? pixel_mean(*shortest, i, step) : 0);
    const double floor = 0.3 / std::sqrt(static_cast<double>(longest->count()));
    std::vector<double> all = value;
    const Centre c = robust_centre(all, floor);
    judge(value, floor, growth ? "hot: it grows with the exposure in the dark" : "another level in the dark",
          false);
    if (growth) {
      o.hot_limit_dn_per_s = kOutlierSigmas * c.sigma / span;
      // The hottest are full: whoever comes near the largest level is taken for at least that (censored).
      double full = 0;
      for (std::size_t i = 0; i < n; ++i)
        if (o.bad[i]) full = std::max(full, value[i] - c.value);
      full *= 0.95;
      for (std::size_t i = 0; i < n; ++i)
        if (o.bad[i] && value[i] > c.value) {
          o.hot_dn_per_s.push_back(std::min(full, value[i] - c.value) / span);
          o.hot_full += value[i] - c.value >= full;
        }
      // A pixel that is hot from the beginning grows no more once it is full.
      for (std::size_t i = 0; i < n; ++i) value[i] = pixel_mean(*shortest, i, step);
      judge(value, floor, "another level in the dark", false);
    }
    // Noisy: blinking pixels.
    double dof = 0;
    std::fill(value.begin(), value.end(), 0.0);
    for (const PhotonLevel& l : levels) {
      if (l.settings.light || l.count() < 2) continue;
      dof += l.count() - 1;
      for (std::size_t i = 0; i < n; ++i) value[i] += pixel_variance(l, i, step) * (l.count() - 1);
    }
    if (dof > 0) {
      std::vector<double> v;
      for (std::size_t i = 0; i < n; ++i)
        if (!o.bad[i]) v.push_back(value[i] / dof);
      double mean = 0;
      for (const double x : v) mean += x / static_cast<double>(v.size());
      std::sort(v.begin(), v.end());
      // The mean of the lower nine tenths is no outlier's; of few degrees of freedom the median is far off
      // it.
      double low = 0;
      const std::size_t tenth = v.size() * 9 / 10;
      for (std::size_t i = 0; i < tenth; ++i) low += v[i] / static_cast<double>(tenth);
      const double limit = std::max(chi_square_limit(dof) * std::max(low, 1.0 / 12) * 1.35, 4 * low);
      for (std::size_t i = 0; i < n; ++i)
        if (!o.bad[i] && value[i] / dof > limit) {
          o.bad[i] = true;
          named.push_back({value[i] / dof / std::max(low, 1e-9),
                           {pixel_name(i, grid.width(), "noisier in the dark than others"),
                            std::sqrt(value[i] / dof), std::sqrt(value[i] / dof / std::max(low, 1e-9))}});
        }
    }
  }
  // Dead or stuck: another response than the neighbourhood's.
  for (const PhotonLevel& l : levels) {
    if (!l.settings.light) continue;
    double white = 0;
    for (std::size_t i = 0; i < n; ++i) white += l.most[i] / out.step >= out.max_dn;
    if (white < 0.02 * static_cast<double>(n) &&
        (!brightest || l.settings.exposure_s > brightest->settings.exposure_s))
      brightest = &l;
  }
  if (brightest) {
    const int s = grid.stride(), w = grid.width(), h = grid.height();
    std::vector<double> value(n, std::nan(""));
    std::vector<double> near;
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) {
        const std::size_t i = static_cast<std::size_t>(y * w + x);
        if (o.bad[i]) continue;
        near.clear();
        for (int dy = -2; dy <= 2; ++dy)
          for (int dx = -2; dx <= 2; ++dx) {
            const int u = x + dx * s, v = y + dy * s;
            if ((dx == 0 && dy == 0) || u < 0 || v < 0 || u >= w || v >= h) continue;
            const std::size_t k = static_cast<std::size_t>(v * w + u);
            if (!o.bad[k]) near.push_back(pixel_mean(*brightest, k, step));
          }
        if (near.size() < 5) continue;
        value[i] = pixel_mean(*brightest, i, step) - median(near);
      }
    judge(value, 0.3 / std::sqrt(static_cast<double>(brightest->count())), "another response to light",
          false);
  }
  std::sort(named.begin(), named.end(),
            [](const auto& a, const auto& b) { return a.second.sigmas > b.second.sigmas; });
  o.count = named.size();
  for (std::size_t i = 0; i < std::min<std::size_t>(named.size(), 1000); ++i)
    o.named.push_back(std::move(named[i].second));
}

LevelPoint point_of(const FrameStacks& stacks, std::size_t index, int phase, const StackStatistics& st) {
  const PhotonLevel& l = stacks.levels()[index];
  const Grid grid(stacks, st.mosaic);
  LevelPoint p;
  p.level = index, p.phase = phase, p.frames = l.count();
  const double step = st.step, frames = l.count();
  double square = 0;
  for (std::size_t i = 0; i < l.sum.size(); ++i) {
    if (st.outliers.bad[i] || grid.phase(i) != phase) continue;
    ++p.pixels;
    const double m = pixel_mean(l, i, step);
    p.mean_dn += m;
    square += m * m;
    if (l.count() > 1) {
      const double v = pixel_variance(l, i, step);
      p.variance_dn2 += v;
      p.fourth_dn4 += v * v;
    }
    p.black_share += l.least[i] == 0;
    p.white_share += l.most[i] / st.step >= st.max_dn;
  }
  if (p.pixels < 1) {
    p.usable = false;
    p.why = "no pixel is left";
    return p;
  }
  p.mean_dn /= p.pixels;
  p.variance_dn2 /= p.pixels;
  // E[s⁴] = σ⁴ (1 + 2/(L − 1))
  p.fourth_dn4 *= (frames - 1) / (frames + 1) / p.pixels;
  p.black_share /= p.pixels, p.white_share /= p.pixels;
  if (l.count() > 1) {
    // The light's flicker moves all pixels alike: EMVA 1288 takes it out by ½(ā − b̄)².
    double mean = 0, flicker = 0;
    std::vector<double> frame;
    for (const auto& f : l.frame_mean) {
      double m = 0;
      for (int k = 0; k < 4; ++k)
        m += st.mosaic ? (k == phase ? f[static_cast<std::size_t>(k)] : 0)
                       : f[static_cast<std::size_t>(k)] / 4;
      frame.push_back(m / step);
      mean += m / step / frames;
    }
    for (const double m : frame) flicker += (m - mean) * (m - mean) / (frames - 1);
    p.flicker_dn2 = flicker - p.variance_dn2 / p.pixels;
    p.variance_dn2 -= p.flicker_dn2;
  }
  p.pixel_variance_dn2 = std::max(0.0, square / p.pixels - p.mean_dn * p.mean_dn - p.variance_dn2 / frames);
  const double allowed = kClippedShare * frames;
  if (p.black_share > allowed) {
    p.usable = false;
    p.why = "clipped at black";
  }
  if (p.white_share > allowed) {
    p.usable = false;
    p.why = "saturated";
  }
  if (p.usable && l.count() < 2) {
    p.usable = false;
    p.why = "one frame has no temporal variance";
  }
  return p;
}

/// A pixel less what is smooth about it: a quadratic over the 5x5 nearest of its colour (Savitzky & Golay),
/// self included, or their mean where some are bad. `kept`: what is left of a pixel's own variance.
struct HighPass {
  double residual, mean, number, kept;
};
double smooth_weight(int dx, int dy) { return (27 - 5.0 * (dx * dx + dy * dy)) / 175; }

template <class Value>
HighPass high_pass(const Grid& grid, const std::vector<bool>& bad, int x, int y, const Value& value) {
  const int s = grid.stride();
  double sum = 0, number = 0, smooth = 0;
  for (int dy = -2; dy <= 2; ++dy)
    for (int dx = -2; dx <= 2; ++dx) {
      const auto k = static_cast<std::size_t>((y + dy * s) * grid.width() + x + dx * s);
      if (bad[k]) continue;
      const double v = value(k);
      sum += v;
      smooth += smooth_weight(dx, dy) * v;
      ++number;
    }
  const double v = value(static_cast<std::size_t>(y * grid.width() + x));
  if (number == 25) return {v - smooth, smooth, number, 1 - smooth_weight(0, 0)};
  return {v - sum / number, sum / number, number, 1 - 1 / number};
}
/// Σ c(d)²/c(0)² of the filter's autocorrelation: what neighbours that share a mean cost in certainty.
double high_pass_correlation() {
  double filter[9][9] = {};
  for (int y = 2; y <= 6; ++y)
    for (int x = 2; x <= 6; ++x) filter[y][x] = -smooth_weight(x - 4, y - 4);
  filter[4][4] += 1;
  double sum = 0, centre = 0;
  for (int dy = -8; dy <= 8; ++dy)
    for (int dx = -8; dx <= 8; ++dx) {
      double c = 0;
      for (int y = 0; y < 9; ++y)
        for (int x = 0; x < 9; ++x)
          if (y + dy >= 0 && y + dy < 9 && x + dx >= 0 && x + dx < 9)
            c += filter[y][x] * filter[y + dy][x + dx];
      if (dx == 0 && dy == 0) centre = c;
      sum += c * c;
    }
  return sum / (centre * centre);
}

template <class Visit>
void interior(const Grid& grid, const std::vector<bool>& bad, const Visit& visit) {
  const int margin = 2 * grid.stride();
  for (int y = margin; y < grid.height() - margin; ++y)
    for (int x = margin; x < grid.width() - margin; ++x)
      if (!bad[static_cast<std::size_t>(y * grid.width() + x)]) visit(x, y);
}

}  // namespace

StackStatistics stack_statistics(const FrameStacks& stacks, const StatisticsOptions& options) {
  StackStatistics out;
  const auto& levels = stacks.levels();
  if (levels.empty()) return out;
  out.step = stacks.step();
  const int largest = stacks.largest() / out.step;
  out.bits = options.bits;
  if (out.bits == 0)
    for (const int b : {8, 10, 12, 14, 16})
      if (largest < (1 << b)) {
        out.bits = b;
        break;
      }
  out.max_dn = (1 << out.bits) - 1;
  // Colours: places of the mosaic that differ in the light by more than a lens or a gain pattern makes.
  out.mosaic = options.mosaic == 1;
  if (options.mosaic < 0)
    for (const PhotonLevel& l : levels) {
      if (!l.settings.light) continue;
      std::array<double, 4> m{};
      for (const auto& f : l.frame_mean)
        for (std::size_t k = 0; k < 4; ++k) m[k] += f[k] / l.count() / out.step;
      const auto [low, high] = std::minmax_element(m.begin(), m.end());
      if (*high - *low > 0.08 * *high && *high - *low > 1) out.mosaic = true;
    }
  judge_pixels(stacks, out);
  const int phases = out.mosaic ? 4 : 1;
  for (std::size_t i = 0; i < levels.size(); ++i)
    for (int phase = 0; phase < phases; ++phase) out.points.push_back(point_of(stacks, i, phase, out));
  return out;
}

std::vector<std::string> repeated_noise(const FrameStacks& stacks, const StackStatistics& st) {
  std::vector<std::string> found;
  const PhotonLevel* before = nullptr;
  for (std::size_t l = 0; l < stacks.levels().size(); ++l) {
    const PhotonLevel& level = stacks.levels()[l];
    const bool usable = std::any_of(st.points.begin(), st.points.end(), [&](const LevelPoint& p) {
      return p.level == l && p.usable && p.variance_dn2 > 0.05;
    });
    if (!usable) continue;
    if (before) {
      double n = 0, x = 0, y = 0, xx = 0, yy = 0, xy = 0;
      for (std::size_t i = 0; i < level.sum.size(); ++i) {
        if (st.outliers.bad[i]) continue;
        const double a = level.last[i] - static_cast<double>(level.sum[i]) / level.count();
        const double b = before->last[i] - static_cast<double>(before->sum[i]) / before->count();
        ++n, x += a, y += b, xx += a * a, yy += b * b, xy += a * b;
      }
      const double variance = (xx - x * x / n) * (yy - y * y / n);
      if (variance > 0 && std::abs(xy - x * y / n) / std::sqrt(variance) > 0.3 + 6 / std::sqrt(n))
        found.push_back(before->text() + " and " + level.text());
    }
    before = &level;
  }
  return found;
}

void fixed_patterns(const FrameStacks& stacks, const std::vector<bool>& in_range, StackStatistics& st) {
  const auto& levels = stacks.levels();
  const Grid grid(stacks, st.mosaic);
  if (grid.width() < 16 || grid.height() < 16) return;
  const double step = st.step;
  const auto& bad = st.outliers.bad;
  std::vector<bool> dark(levels.size(), false), light(levels.size(), false);
  double top = 0;
  for (std::size_t k = 0; k < st.points.size(); ++k)
    if (in_range[k] && levels[st.points[k].level].settings.light) top = std::max(top, st.points[k].mean_dn);
  for (std::size_t k = 0; k < st.points.size(); ++k) {
    const bool is_light = levels[st.points[k].level].settings.light;
    if (in_range[k] && !is_light) dark[st.points[k].level] = true;
  }
  for (std::size_t l = 0; l < levels.size(); ++l) {
    if (!levels[l].settings.light) continue;
    bool all = true;
    double most = 0;
    for (std::size_t k = 0; k < st.points.size(); ++k)
      if (st.points[k].level == l) all = all && in_range[k], most = std::max(most, st.points[k].mean_dn);
    light[l] = all && most > 0.4 * top;
  }
  // The light's flicker is common to all pixels: no noise of the pattern.
  std::vector<std::array<double, 4>> flicker(levels.size());
  for (const LevelPoint& p : st.points) flicker[p.level][static_cast<std::size_t>(p.phase)] = p.flicker_dn2;
  const auto noise_of = [&](std::size_t l, std::size_t i) {
    return (pixel_variance(levels[l], i, step) - flicker[l][static_cast<std::size_t>(grid.phase(i))]) /
           levels[l].count();
  };
  std::vector<float> dark_mean(bad.size(), 0), dark_noise(bad.size(), 0);
  double frames = 0, dark_frames = 0;
  for (std::size_t l = 0; l < levels.size(); ++l)
    if (dark[l]) dark_frames += levels[l].count();
  for (std::size_t l = 0; l < levels.size(); ++l) {
    if (!dark[l]) continue;
    const double weight = levels[l].count() / dark_frames;
    for (std::size_t i = 0; i < bad.size(); ++i) {
      dark_mean[i] += static_cast<float>(weight * pixel_mean(levels[l], i, step));
      dark_noise[i] += static_cast<float>(weight * weight * noise_of(l, i));
    }
  }
  const double correlation = high_pass_correlation();
  const auto finish = [&](double square, double noise, double number, PatternVariance& p) {
    if (number < 100) return;
    p.pixels = number;
    p.value = (square - noise) / number;
    p.sigma = square / number * std::sqrt(2 * correlation / number);
    p.valid = true;
  };
  if (dark_frames > 0) {
    double square = 0, noise = 0, number = 0;
    interior(grid, bad, [&](int x, int y) {
      const HighPass h = high_pass(grid, bad, x, y, [&](std::size_t k) { return double(dark_mean[k]); });
      if (h.number < 5) return;
      square += h.residual * h.residual / h.kept;
      noise += dark_noise[static_cast<std::size_t>(y * grid.width() + x)];
      ++number;
    });
    finish(square, noise, number, st.dark_pattern_dn2);
    st.dark_split_dn2 =
        split_pattern(dark_mean, dark_noise, bad, {grid.width(), grid.height(), grid.stride()});
  }
  std::vector<float> gain(bad.size(), 0), gain_noise(bad.size(), 0);
  for (std::size_t l = 0; l < levels.size(); ++l) {
    if (!light[l]) continue;
    ++frames;
    for (std::size_t i = 0; i < bad.size(); ++i) {
      gain[i] += static_cast<float>(pixel_mean(levels[l], i, step));
      gain_noise[i] += static_cast<float>(noise_of(l, i));
    }
  }
  if (frames > 0 && dark_frames > 0) {
    double square = 0, noise = 0, number = 0;
    interior(grid, bad, [&](int x, int y) {
      const auto at = static_cast<std::size_t>(y * grid.width() + x);
      const HighPass h =
          high_pass(grid, bad, x, y, [&](std::size_t k) { return gain[k] - frames * dark_mean[k]; });
      if (h.number < 5 || !(h.mean > 0)) return;
      square += h.residual * h.residual / (h.mean * h.mean) / h.kept;
      noise += (gain_noise[at] + frames * frames * dark_noise[at]) / (h.mean * h.mean);
      ++number;
    });
    finish(square, noise, number, st.light_pattern);
    // Relative to the mean light of each colour.
    std::array<double, 4> mean{}, count{};
    std::vector<float> relative(bad.size()), relative_noise(bad.size());
    for (std::size_t i = 0; i < bad.size(); ++i) {
      relative[i] = static_cast<float>(gain[i] - frames * dark_mean[i]);
      if (bad[i]) continue;
      const auto k = static_cast<std::size_t>(grid.phase(i));
      mean[k] += relative[i], ++count[k];
    }
    for (std::size_t i = 0; i < bad.size(); ++i) {
      const auto k = static_cast<std::size_t>(grid.phase(i));
      const auto m = static_cast<float>(mean[k] / std::max(1.0, count[k]));
      relative[i] /= m;
      relative_noise[i] = (gain_noise[i] + static_cast<float>(frames * frames) * dark_noise[i]) / (m * m);
    }
    st.light_split =
        split_pattern(relative, relative_noise, bad, {grid.width(), grid.height(), grid.stride()});
  }
}

}  // namespace rigor::calibration
