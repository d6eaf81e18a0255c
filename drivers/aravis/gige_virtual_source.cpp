#include "drivers/aravis/gige_virtual_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>

#include "drivers/aravis/aravis_settings.h"
#include "drivers/aravis/frame_sequence.h"
#include "drivers/aravis/gige_memory_link.h"
#include "drivers/aravis/range_parts.h"

namespace rigor {
namespace {

// The camera ran before the bench did: its clock is ahead of the bench's, so that no instant of it is
// negative.
constexpr Duration kDeviceAhead = seconds(10);
DeviceTime device_time(BenchTime t) { return DeviceTime((t + kDeviceAhead).ns()); }
BenchTime bench_time(DeviceTime t) { return BenchTime(t.ns()) - kDeviceAhead; }

ConfigError refused(const ChannelConfig& config, std::string_view key, const std::string& message) {
  return config.params.error(key, message);
}

}  // namespace

struct GigeVirtualSource::Impl {
  Impl(GigeVirtualSource& s, DeviceParts p, ConfigNode n)
      : self(s), parts(std::move(p)), emulator_params(std::move(n)), health(s.health_) {}

  GigeVirtualSource& self;
  DeviceParts parts;
  ConfigNode emulator_params;
  HealthCounters& health;
  ChannelConfig config;
  AravisSettings settings;
  EmulatedCameraSettings camera;
  EmulatedSensor sensor;
  RangeScale scale;
  bool range_part = false;  ///< `part`: the range, not the amplitude
  gige::Region region;
  double gain_db = 0;
  Duration exposure;

  // Parts of one run; the link refers to the model, the client to the link.
  std::unique_ptr<gige::GigeDeviceModel> model;
  std::unique_ptr<gige::GigeMemoryLink> link;
  std::unique_ptr<gige::GigeClient> client;
  gige::AssembledFrame frame;
  FrameSequence sequence;
  BenchTime first_exposure, next_exposure;  // start of the first, and of the next one that is not begun
  std::int64_t next_index = 0;
  DeviceTime device_now;
  bool running = false;

