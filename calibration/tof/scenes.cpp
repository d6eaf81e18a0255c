#include "calibration/tof/scenes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <numbers>

#include "sensor-hal/models/tof/tof_math.h"

namespace rigor::calibration {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr double kLightSpeed_mps = 299792458.0;
constexpr double kRejectSigmas = 5;

std::uint64_t hash_of(const TofFrame& f) {
  std::uint64_t h = 1469598103934665603u;
  const auto add = [&](const std::vector<float>& v) {
    for (const float x : v) {
      std::uint32_t bits = 0;
      std::memcpy(&bits, &x, sizeof bits);
      h = (h ^ bits) * 1099511628211u;
    }
  };
  add(f.range_m);
  add(f.amplitude);
  return h;
}

double median_of(std::vector<double>& v) {
  const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), middle, v.end());
  return *middle;
}

/// One pixel over the frames of a scene.
struct Group {
  double amplitude, inverse, shot_inverse, inverse_square;
  std::size_t first, count;  ///< of its samples
  double centre;
};

}  // namespace

Result<TofScenes> sort_scenes(std::vector<TofFrame> frames, const std::vector<std::size_t>& scene_of) {
  TofScenes out;
  if (frames.empty()) return fail(ErrorCode::bad_input, "", "expected pictures of ranges, got none");
  const std::string first = frames.front().name;
  out.width_px = frames.front().width_px, out.height_px = frames.front().height_px;
  std::map<std::uint64_t, std::size_t> known;
  std::map<std::pair<double, std::size_t>, std::size_t> scene;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    TofFrame& f = frames[i];
    if (f.width_px != out.width_px || f.height_px != out.height_px)
      return fail(
          ErrorCode::bad_input, f.name,
          fmt::format("expected pictures of one size, got {}x{} and before it {}x{} ({}): one camera, "
                      "one mode at a time",
                      f.width_px, f.height_px, out.width_px, out.height_px, first));
    if (f.range_m.size() != out.pixels() || (!f.amplitude.empty() && f.amplitude.size() != out.pixels()))
      return fail(ErrorCode::bad_input, f.name,
                  fmt::format("expected {} ranges and as many amplitudes or none, got {} and {}",
                              out.pixels(), f.range_m.size(), f.amplitude.size()));
    // Noise does not repeat in a thousand pixels: equal frames are one frame that was written twice.
    const auto [it, fresh] = known.emplace(hash_of(f), i);
    if (!fresh && out.pixels() > 1) {
      ++out.duplicates;
      if (out.notes.size() < 20)
        out.notes.push_back(f.name + ": a copy of " + out.frames[it->second].name + ", used once");
      continue;
    }
    it->second = out.frames.size();
    const bool placed = std::isfinite(f.distance_m);
    const auto key =
        std::make_pair(placed ? f.distance_m : -1.0, i < scene_of.size() ? scene_of[i] : std::size_t{0});
    const auto [at, added] = scene.emplace(key, out.scenes.size());
    if (added) {
      std::string name = placed ? fmt::format("plane at {:g} m", f.distance_m) : f.name;
      if (std::any_of(out.scenes.begin(), out.scenes.end(),
                      [&](const TofScene& s) { return s.name == name; }))
        name += " (" + f.name + ")";
      out.scenes.push_back({std::move(name), f.distance_m, {}});
    }
    out.scenes[at->second].frames.push_back(out.frames.size());
    out.frames.push_back(std::move(f));
  }
  out.ceiling = amplitude_ceiling(out.frames);
  std::size_t good = 0;
  for (TofFrame& f : out.frames) {
    for (std::size_t p = 0; p < f.range_m.size(); ++p) {
      float& r = f.range_m[p];
      const bool full = !f.amplitude.empty() && f.amplitude[p] >= out.ceiling;
      out.saturated += full;
      if (full || !(r > 0) || !std::isfinite(r)) {
        out.empty += !full;
        r = kNaN;
      } else {
        ++good;
      }
    }
  }
  if (good == 0)
    return fail(ErrorCode::bad_input, first,
                "expected ranges above 0 in at least one picture, got none: nothing came back, or everything "
                "is saturated");
  if (out.saturated > 0)
    out.notes.push_back(
        fmt::format("{} pixels at the largest amplitude there is ({:g}) are saturated and not used",
                    out.saturated, out.ceiling));
  return out;
}

