#include "sim/sensors/tof/tof_simulator.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "sensor-hal/models/tof/tof_math.h"
#include "sim/sensors/tof/tof_filters.h"
#include "sim/sensors/tof/tof_light.h"
#include "sim/sensors/tof/tof_pixels.h"
#include "sim/sensors/tof/tof_rays.h"

namespace rigor {
namespace {

using render::ContentWindow;
using tof::ExposedTaps;
using tof::Instant;

models::PhiloxKey key_of(const TofSpec& spec) {
  return models::channel_key(spec.seed, models::channel_id_from_name(spec.name));
}

bool same_content(const ContentWindow& window) {
  return std::all_of(window.frames.begin(), window.frames.end(),
                     [&](const auto& f) { return f->batches == window.first().batches; });
}

/// Farther than this a white matt surface sends back less than a quarter of the least amplitude that a pixel
/// may have: what lies there is asked for no finer than samples see it. Infinity where no amplitude is too
/// small.
double lit_within_m(const models::TofModel& model) {
  const double least_e = 2 * model.limits.min_amplitude_e / model.modulation.contrast;
  return std::sqrt(4 * model.active_electrons(1, 1) / least_e);
}

}  // namespace

struct TofSimulator::Impl {
  Impl(const TofSpec& s, std::shared_ptr<render::RayEngine> e)
      : spec(s),
        engine(std::move(e)),
        rays{s.ideal ? tof::centre_rays(s.model) : tof::sample_rays(s.model, key_of(s)),
             tof::centre_rays(s.model)},
        meter(s.model, key_of(s)),
        pixels(s.model, key_of(s)) {}

  [[nodiscard]] Status ideal(const Instant& instant, TofPicture& picture, bool keep_taps);
  [[nodiscard]] Status ground_truth(const render::SensorView& view, const Instant& instant,
                                    GroundTruth& truth);