  void advance(DeviceTime t);
  void collect();
  [[nodiscard]] Duration ptp_offset();
  void set_up();
  void set_up_line();
  void set_up_parts();
  void fill_range(Sample& sample, std::size_t picture) const;
  void set_up_chunks();
  void set_up_action();
  /// Exposures that begin when the camera says so, not by the bench's grid.
  void complete_camera(BenchTime now);
  void complete_actions(BenchTime now);
  void require(const Status& status, std::string_view key, const std::string& what) const;
  [[nodiscard]] std::uint32_t read(gige::reg::Address address, const std::string& what) const;
  [[nodiscard]] double read_double(gige::reg::Address address, const std::string& what) const;
};

GigeVirtualSource::GigeVirtualSource(DeviceParts parts, ConfigNode emulator_params)
    : impl_(std::make_unique<Impl>(*this, std::move(parts), std::move(emulator_params))) {}
GigeVirtualSource::~GigeVirtualSource() = default;

Status GigeVirtualSource::do_configure(const ChannelConfig& config) {
  Impl& i = *impl_;
  i.config = config;
  i.settings = read_aravis_settings(config);
  if (config.period.ns() <= 0)
    return fail(ErrorCode::bad_input, config.name,
                "expected a rate: a camera in virtual time exposes on the bench's grid");
  i.camera = read_emulated_camera(i.emulator_params, default_frame_id(config.name), config.period);
  const auto sensor = sensor_of(i.parts);
  if (!sensor)
    return fail(ErrorCode::bad_input, config.name,
                "expected something that makes pictures or measures range: give the emulator that stands for "
                "this camera a `sensor`");
  i.sensor = *sensor;
  if (i.settings.parts() && !sensor->range)
    return fail(ErrorCode::bad_input, config.name,
                "expected a 3D camera: give the emulator that stands for it the `sensor` of a time-of-flight "
                "camera");
  i.range_part = i.settings.part == "Range" || i.settings.part == "0";
  if (!i.settings.part.empty() && !i.range_part && i.settings.part != "Intensity" && i.settings.part != "1")
    throw refused(config, "part", "expected Range (0) or Intensity (1), which the emulated camera has");
  const ImageProvider::Geometry& g = sensor->geometry;
  i.region = {0, 0, g.width_px, g.height_px};
  if (const auto& r = i.settings.region) i.region = {r->x_px, r->y_px, r->width_px, r->height_px};
  description_.kind = config.kind;
  description_.frame_id = i.settings.frame_id;
  description_.format = i.settings.format;
  description_.width_px = i.region.width_px, description_.height_px = i.region.height_px;
  description_.max_bytes = i.settings.range
                               ? std::size_t{i.region.width_px} * i.region.height_px * 2 * sizeof(float)
                               : image_bytes(i.settings.format, i.region.width_px, i.region.height_px);
  return {};
}

void GigeVirtualSource::Impl::require(const Status& status, std::string_view key,
                                      const std::string& what) const {
  if (!status) throw refused(config, key, what + ": " + status.error().message);
}
std::uint32_t GigeVirtualSource::Impl::read(gige::reg::Address address, const std::string& what) const {
  auto v = client->read(address);
  if (!v) throw ConfigError({v.error().code, config.name, what + ": " + v.error().text()});
  return *v;
}
double GigeVirtualSource::Impl::read_double(gige::reg::Address address, const std::string& what) const {
  auto v = client->read_double(address);
  if (!v) throw ConfigError({v.error().code, config.name, what + ": " + v.error().text()});
  return *v;
}

/// The rig's settings on the camera, as aravis_features.cpp makes them on a real one.
void GigeVirtualSource::Impl::set_up() {
  const gige::GigeCameraConfig& c = model->config();
  require(client->connect(), {}, "taking control of the camera");
  if (settings.parts()) {
    set_up_parts();
  } else {
    require(client->set_pixel_format(to_gige(settings.format)), "pixel_format",
            "expected a format that the camera offers");
  }
  require(client->set_region(region), "region",
          fmt::format("expected a region within {}x{} px, width in steps of {}, height of {}, offsets of {}, "
                      "got {}x{} at {},{}",
                      c.sensor_width_px, c.sensor_height_px, c.width_step_px, c.height_step_px,
                      c.offset_step_px, region.width_px, region.height_px, region.x_px, region.y_px));
  if (settings.exposure_us) {
    const Duration wanted = seconds_from(*settings.exposure_us * 1e-6);
    require(client->set_exposure(wanted), "exposure_us",
            fmt::format("expected {:g} … {:g} µs, as the camera offers, got {:g}", c.min_exposure_us,
                        c.max_exposure_us, *settings.exposure_us));
  }
  if (settings.gain_db)
    require(client->set_gain(*settings.gain_db), "gain_db",
            fmt::format("expected {:g} … {:g} dB, as the camera offers, got {:g}", c.min_gain_db,
                        c.max_gain_db, *settings.gain_db));
  require(client->set_frame_rate(config.period.hz()), "rate_hz",
          fmt::format("expected {:g} … {:g} Hz, as the camera offers, got {:g}", c.min_frame_rate_hz,
                      c.max_frame_rate_hz, config.period.hz()));
  require(client->set_acquisition(gige::AcquisitionMode::continuous), {}, "setting continuous acquisition");
  require(client->set_software_trigger(settings.triggered_by_bench() || settings.hardware_trigger), "trigger",
          "setting the trigger");
  if (settings.hardware_trigger) set_up_line();
  if (settings.action) set_up_action();
  if (settings.chunks) set_up_chunks();
  if (settings.ptp)
    require(client->write(gige::reg::kPtpEnable, 1), "ptp",
            "expected a camera with a PTP clock (`ptp` of the emulator)");
  exposure = seconds_from(read_double(gige::reg::kExposureTime, "reading the exposure time") * 1e-6);
  gain_db = read_double(gige::reg::kGain, "reading the gain");
  if (exposure > config.period)
    throw refused(config, "exposure_us",
                  fmt::format("expected an exposure within the channel's period of {:g} µs, got {:g}",
                              config.period.seconds() * 1e6, exposure.seconds() * 1e6));
  if (config.latency < exposure / 2 + camera.readout)
    throw refused(
        config, "latency_ms",
        fmt::format("expected at least {:g} ms, half of the exposure and the readout of {:g} ms: earlier no "
                    "picture can be there; got {:g}",
                    (exposure / 2 + camera.readout).seconds() * 1e3, camera.readout.seconds() * 1e3,
                    config.latency.seconds() * 1e3));
  const auto payload = read(gige::reg::kPayloadSize, "reading the payload size");
  const auto picture =
      image_bytes(settings.format, region.width_px, region.height_px) * (settings.range ? 2 : 1);
  if (settings.chunks ? payload <= picture : payload != picture)
    throw ConfigError({ErrorCode::internal, config.name, "the camera's payload is not its picture's size"});
}

/// Both pictures for a range image, or the one that the rig wants.
void GigeVirtualSource::Impl::set_up_parts() {
  const auto format = settings.range || range_part ? PixelFormat::coord3d_c16 : PixelFormat::mono16;
  if (settings.format != format)
    throw refused(config, "pixel_format",
                  fmt::format("expected {}, in which the camera sends this part, got {}", pfnc_name(format),
                              pfnc_name(settings.format)));
  require(client->set_parts(settings.range || range_part, settings.range || !range_part), "part",
          "asking for multi-part frames");
  scale.scale_m =
      settings.range_scale_mm.value_or(read_double(gige::reg::kScan3dScale, "reading the scale")) * 1e-3;
  scale.offset_m =
      settings.range_offset_mm.value_or(read_double(gige::reg::kScan3dOffset, "reading the offset")) * 1e-3;
  scale.invalid = read_double(gige::reg::kScan3dInvalidValue, "reading the value of no return");
  scale.amplitude_scale = settings.amplitude_scale;
}

void GigeVirtualSource::Impl::fill_range(Sample& s, std::size_t picture) const {
  const std::size_t pixels = std::size_t{region.width_px} * region.height_px;
  const auto counts = std::as_bytes(std::span(frame.data));
  const std::span<float> planes(reinterpret_cast<float*>(s.memory().data()), 2 * pixels);
  counts_to_range(scale, counts.first(picture), !frame.complete, planes.first(pixels));
  counts_to_amplitude(scale, counts.subspan(picture, picture), 2, planes.subspan(pixels));
  s.info = RangeImageInfo{region.width_px, region.height_px};
  s.size_bytes = 2 * pixels * sizeof(float);
}

void GigeVirtualSource::Impl::set_up_line() {
  if (settings.trigger_line != "Line1")
    throw refused(config, "trigger_line",
                  "expected Line1, which the emulated camera has, got " + settings.trigger_line);
  if (camera.line_period.ns() == 0)
    throw refused(config, "trigger",
                  "expected something on the emulated camera's line: give the emulator a `trigger_line`");
  require(client->write(gige::reg::kTriggerSource, gige::reg::kTriggerSourceLine1), "trigger_line",
          "setting the trigger's source");
  require(client->write(gige::reg::kTriggerActivation,
                        settings.falling_edge ? gige::reg::kFallingEdge : gige::reg::kRisingEdge),
          "trigger_edge", "setting the trigger's edge");
  require(client->write_double(gige::reg::kTriggerDelay, settings.trigger_delay_us), "trigger_delay_us",
          "setting the trigger's delay");
}

void GigeVirtualSource::Impl::set_up_action() {
  if (!camera.ptp.present)
    throw refused(
        config, "trigger",
        "expected a camera with a PTP clock, whose time action commands have: give the emulator `ptp`");
  if (camera.ptp.settle + settings.action->lead >= kDeviceAhead)
    throw refused(
        config, "trigger",
        fmt::format("expected an emulator whose PTP clock settles within the {:g} s that it ran before the "
                    "bench, got {:g} s",
                    kDeviceAhead.seconds(), camera.ptp.settle.seconds()));
  const gige::RegisterWrite steps[] = {
      {gige::reg::kTriggerSource, gige::reg::kTriggerSourceAction0},
      {gige::reg::kGvcpConfiguration, gige::reg::kExtendedStatus | gige::reg::kIeee1588},
      {gige::reg::kActionDeviceKey, settings.action->device_key},
      {gige::reg::kActionGroupKey, settings.action->group_key},
      {gige::reg::kActionGroupMask, settings.action->group_mask}};
  for (const auto& s : steps)
    require(client->write(s.address, s.value), "action", "setting the action trigger");
}

void GigeVirtualSource::Impl::set_up_chunks() {
  require(client->write(gige::reg::kChunkModeActive, 1), "chunks", "switching chunk data on");
  for (const auto id : {gige::reg::kChunkTimestamp, gige::reg::kChunkExposureTime, gige::reg::kChunkGain}) {
    require(client->write(gige::reg::kChunkSelector, id), "chunks", "choosing a chunk");
    require(client->write(gige::reg::kChunkEnable, 1), "chunks", "switching a chunk on");
  }
}

Status GigeVirtualSource::do_arm(const ArmContext& context) {
  Impl& i = *impl_;
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, i.config.name, "this stand-in runs in virtual time only");
  gige::GigeCameraConfig camera = camera_config(i.camera, i.sensor);
  camera.align_to_clock = false;  // aligned by hand, to the bench's grid
  // Pulses are on the bench's clock, which the camera's is ahead of.
  camera.line_phase = camera.line_phase + kDeviceAhead;
  auto model = gige::GigeDeviceModel::create(camera);
  if (!model) return fail(model.error().code, i.config.name, model.error().text());
  i.model = std::make_unique<gige::GigeDeviceModel>(std::move(*model));
  i.link = std::make_unique<gige::GigeMemoryLink>(*i.model,
                                                  picture_of(i.parts, i.camera, BenchTime(0) - kDeviceAhead));
  gige::GigeClientOptions options;
  options.heartbeat_timeout_ms = 0xFFFFFFFF;  // no one else is on this wire
  options.packet_size = i.settings.packet_size.value_or(camera.max_packet_size);
  i.client = std::make_unique<gige::GigeClient>(*i.link, options);
  i.device_now = DeviceTime(0);
  i.link->advance(i.device_now);
  if (auto done = catch_config([&] { return i.set_up(), true; }); !done)
    return tl::unexpected<Error>(done.error());
  open_stream(i.settings.buffers, description_.max_bytes, true);
  i.sequence = FrameSequence(i.config.period);
  health_.connected = true;
  return {};
}

