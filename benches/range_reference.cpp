#include "benches/range_reference.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sensor-hal/models/philox.h"
#include "sim/sensors/lidar/echoes.h"
#include "sim/sensors/lidar/lidar_simulator_impl.h"
#include "sim/sensors/lidar/scan_rays.h"
#include "sim/sensors/tof/tof_light.h"
#include "sim/sensors/tof/tof_pixels.h"
#include "sim/sensors/tof/tof_rays.h"

namespace rigor::bench {
namespace {

constexpr std::uint32_t kColumnStep = 4;
constexpr int kPixelStep = 2;
/// Second word of the draws' counters: nobody else's effect.
constexpr std::uint32_t kFootprintDraws = 0x52454601U;
/// Firings whose rays are held at once.
constexpr std::size_t kBlock = 64;

std::uint32_t column_step(const models::LidarModel& m) { return m.scan.beams.size() > 1 ? kColumnStep : 1; }
std::size_t kept_columns(const models::LidarModel& m) {
  return (m.scan.columns + column_step(m) - 1) / column_step(m);
}
std::size_t kept(int pixels) { return static_cast<std::size_t>((pixels + kPixelStep - 1) / kPixelStep); }

/// Even over the disc by a sequence of low discrepancy (Roberts 2018, R2), shifted by a draw for each firing
/// and pass; weights are the profile's.
std::vector<models::SubRay> footprint_rays(const models::LidarFootprint& footprint, std::uint32_t pass,
                                           std::uint32_t firing) {
  constexpr double a1 = 0.7548776662466927, a2 = 0.5698402909980532;
  const auto words = models::philox({firing, kFootprintDraws, pass, 0}, {});
  double s = models::NoiseMath<double>::unit_from_bits(words[0]),
         t = models::NoiseMath<double>::unit_from_bits(words[1]), sum = 0;
  std::vector<models::SubRay> rays(kReferenceRays);
  for (models::SubRay& r : rays) {
    s = std::fmod(s + a1, 1.0);
    t = std::fmod(t + a2, 1.0);
    const double angle = 2 * std::numbers::pi * t;
    r = {std::sqrt(s) * std::cos(angle), std::sqrt(s) * std::sin(angle),
         footprint.profile == models::LidarProfile::gaussian ? std::exp(-2 * s) : 1.0};
    sum += r.weight;
  }
  for (models::SubRay& r : rays) r.weight /= sum;
  return rays;
}

/// The rays of one firing, as LidarSimulator has them.
class Firings {
 public:
  Firings(const models::LidarModel& m, const Eigen::Isometry3d& T_world_sensor) : model_(m), scan_(m, true) {
    track_.follow([&](BenchTime) { return T_world_sensor; }, BenchTime{}, Duration(0), m.scan.columns);
  }
  [[nodiscard]] std::size_t kept() const { return kept_columns(model_) * scan_.beams(); }
  /// Firing of the scan, by beam, not by the order in which they fire.
  [[nodiscard]] std::size_t firing(std::size_t i) const {
    const std::size_t column = i / scan_.beams() * column_step(model_), ring = i % scan_.beams();
    std::uint32_t slot = 0;
    while (scan_.slot(slot).ring != ring) ++slot;
    return column * scan_.beams() + slot;
  }
  void aim(std::size_t firing, std::span<const models::SubRay> pattern, std::span<render::Ray> rays) const {
    const models::LidarFootprint& f = model_.footprint;
    const Eigen::Matrix3f R = track_.at(0).R_world_sensor;
    const auto& aim = scan_.aim(firing);
    const Eigen::Vector3f d_sensor(aim.direction[0], aim.direction[1], aim.direction[2]);
    const Eigen::Vector3f o = R * Eigen::Vector3f(aim.origin_m[0], aim.origin_m[1], aim.origin_m[2]);
    const float level = std::hypot(d_sensor.x(), d_sensor.y());
    const Eigen::Vector3f left_sensor = level > 1e-6F
                                            ? Eigen::Vector3f(-d_sensor.y() / level, d_sensor.x() / level, 0)
                                            : Eigen::Vector3f(0, 1, 0);
    const Eigen::Vector3f d = R * d_sensor, left = R * left_sensor, up = d.cross(left);
    const double across = std::tan(f.horizontal_divergence_rad / 2),
                 rise = std::tan(f.vertical_divergence_rad / 2), radius_m = f.start_diameter_m / 2;
    for (std::size_t i = 0; i < pattern.size(); ++i) {
      const auto [u, v, weight] = pattern[i];
      const Eigen::Vector3f start =
          o + static_cast<float>(u * radius_m) * left + static_cast<float>(v * radius_m) * up;
      const Eigen::Vector3f way =
          (d + static_cast<float>(u * across) * left + static_cast<float>(v * rise) * up).normalized();
      render::Ray& ray = rays[i];
      for (int k = 0; k < 3; ++k) ray.origin[k] = start[k], ray.direction[k] = way[k];
      ray.far_m = static_cast<float>(model_.range.max_m * 1.001 + 1);
    }
  }