Result<LocalNoise> temporal_noise(const TofScenes& scenes, const models::TofModel& model, int bins) {
  const double wrap = model.unambiguous_range_m();
  std::vector<Group> groups, partial;
  std::vector<float> samples;
  bool repeated = false, amplitudes = false;
  const double turns_per_m = 2 * model.modulation.frequencies_hz.front() / kLightSpeed_mps;
  const auto& m = model.modulation;
  const bool harmonics = m.waveform == models::TofWaveform::harmonics && m.frequencies_hz.size() == 1;
  for (const TofScene& scene : scenes.scenes) {
    if (scene.frames.size() < 2) continue;
    repeated = true;
    for (std::size_t p = 0; p < scenes.pixels(); ++p) {
      const std::size_t first = samples.size();
      double sum = 0, square = 0;
      for (const std::size_t i : scene.frames) {
        const TofFrame& f = scenes.frames[i];
        if (f.amplitude.empty() || !std::isfinite(f.range_m[p]) || !(f.amplitude[p] > 0)) continue;
        double r = f.range_m[p];
        if (samples.size() > first) r -= wrap * std::round((r - samples[first]) / wrap);
        samples.push_back(static_cast<float>(r));
        sum += f.amplitude[p];
        square += double(f.amplitude[p]) * f.amplitude[p];
      }
      const std::size_t count = samples.size() - first;
      const auto n = static_cast<double>(count);
      amplitudes = amplitudes || count > 0;
      if (count < 2) {
        samples.resize(first);
        continue;
      }
      const double mean = sum / n, variance = std::max(0.0, (square - n * mean * mean) / (n - 1));
      // Below ten times its own noise an amplitude, and the law of small errors, means little.
      if (count >= 4 && mean * mean < 100 * variance) {
        samples.resize(first);
        continue;
      }
      // The length of a noisy phasor is too long by σ²/2A; means of 1/A and 1/A² are too large by the noise
      // that is left in the mean amplitude.
      const double a = std::sqrt(std::max(0.25 * mean * mean, mean * mean - variance));
      const double v = variance / n / (mean * mean);
      Group g{a, (1 - v) / a, (1 - v) / a, (1 - 3 * v) / (a * a), first, count, 0};
      if (harmonics) {
        double x = 1, y = 0;
        models::TofMath<double>::tof_phasor(samples[first] * turns_per_m, 0, m.harmonics[0], m.harmonics[1],
                                            m.harmonics[2], m.harmonics[3], 1, 1, x, y);
        g.shot_inverse /= std::hypot(x, y);
      }
      // A pixel that is missing in some frames was near a limit: what is left of it was chosen by its noise.
      (count == scene.frames.size() ? groups : partial).push_back(g);
    }
  }
  if (groups.size() < partial.size()) groups.insert(groups.end(), partial.begin(), partial.end());
  if (groups.empty())
    return fail(ErrorCode::bad_input, "noise against amplitude",
                !repeated     ? "expected two frames or more of one scene at rest, got single ones"
                : !amplitudes ? "expected amplitudes beside the ranges, got none"
                              : "expected pixels with a range in two frames or more, got none");
  std::sort(groups.begin(), groups.end(),
            [](const Group& a, const Group& b) { return a.amplitude < b.amplitude; });
  const auto end = [&](double q) {
    return std::log(groups[static_cast<std::size_t>(q * static_cast<double>(groups.size() - 1))].amplitude);
  };
  const double from = end(0), to = std::max(end(1), from + 1e-9);
  const auto bin_of = [&](const Group& g) {
    return std::clamp(static_cast<int>((std::log(g.amplitude) - from) / (to - from) * bins), 0, bins - 1);
  };
  std::vector<double> work;
  for (Group& g : groups) {
    work.assign(samples.begin() + static_cast<std::ptrdiff_t>(g.first),
                samples.begin() + static_cast<std::ptrdiff_t>(g.first + g.count));
    g.centre = median_of(work);
  }
  // First limits from the medians of the absolute deviations in each group of amplitudes, then from what
  // passed.
  std::vector<double> limit(static_cast<std::size_t>(bins), 0);
  std::size_t at = 0;
  for (int b = 0; b < bins; ++b) {
    work.clear();
    for (; at < groups.size() && bin_of(groups[at]) == b; ++at)
      for (std::size_t i = 0; i < groups[at].count; ++i)
        work.push_back(std::abs(samples[groups[at].first + i] - groups[at].centre));
    if (!work.empty()) limit[static_cast<std::size_t>(b)] = kRejectSigmas * 1.8 * median_of(work);
  }
  LocalNoise out;
  std::vector<double> squares(static_cast<std::size_t>(bins));
  std::vector<NoiseBin> all(static_cast<std::size_t>(bins));
  std::size_t rejected = 0, used = 0;
  for (int round = 0; round < 3; ++round) {
    std::fill(all.begin(), all.end(), NoiseBin{});
    std::fill(squares.begin(), squares.end(), 0);
    out.samples.clear();
    rejected = used = 0;
    std::size_t seen = 0;
    for (Group& g : groups) {
      const auto b = static_cast<std::size_t>(bin_of(g));
      double sum = 0, n = 0, square = 0;
      for (std::size_t i = g.first; i < g.first + g.count; ++i) {
        const double d = samples[i] - g.centre;
        if (limit[b] > 0 && std::abs(d) > limit[b]) {
          ++rejected;
          continue;
        }
        sum += d, square += d * d, n += 1;
      }
      if (n < 2) continue;
      const double mean = sum / n;
      squares[b] += square - n * mean * mean;
      used += static_cast<std::size_t>(n);
      NoiseBin& bin = all[b];
      bin.dof += n - 1;
      bin.samples += static_cast<std::size_t>(n);
      bin.amplitude += (n - 1) * std::log(g.amplitude);
      bin.inverse += (n - 1) * g.inverse;
      bin.shot_inverse += (n - 1) * g.shot_inverse;
      bin.inverse_square += (n - 1) * g.inverse_square;
      if (seen++ % (1 + groups.size() / 6000) == 0)
        for (std::size_t i = g.first; i < g.first + std::min<std::size_t>(g.count, 3); ++i)
          if (std::abs(samples[i] - g.centre) <= limit[b])
            out.samples.push_back({g.amplitude, (samples[i] - g.centre - mean) / std::sqrt(1 - 1 / n)});
      // From the mean of those that passed the next round's deviations are counted.
      g.centre += mean;
    }
    for (std::size_t b = 0; b < all.size(); ++b)
      if (all[b].dof > 0) limit[b] = kRejectSigmas * std::sqrt(squares[b] / all[b].dof);
  }
  for (std::size_t b = 0; b < all.size(); ++b) {
    NoiseBin bin = all[b];
    if (bin.dof < 20 || !(squares[b] > 0)) continue;
    bin.variance_m2 = squares[b] / bin.dof;
    bin.amplitude = std::exp(bin.amplitude / bin.dof);
    bin.inverse /= bin.dof, bin.shot_inverse /= bin.dof, bin.inverse_square /= bin.dof;
    out.bins.push_back(bin);
  }
  out.windows = groups.size();
  out.estimator = fmt::format(
      "temporal: variance of each pixel over the frames of a scene at rest, {} samples of {} pixels, {} "
      "beyond "
      "{:g} sigma left out",
      used, groups.size(), rejected, kRejectSigmas);
  return out;
}

