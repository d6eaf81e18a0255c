#include "calibration/photon/exposure_pairs.h"

#include <ceres/autodiff_cost_function.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>

#include "calibration/core/least_squares.h"

namespace rigor::calibration {
namespace {

struct BinResidual {
  double signal_factor, offset_factor, variance, sigma;
  template <class T>
  bool operator()(const T* gain, const T* offset, T* r) const {
    r[0] = (T(variance) - gain[0] * T(signal_factor) - offset[0] * T(offset_factor)) / T(sigma);
    return true;
  }
};

struct Sample {
  double z, b;
};

/// Variance of b about a line in z, what lies beyond four deviations left out.
bool scatter(const std::vector<Sample>& samples, double& variance, double& number,
             std::vector<float>& deviations) {
  double zm = 0, bm = 0, slope = 0, limit = 1e300;
  for (int round = 0; round < 8; ++round) {
    double n = 0, sz = 0, sb = 0, szz = 0, szb = 0, rest = 0;
    deviations.clear();
    for (const Sample& s : samples) {
      const double e = s.b - bm - slope * (s.z - zm);
      if (round > 0 && std::abs(e) > limit) continue;
      ++n, sz += s.z, sb += s.b;
    }
    if (n < 50) return false;
    const double z0 = sz / n, b0 = sb / n;
    for (const Sample& s : samples) {
      const double e = s.b - bm - slope * (s.z - zm);
      if (round > 0 && std::abs(e) > limit) continue;
      szz += (s.z - z0) * (s.z - z0), szb += (s.z - z0) * (s.b - b0);
    }
    const double k = szz > 0 ? szb / szz : 0;
    for (const Sample& s : samples) {
      const double e = s.b - bm - slope * (s.z - zm);
      if (round > 0 && std::abs(e) > limit) continue;
      const double f = s.b - b0 - k * (s.z - z0);
      rest += f * f;
      deviations.push_back(static_cast<float>(f));
    }
    zm = z0, bm = b0, slope = k;
    variance = rest / (n - 2), number = n;
    limit = 4 * std::sqrt(variance) + 0.5;
  }
  return true;
}

std::string pair_text(double a, double b) {
  char t[80];
  std::snprintf(t, sizeof t, "%.6g ms and %.6g ms", a * 1e3, b * 1e3);
  return t;
}

}  // namespace

std::vector<PairBin> pair_bins(const FrameStacks& stacks, const StackStatistics& st) {
  std::vector<PairBin> bins;
  std::vector<const PhotonLevel*> light;
  for (const PhotonLevel& l : stacks.levels())
    if (l.settings.light) light.push_back(&l);
  const int w = stacks.width_px(), h = stacks.height_px(), s = st.mosaic ? 2 : 1;
  int set = 0;
  for (std::size_t p = 0; p + 1 < light.size(); ++p) {
    const double first_s = light[p]->settings.exposure_s, second_s = light[p + 1]->settings.exposure_s;
    const auto value = [&](const PhotonLevel& l, std::size_t i) {
      return static_cast<double>(l.sum[i]) / l.count() / st.step;
    };
    for (int phase = 0; phase < (st.mosaic ? 4 : 1); ++phase, ++set) {
      std::vector<std::pair<double, Sample>> flat;
      for (int y = s; y < h - s; ++y)
        for (int x = s; x < w - s; ++x) {
          if (st.mosaic && (y & 1) * 2 + (x & 1) != phase) continue;
          const auto i = static_cast<std::size_t>(y * w + x);
          if (st.outliers.bad[i]) continue;
          double low = 1e300, high = 0;
          for (const auto& [dx, dy] : {std::pair{-s, 0}, {s, 0}, {0, -s}, {0, s}}) {
            const auto k = static_cast<std::size_t>((y + dy) * w + x + dx);
            const double z = value(*light[p], k) + value(*light[p + 1], k);
            low = std::min(low, z), high = std::max(high, z);
          }
          // Judged by the neighbours, so that the choice does not know the pixel's own noise.
          if (high - low > 0.08 * high + 0.016 * st.max_dn) continue;
          const double a = value(*light[p], i), b = value(*light[p + 1], i);
          flat.emplace_back(a + b, Sample{a + b, b});
        }
      std::sort(flat.begin(), flat.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
      const std::size_t size = std::max<std::size_t>(300, flat.size() / 40);
      for (std::size_t from = 0; from + size <= flat.size(); from += size) {
        std::vector<Sample> bin;
        double a_mean = 0, b_mean = 0;
        bool clip = false;
        for (std::size_t k = from; k < from + size; ++k) {
          const Sample& x = flat[k].second;
          bin.push_back(x);
          a_mean += (x.z - x.b) / static_cast<double>(size);
          b_mean += x.b / static_cast<double>(size);
          clip = clip || x.z - x.b < 1 || x.b >= st.max_dn;
        }
        double variance = 0, number = 0;
        std::vector<float> deviations;
        // A bin that spans much of the range is no bin.
        if (clip || bin.back().z - bin.front().z > 0.25 * bin.back().z) continue;
        if (!scatter(bin, variance, number, deviations) || !(variance > 0)) continue;
        bins.push_back({pair_text(first_s, second_s), set, first_s, second_s, a_mean, b_mean, variance,
                        number, 0, std::move(deviations)});
      }
    }
  }
  return bins;
}

Result<ExposurePairs> fit_exposure_pairs(const FrameStacks& stacks, const StackStatistics& st,
                                         const StopToken& stop) {
  ExposurePairs out;
  std::vector<const PhotonLevel*> light;
  for (const PhotonLevel& l : stacks.levels())
    if (l.settings.light) light.push_back(&l);
  if (light.size() < 2)
    return fail(
        ErrorCode::bad_input, "",
        "expected two frames of the same exposure, or a still scene at two exposure times or more, got " +
            std::to_string(light.size()) + " frame(s) of light");
  out.bins = pair_bins(stacks, st);
  FitResult& result = out.result;
  if (out.bins.size() < 6) {
    result.not_identifiable.emplace_back("system_gain_dn_per_e",
                                         "too few pixels lie between black and white in two exposures that "
                                         "follow each other, away from edges: take two "
                                         "frames or more of each exposure");
    return out;
  }
  struct One {
    double gain, sigma;
  };
  // One gain for all, and one for each pair: they must agree, else it is not the photons that are seen.
  const auto fit = [&](double only_first_s, LeastSquares::Outcome& result_out) {
    std::vector<std::unique_ptr<double>> offsets;
    std::map<double, double*> offset_of;
    double gain = 0.01 * st.max_dn / 255.0;
    LeastSquares problem;
    problem.add_block(&gain, {{"system_gain_dn_per_e", 0.1 * gain, 0, 1e6, false}});
    for (std::size_t k = 0; k < out.bins.size(); ++k) {
      const PairBin& b = out.bins[k];
      if (only_first_s > 0 && b.first_s != only_first_s) continue;
      double*& offset = offset_of[b.first_s];
      if (!offset) {
        offsets.push_back(std::make_unique<double>(0.5));
        offset = offsets.back().get();
        problem.add_nuisance(offset, 1);
      }
      const double r = b.second_s / b.first_s, q = (1 + r) * (1 + r);
      problem.add(new ceres::AutoDiffCostFunction<BinResidual, 1, 1, 1>(
                      new BinResidual{r * (b.first_dn + b.second_dn) / q, (1 + r * r) / q, b.variance_dn2,
                                      b.variance_dn2 * std::sqrt(2 / (b.pixels - 2))}),
                  {&gain, offset}, static_cast<std::uint32_t>(k));
    }
    FitOptions o;
    o.threads = 1;
    o.unit = "standard deviations";
    o.stop = stop;
    auto solved = problem.solve(o);
    if (!solved) return false;
    if (only_first_s == 0)
      for (PairBin& b : out.bins) {
        const double r = b.second_s / b.first_s, q = (1 + r) * (1 + r);
        b.expected_dn2 = gain * r * (b.first_dn + b.second_dn) / q + *offset_of[b.first_s] * (1 + r * r) / q;
      }
    result_out = std::move(*solved);
    return true;
  };
  LeastSquares::Outcome all;
  if (!fit(0, all)) {
    result.not_identifiable.emplace_back("system_gain_dn_per_e",
                                         "the scatter between exposures follows no line over brightness");
    return out;
  }
  std::vector<One> each;
  std::string list;
  for (std::size_t p = 0; p + 1 < light.size(); ++p) {
    LeastSquares::Outcome one;
    const double t = light[p]->settings.exposure_s;
    if (std::count_if(out.bins.begin(), out.bins.end(), [&](const PairBin& b) { return b.first_s == t; }) < 5)
      continue;
    if (!fit(t, one)) continue;
    const Parameter& g = one.fit.parameters[0];
    if (!std::isfinite(g.sigma) || g.sigma > 0.5 * std::abs(g.value)) continue;
    each.push_back({g.value, g.sigma});
    char text[96];
    std::snprintf(text, sizeof text, "%s%s: %.3g ± %.2g", list.empty() ? "" : "; ",
                  pair_text(t, light[p + 1]->settings.exposure_s).c_str(), g.value, g.sigma);
    list += text;
  }
  result = all.fit;
  for (std::size_t i = 0; i < all.rejected_ids.size(); ++i) {
    const PairBin& b = out.bins[all.rejected_ids[i]];
    char text[160];
    std::snprintf(text, sizeof text, "scatter between %s at %.3g DN", b.pair.c_str(), b.second_dn);
    result.rejected[i].what = text;
  }
  Parameter& gain = result.parameters[0];
  // Between pairs: what the pairs disagree by is uncertainty, too.
  double chi = 0, weight = 0;
  for (const One& o : each) {
    chi += std::pow((o.gain - gain.value) / o.sigma, 2);
    weight += 1 / (o.sigma * o.sigma);
  }
  if (each.size() > 1) {
    const double excess = chi / static_cast<double>(each.size() - 1);
    // They differ for a reason, not by chance: more of them would not agree better.
    const double between = std::sqrt(excess / weight * static_cast<double>(each.size()));
    if (between > gain.sigma) {
      gain.sigma = between;
      result.covariance(0, 0) = between * between;
    }
    result.warnings.push_back("gain from each pair of exposures, DN/e: " + list);
  }
  if (each.empty() || gain.at_bound || !(gain.value > 5 * gain.sigma)) {
    char text[400];
    std::snprintf(
        text, sizeof text,
        "the scatter between exposures gives %.3g ± %.2g DN/e (%s): more than photons is in it, or less. "
        "Take two frames or more of each exposure",
        gain.value, gain.sigma, list.c_str());
    result.not_identifiable.emplace_back("system_gain_dn_per_e", text);
    result.parameters.clear();
    result.covariance.resize(0, 0);
  }
  return out;
}

}  // namespace rigor::calibration