 private:
  const models::LidarModel& model_;
  lidar::ScanRays scan_;
  lidar::Track track_;
};

/// What a device without errors says of echoes.
Element receive(const models::LidarModel& m, const lidar::EchoList& echoes) {
  Element e{std::nanf(""), 0, 0};
  int first = -1, last = -1, strongest = -1, second = -1;
  double most = -1, next = -1;
  for (int i = 0; i < static_cast<int>(echoes.count()); ++i) {
    const lidar::Echo& echo = echoes[static_cast<std::uint32_t>(i)];
    const double least = lidar::LidarMath::lidar_least_remission(
        static_cast<double>(echo.range_m), m.detection.minimum_remission, m.detection.limit_remission,
        m.detection.limit_range_m, m.detection.overlap_m);
    if (!(echo.remission > 0) || static_cast<double>(echo.remission) < least) continue;
    if (first < 0) first = i;
    last = i;
    const double p = lidar::power(m, static_cast<double>(echo.remission), static_cast<double>(echo.range_m));
    if (p > most)
      second = strongest, next = most, strongest = i, most = p;
    else if (p > next)
      second = i, next = p;
  }
  if (first < 0) return e;
  const auto in_range = [&](int i) {
    const auto r = static_cast<double>(echoes[static_cast<std::uint32_t>(i)].range_m);
    return r >= m.range.min_m && r <= m.range.max_m;
  };
  for (const int i : {strongest, last != strongest ? last : second})
    if (i >= 0 && in_range(i)) e.echoes += 1;
  const int it = m.echoes.returns == models::LidarReturns::first  ? first
                 : m.echoes.returns == models::LidarReturns::last ? last
                                                                  : strongest;
  if (!in_range(it)) return e;
  const lidar::Echo& echo = echoes[static_cast<std::uint32_t>(it)];
  e.range_m = echo.range_m;
  const double units = lidar::LidarMath::lidar_remission_units(
      static_cast<double>(echo.remission), static_cast<double>(echo.range_m), m.remission.scale,
      m.remission.retro_scale, m.remission.range_exponent > 0 ? m.remission.reference_range_m : 0,
      m.remission.range_exponent);
  e.remission = static_cast<float>(m.remission.maximum > 0 ? std::min(units, m.remission.maximum) : units);
  return e;
}

}  // namespace

models::LidarModel without_errors(models::LidarModel m, int sub_rays, int most_sub_rays) {
  m.noise = {};
  m.remission.noise = m.remission.step = 0;
  m.range = {.min_m = m.range.min_m, .max_m = m.range.max_m, .housing_m = m.range.housing_m};
  for (models::LidarBeam& b : m.scan.beams) b.range_bias_m = 0, b.remission_gain = 1;
  m.retro.crosstalk = 0;
  m.sun = {};
  m.footprint.sub_rays = sub_rays;
  m.footprint.most_sub_rays = most_sub_rays;
  return m;
}

models::TofModel without_errors(models::TofModel m, int samples) {
  m.pixel.trembling = false;
  m.pixel.range_offset_sigma_m = m.pixel.gain_sigma = m.pixel.read_noise_e = 0;
  m.pixel.adc_bits = 0;
  m.sampling.samples = samples;
  return m;
}

std::vector<Element> kept_firings(const models::LidarModel& m, const std::vector<Element>& all) {
  std::vector<Element> out;
  for (std::size_t c = 0; c < m.scan.columns; c += column_step(m))
    for (std::size_t b = 0; b < m.scan.beams.size(); ++b) out.push_back(all[c * m.scan.beams.size() + b]);
  return out;
}
std::vector<std::size_t> kept_shape(const models::LidarModel& m) {
  return {kept_columns(m), m.scan.beams.size()};
}
std::vector<std::size_t> kept_shape(const models::TofModel& m) {
  return {kept(m.height_px), kept(m.width_px)};
}
std::vector<Element> kept_pixels(const models::TofModel& m, const std::vector<Element>& all) {
  std::vector<Element> out;
  for (int v = 0; v < m.height_px; v += kPixelStep)
    for (int u = 0; u < m.width_px; u += kPixelStep)
      out.push_back(all[static_cast<std::size_t>(v) * static_cast<std::size_t>(m.width_px) +
                        static_cast<std::size_t>(u)]);
  return out;
}

Result<Reference> lidar_reference(const models::LidarModel& model, const Eigen::Isometry3d& T_world_sensor,
                                  render::EmbreeEngine& engine, int passes,
                                  const std::vector<models::SubRay>& pattern) {
  const models::LidarModel m = without_errors(model, 1);
  const Firings firings(m, T_world_sensor);
  const int band = lidar::band_of(m.wavelength_nm);
  const double z_m = T_world_sensor.translation().z();
  const lidar::AirState air = lidar::air_state(m, engine.window()->first(), band, z_m);
  if (air.drops_per_m3 > 0)
    return fail(ErrorCode::bad_input, "reference", "expected air without rain and snow");
  const std::size_t each = pattern.empty() ? kReferenceRays : pattern.size(),
                    all = each * static_cast<std::size_t>(passes);
  Reference out;
  out.passes.assign(static_cast<std::size_t>(passes), std::vector<Element>(firings.kept()));
  out.all.resize(firings.kept());
  std::vector<render::Ray> rays(kBlock * all);
  std::vector<render::Hit> hits(kBlock * all);
  std::vector<double> weights(kBlock * all);
  for (std::size_t begin = 0; begin < firings.kept(); begin += kBlock) {
    const std::size_t count = std::min(kBlock, firings.kept() - begin);
    tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
      const std::size_t firing = firings.firing(begin + i);
      for (std::size_t pass = 0; pass < out.passes.size(); ++pass) {
        const auto drawn = pattern.empty() ? footprint_rays(m.footprint, static_cast<std::uint32_t>(pass),
                                                            static_cast<std::uint32_t>(firing))
                                           : pattern;
        const std::size_t at = i * all + pass * each;
        firings.aim(firing, drawn, std::span(rays).subspan(at, each));
        for (std::size_t k = 0; k < each; ++k) weights[at + k] = drawn[k].weight;
      }
    });
    if (auto s = engine.cast({.origin = T_world_sensor.translation(),
                              .band = band,
                              .near_m = std::max(0.001F, static_cast<float>(m.range.housing_m)),
                              .rays = std::span<const render::Ray>(rays).first(count * all)},
                             std::span(hits).first(count * all));
        !s)
      return tl::unexpected<Error>(s.error());
    tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
      std::vector<lidar::Return> together, returns;
      const auto formed = [&](std::vector<lidar::Return>& of) {
        // form_echoes sorts by insertion, which takes long where little is in order.
        std::sort(of.begin(), of.end(), [](const auto& a, const auto& b) { return a.range_m < b.range_m; });
        lidar::EchoList list = of.empty() ? lidar::EchoList{} : lidar::form_echoes(m, of);
        if (air.soft_remission > 0 && (list.count() == 0 || air.soft_range_m < list[0].range_m))
          list.insert(m, {.range_m = air.soft_range_m,
                          .remission = air.soft_remission,
                          .source = lidar::EchoSource::particle});
        return receive(m, list);
      };
      for (std::size_t pass = 0; pass < out.passes.size(); ++pass) {
        returns.clear();
        for (std::size_t k = i * all + pass * each; k < i * all + (pass + 1) * each; ++k) {
          if (hits[k].nothing()) continue;
          double e = weights[k] * lidar::surface_remission(m, hits[k]);
          if (!air.clear())
            e *= air.two_way(z_m + static_cast<double>(rays[k].origin[2]),
                             static_cast<double>(rays[k].direction[2]), static_cast<double>(hits[k].range_m));
          if (!(e > 0)) continue;
          returns.push_back({hits[k].range_m, 0, e, hits[k].cos_incidence});
          together.push_back(returns.back());
          together.back().remission /= static_cast<double>(passes);
        }
        out.passes[pass][begin + i] = formed(returns);
      }
      out.all[begin + i] = formed(together);
    });
  }
  return out;
}

