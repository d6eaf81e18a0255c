#include "sim/sensors/camera/sensor_stage.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "sensor-hal/models/lens_walk.h"
#include "sensor-hal/models/one_source.h"
#include "sim/sensors/camera/rows.h"
#include "sim/sensors/camera/sensor_stage_bloom.h"
#include "sim/sensors/camera/sensor_stage_draws.h"
#include "sim/sensors/camera/sensor_stage_processing.h"

namespace rigor {
namespace {

using namespace sensor_stage;
static_assert(std::endian::native == std::endian::little, "words of pixels are little-endian");

struct Rect {
  int x = 0, y = 0, width = 0, height = 0;
  [[nodiscard]] int right() const { return x + width; }
  [[nodiscard]] int bottom() const { return y + height; }
};

/// `r` and `margin` pixels round it, as far as `limit` goes.
Rect grown(const Rect& r, int margin, const Rect& limit) {
  Rect out;
  out.x = std::max(limit.x, r.x - margin);
  out.y = std::max(limit.y, r.y - margin);
  out.width = std::min(limit.right(), r.right() + margin) - out.x;
  out.height = std::min(limit.bottom(), r.bottom() + margin) - out.y;
  return out;
}

using Response = std::array<float, 4>;
Response response_of(const CameraModel& c, const std::array<double, 4>& efficiency) {
  const auto rate = c.electron_rate_per_radiance(efficiency);
  Response out;
  for (std::size_t b = 0; b < 4; ++b) out[b] = static_cast<float>(rate[b]);
  return out;
}

struct HotPixel {
  std::uint32_t element;
  float dark_e_per_s;  ///< with that of every pixel
};

/// Numbers of a converter to those of an output, colour by colour.
using Table = std::vector<std::uint16_t>;

}  // namespace

/// What falls on the sensor: radiance, or what is already counted in electrons.
struct SensorStage::Light {
  const OpticsPicture* picture = nullptr;
  std::span<const float> rates{};
};

struct SensorStage::Impl {
  SensorStageSpec spec;
  models::PhiloxKey key;
  Response mono{};
  std::array<Response, 3> colour{};
  float dark_e_per_s = 0;
  // Maps of the full sensor; empty: the same for all pixels.
  std::vector<float> vignetting, prnu, both, dsnu_e;
  std::vector<HotPixel> hot;          ///< by element
  std::vector<BloomOperator> blooms;  ///< by size of picture; the last that were used

  // Kept between calls, so that they are not allocated anew.
  std::array<std::vector<float>, 3> spread;  ///< light of each colour after bloom
  std::array<NumberPlane, 3> numbers, processed;
  std::vector<std::uint16_t> packed;

