#include "sim/sensors/tof/tof_rays.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "sensor-hal/models/lens_walk.h"
#include "sim/sensors/tof/tof_effects.h"

namespace rigor::tof {
namespace {

void resize(SampleRays& r, std::size_t count) {
  for (auto* v : {&r.x, &r.y, &r.z, &r.u_px, &r.v_px, &r.gain, &r.intensity_w_per_sr}) v->resize(count);
}

/// `at`: pixel coordinates, whose origin is the middle of the first pixel.
void set(SampleRays& r, std::size_t sample, const OffAxis& off_axis, LensWalk& undistort, PixelPosition at) {
  r.u_px[sample] = static_cast<float>(at.u_px + 0.5);
  r.v_px[sample] = static_cast<float>(at.v_px + 0.5);
  const std::optional<NormalisedPosition> p = undistort(at);
  if (!p) {
    r.x[sample] = r.y[sample] = r.z[sample] = std::numeric_limits<float>::quiet_NaN();
    r.gain[sample] = r.intensity_w_per_sr[sample] = 0;
    return;
  }
  const double cosine = 1 / std::sqrt(1 + p->x * p->x + p->y * p->y);
  r.x[sample] = static_cast<float>(p->x * cosine);
  r.y[sample] = static_cast<float>(p->y * cosine);
  r.z[sample] = static_cast<float>(cosine);
  r.gain[sample] = off_axis.gain(r.z[sample]);
  r.intensity_w_per_sr[sample] = off_axis.intensity_w_per_sr(r.z[sample]);
}

}  // namespace

OffAxis::OffAxis(const models::TofModel& m)
    : electrons_per_radiance_(static_cast<float>(m.electrons_per_radiance())),
      cos4_weight_(static_cast<float>(m.optics.cos4_weight)),
      on_axis_w_per_sr_(static_cast<float>(m.illumination.radiant_intensity_w_per_sr)),
      exponent_(static_cast<float>(m.illumination.cosine_exponent)) {}

std::size_t SampleRays::middle_sample(std::size_t pixel) const {
  const auto s = static_cast<std::size_t>(side), w = static_cast<std::size_t>(width_px);
  if (!lattice) return pixel * s * s + (s / 2) * s + s / 2;
  return (pixel / w * s + s / 2 + 1) * static_cast<std::size_t>(lattice_width()) + pixel % w * s + s / 2 + 1;
}

std::size_t SampleRays::pixel_of(std::size_t sample) const {
  if (!lattice) return sample / static_cast<std::size_t>(side * side);
  const int lx = static_cast<int>(sample % static_cast<std::size_t>(lattice_width()));
  const int ly = static_cast<int>(sample / static_cast<std::size_t>(lattice_width()));
  const int u = std::clamp((lx - 1) / side, 0, width_px - 1);
  const int v = std::clamp((ly - 1) / side, 0, height_px - 1);
  return static_cast<std::size_t>(v) * static_cast<std::size_t>(width_px) + static_cast<std::size_t>(u);
}

SampleRays sample_rays(const models::TofModel& model, models::PhiloxKey key) {
  SampleRays r;
  r.width_px = model.width_px;
  r.height_px = model.height_px;
  r.side = model.sampling.samples == 16  ? 4
           : model.sampling.samples == 9 ? 3
           : model.sampling.samples == 4 ? 2
                                         : 1;
  r.lattice = model.sampling.bilinear;
  const CameraModel camera = model.camera();
  const OffAxis off_axis(model);
  const auto s = static_cast<std::size_t>(r.side);
  if (r.lattice) {
    const auto columns = static_cast<std::size_t>(r.lattice_width());
    const std::size_t rows = s * static_cast<std::size_t>(r.height_px) + 2;
    resize(r, columns * rows);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, rows), [&](const auto& range) {
      for (std::size_t ly = range.begin(); ly < range.end(); ++ly) {
        LensWalk undistort(camera);
        for (std::size_t lx = 0; lx < columns; ++lx)
          set(r, ly * columns + lx, off_axis, undistort,
              {(static_cast<double>(lx) - 0.5) / r.side - 0.5,
               (static_cast<double>(ly) - 0.5) / r.side - 0.5});
      }
    });
    return r;
  }
  const auto width = static_cast<std::size_t>(r.width_px), height = static_cast<std::size_t>(r.height_px);
  resize(r, width * height * s * s);
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, height), [&](const auto& range) {
    for (std::size_t v = range.begin(); v < range.end(); ++v) {
      LensWalk undistort(camera);
      for (std::size_t u = 0; u < width; ++u)
        for (std::size_t i = 0; i < s * s; ++i) {
          const std::size_t sample = (v * width + u) * s * s + i;
          double du = 0.5, dv = 0.5;
          if (s > 1) {
            const auto words = models::draw_words(key, models::NoiseEffect::tof_jitter, 0,
                                                  static_cast<std::uint32_t>(sample));
            du = models::NoiseMath<double>::unit_from_bits(words[0]);
            dv = models::NoiseMath<double>::unit_from_bits(words[1]);
          }
          set(r, sample, off_axis, undistort,
              {static_cast<double>(u) - 0.5 + (static_cast<double>(i % s) + du) / r.side,
               static_cast<double>(v) - 0.5 + (static_cast<double>(i / s) + dv) / r.side});
        }
    }
  });
  return r;
}

SampleRays centre_rays(const models::TofModel& model) {
  models::TofModel one = model;
  one.sampling.samples = 1;
  one.sampling.bilinear = false;
  return sample_rays(one, {});
}

}  // namespace rigor::tof