Result<Reference> tof_reference(const models::TofModel& model, std::span<const tof::Instant> instants,
                                render::EmbreeEngine& engine, int passes) {
  // Rows of kept pixels, one after the other. The samples of a pixel are those of its cells, which are pixels
  // of a sensor that is finer by `finer`.
  constexpr int finer = kReferenceSide / 4;
  models::TofModel m = without_errors(model, 16);
  m.sampling.bilinear = m.sampling.motion = false;
  models::TofModel row = m;
  row.width_px = static_cast<int>(kept(m.width_px));
  row.height_px = 1;
  models::TofModel cells = m;
  cells.width_px *= finer;
  cells.height_px = finer;
  cells.fx_px *= finer, cells.fy_px *= finer;
  cells.cx_px = finer * (m.cx_px + 0.5) - 0.5;
  const auto columns = static_cast<std::size_t>(row.width_px);
  Reference out;
  out.passes.resize(static_cast<std::size_t>(passes));
  tof::LightMeter meter(m, {});
  for (int v = 0; v < m.height_px; v += kPixelStep) {
    cells.cy_px = finer * (m.cy_px - v + 0.5) - 0.5;
    tof::PixelArray pixels(row, {});
    tof::TapMeans mean;
    const auto read = [&](std::vector<Element>& to) {
      TofPicture picture;
      pixels.read(0, picture, false);
      for (std::size_t i = 0; i < columns; ++i) to.push_back({picture.range_m[i], picture.amplitude[i]});
    };
    for (std::size_t pass = 0; pass < out.passes.size(); ++pass) {
      const models::PhiloxKey key{static_cast<std::uint32_t>(pass), static_cast<std::uint32_t>(v)};
      const tof::SampleRays from = tof::sample_rays(cells, key);
      tof::SampleRays rays;
      rays.width_px = row.width_px, rays.height_px = 1, rays.side = kReferenceSide;
      for (std::size_t u = 0; u < columns; ++u)
        for (int cell = 0; cell < finer * finer; ++cell) {
          const std::size_t first =
              16 * (static_cast<std::size_t>(cell / finer) * static_cast<std::size_t>(cells.width_px) +
                    u * kPixelStep * finer + static_cast<std::size_t>(cell % finer));
          for (const auto part : {&tof::SampleRays::x, &tof::SampleRays::y, &tof::SampleRays::z,
                                  &tof::SampleRays::gain, &tof::SampleRays::intensity_w_per_sr}) {
            const auto begin = (from.*part).begin() + static_cast<std::ptrdiff_t>(first);
            (rays.*part).insert((rays.*part).end(), begin, begin + 16);
          }
        }
      // Each instant by itself: those that are measured together share samples. Each sample as a pixel:
      // whether the sun reaches it is asked for each pixel once.
      tof::CameraRays single{rays, {}};
      single.samples.width_px = static_cast<int>(rays.count());
      single.samples.side = 1;
      for (std::size_t k = 0; k < instants.size(); ++k) {
        tof::SampleLight light;
        if (auto s =
                meter.measure(engine, *engine.window(), single, instants.subspan(k, 1), std::span(&light, 1));
            !s)
          return tl::unexpected<Error>(s.error());
        light.parts = {};  // from here on they are samples of `rays` again, in their order
        pixels.expose(rays, light,
                      instants.size() == 1
                          ? tof::ExposedTaps{.frequencies = m.modulation.frequencies_hz.size()}
                          : tof::taps_of(m.modulation, static_cast<int>(k)));
      }
      mean.resize(pixels.means().size());
      for (std::size_t i = 0; i < mean.size(); ++i) mean[i] += pixels.means()[i] / static_cast<float>(passes);
      read(out.passes[pass]);
    }
    pixels.means() = mean;
    read(out.all);
  }
  return out;
}

}  // namespace rigor::bench