  void make_maps();
  BloomOperator& bloom_of(int width, int height);
  [[nodiscard]] bool has_processing() const;
  /// White balance, after which numbers are still those of the converter; empty: none.
  [[nodiscard]] Table balance_table(int colour_index) const;
  /// From balanced numbers to the output's bits.
  [[nodiscard]] Table output_table(int output_bits) const;
  [[nodiscard]] bool mosaic(PixelFormat format) const {
    return is_bayer(format) || (format == PixelFormat::rgb8 && spec.model.processing.demosaic);
  }
  [[nodiscard]] std::size_t samples(PixelFormat format) const {
    return is_mono(format) || mosaic(format) ? 1 : 3;
  }
  [[nodiscard]] Status check(const SensorStageRequest& q, const Light& light, std::size_t bytes, Rect& region,
                             Rect& extent) const;
};

void SensorStage::Impl::make_maps() {
  const CameraModel& c = spec.model;
  const std::size_t n = static_cast<std::size_t>(c.width_px) * static_cast<std::size_t>(c.height_px);
  mono = response_of(c, c.optics.mono_efficiency);
  for (std::size_t f = 0; f < 3; ++f) colour[f] = response_of(c, c.optics.colour_efficiency[f]);
  dark_e_per_s = static_cast<float>(c.noise.dark_current_at_temperature_e_per_s());
  key = models::channel_key(spec.seed, models::channel_id_from_name(spec.name));

  const auto f = [](double v) { return static_cast<float>(v); };
  const Vignetting& v = c.vignetting;
  if (v.cos4_weight != 0 || v.a2 != 0 || v.a4 != 0 || v.a6 != 0) {
    vignetting.resize(n);
    for_rows(c.height_px, [&](int y) {
      LensWalk walk(c);
      for (int x = 0; x < c.width_px; ++x) {
        float gain = 0;
        // Tan of the ideal ray's angle is what the model asks for.
        using Lens = models::LensMath<float>;
        float rx = 0, ry = 0, valid = 0;
        if (c.projection == Projection::opencv) {
          if (const auto p = walk({static_cast<double>(x), static_cast<double>(y)})) {
            rx = f(p->x);
            ry = f(p->y);
            valid = 1;
          }
        } else if (const auto ray = unproject_ray(c, {static_cast<double>(x), static_cast<double>(y)})) {
          // From 90 degrees on cos is 0: a tangent so large that its square is that, and no more.
          constexpr double kLeastCosine = 1e-6;
          rx = f(ray->x / std::max(ray->z, kLeastCosine));
          ry = f(ray->y / std::max(ray->z, kLeastCosine));
          valid = 1;
        }
        if (valid > 0.5f) gain = Lens::vignetting_factor(rx, ry, f(v.cos4_weight), f(v.a2), f(v.a4), f(v.a6));
        vignetting[static_cast<std::size_t>(y) * c.width_px + x] = gain;
      }
    });
  }
  if (!spec.noise) {
    both = vignetting;
    return;
  }
  using Noise = models::NoiseMath<float>;
  if (c.noise.prnu > 0) prnu.resize(n);
  if (c.noise.dsnu_e > 0) dsnu_e.resize(n);
  if (c.noise.prnu > 0 || c.noise.dsnu_e > 0)
    for_rows(c.height_px, [&](int y) {
      for (int x = 0; x < c.width_px; ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * c.width_px + x;
        const auto w = models::draw_words(key, models::NoiseEffect::camera_fixed_pattern, 0,
                                          static_cast<std::uint32_t>(i));
        if (!prnu.empty())
          prnu[i] =
              std::max(1.0f + f(c.noise.prnu) * Noise::normal_quantile(Noise::unit_from_bits(w[0])), 0.0f);
        if (!dsnu_e.empty())
          dsnu_e[i] = f(c.noise.dsnu_e) * Noise::normal_quantile(Noise::unit_from_bits(w[1]));
      }
    });
  if (vignetting.empty()) {
    both = prnu;
  } else {
    both = vignetting;
    if (!prnu.empty())
      for (std::size_t i = 0; i < n; ++i) both[i] *= prnu[i];
  }
  if (c.noise.hot_pixel_share > 0) {
    const double mean = c.noise.hot_pixel_dark_at_temperature_e_per_s();
    for (std::size_t i = 0; i < n; ++i) {
      const auto w =
          models::draw_words(key, models::NoiseEffect::camera_hot_pixel, 0, static_cast<std::uint32_t>(i));
      const float more = Noise::hot_pixel_rate(f(c.noise.hot_pixel_share), f(mean),
                                               Noise::unit_from_bits(w[0]), Noise::unit_from_bits(w[1]));
      if (more > 0) hot.push_back({static_cast<std::uint32_t>(i), dark_e_per_s + more});
    }
  }
}

BloomOperator& SensorStage::Impl::bloom_of(int width, int height) {
  constexpr std::size_t kKept = 4;
  for (std::size_t i = 0; i < blooms.size(); ++i)
    if (blooms[i].width_px() == width && blooms[i].height_px() == height) return blooms[i];
  if (blooms.size() == kKept) blooms.erase(blooms.begin() + 1);  // the full sensor's stays
  return blooms.emplace_back(width, height, spec.model.bloom);
}

bool SensorStage::Impl::has_processing() const {
  const ImageProcessing& p = spec.model.processing;
  return p.gamma != 1 || p.subtract_black || p.white_balance != std::array<double, 3>{1, 1, 1};
}

Table SensorStage::Impl::balance_table(int colour_index) const {
  using Picture = models::PictureMath<double>;
  const EmvaNoise& n = spec.model.noise;
  const double gain = spec.model.processing.white_balance[static_cast<std::size_t>(colour_index)];
  if (gain == 1) return {};
  const double max_dn = std::ldexp(1.0, n.adc_bits) - 1.0;
  Table table(static_cast<std::size_t>(max_dn) + 1);
  for (std::size_t dn = 0; dn < table.size(); ++dn)
    table[dn] = static_cast<std::uint16_t>(
        std::clamp(std::floor(n.black_level_dn +
                              Picture::balanced_dn(static_cast<double>(dn), n.black_level_dn, gain) + 0.5),
                   0.0, max_dn));
  return table;
}

Table SensorStage::Impl::output_table(int output_bits) const {
  using Picture = models::PictureMath<double>;
  const EmvaNoise& n = spec.model.noise;
  const ImageProcessing& p = spec.model.processing;
  const double max_dn = std::ldexp(1.0, n.adc_bits) - 1.0;
  const int shift = n.adc_bits - output_bits;
  Table table(static_cast<std::size_t>(max_dn) + 1);
  const bool plain = p.gamma == 1 && !p.subtract_black;
  for (std::size_t dn = 0; dn < table.size(); ++dn) {
    const double out =
        plain ? static_cast<double>(dn)
              : Picture::processed_dn(static_cast<double>(dn) - n.black_level_dn, n.black_level_dn, max_dn,
                                      1.0 / p.gamma, p.subtract_black ? 0.0 : n.black_level_dn);
    // Rounded at the output's bits where something was worked out; what is raw loses its lower bits.
    const double scaled = std::ldexp(out, -shift);
    table[dn] = static_cast<std::uint16_t>(
        std::min(plain ? std::floor(scaled) : std::floor(scaled + 0.5), std::ldexp(1.0, output_bits) - 1.0));
  }
  return table;
}

Status SensorStage::Impl::check(const SensorStageRequest& q, const Light& light, std::size_t bytes,
                                Rect& region, Rect& extent) const {
  const CameraModel& c = spec.model;
  const auto bad = [&](const char* what, std::string message) {
    return fail(ErrorCode::bad_input, spec.name + ": " + what, std::move(message));
  };
  region = {q.region.x_px, q.region.y_px, q.region.width_px, q.region.height_px};
  if (q.region.width_px == 0) region = {0, 0, c.width_px, c.height_px};
  const auto fits = [](long long offset, long long size, long long all) {
    return offset >= 0 && size >= 1 && offset + size <= all;
  };
  if (!fits(region.x, region.width, c.width_px) || !fits(region.y, region.height, c.height_px))
    return bad("region", "expected a region within " + std::to_string(c.width_px) + "x" +
                             std::to_string(c.height_px) + " px, got " + std::to_string(region.width) + "x" +
                             std::to_string(region.height) + " at (" + std::to_string(region.x) + ", " +
                             std::to_string(region.y) + ")");
  if (mosaic(q.format) && (region.x % 2 != 0 || region.y % 2 != 0))
    return bad("region", std::string(pfnc_name(q.format)) + ": expected even offsets, got (" +
                             std::to_string(region.x) + ", " + std::to_string(region.y) + ")");
  if (light.picture != nullptr) {
    const OpticsPicture& picture = *light.picture;
    if (picture.width_px == c.width_px && picture.height_px == c.height_px)
      extent = {0, 0, c.width_px, c.height_px};
    else if (picture.width_px == region.width && picture.height_px == region.height)
      extent = region;
    else
      return bad("picture", "expected the size of the region or of the sensor, got " +
                                std::to_string(picture.width_px) + "x" + std::to_string(picture.height_px));
    const std::size_t values = 4 * static_cast<std::size_t>(extent.width) * extent.height;
    if (picture.radiance.size() != values)
      return bad("picture", "expected " + std::to_string(values) + " values of radiance, got " +
                                std::to_string(picture.radiance.size()));
  } else {
    extent = region;
    const std::size_t values =
        samples(q.format) * static_cast<std::size_t>(region.width) * static_cast<std::size_t>(region.height);
    if (light.rates.size() != values)
      return bad("rates", "expected " + std::to_string(values) + " electrons per second, got " +
                              std::to_string(light.rates.size()));
    if (c.bloom.active())
      return bad(
          "bloom",
          "expected a camera without bloom where light is handed in as rates, got one with it: use expose()");
  }
  const std::size_t wanted =
      image_bytes(q.format, static_cast<std::size_t>(region.width), static_cast<std::size_t>(region.height));
  if (bytes != wanted)
    return bad("pixels",
               "expected room for " + std::to_string(wanted) + " bytes, got " + std::to_string(bytes));
  if (!(q.exposure_s >= 0.0 && q.exposure_s <= 3600.0))
    return bad("exposure", "expected 0 to 3600 s, got " + std::to_string(q.exposure_s));
  if (!(q.gain_db >= -120.0 && q.gain_db <= 120.0))
    return bad("gain", "expected -120 to 120 dB, got " + std::to_string(q.gain_db));
  return {};
}

SensorStage::SensorStage(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SensorStage::~SensorStage() = default;

Result<std::unique_ptr<SensorStage>> SensorStage::create(const SensorStageSpec& spec) {
  if (auto s = spec.model.validate(); !s) {
    Error e = s.error();
    e.where = spec.name + ": " + e.where;
    return tl::unexpected<Error>(std::move(e));
  }
  auto impl = std::make_unique<Impl>();
  impl->spec = spec;
  impl->make_maps();
  if (spec.model.bloom.active()) impl->bloom_of(spec.model.width_px, spec.model.height_px);
  return std::unique_ptr<SensorStage>(new SensorStage(std::move(impl)));
}

Status SensorStage::expose(const SensorStageRequest& q, const OpticsPicture& picture,
                           std::span<std::byte> pixels, SensorStageCounts* counts) {
  return expose_light(q, {.picture = &picture}, pixels, counts);
}

std::size_t SensorStage::rate_planes(PixelFormat format) const { return impl_->samples(format); }

Status SensorStage::expose_rates(const SensorStageRequest& q, std::span<const float> rates,
                                 std::span<std::byte> pixels) {
  return expose_light(q, {.rates = rates}, pixels, nullptr);
}

Status SensorStage::expose_light(const SensorStageRequest& q, const Light& light, std::span<std::byte> pixels,
                                 SensorStageCounts* counts) {
  Impl& m = *impl_;
  const CameraModel& c = m.spec.model;
  Rect region, extent;
  if (auto s = m.check(q, light, pixels.size(), region, extent); !s) return s;

  const bool mosaic = m.mosaic(q.format);
  const bool demosaicing = mosaic && q.format == PixelFormat::rgb8;
  const bool mono = is_mono(q.format);
  const std::size_t samples = m.samples(q.format);
  const bool bloom = c.bloom.active();

  ExposureConstants k;
  k.key = m.key;
  k.capture_index = q.capture_index;
  k.shot_noise = m.spec.noise && c.noise.shot_noise;
  k.read_noise = m.spec.noise && c.noise.read_noise_e > 0;
  k.exposure_s = static_cast<float>(q.exposure_s);
  k.dark_e_per_s = m.dark_e_per_s;
  k.full_well_e = static_cast<float>(c.noise.full_well_e);
  k.read_noise_e = static_cast<float>(c.noise.read_noise_e);
  // The factor in double, then float.
  k.gain_dn_per_e = static_cast<float>(c.system_gain_dn_per_e() * std::pow(10.0, q.gain_db / 20.0));
  k.black_dn = static_cast<float>(c.noise.black_level_dn);
  k.max_dn = static_cast<float>(std::ldexp(1.0, c.noise.adc_bits) - 1.0);
  k.response_c2 = static_cast<float>(c.noise.response_c2);
  k.response_c3 = static_cast<float>(c.noise.response_c3);

  const auto radiance_at = [&](int x, int y) {
    return light.picture->radiance.data() + 4 * (static_cast<std::size_t>(y - extent.y) * extent.width +
                                                 static_cast<std::size_t>(x - extent.x));
  };
  const auto map_at = [&](const std::vector<float>& map, int x, int y) -> const float* {
    return map.empty() ? nullptr : map.data() + static_cast<std::size_t>(y) * c.width_px + x;
  };
  // The responses of the two pixels that alternate along a row from column x on; one plane.
  const auto mosaic_colour = [](int x, int y) { return (y & 1) + (x & 1); };

  if (counts != nullptr) {
    std::atomic<std::uint64_t> invalid = 0, clipped = 0;
    for_rows(region.height, [&](int y) {
      const BadRadiance bad =
          count_bad_radiance(radiance_at(region.x, region.y + y), region.width, kMaxRadiance);
      invalid += bad.invalid;
      clipped += bad.clipped;
    });
    *counts = {invalid, clipped};
  }

  // Bloom needs the light of every colour everywhere, before the mosaic picks.
  const std::size_t light_planes = mono ? 1 : 3;
  if (bloom) {
    for (std::size_t p = 0; p < light_planes; ++p) {
      std::vector<float>& plane = m.spread[p];
      plane.resize(static_cast<std::size_t>(extent.width) * extent.height);
      const Response& response = mono ? m.mono : m.colour[p];
      for_rows(extent.height, [&](int y) {
        float* const to = plane.data() + static_cast<std::size_t>(y) * extent.width;
        rates_of_run(radiance_at(extent.x, extent.y + y), extent.width, response.data(), response.data(),
                     kMaxRadiance, to);
        if (const float* const v = map_at(m.vignetting, extent.x, extent.y + y))
          for (int x = 0; x < extent.width; ++x) to[x] *= v[x];
      });
      m.bloom_of(extent.width, extent.height).apply(plane);
    }
  }
  const std::vector<float>& gain_map = bloom ? m.prnu : m.both;

  // Rows and columns beside the region that the processing looks at.
  int margin = demosaicing ? 2 : 0;
  const int median_step = mosaic ? 2 : 1;
  if (c.processing.median_filter) margin += median_step;
  // Even offsets stay even: margins are, and so is where the picture begins.
  const Rect work = grown(region, margin, extent);
  const int output_bits = std::min(c.noise.adc_bits, significant_bits(q.format));
  const int shift = c.noise.adc_bits - output_bits;
  const bool tables = m.has_processing();
  std::array<Table, 3> balance;
  Table output;
  if (tables) {
    if (!mono)
      for (int i = 0; i < 3; ++i) balance[static_cast<std::size_t>(i)] = m.balance_table(i);
    output = m.output_table(output_bits);
  }
  const bool simple = !c.processing.median_filter && !demosaicing && q.format != PixelFormat::mono12p;

  // Numbers of the converter of one row into up to three planes.
  const auto expose_row = [&](int y, int x0, int width, std::array<std::uint16_t*, 3> to) {
    thread_local std::array<std::vector<float>, 4> rows;
    RunRates rates;
    rates.planes = static_cast<int>(samples);
    for (std::size_t p = 0; p < samples; ++p) {
      if (light.picture == nullptr) {
        rates.plane[p] =
            light.rates.data() +
            (p * static_cast<std::size_t>(extent.height) + static_cast<std::size_t>(y - extent.y)) *
                static_cast<std::size_t>(extent.width) +
            static_cast<std::size_t>(x0 - extent.x);
        continue;
      }
      std::vector<float>& row = rows[p];
      row.resize(static_cast<std::size_t>(width));
      rates.plane[p] = row.data();
      if (bloom) {
        const std::size_t at =
            static_cast<std::size_t>(y - extent.y) * extent.width + static_cast<std::size_t>(x0 - extent.x);
        if (!mosaic) {
          rates.plane[p] = m.spread[p].data() + at;
        } else {
          const float* const even = m.spread[static_cast<std::size_t>(mosaic_colour(x0, y))].data() + at;
          const float* const odd = m.spread[static_cast<std::size_t>(mosaic_colour(x0 + 1, y))].data() + at;
          for (int x = 0; x < width; ++x) row[static_cast<std::size_t>(x)] = (x & 1) == 0 ? even[x] : odd[x];
        }
      } else {
        const Response& even = mono     ? m.mono
                               : mosaic ? m.colour[static_cast<std::size_t>(mosaic_colour(x0, y))]
                                        : m.colour[p];
        const Response& odd = mosaic ? m.colour[static_cast<std::size_t>(mosaic_colour(x0 + 1, y))] : even;
        rates_of_run(radiance_at(x0, y), width, even.data(), odd.data(), kMaxRadiance, row.data());
      }
    }
    PixelRun run;
    run.first_element = static_cast<std::uint32_t>(y) * static_cast<std::uint32_t>(c.width_px) +
                        static_cast<std::uint32_t>(x0);
    run.count = width;
    run.gain = map_at(gain_map, x0, y);
    run.offset_e = map_at(m.dsnu_e, x0, y);
    if (!m.hot.empty()) {
      const auto before = [](const HotPixel& h, std::uint32_t element) { return h.element < element; };
      auto h = std::lower_bound(m.hot.begin(), m.hot.end(), run.first_element, before);
      const std::uint32_t end = run.first_element + static_cast<std::uint32_t>(width);
      if (h != m.hot.end() && h->element < end) {
        rows[3].assign(static_cast<std::size_t>(width), k.dark_e_per_s);
        for (; h != m.hot.end() && h->element < end; ++h)
          rows[3][h->element - run.first_element] = h->dark_e_per_s;
        run.dark_e_per_s = rows[3].data();
      }
    }
    RunNumbers numbers;
    for (std::size_t p = 0; p < samples; ++p) numbers.plane[p] = to[p];
    expose_run(k, run, rates, numbers);
  };
  const auto balanced = [&](std::uint16_t dn, std::size_t colour_index) {
    const Table& t = balance[colour_index];
    return t.empty() ? dn : t[dn];
  };
  // From numbers of the converter, balanced, to bytes: `planes` samples a pixel.
  const auto lay_down = [&](const std::array<const std::uint16_t*, 3>& from, std::size_t planes, int width,
                            std::byte* to) {
    const auto finish = [&](std::uint16_t dn) {
      return tables ? output[dn] : static_cast<std::uint16_t>(dn >> shift);
    };
    if (has_words(q.format)) {
      for (int x = 0; x < width; ++x) {
        const std::uint16_t v = finish(from[0][x]);
        std::memcpy(to + 2 * static_cast<std::size_t>(x), &v, 2);
      }
    } else {
      for (std::size_t p = 0; p < planes; ++p)
        for (int x = 0; x < width; ++x)
          to[planes * static_cast<std::size_t>(x) + p] = static_cast<std::byte>(finish(from[p][x]));
    }
  };
  const auto balance_row = [&](int y, int x0, int width, std::array<std::uint16_t*, 3> row) {
    if (!tables || mono) return;
    for (std::size_t p = 0; p < samples; ++p)
      for (int x = 0; x < width; ++x)
        row[p][x] = balanced(row[p][x], mosaic ? static_cast<std::size_t>(mosaic_colour(x0 + x, y)) : p);
  };
  const std::size_t out_planes = q.format == PixelFormat::rgb8 ? 3 : 1;
  const std::size_t row_bytes = static_cast<std::size_t>(region.width) * bits_per_pixel(q.format) / 8;

  if (simple) {
    for_rows(region.height, [&](int y) {
      thread_local std::array<std::vector<std::uint16_t>, 3> rows;
      std::array<std::uint16_t*, 3> to{};
      for (std::size_t p = 0; p < samples; ++p) {
        rows[p].resize(static_cast<std::size_t>(region.width));
        to[p] = rows[p].data();
      }
      expose_row(region.y + y, region.x, region.width, to);
      balance_row(region.y + y, region.x, region.width, to);
      lay_down({to[0], to[1], to[2]}, out_planes, region.width,
               pixels.data() + static_cast<std::size_t>(y) * row_bytes);
    });
    return {};
  }

  for (std::size_t p = 0; p < samples; ++p) m.numbers[p].resize(work.width, work.height);
  const auto rows_of = [&](std::array<NumberPlane, 3>& planes, int y) {
    std::array<std::uint16_t*, 3> rows{};
    for (std::size_t p = 0; p < samples; ++p) rows[p] = planes[p].row(y);
    return rows;
  };
  for_rows(work.height, [&](int y) { expose_row(work.y + y, work.x, work.width, rows_of(m.numbers, y)); });
  if (c.processing.median_filter)
    for (std::size_t p = 0; p < samples; ++p) {
      median_3x3(m.numbers[p], median_step, m.processed[p]);
      std::swap(m.numbers[p], m.processed[p]);
    }
  for_rows(work.height, [&](int y) { balance_row(work.y + y, work.x, work.width, rows_of(m.numbers, y)); });
  const std::array<NumberPlane, 3>* finished = &m.numbers;
  if (demosaicing) {
    demosaic(m.numbers[0], static_cast<std::uint16_t>(k.max_dn), m.processed);
    finished = &m.processed;
  }
  const auto row_from = [&](int y) {
    std::array<const std::uint16_t*, 3> from{};
    for (std::size_t p = 0; p < out_planes; ++p)
      from[p] = (*finished)[p].row(region.y + y - work.y) + (region.x - work.x);
    return from;
  };
  if (q.format == PixelFormat::mono12p) {
    m.packed.resize(static_cast<std::size_t>(region.width) * region.height);
    for_rows(region.height, [&](int y) {
      const std::uint16_t* const from = row_from(y)[0];
      std::uint16_t* const to = m.packed.data() + static_cast<std::size_t>(y) * region.width;
      for (int x = 0; x < region.width; ++x)
        to[x] = tables ? output[from[x]] : static_cast<std::uint16_t>(from[x] >> shift);
    });
    pack_12p(m.packed, pixels.data());
    return {};
  }
  for_rows(region.height, [&](int y) {
    lay_down(row_from(y), out_planes, region.width, pixels.data() + static_cast<std::size_t>(y) * row_bytes);
  });
  return {};
}

}  // namespace rigor