Status GigeVirtualSource::do_start(BenchTime t0) {
  Impl& i = *impl_;
  const bool begins_there = i.settings.triggered_by_bench();
  i.first_exposure = i.next_exposure = begins_there ? t0 : t0 - i.exposure / 2;
  i.next_index = 0;
  if (!begins_there) i.advance(device_time(i.next_exposure));
  // Before its first exposure a camera has time to hear of it.
  if (i.settings.action) i.advance(device_time(t0 - i.settings.action->lead));
  if (auto status = i.client->start(); !status)
    return fail(status.error().code, i.config.name, status.error().text());
  i.running = true;
  return {};
}

Status GigeVirtualSource::do_stop() {
  Impl& i = *impl_;
  i.running = false;
  close_stream();
  i.client.reset();
  i.link.reset();
  i.model.reset();
  health_.connected = false;
  return {};
}

void GigeVirtualSource::complete_until(BenchTime now) {
  Impl& i = *impl_;
  if (!i.running) return;
  if (i.settings.hardware_trigger) return i.complete_camera(now);
  if (i.settings.action) return i.complete_actions(now);
  while (i.next_exposure + i.exposure / 2 <= now) {
    i.advance(device_time(i.next_exposure));
    if (i.settings.software_trigger && !i.client->trigger()) count_lost(1);
    // The exposure opens here, so that the picture is asked for now; and its packets are due before the next
    // one.
    i.advance(device_time(i.next_exposure) + nanoseconds(1));
    i.next_exposure = i.first_exposure + i.config.period * ++i.next_index;
  }
  // Packets of what is released by now, though the camera's clock has not come that far: no later exposure is
  // opened.
  const DeviceTime before_next = device_time(i.next_exposure) - nanoseconds(1);
  i.advance(std::min(device_time(now), before_next));
}