  TofSpec spec;
  std::shared_ptr<render::RayEngine> engine;
  tof::CameraRays rays;
  tof::LightMeter meter;
  std::vector<Instant> instants;
  std::vector<tof::SampleLight> lights;  ///< of each
  tof::PixelArray pixels;
  std::vector<float> scratch;
  double lit_m = lit_within_m(spec.model);
};

TofSimulator::TofSimulator(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TofSimulator::~TofSimulator() = default;
const TofSpec& TofSimulator::spec() const { return impl_->spec; }

Result<std::unique_ptr<TofSimulator>> TofSimulator::create(const TofSpec& spec,
                                                           std::shared_ptr<render::RayEngine> engine) {
  if (!engine) return fail(ErrorCode::bad_input, spec.name, "expected an engine, got none");
  if (auto valid = spec.model.validate(); !valid) {
    Error e = valid.error();
    e.where = spec.name + (e.where.empty() ? "" : ": " + e.where);
    return tl::unexpected<Error>(std::move(e));
  }
  return std::unique_ptr<TofSimulator>(new TofSimulator(std::make_unique<Impl>(spec, std::move(engine))));
}

Status TofSimulator::capture(const MeasureRequest& request, const render::SensorView& view,
                             TofPicture& picture, GroundTruth* truth, bool keep_taps) {
  Impl& my = *impl_;
  const models::TofModel& model = my.spec.model;
  picture.width_px = static_cast<std::uint32_t>(model.width_px);
  picture.height_px = static_cast<std::uint32_t>(model.height_px);

  const int exposures = my.spec.ideal || !model.sampling.motion ? 1 : model.exposures();
  const auto instant_of = [&](int m) {
    return exposures == 1 ? request.t_capture : request.t_capture + seconds_from(model.exposure_offset_s(m));
  };
  const Eigen::Isometry3d T_world_sensor = view.T_world_sensor(request.t_capture);
  render::ContentQuery query;
  query.look_from_cell_of(T_world_sensor.translation());
  query.allowed_error_rad = my.spec.allowed_error_rad;
  if (query.allowed_error_rad <= 0) {
    query.allowed_error_rad = 1 / (std::max(model.fx_px, model.fy_px) * my.rays.samples.side);
    query.full_within_m = my.lit_m;
  }
  query.t = request.t_capture;
  // Between four instants, motion is even.
  const auto window =
      view.world.collect(query, instant_of(0), instant_of(exposures - 1), std::min(exposures, 4));
  if (auto s = my.engine->prepare(window); !s) return s;
  const Instant middle{T_world_sensor, static_cast<float>(window->time_of(request.t_capture))};

  if (truth)
    if (auto s = my.ground_truth(view, middle, *truth); !s) return s;
  if (my.spec.ideal) return my.ideal(middle, picture, keep_taps);

  bool still = same_content(*window);
  for (int m = 0; m < exposures && still; ++m)
    still = view.T_world_sensor(instant_of(m)).matrix() == T_world_sensor.matrix();
  my.instants.assign(1, middle);
  if (!still) {
    my.instants.clear();
    for (int m = 0; m < exposures; ++m) {
      const BenchTime t = instant_of(m);
      my.instants.push_back({view.T_world_sensor(t), static_cast<float>(window->time_of(t))});
    }
  }
  my.lights.resize(my.instants.size());
  if (auto s = my.meter.measure(*my.engine, *window, my.rays, my.instants, my.lights); !s) return s;
  for (std::size_t m = 0; m < my.lights.size(); ++m)
    my.pixels.expose(my.rays.samples, my.lights[m],
                     still ? ExposedTaps{.frequencies = model.modulation.frequencies_hz.size()}
                           : tof::taps_of(model.modulation, static_cast<int>(m)));
  my.pixels.read(request.index, picture, keep_taps);
  tof::filter(model.filters, picture, my.scratch);
  return {};
}

Status TofSimulator::Impl::ideal(const Instant& instant, TofPicture& picture, bool keep_taps) {
  const tof::SampleRays& middles = rays.middles;
  const auto hits = meter.cast(*engine, middles, instant);
  if (!hits) return tl::unexpected<Error>(hits.error());
  const std::size_t count = hits->size();
  picture.range_m.resize(count);
  picture.amplitude.resize(count);
  picture.status.resize(count);
  picture.taps.resize(keep_taps ? 4 * count : 0);
  using Math = models::TofMath<float>;
  const auto contrast = static_cast<float>(spec.model.modulation.contrast);
  const auto turns_per_m = static_cast<float>(2 * spec.model.modulation.frequencies_hz[0] / 299792458.0);
  for (std::size_t i = 0; i < count; ++i) {
    const render::Hit& h = (*hits)[i];
    const bool nothing = h.nothing();
    const float e =
        nothing ? 0.0F
                : Math::tof_active_electrons(middles.gain[i], middles.intensity_w_per_sr[i], h.range_m,
                                             tof::remission(h, spec.model.sampling.retro_gain));
    picture.range_m[i] = nothing ? std::numeric_limits<float>::quiet_NaN() : h.range_m;
    picture.amplitude[i] = 0.5F * contrast * e;
    picture.status[i] = nothing ? TofPixelStatus::no_return : TofPixelStatus::valid;
    if (keep_taps) {
      float s = 0, c = 1;
      Math::tof_sincos_turns(nothing ? 0.0F : h.range_m * turns_per_m, s, c);
      float* d = &picture.taps[4 * i];
      Math::tof_taps(e, e * c, e * s, contrast, 0.0F, d[0], d[1], d[2], d[3]);
    }
  }
  return {};
}

Status TofSimulator::Impl::ground_truth(const render::SensorView& view, const Instant& instant,
                                        GroundTruth& truth) {
  const auto hits = meter.cast(*engine, rays.middles, instant);
  if (!hits) return tl::unexpected<Error>(hits.error());
  const std::size_t count = hits->size();
  truth.width = static_cast<std::uint32_t>(spec.model.width_px);
  truth.height = static_cast<std::uint32_t>(spec.model.height_px);
  truth.node.assign(count, 0);
  truth.class_index.assign(count, 0);
  truth.class_names.assign(1, "");
  truth.range_m.assign(count, std::numeric_limits<float>::infinity());
  truth.normal.assign(3 * count, 0);
  truth.flow_px.clear();
  const Eigen::Matrix3f R_sensor_world = instant.T_world_sensor.linear().transpose().cast<float>();
  std::map<std::uint64_t, std::uint16_t> class_of;
  for (std::size_t i = 0; i < count; ++i) {
    const render::Hit& h = (*hits)[i];
    if (h.nothing()) continue;
    const std::uint64_t node = h.node.value;
    const auto [at, is_new] = class_of.try_emplace(node, std::uint16_t{0});
    if (is_new) {
      const std::string name = view.world.type_name(h.node);
      const auto found = std::find(truth.class_names.begin(), truth.class_names.end(), name);
      at->second = static_cast<std::uint16_t>(found - truth.class_names.begin());
      if (found == truth.class_names.end()) truth.class_names.push_back(name);
    }
    truth.node[i] = node;
    truth.class_index[i] = at->second;
    truth.range_m[i] = h.range_m;
    const Eigen::Vector3f n = R_sensor_world * Eigen::Vector3f(h.normal[0], h.normal[1], h.normal[2]);
    for (int a = 0; a < 3; ++a) truth.normal[3 * i + static_cast<std::size_t>(a)] = n[a];
  }
  return {};
}

}  // namespace rigor
