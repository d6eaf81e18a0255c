#include "sim/render/view/view_frame.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace rigor::render {
namespace {

using view_gpu::pick;
using view_gpu::vec4;
using view_gpu::xyz;

/// What a leaf scatters of the light on it, both sides together (Jacquemoud and Baret 1990, green leaves).
constexpr Spectrum kLeafScatters{0.12F, 0.24F, 0.08F, 0.92F, 0.92F, 0.60F};
/// Extinction by black leaves times their area, from the sky to a point that cannot see it: the middle of a
/// crown rather than the floor of a dense wood.
constexpr float kLeafDepth = 2.0F;
/// Behind things that no light shines through: what walls and floors throw about, about a tenth.
constexpr float kWallShare = 0.1F;
constexpr double kNoisePeriod_m = 1024;

/// At most as many as the shaders take: those of one height are one; beyond that the last ones are.
std::vector<Haze> joined(const ContentFrame& frame, const Spectrum& surrounding) {
  std::vector<Haze> all = frame.hazes;
  if (frame.precipitation.kind != Precipitation::Kind::none)
    all.push_back(
        {.extinction_per_m = frame.precipitation.extinction_per_m, .inscattered_radiance = surrounding});
  std::erase_if(all, [](const Haze& h) {
    return std::none_of(h.extinction_per_m.begin(), h.extinction_per_m.end(), [](float e) { return e > 0; });
  });
  std::vector<Haze> out;
  for (const Haze& h : all) {
    auto same = std::find_if(out.begin(), out.end(), [&](const Haze& o) { return o.top_m == h.top_m; });
    if (same == out.end() && out.size() == view_gpu::kMaxHazes) same = out.end() - 1;
    if (same == out.end()) {
      out.push_back(h);
      continue;
    }
    same->top_m = std::max(same->top_m, h.top_m);
    for (std::size_t b = 0; b < h.extinction_per_m.size(); ++b) {
      const float a = same->extinction_per_m[b], c = h.extinction_per_m[b], sum = a + c;
      if (sum > 0)
        same->inscattered_radiance[b] =
            (a * same->inscattered_radiance[b] + c * h.inscattered_radiance[b]) / sum;
      same->extinction_per_m[b] = sum;
    }
  }
  return out;
}

std::vector<PointLight> strongest(const std::vector<PointLight>& lamps, const Eigen::Vector3d& eye) {
  std::vector<PointLight> all;
  for (const PointLight& l : lamps)
    if (l.position.allFinite() &&
        std::any_of(l.radiant_intensity.begin(), l.radiant_intensity.end(), [](float i) { return i > 0; }))
      all.push_back(l);
  if (all.size() <= view_gpu::kMaxLamps) return all;
  const auto at_eye = [&](const PointLight& l) {
    return static_cast<double>(*std::max_element(l.radiant_intensity.begin(), l.radiant_intensity.end())) /
           std::max((l.position - eye).squaredNorm(), 1.0);
  };
  std::stable_sort(all.begin(), all.end(),
                   [&](const PointLight& a, const PointLight& b) { return at_eye(a) > at_eye(b); });
  all.resize(view_gpu::kMaxLamps);
  return all;
}

}  // namespace

FrameNumbers place_numbers(const ContentFrame& frame, const ViewRequest& request, const ViewCamera& camera) {
  FrameNumbers out;
  view_gpu::ViewFrame& u = out.uniforms;
  const Pinhole& p = camera.pinhole;
  const auto& bands = request.bands;
  const double w = p.width_px, h = p.height_px;
  // u = fx x / z + cx with pixel centres at integers; ndc = 2 (u + 0.5) / width - 1.
  u.clip_x = xyz(camera.right * (2 * p.fx_px / w) + camera.forward * (2 * (p.cx_px + 0.5) / w - 1), p.near_m);
  u.clip_y = xyz(camera.down * (2 * p.fy_px / h) + camera.forward * (2 * (p.cy_px + 0.5) / h - 1));
  u.clip_w = xyz(camera.forward, 1.0 / camera.focal_px);
  u.ray_x = xyz(camera.right * (0.5 * w / p.fx_px));
  u.ray_y = xyz(camera.down * (0.5 * h / p.fy_px));
  u.ray_0 = xyz(camera.forward + camera.right * ((0.5 * w - 0.5 - p.cx_px) / p.fx_px) +
                camera.down * ((0.5 * h - 0.5 - p.cy_px) / p.fy_px));
  view_gpu::put(colour_to_band(bands, true), u.tint_to_band);
  u.snow = pick(kSnowReflectance, bands);
  u.weather = {std::clamp(frame.surface.wetness, 0.0F, 1.0F), std::max(frame.surface.snow_depth_m, 0.0F), 0,
               0};
  const auto wrapped = [](double v) { return v - std::floor(v / kNoisePeriod_m) * kNoisePeriod_m; };
  u.eye = xyz({wrapped(camera.eye.x()), wrapped(camera.eye.y()), wrapped(camera.eye.z())});

  if (frame.wind.velocity_m_per_s.allFinite()) {
    const Eigen::Vector3d wind = frame.wind.velocity_m_per_s.cast<double>();
    const double speed = wind.norm();
    // Drag grows with the square of the speed, crowns give way: between the two, and bounded.
    out.sway_factor = std::min(std::pow(speed / 10.0, 1.5), 2.5);
    u.wind = xyz(speed > 1e-6 ? Eigen::Vector3d(wind / speed * out.sway_factor) : Eigen::Vector3d::Zero());
    const double t = static_cast<double>(request.t.ns()) * 1e-9;
    const auto phase = [&](double hertz) {
      return 2 * std::numbers::pi * (t * hertz - std::floor(t * hertz));
    };
    u.gust = {static_cast<float>(phase(0.35)), static_cast<float>(phase(1.9)), 0, 0};
  }
  return out;
}

