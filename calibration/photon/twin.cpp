#include "calibration/photon/twin.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "calibration/photon/exposure_pairs.h"
#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"

namespace rigor::calibration {
namespace {

using Noise = models::NoiseMath<double>;
constexpr std::size_t kPixels = 8192;  ///< of a level: enough for its thousandths
constexpr int kFrames = 16;

class Pixel {
 public:
  Pixel(const EmvaNoise& noise, std::uint64_t seed)
      : n_(noise),
        key_(models::channel_key(seed, models::channel_id_from_name("calibration twin"))),
        max_dn_(std::ldexp(1.0, noise.adc_bits) - 1) {}
  /// `electrons` on average, dark ones included, before the gain pattern.
  [[nodiscard]] double dn(double electrons, std::uint64_t capture, std::uint32_t element) const {
    const auto fixed = models::draw_words(key_, models::NoiseEffect::camera_fixed_pattern, 0, element);
    const auto w = models::draw_words(key_, models::NoiseEffect::camera_shot_and_read, capture, element);
    const auto normal = [](std::uint32_t bits) {
      return Noise::normal_quantile(Noise::unit_from_bits(bits));
    };
    const double mean = std::max(0.0, electrons * (1 + n_.prnu * normal(fixed[0])));
    const double shot = n_.shot_noise ? Noise::poisson_quantile(mean, Noise::unit_from_bits(w[0])) : mean;
    const double e = Noise::emva_collected_electrons(shot, n_.full_well_e, n_.dsnu_e * normal(fixed[1]),
                                                     n_.read_noise_e, normal(w[1]));
    const double x = Noise::emva_response(Noise::emva_analogue_dn(e, n_.system_gain_dn_per_e, 0.0),
                                          max_dn_ - n_.black_level_dn, n_.response_c2, n_.response_c3);
    return Noise::emva_quantise(n_.black_level_dn + x, max_dn_);
  }