/// Each command is sent its lead before its exposure, on time whatever the loop's period is.
void GigeVirtualSource::Impl::complete_actions(BenchTime now) {
  const AravisSettings::Action& a = *settings.action;
  for (BenchTime t_send = next_exposure - a.lead; t_send <= now; t_send = next_exposure - a.lead) {
    complete_camera(t_send);
    const auto ticks = static_cast<std::uint64_t>(device_time(next_exposure).ns());
    const auto status = client->action({a.device_key, a.group_key, a.group_mask, ticks});
    if (!status || *status != gige::GvStatus::success) self.count_lost(1);
    next_exposure = first_exposure + config.period * ++next_index;
  }
  complete_camera(now);
}

void GigeVirtualSource::Impl::complete_camera(BenchTime now) {
  while (true) {
    const DeviceTime next = model->next_exposure();
    if (next == DeviceTime::never() || bench_time(next) + exposure / 2 > now) break;
    advance(next);
    advance(next + nanoseconds(1));
  }
  const DeviceTime next = model->next_exposure();
  const DeviceTime before_next = next == DeviceTime::never() ? next : next - nanoseconds(1);
  advance(std::min(device_time(now), before_next));
}

void GigeVirtualSource::Impl::advance(DeviceTime t) {
  if (t < device_now) return;
  device_now = t;
  link->advance(t);
  collect();
}