double phase_noise_constant_m(const models::TofModel& model) {
  double squares = 0;
  for (const double f : model.modulation.frequencies_hz) squares += f * f;
  return kLightSpeed_mps / (4 * std::numbers::pi * std::sqrt(2 * squares));
}

FitResult pixel_noise(const NoiseLawFit& fit, const models::TofModel& model, bool counts, PixelNoise& out,
                      double range_step_m) {
  FitResult r;
  const bool floor = fit.noise.law == NoiseLaw::shot_read_floor;
  if (!floor && fit.noise.law != NoiseLaw::shot_read) return r;
  const double k = phase_noise_constant_m(model), p = fit.noise.c[0], q = fit.noise.c[1],
               n = fit.noise.c[2] - range_step_m * range_step_m / 12;
  const Eigen::Index m = floor ? 3 : 2;
  const Eigen::MatrixXd& c = fit.result.covariance;
  Eigen::MatrixXd j = Eigen::MatrixXd::Zero(m, m);
  const bool signal = p > 0 && p > 2 * std::sqrt(c(0, 0));
  if (!signal) {
    r.not_identifiable.emplace_back(
        counts ? "electrons_per_count" : "contrast",
        "the noise does not show the shot noise of the signal; record brighter surfaces");
    return r;
  }
  const double e = counts ? k * k / (p * model.modulation.contrast) : 1;
  const double contrast = counts ? model.modulation.contrast : k * k / p;
  // What stays when there is no signal, less what the model already counts: dark current and rounding.
  const double step =
      model.pixel.adc_bits > 0 ? model.pixel.full_well_e / (std::ldexp(1.0, model.pixel.adc_bits) - 1) : 0;
  const double known =
      step * step / 12 + model.pixel.dark_current_e_per_s * model.modulation.integration_time_s;
  const double square = q * e * e / (k * k) - known;
  const double read = std::sqrt(std::max(0.0, square));
  r.parameters.push_back(
      {counts ? "electrons_per_count" : "contrast", counts ? e : contrast, 0, counts ? e : 0.1});
  j(0, 0) = counts ? -e / p : -contrast / p;
  r.parameters.push_back({"read_noise_e", read, 0, std::max(read, 1.0)});
  if (read > 0) {
    j(1, 1) = e * e / (k * k) / (2 * read);
    if (counts) j(1, 0) = q * 2 * e * (-e / p) / (k * k) / (2 * read);
  }
  if (floor) {
    const double f = std::sqrt(std::max(0.0, n));
    r.parameters.push_back({"pixel_floor_m", f, 0, std::max(f, 1e-12)});
    if (f > 0) j(2, 2) = 1 / (2 * f);
    out.floor_m = f;
  }
  r.covariance = j * c.topLeftCorner(m, m) * j.transpose();
  for (Eigen::Index i = 0; i < m; ++i)
    r.parameters[static_cast<std::size_t>(i)].sigma = std::sqrt(std::max(0.0, r.covariance(i, i)));
  const auto unknown = [&](Eigen::Index i, const std::string& why) {
    r.not_identifiable.emplace_back(r.parameters[static_cast<std::size_t>(i)].name, why);
    r.parameters[static_cast<std::size_t>(i)].sigma = std::numeric_limits<double>::infinity();
    r.covariance.row(i).setZero();
    r.covariance.col(i).setZero();
    r.covariance(i, i) = std::numeric_limits<double>::infinity();
  };
  if (!(square > 0) || square < 2 * e * e / (k * k) * std::sqrt(c(1, 1)))
    unknown(1, "the noise without signal is not told from dark current and rounding; record darker surfaces");
  if (floor && !(n > 2 * std::sqrt(c(2, 2))))
    unknown(2,
            "the noise has no floor that shows beyond the rounding of the ranges; record brighter surfaces");
  out.contrast = contrast, out.contrast_sigma = counts ? 0 : r.parameters[0].sigma;
  out.electrons = e, out.electrons_sigma = counts ? r.parameters[0].sigma : 0;
  out.read_noise_e = read, out.read_noise_sigma_e = r.parameters[1].sigma;
  if (floor) out.floor_sigma_m = r.parameters[2].sigma;
  if (contrast > 1)
    r.warnings.push_back(
        fmt::format("a contrast of {:.3g} came out, which no pixel has: the amplitude is not in "
                    "electrons (say --amplitude-unit counts)",
                    contrast));
  return r;
}

}  // namespace rigor::calibration
