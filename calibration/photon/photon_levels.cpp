// Which levels count, how sure each of their numbers is, and where the fit starts.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include "calibration/photon/photon_problem.h"

namespace rigor::calibration {

std::string photon_text(const char* format, double a, double b, double c) {
  char t[320];
  std::snprintf(t, sizeof t, format, a, b, c);
  return t;
}

Whitening PhotonProblem::whitening(std::size_t k, const PhotonModel& m) const {
  const LevelPoint& p = st_.points[k];
  Whitening w;
  w.mean = p.mean_dn, w.variance = p.variance_dn2;
  // Before the converter: the mean that it gives is off by as much as the rounding that is to be modelled.
  const PhotonFrame& s = level(k).settings;
  const double above_k = std::isfinite(s.temperature_c) ? s.temperature_c - out_.temperature_reference_c : 0;
  const double signal =
      std::max(0.0, s.light ? m.signal[k]
                            : m.p[kGain] * m.p[kDark] * s.exposure_s * std::exp2(above_k / m.p[kDoubling]));
  const double mean = m.p[kBlack] + signal;
  const double before =
      std::max(1e-4, m.p[kOffset] + std::pow(m.p[kGain] * m.p[kRead], 2) + m.p[kGain] * signal);
  w.pixel_variance = pixel_variance_before(mean, before, p.pixel_variance_dn2);
  const double samples = p.pixels * p.frames, gain = m.p[kGain];
  // Cumulants of K·Poisson: third K² signal, fourth K³ signal.
  const double third = plan_.dark_level ? gain * gain * signal : 0;
  const double fourth = plan_.dark_level ? gain * gain * gain * signal : 0;
  const double floor = 1e-6;
  double vm = std::max(floor, p.variance_dn2) / samples;
  double vv = (2 * std::max(floor, p.fourth_dn4) / (p.frames - 1) + fourth / p.frames) / p.pixels;
  if (before < 0.5) {
    // The pixels stand at places between two steps that chance gave them, which bends mean and variance.
    double bent = 0;
    (void)rounded_pixel_variance(mean, before, w.pixel_variance, &bent);
    vm += std::max(0.0, bent) / p.pixels;
    vv += std::max(0.0, p.fourth_dn4 - p.variance_dn2 * p.variance_dn2) / p.pixels;
  }
  // Without noise the mean stands on a step of the converter, somewhere in it.
  if (p.variance_dn2 < kNoNoise_dn2) vm += 1.0 / 12;
  const double limit = 0.99 * std::sqrt(vm * vv);
  const double c = std::clamp(third / samples, -limit, limit);
  w.l11 = std::sqrt(vm);
  w.l21 = c / w.l11;
  w.l22 = std::sqrt(vv - w.l21 * w.l21);
  w.with_variance = p.variance_dn2 >= kNoNoise_dn2;
  return w;
}

void PhotonProblem::unround_dark_pattern(const PhotonModel& m) {
  if (!plan_.dsnu) return;
  struct Level {
    double weight, mean, signal;
  };
  std::vector<Level> levels;
  double total = 0;
  const double gain = m.p[kGain], read_dn2 = std::pow(gain * m.p[kRead], 2);
  for (const std::size_t k : of(false)) {
    const PhotonFrame& s = level(k).settings;
    const double above = std::isfinite(s.temperature_c) ? s.temperature_c - out_.temperature_reference_c : 0;
    const double signal = std::max(0.0, gain * m.p[kDark] * s.exposure_s * std::exp2(above / m.p[kDoubling]));
    levels.push_back({static_cast<double>(st_.points[k].frames), m.p[kBlack] + signal, signal});
    total += levels.back().weight;
  }
  if (read_dn2 > 0.5 || levels.empty()) return;
  for (const std::size_t k : of(false))
    if (st_.points[k].variance_dn2 < kNoNoise_dn2) {
      // Nothing dithers the steps: a pixel shows on which side of one it lies, and no more.
      plan_.dsnu = false;
      plan_.dsnu_rounded = true;
      return;
    }
  // Of the mean picture that a pattern of standard deviation `dn` gives.
  const auto rounded = [&](double dn) {
    double mean = 0, square = 0, sum = 0;
    for (int i = -20; i <= 20; ++i) {
      const double z = 0.25 * i, w = std::exp(-0.5 * z * z);
      double picture = 0;
      for (const Level& l : levels) {
        double value = 0, variance = 0;
        rounded_moments(l.mean + dn * z, read_dn2, gain, l.signal, 0.0, value, variance);
        picture += l.weight / total * value;
      }
      const double deviation = picture - m.p[kBlack];
      mean += w * deviation, square += w * deviation * deviation, sum += w;
    }
    return square / sum - std::pow(mean / sum, 2);
  };
  const PatternVariance& measured = st_.dark_pattern_dn2;
  double dn = std::sqrt(std::max(1e-12, measured.value)), slope = 1;
  for (int i = 0; i < 12; ++i) {
    const double v = rounded(dn), step = 0.02 * dn;
    slope = (rounded(dn + step) - v) / (std::pow(dn + step, 2) - dn * dn);
    // Between two steps of the converter the picture hardly knows the pattern.
    if (!(slope > 0.2)) break;
    const double next = std::sqrt(std::max(0.01 * dn * dn, dn * dn + (measured.value - v) / slope));
    const bool done = std::abs(next - dn) < 1e-5 * dn;
    dn = next;
    if (done) break;
  }
  if (!(slope > 0.2) || !(std::abs(rounded(dn) - measured.value) < 0.01 * measured.value)) {
    plan_.dsnu = false;
    plan_.dsnu_rounded = true;
    return;
  }
  dark_pattern_.value = dn * dn;
  dark_pattern_.sigma = measured.sigma / slope;
}

Status PhotonProblem::prepare() {
  std::string levels;
  std::size_t usable = 0;
  out_.in_range.assign(st_.points.size(), false);
  std::map<std::size_t, std::string> why;
  for (const LevelPoint& p : st_.points) {
    usable += p.usable;
    if (!p.usable) {
      std::string& s = why[p.level];
      if (s.find(p.why) == std::string::npos) s += (s.empty() ? "" : ", ") + p.why;
    }
  }
  for (const auto& [l, reason] : why) {
    const std::string name = stacks_.levels()[l].text();
    levels += (levels.empty() ? "" : "; ") + name + ": " + reason;
    st_.warnings.push_back(name + " left out" + (st_.mosaic ? " (in one colour or more)" : "") + ": " +
                           reason);
  }
  if (usable == 0)
    return fail(ErrorCode::bad_input, "",
                "expected levels of two frames or more between black and white, got none (" + levels +
                    "); raise the black level until the dark frames are above 0 everywhere, and take "
                    "exposures from a tenth to seven tenths of the range");
  choose_range();
  return {};
}

void PhotonProblem::choose_range() {
  const int phases = st_.mosaic ? 4 : 1;
  std::size_t outside = 0;
  double black = 0, blacks = 0;
  for (std::size_t k = 0; k < st_.points.size(); ++k)
    if (st_.points[k].usable && !level(k).settings.light) {
      out_.in_range[k] = true;
      black += st_.points[k].mean_dn, ++blacks;
    }
  if (blacks > 0) black /= blacks;
  double saturation = 0, full_s = 0;
  bool peak = false;
  for (int phase = 0; phase < phases; ++phase) {
    std::vector<const LevelPoint*> rising;  // in order of exposure
    bool white = false;
    for (std::size_t k = 0; k < st_.points.size(); ++k) {
      const LevelPoint& p = st_.points[k];
      if (p.phase != phase || !level(k).settings.light) continue;
      white = white || p.why == "saturated";
      if (p.usable) rising.push_back(&p);
    }
    if (rising.empty()) continue;
    // The variance falls and does not come back: the pixel is full. (After a change of the gain it rises
    // again; under a tone curve it falls from the beginning.) Or the converter is full.
    std::size_t top = rising.size() - 1;
    while (top > 0) {
      const LevelPoint &p = *rising[top], &q = *rising[top - 1];
      const double sigma = std::sqrt(2 * p.fourth_dn4 / (p.frames - 1) / p.pixels);
      if (p.variance_dn2 > q.variance_dn2 + 5 * sigma + 0.01) break;
      --top;
    }
    const double at = rising[top]->mean_dn, last = rising.back()->mean_dn;
    if (at < last * 0.98 && at > last * 0.5 &&
        rising.back()->variance_dn2 < 0.9 * rising[top]->variance_dn2) {
      peak = true;
      saturation = std::max(saturation, at);
      full_s = std::max(full_s, stacks_.levels()[rising[top]->level].settings.exposure_s);
    } else if (white) {
      saturation = std::max(saturation, static_cast<double>(st_.max_dn));
      out_.converter_saturates = true;
    }
  }
  if (peak) out_.converter_saturates = false;
  if (saturation > 0) out_.saturation_signal_dn = saturation - black;
  const double limit = saturation > 0 ? black + 0.7 * (saturation - black) : 1e300;
  for (std::size_t k = 0; k < st_.points.size(); ++k) {
    if (!st_.points[k].usable || !level(k).settings.light) continue;
    // 70 % of the saturation's light; where the response bends that is not 70 % of its signal.
    out_.in_range[k] =
        st_.points[k].mean_dn <= limit || (full_s > 0 && level(k).settings.exposure_s <= 0.7 * full_s);
    outside += !out_.in_range[k];
  }
  if (outside > 0)
    st_.warnings.push_back(
        photon_text("%.0f levels above 70 %% of the saturation at %.5g DN are not in the photon transfer",
                    double(outside), saturation));
  // All pixels full: the variance of the light is gone, the mean is the full well.
  double dark_variance = 0;
  for (const std::size_t k : of(false)) dark_variance = std::max(dark_variance, st_.points[k].variance_dn2);
  double number = 0;
  for (std::size_t k = 0; peak && dark_variance > 0 && k < st_.points.size(); ++k) {
    const LevelPoint& p = st_.points[k];
    if (!p.usable || !level(k).settings.light || out_.in_range[k] || p.variance_dn2 > 1.15 * dark_variance)
      continue;
    if (number == 0 || p.mean_dn > plateau_dn_) {
      plateau_dn_ = p.mean_dn;
      // Without noise the plateau stands on a step of the converter, somewhere in it.
      plateau_sigma_dn_ = p.variance_dn2 > 0.1 ? std::sqrt(p.variance_dn2 / (p.pixels * p.frames)) : 0.29;
    }
    ++number;
  }
  if (number > 0) out_.saturation_signal_dn = plateau_dn_ - black;
}

void PhotonProblem::start(PhotonModel& m) const {
  const auto dark = of(false), light = of(true);
  double black = 0, read_dn2 = 0;
  if (!dark.empty()) {
    // The shortest dark exposure stands for black.
    const std::size_t k = *std::min_element(dark.begin(), dark.end(), [&](std::size_t a, std::size_t b) {
      return level(a).settings.exposure_s < level(b).settings.exposure_s;
    });
    black = st_.points[k].mean_dn;
    read_dn2 = std::max(0.01, st_.points[k].variance_dn2 - 1.0 / 12);
  }
  m.p[kBlack] = black;
  double num = 0, den = 0, mean = 0, variance = 0;
  for (const std::size_t k : light) {
    mean += st_.points[k].mean_dn / static_cast<double>(light.size());
    variance += st_.points[k].variance_dn2 / static_cast<double>(light.size());
  }
  const bool through = !dark.empty();
  for (const std::size_t k : light) {
    const double x = st_.points[k].mean_dn - (through ? black : mean);
    const double y = st_.points[k].variance_dn2 - (through ? read_dn2 + 1.0 / 12 : variance);
    num += x * y, den += x * x;
  }
  m.p[kGain] = den > 0 && num > 0 ? num / den : 0.01 * std::max(1.0, st_.max_dn / 255.0);
  m.p[kRead] = std::sqrt(read_dn2) / m.p[kGain];
  m.p[kOffset] = through ? 0 : variance - m.p[kGain] * mean;
  if (!through) m.p[kRead] = 0;
  double t0 = 1e300, t1 = 0, y0 = 0, y1 = 0;
  for (const std::size_t k : dark) {
    const double t = level(k).settings.exposure_s;
    if (t < t0) t0 = t, y0 = st_.points[k].mean_dn;
    if (t > t1) t1 = t, y1 = st_.points[k].mean_dn;
  }
  if (plan_.dark_current) m.p[kDark] = std::max(1e-3 / (t1 * m.p[kGain]), (y1 - y0) / (t1 - t0) / m.p[kGain]);
  m.dsnu = plan_.dsnu ? std::sqrt(st_.dark_pattern_dn2.value) / m.p[kGain] : 0;
  m.prnu = plan_.prnu ? std::sqrt(st_.light_pattern.value) : 0;
  m.full_well = plan_.full_well ? (plateau_dn_ - black) / m.p[kGain] : 0;
  m.signal.assign(st_.points.size(), 0);
  for (const std::size_t k : light) m.signal[k] = st_.points[k].mean_dn - black;
}

}  // namespace rigor::calibration