 private:
  const EmvaNoise& n_;
  models::PhiloxKey key_;
  double max_dn_;
};

void finish(NoisePair& p) {
  for (const bool twin : {false, true}) {
    std::vector<double>& v = twin ? p.twin_dn : p.real_dn;
    auto& quantiles = twin ? p.twin_quantiles_dn : p.real_quantiles_dn;
    double mean = 0, square = 0;
    for (const double x : v) mean += x / static_cast<double>(v.size());
    for (const double x : v) square += (x - mean) * (x - mean) / static_cast<double>(v.size() - 1);
    (twin ? p.twin_sigma_dn : p.real_sigma_dn) = std::sqrt(square);
    std::vector<double> sorted = v;
    std::sort(sorted.begin(), sorted.end());
    for (std::size_t i = 0; i < quantiles.size(); ++i)
      quantiles[i] =
          sorted[static_cast<std::size_t>(kNoiseQuantiles[i] * static_cast<double>(sorted.size() - 1))];
  }
}

/// Last frame against the others, less what all pixels have in common (the light's flicker).
void deviations(std::vector<double>& v) {
  double mean = 0;
  for (const double x : v) mean += x / static_cast<double>(v.size());
  for (double& x : v) x -= mean;
}

}  // namespace

std::vector<NoisePair> noise_twins(const FrameStacks& stacks, const PhotonFit& fit,
                                   const EmvaNoise& sensor_model, std::uint64_t seed) {
  std::vector<NoisePair> out;
  const auto& st = fit.statistics;
  if (!(sensor_model.system_gain_dn_per_e > 0) || !fit.result.find("system_gain_dn_per_e")) return out;
  const Pixel pixel(sensor_model, seed);
  const double step = st.step;
  const auto width = static_cast<std::size_t>(stacks.width_px());
  PhotonResponse response;
  response.terms = 2;
  response.full_scale_dn = std::ldexp(1.0, sensor_model.adc_bits) - 1 - sensor_model.black_level_dn;
  response.c = {sensor_model.response_c2, sensor_model.response_c3};
  if (!fit.pairs.empty()) {
    FrameStacks twin;
    for (const PhotonLevel& l : stacks.levels()) {
      if (!l.settings.light) continue;
      std::vector<std::uint16_t> frame(l.sum.size());
      for (std::size_t i = 0; i < frame.size(); ++i) {
        // Light of the scene at this pixel: of all its exposures that are neither black nor white.
        double sum = 0, time = 0;
        for (const PhotonLevel& other : stacks.levels()) {
          const double dn = static_cast<double>(other.sum[i]) / other.count() / step;
          if (!other.settings.light || dn < 1 || dn >= st.max_dn) continue;
          sum += std::max(0.0, dn - sensor_model.black_level_dn), time += other.settings.exposure_s;
        }
        const double light = time > 0 ? sum / time / sensor_model.system_gain_dn_per_e : 0;
        const double brightest = static_cast<double>(l.sum[i]) / step >= st.max_dn && time == 0 ? 1e9 : 0;
        frame[i] = static_cast<std::uint16_t>(
            pixel.dn(std::max(brightest, light * l.settings.exposure_s),
                     static_cast<std::uint64_t>(std::llround(l.settings.exposure_s * 1e6)),
                     static_cast<std::uint32_t>(i)));
      }
      PhotonFrame settings = l.settings;
      if (!twin.add(settings, frame, stacks.width_px(), stacks.height_px())) return out;
    }
    StackStatistics twin_statistics = st;
    twin_statistics.step = 1;
    const std::vector<PairBin> simulated = pair_bins(twin, twin_statistics);
    std::map<std::string, NoisePair> pairs;
    std::vector<std::string> order;
    for (const bool is_twin : {false, true})
      for (const PairBin& b : is_twin ? simulated : fit.pairs) {
        if (pairs.count(b.pair) == 0) {
          if (is_twin) continue;
          order.push_back(b.pair);
          pairs[b.pair].level = b.pair;
        }
        NoisePair& p = pairs[b.pair];
        if (!is_twin) p.signal_dn = std::max(p.signal_dn, b.second_dn);
        auto& to = is_twin ? p.twin_dn : p.real_dn;
        to.insert(to.end(), b.deviations_dn.begin(), b.deviations_dn.end());
      }
    for (const std::string& name : order)
      if (NoisePair& p = pairs[name]; p.real_dn.size() > 100 && p.twin_dn.size() > 100) {
        finish(p);
        out.push_back(std::move(p));
      }
    return out;
  }
  for (std::size_t k = 0; k < st.points.size(); ++k) {
    const LevelPoint& point = st.points[k];
    const PhotonLevel& l = stacks.levels()[point.level];
    if (!fit.in_range[k] || l.count() < 2) continue;
    NoisePair p;
    p.level = l.text();
    if (st.mosaic) p.level += " colour " + std::to_string(point.phase);
    p.signal_dn = point.mean_dn - fit.black_dn;
    const int frames = std::min(l.count(), kFrames);
    const double scale = std::sqrt((l.count() - 1.0) / l.count());
    // Evenly over the picture, as many as the twin has.
    std::vector<std::size_t> pixels;
    for (std::size_t i = 0; i < l.sum.size(); ++i) {
      const std::size_t phase = st.mosaic ? (i / width % 2) * 2 + i % width % 2 : 0;
      if (!st.outliers.bad[i] && phase == static_cast<std::size_t>(point.phase)) pixels.push_back(i);
    }
    const std::size_t stride = std::max<std::size_t>(1, pixels.size() / kPixels);
    for (std::size_t i = 0; i < pixels.size(); i += stride) {
      const double last = l.last[pixels[i]];
      p.real_dn.push_back(scale * (last - (l.sum[pixels[i]] - last) / (l.count() - 1.0)) / step);
    }
    const double electrons = response.inverse(std::max(0.0, p.signal_dn)) / sensor_model.system_gain_dn_per_e;
    const double twin_scale = std::sqrt((frames - 1.0) / frames);
    for (std::uint32_t i = 0; i < kPixels; ++i) {
      double sum = 0, last = 0;
      for (int f = 0; f < frames; ++f)
        sum += last = pixel.dn(electrons, (std::uint64_t{k} << 16) + static_cast<std::uint64_t>(f), i);
      p.twin_dn.push_back(twin_scale * (last - (sum - last) / (frames - 1.0)));
    }
    deviations(p.real_dn);
    if (p.real_dn.size() < 100) continue;
    finish(p);
    out.push_back(std::move(p));
  }
  return out;
}

}  // namespace rigor::calibration
