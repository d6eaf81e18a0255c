#include "sim/render/view/tone_map.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/render/content/texels.h"

namespace rigor::render {
namespace {

using Channels = std::array<std::size_t, 3>;

Channels channels_of(ToneMapOptions::Colours colours) {
  switch (colours) {
    case ToneMapOptions::Colours::near_infrared:
      return {3, 3, 3};
    case ToneMapOptions::Colours::false_near_infrared:
      return {3, 0, 1};
    default:
      return {0, 1, 2};
  }
}

/// Brightness of each pixel; what is not finite or not lit is left out.
std::vector<float> brightness(const ViewPicture& picture, const Channels& c) {
  std::vector<float> all;
  all.reserve(picture.radiance.size() / 4);
  for (std::size_t i = 0; i + 3 < picture.radiance.size(); i += 4) {
    const float* p = &picture.radiance[i];
    const float y = 0.2126F * p[c[0]] + 0.7152F * p[c[1]] + 0.0722F * p[c[2]];
    if (std::isfinite(y) && y > 0) all.push_back(y);
  }
  return all;
}

/// A twentieth of a picture may be brighter than this.
constexpr double kBright = 0.6, kBrightShare = 0.95;

/// As film: darks are pressed together and brights bent towards white, with more contrast between (the curve
/// that Narkowicz fitted to ACES, 2015). Scaled so that 0.18 stays 0.18.
double filmed(double v) {
  const double x = 0.724 * std::max(v, 0.0);
  return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14);
}

}  // namespace

double exposure_scale(const ViewPicture& picture, const ToneMapOptions& o) {
  const double stops = std::exp2(o.compensation_ev);
  if (o.exposure == ToneMapOptions::Exposure::fixed) return o.scale * stops;
  std::vector<float> y = brightness(picture, channels_of(o.colours));
  if (y.empty()) return 0;
  const auto at = [&](double share) {
    const auto k = static_cast<std::size_t>(std::clamp(share, 0.0, 1.0) * static_cast<double>(y.size() - 1));
    std::nth_element(y.begin(), y.begin() + static_cast<std::ptrdiff_t>(k), y.end());
    return static_cast<double>(y[k]);
  };
  if (o.exposure == ToneMapOptions::Exposure::percentile) return stops / at(o.percentile);
  // Neither the darkest corner nor the sun decides.
  const double low = at(0.01), high = at(0.99);
  double sum = 0;
  for (const float v : y) sum += std::log(std::clamp(static_cast<double>(v), low, high));
  // Where much is dark, what is bright still keeps its colour.
  const double scale = o.key / std::exp(sum / static_cast<double>(y.size()));
  return stops * std::min(scale, kBright / at(kBrightShare));
}

std::vector<std::uint8_t> tone_map(const ViewPicture& picture, const ToneMapOptions& o) {
  const Channels c = channels_of(o.colours);
  const double scale = exposure_scale(picture, o);
  const std::size_t pixels = picture.radiance.size() / 4;
  const SrgbBytes& bytes = srgb_bytes();
  std::vector<std::uint8_t> rgb(pixels * 3, 0);
  for (std::size_t i = 0; i < pixels; ++i)
    for (std::size_t k = 0; k < 3; ++k) {
      const double v = static_cast<double>(picture.radiance[4 * i + c[k]]) * scale;
      if (std::isfinite(v)) rgb[3 * i + k] = bytes.of(static_cast<float>(o.film ? filmed(v) : v));
    }
  return rgb;
}

}  // namespace rigor::render