FrameNumbers frame_numbers(const ContentFrame& frame, const ViewRequest& request, const ViewCamera& camera,
                           const SkyLight& sky, float sky_scale) {
  FrameNumbers out = place_numbers(frame, request, camera);
  view_gpu::ViewFrame& u = out.uniforms;
  const auto& bands = request.bands;
  Light light = frame.light;
  Eigen::Vector3d to_sun = light.direction_to_sun;
  const bool valid = to_sun.allFinite() && to_sun.norm() > 1e-9;
  to_sun = valid ? Eigen::Vector3d(to_sun.normalized()) : Eigen::Vector3d(0, 0, -1);
  light.direction_to_sun = to_sun;
  out.sun = to_sun.z() > 0 && std::any_of(light.sun_irradiance.begin(), light.sun_irradiance.end(),
                                          [](float e) { return e > 0; });
  if (!out.sun) light.sun_irradiance = {};
  const double radius = std::max(static_cast<double>(light.sun_angular_radius_rad), 1e-4);
  u.sun = xyz(to_sun, radius);
  u.sun_irradiance = pick(light.sun_irradiance, bands);
  Spectrum disc = light.sun_irradiance;
  for (float& l : disc) l = static_cast<float>(l / (std::numbers::pi * radius * radius));
  u.sun_disc = pick(disc, bands);
  Spectrum ground{};
  const SkyLight all = with_ground(sky, light, ground);
  for (std::size_t i = 0; i < all.size(); ++i) u.sky_light[i] = pick(all[i], bands);
  u.ground = pick(ground, bands);
  u.weather.z = sky_scale;

  Spectrum surrounding{};
  const Spectrum up = irradiance(all, Eigen::Vector3d::UnitZ()),
                 down = irradiance(all, -Eigen::Vector3d::UnitZ());
  for (std::size_t b = 0; b < surrounding.size(); ++b)
    surrounding[b] = (up[b] + down[b]) / (2 * std::numbers::pi_v<float>);
  const auto hazes = joined(frame, surrounding);
  for (std::size_t i = 0; i < hazes.size(); ++i) {
    u.hazes[i].extinction = pick(hazes[i].extinction_per_m, bands);
    u.hazes[i].inscatter = pick(hazes[i].inscattered_radiance, bands);
    u.hazes[i].top.x = static_cast<float>(std::clamp(hazes[i].top_m - camera.eye.z(), -1e9, 1e9));
  }
  const auto lamps = strongest(frame.lamps, camera.eye);
  for (std::size_t i = 0; i < lamps.size(); ++i) {
    u.lamps[i].position = xyz(lamps[i].position - camera.eye);
    u.lamps[i].intensity = pick(lamps[i].radiant_intensity, bands);
  }
  u.counts = {static_cast<std::uint32_t>(hazes.size()), static_cast<std::uint32_t>(lamps.size()), 0, 0};
  return out;
}

// Leaves let exp(-depth sqrt(1 - scattered)) of diffuse light through (Goudriaan 1977): a seventh of the
// visible, greener than the sky, and half of the near infrared. Sunlight that leaves scatter down is left
// out: what the same formula gives for it is 18 times too bright in the shade of a stand
// (docs/light-error.md).
void set_covered(bool leaves, const view_gpu::Bands& bands, view_gpu::ViewFrame& u) {
  Spectrum covered{};
  for (std::size_t b = 0; b < covered.size(); ++b)
    covered[b] = leaves ? std::exp(-kLeafDepth * std::sqrt(1 - kLeafScatters[b])) : kWallShare;
  u.covered = pick(covered, bands);
}

}  // namespace rigor::render