Duration GigeVirtualSource::Impl::ptp_offset() {
  if (!client->write(gige::reg::kPtpLatch, 1)) return {};
  const auto high = client->read(gige::reg::kPtpOffsetHigh), low = client->read(gige::reg::kPtpOffsetLow);
  if (!high || !low) return {};
  return Duration(std::abs(static_cast<std::int64_t>(std::uint64_t{*high} << 32 | *low)));
}

void GigeVirtualSource::Impl::collect() {
  while (client->poll(device_now, frame)) {
    const BenchTime t_start = bench_time(DeviceTime(static_cast<std::int64_t>(frame.leader.timestamp_ticks)));
    Stamp stamp;
    Duration exposed = exposure;
    double gain = gain_db;
    const std::size_t picture = image_bytes(settings.format, region.width_px, region.height_px);
    if (settings.chunks && frame.complete) {
      if (const auto c = gige::find_chunk(frame.data, gige::reg::kChunkExposureTime); c.size() == 8)
        exposed = seconds_from(load_be<double>(c, 0) * 1e-6);
      if (const auto c = gige::find_chunk(frame.data, gige::reg::kChunkGain); c.size() == 8)
        gain = load_be<double>(c, 0);
    }
    stamp.t_capture = t_start + exposed / 2;
    if (settings.ptp) stamp.sigma_capture = ptp_offset();
    const FrameSequence::Step step = sequence.step(frame.block_id, stamp.t_capture);
    self.count_lost(step.lost_before);
    SampleSlot slot = self.take_slot();
    if (!slot) {
      self.hand_over(std::move(slot));
      continue;
    }
    const std::size_t payload = settings.range ? 2 * picture : picture;
    if (settings.chunks ? frame.data.size() < payload : frame.data.size() != payload) {
      health.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      self.count_lost(1);
      continue;
    }
    stamp.sequence = step.sequence;
    stamp.t_release = stamp.t_arrival = stamp.t_capture + config.latency;
    stamp.validity = frame.complete ? kValid : kIncomplete;
    Sample& s = *slot;
    s.stamp = stamp;
    if (!frame.complete) health.incomplete.fetch_add(1, std::memory_order_relaxed);
    if (settings.range) {
      fill_range(s, picture);
    } else {
      s.info = ImageInfo{.format = settings.format,
                         .width_px = region.width_px,
                         .height_px = region.height_px,
                         .offset_x_px = region.x_px,
                         .offset_y_px = region.y_px,
                         .exposure = exposed,
                         .gain_db = gain};
      s.size_bytes = picture;
      std::memcpy(s.memory().data(), frame.data.data(), s.size_bytes);
    }
    self.hand_over(std::move(slot));
  }
}

}  // namespace rigor
