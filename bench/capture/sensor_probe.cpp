#include "bench/capture/sensor_probe.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bench/sensing/inertial.h"
#include "bench/sensing/simulation.h"
#include "bench/tune/engine_choices.h"

namespace rigor {
namespace {

/// A year: instants count in nanoseconds.
constexpr double kLatest_s = 366 * 86400.0;

}  // namespace

struct SensorProbe::Impl {
  RigConfig rig;
  SensorProbeOptions options;
  const ChannelEntry* entry = nullptr;
  const BackendChoice* choice = nullptr;
  std::string noise_name;  ///< the name that keys the channel's noise in a run
  std::unique_ptr<Simulation> simulation;
  WorldMotion motion;
  SensorOptions how;
  GroundTruth truth;
  std::shared_ptr<ImageProvider> camera;
  std::shared_ptr<SensedCamera> truthful;  ///< where `camera` knows no truth
  std::shared_ptr<TruthfulSampler> sampler;
  std::shared_ptr<SampleProvider> inertial;

  Status find_channel();
  Status make_sensor();
  Status make_camera();
  Status capture_image(const SampleProvider::Request& at, Sample& sample);
  Status capture_inertial(SampleProvider::Request at, Sample& sample);
};

Status SensorProbe::Impl::find_channel() {
  std::vector<std::string> names;
  for (const ChannelEntry& c : rig.channels) {
    const BackendChoice& side = c.is_pair ? c.simulated : c.source;
    if (side.backend != "simulated") continue;
    names.push_back(c.name);
    if (c.name != options.channel) continue;
    entry = &c;
    choice = &side;
    noise_name = c.is_pair ? c.name + ".simulated" : c.name;
  }
  if (!entry)
    return fail(ErrorCode::bad_input, "--channel",
                fmt::format("expected a simulated channel of the rig, got \"{}\"; there {}: {}",
                            options.channel, names.size() == 1 ? "is" : "are",
                            names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "))));
  if (rig.simulation.world.empty())
    return fail(ErrorCode::bad_input, rig.file.string(), "expected `simulation.world`, found none");
  if (!is_inertial(entry->kind)) return {};
  for (const auto& [option, given] : {std::pair{"--only", !options.only.empty()},
                                      {"--renderer", !options.renderer.empty()},
                                      {"--truth", options.truth}})
    if (given)
      return fail(ErrorCode::bad_input, option,
                  fmt::format("expected it with a sensor that looks, got a channel of kind {}; --ideal gives "
                              "a sample without errors",
                              kind_name(entry->kind)));
  return {};
}

Status SensorProbe::Impl::make_sensor() {
  const ConfigNode& params = choice->params;
  how.ideal = options.ideal;
  how.only = options.only;
  motion = simulation->motion_at_rest();
  for (const auto& [name, degrees] : options.joints_deg) {
    const auto index = simulation->joint(name);
    if (!index) return tl::unexpected<Error>(index.error());
    motion.joint[*index].position_rad = degrees * std::numbers::pi / 180;
  }
  if (is_inertial(entry->kind)) {
    auto made = simulation->inertial(entry->kind, params, rig.seed, noise_name, entry->period, how);
    if (!made) return tl::unexpected<Error>(made.error());
    inertial = std::move(*made);
    return {};
  }
  auto renderer = sense_choice(rig, *entry, *simulation, options.renderer);
  if (!renderer) return tl::unexpected<Error>(renderer.error());
  how.choice = std::move(*renderer);
  if (entry->kind == SampleKind::image) return make_camera();
  auto made = simulation->sampler(entry->kind, params, rig.seed, noise_name, how);
  if (!made) return tl::unexpected<Error>(made.error());
  sampler = std::move(*made);
  if (options.truth) sampler->set_truth(&truth);
  return {};
}

Status SensorProbe::Impl::make_camera() {
  auto made = simulation->camera(choice->params, rig.seed, noise_name, how);
  if (!made) return tl::unexpected<Error>(made.error());
  camera = std::move(*made);
  if (!options.truth) return {};
  if (auto* sensed = dynamic_cast<SensedCamera*>(camera.get())) {
    sensed->set_truth(&truth);
    return {};
  }
  SensorOptions by_rays = how;
  by_rays.choice = EngineChoice{.engine = "rays"};
  auto other = simulation->sensed_camera(choice->params, rig.seed, noise_name, by_rays);
  if (!other) return tl::unexpected<Error>(other.error());
  truthful = std::move(*other);
  truthful->set_truth(&truth);
  return {};
}

Status SensorProbe::Impl::capture_image(const SampleProvider::Request& at, Sample& sample) {
  const auto geometry = camera->geometry();
  const ConfigNode& params = choice->params;
  ImageRequest r;
  r.index = at.index;
  r.t_capture = at.t_capture;
  r.motion = at.motion;
  r.format = geometry.format;
  r.width_px = geometry.width_px;
  r.height_px = geometry.height_px;
  r.exposure =
      seconds_from(params.number_or("exposure_us", geometry.exposure.seconds() * 1e6, {.min = 1}) * 1e-6);
  r.gain_db = params.number_or("gain_db", 0);
  const std::size_t bytes = image_bytes(r.format, r.width_px, r.height_px);
  sample.reserve(bytes);
  if (truthful)
    if (auto s = truthful->capture(r, sample.memory()); !s) return s;
  if (auto s = camera->capture(r, sample.memory()); !s) return s;
  sample.size_bytes = bytes;
  sample.info = ImageInfo{r.format, r.width_px, r.height_px, 0, 0, r.exposure, r.gain_db};
  return {};
}

/// Odometry adds up: every capture since the start, as a run takes them.
Status SensorProbe::Impl::capture_inertial(SampleProvider::Request at, Sample& sample) {
  const std::uint64_t last = at.index;
  const BenchTime t_last = at.t_capture;
  for (at.index = entry->kind == SampleKind::odometry ? 0 : last; at.index <= last; ++at.index) {
    at.t_capture = t_last - entry->period * static_cast<std::int64_t>(last) +
                   entry->period * static_cast<std::int64_t>(at.index);
    if (auto s = inertial->capture(at, sample); !s) return s;
  }
  return {};
}

SensorProbe::SensorProbe(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SensorProbe::~SensorProbe() = default;

Result<std::unique_ptr<SensorProbe>> SensorProbe::open(RigConfig rig, SensorProbeOptions options) {
  auto impl = std::make_unique<Impl>();
  impl->rig = std::move(rig);
  impl->options = std::move(options);
  if (auto s = impl->find_channel(); !s) return tl::unexpected<Error>(s.error());
  auto simulation = Simulation::open(impl->rig.simulation);
  if (!simulation) return tl::unexpected<Error>(simulation.error());
  impl->simulation = std::move(*simulation);
  const auto made = catch_config([&] { return impl->make_sensor(); });
  if (!made) return tl::unexpected<Error>(made.error());
  if (!*made) return tl::unexpected<Error>(made->error());
  return std::unique_ptr<SensorProbe>(new SensorProbe(std::move(impl)));
}

Result<SampleKind> SensorProbe::kind_of(const RigConfig& rig, const SensorProbeOptions& options) {
  Impl impl;
  impl.rig = rig;
  impl.options = options;
  if (auto s = impl.find_channel(); !s) return tl::unexpected<Error>(s.error());
  return impl.entry->kind;
}

Result<Capture> SensorProbe::capture(double at_s) {
  if (!(at_s >= 0 && at_s <= kLatest_s))
    return fail(ErrorCode::bad_input, "--at",
                fmt::format("expected seconds from 0 to {:.0f}, got {:g}", kLatest_s, at_s));
  Capture capture;
  const auto done = catch_config([&]() -> Status {
    const Period period = impl_->entry->period;
    const Duration phase = seconds_from(impl_->choice->params.number_or("phase_us", 0, {.min = 0}) * 1e-6);
    SampleProvider::Request at;
    at.index =
        period.ns() > 0
            ? static_cast<std::uint64_t>(std::max<std::int64_t>(0, (seconds_from(at_s) - phase) / period))
            : 0;
    at.t_capture = BenchTime(0) + phase + period * static_cast<std::int64_t>(at.index);
    at.motion = impl_->motion;
    capture.index = at.index;
    if (impl_->inertial) {
      if (auto s = impl_->capture_inertial(at, capture.sample); !s) return s;
    } else if (impl_->camera) {
      if (auto s = impl_->capture_image(at, capture.sample); !s) return s;
    } else {
      capture.sample.reserve(impl_->sampler->geometry().max_bytes);
      if (auto s = impl_->sampler->capture(at, capture.sample); !s) return s;
      capture.directions = impl_->sampler->directions();
    }
    capture.sample.stamp.sequence = at.index;
    capture.sample.stamp.t_capture = at.t_capture;
    if (impl_->options.truth) capture.truth = impl_->truth;
    return {};
  });
  if (!done) return tl::unexpected<Error>(done.error());
  if (!*done) return tl::unexpected<Error>(done->error());
  return capture;
}

SampleKind SensorProbe::kind() const { return impl_->entry->kind; }
const RigConfig& SensorProbe::rig() const { return impl_->rig; }
std::string SensorProbe::renderer() const { return impl_->simulation->engine(); }

}  // namespace rigor
