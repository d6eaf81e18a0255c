#include "drivers/sick/sick_virtual_source.h"

#include <algorithm>
#include <cstdio>
#include <optional>

#include "drivers/sick/point_capture.h"
#include "drivers/sick/scan_receiver.h"
#include "drivers/sick/sick_settings.h"

namespace rigor::sick {
namespace {

// The scanner was switched on before the bench, so that no instant of it is negative.
constexpr Duration kDeviceAhead = seconds(10);
DeviceTime device_time(BenchTime t) { return DeviceTime((t + kDeviceAhead).ns()); }
BenchTime bench_time(DeviceTime t) { return BenchTime(t.ns()) - kDeviceAhead; }

std::string milliseconds_text(Duration d) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", d.seconds() * 1e3);
  return text;
}

}  // namespace

struct SickVirtualSource::Impl {
  Impl(DeviceParts p, ConfigNode n) : parts(std::move(p)), emulator_params(std::move(n)) {}
  DeviceParts parts;
  ConfigNode emulator_params;
  ChannelSettings settings;
  ScannerConfig scanner;
  std::optional<PointCapture> capture;
  std::optional<ScannerDevice> device;
  Session session;
  std::optional<ClientDialog> dialog;
  FrameParser to_device, to_client;
  Buffer wire;
  ScanData scan;
  CloudMaker clouds;
  MicrosecondClock clock;
  ScanSequence sequence;
  BenchTime t0;
  std::uint64_t next_scan = 0;
  bool running = false;

  [[nodiscard]] DeviceTime zero(std::uint64_t k) const {
    // Its first beam of all falls on the bench's grid.
    const DeviceTime first = device_time(t0 + device->period() * static_cast<std::int64_t>(k));
    return first - (device->first_beam(first) - first);
  }
  Status converse(DeviceTime now);
};

SickVirtualSource::SickVirtualSource(DeviceParts parts, ConfigNode emulator_params)
    : impl_(std::make_unique<Impl>(std::move(parts), std::move(emulator_params))) {}
SickVirtualSource::~SickVirtualSource() = default;

Status SickVirtualSource::do_configure(const ChannelConfig& config) {
  Impl& i = *impl_;
  i.settings = read_channel_settings(config, false);
  if (!i.parts.samples || i.parts.samples->geometry().kind != SampleKind::point_cloud)
    return fail(
        ErrorCode::bad_input, config.name,
        "expected something that makes points: give the emulator that stands for this scanner the `sensor` "
        "of a LiDAR");
  i.scanner = read_scanner(i.emulator_params, i.parts.samples->scan());
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = i.settings.frame_id;
  return {};
}

Status SickVirtualSource::Impl::converse(DeviceTime now) {
  while (!dialog->done()) {
    wire.clear();
    dialog->request(wire);
    to_device.add(wire);
    for (Bytes body = to_device.next(); body.data(); body = to_device.next()) {
      wire.clear();
      device->answer(session, body, now, wire);
      to_client.add(wire);
    }
    bool answered = false;
    for (Bytes body = to_client.next(); body.data(); body = to_client.next()) {
      const auto t = parse_telegram(body);
      auto taken = t ? dialog->answer(*t) : Result<bool>(false);
      if (!taken) return tl::unexpected<Error>(taken.error());
      answered = answered || *taken;
    }
    if (!answered)
      return fail(ErrorCode::internal, settings.wish.where, "the scanner's model does not answer");
  }
  return {};
}

Status SickVirtualSource::do_arm(const ArmContext& context) {
  Impl& i = *impl_;
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time only");
  i.device.emplace(i.scanner);
  i.capture.emplace(i.parts);
  i.session = {};
  i.to_device.reset(), i.to_client.reset();
  i.dialog.emplace(i.settings.wish);
  if (auto s = i.converse(DeviceTime(0)); !s) return s;
  i.t0 = BenchTime(0);
  const DeviceTime zero = i.zero(0);
  const double degrees = i.dialog->facts().start_deg_e4 * 1e-4 - i.scanner.zero_index_deg;
  const Duration first = seconds_from(degrees / 360 * i.device->period().seconds());
  const Duration needed = i.device->transmission(zero) - (zero + first);
  if (config().latency < needed)
    return fail(ErrorCode::bad_input, config().params.place(),
                config().name + ": latency_ms: expected at least " + milliseconds_text(needed) +
                    ", from the first beam to the telegram: no scan can be there earlier; got " +
                    milliseconds_text(config().latency));
  description_.max_bytes = i.dialog->max_points() * sizeof(LidarPoint);
  open_stream(i.settings.buffers, description_.max_bytes, true);
  i.clock.reset();
  i.sequence.reset();
  health_.connected = true;
  return {};
}

Status SickVirtualSource::do_start(BenchTime t0) {
  Impl& i = *impl_;
  i.t0 = t0;
  i.next_scan = 0;
  i.dialog->begin_stream();
  if (auto s = i.converse(device_time(t0)); !s) return s;
  i.running = true;
  return {};
}

Status SickVirtualSource::do_stop() {
  Impl& i = *impl_;
  i.running = false;
  close_stream();
  i.dialog.reset();
  i.device.reset();
  health_.connected = false;
  return {};
}

void SickVirtualSource::complete_until(BenchTime now) {
  Impl& i = *impl_;
  while (i.running) {
    const DeviceTime zero = i.zero(i.next_scan);
    const DeviceTime sent = i.device->transmission(zero);
    if (bench_time(sent) > now) return;
    const std::uint64_t k = i.next_scan++;
    if (!i.device->made_scan(k)) continue;
    const auto points = i.capture->points(k, bench_time(i.device->first_beam(zero)), i.t0);
    if (!points) {
      count_lost(1);
      continue;
    }
    i.device->set_scan(*points, k, zero, sent);
    i.wire.clear();
    i.device->append_scan(i.wire);
    i.to_client.add(i.wire);
    for (Bytes body = i.to_client.next(); body.data(); body = i.to_client.next()) {
      const auto t = parse_telegram(body);
      if (!t || decode_scan(t->values, i.scan) != ScanError::none) {
        health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
        continue;
      }
      const ScanInstants instants = scan_instants(i.scan, i.clock, i.settings.zero_index_deg);
      Stamp stamp;
      stamp.t_capture = bench_time(instants.first_beam);
      // The stamps of failed scans are missing from the count of telegrams, and were counted above.
      stamp.sequence =
          i.sequence
              .step(i.scan.scan_counter, i.settings.wish.output_interval, stamp.t_capture, instants.period)
              .sequence;
      stamp.t_release = stamp.t_arrival = stamp.t_capture + config().latency;
      stamp.sigma_capture = nanoseconds(289);  // a microsecond's rounding
      stamp.validity = in_error(i.scan) ? kCorrupt : kValid;
      SampleSlot slot = take_slot();
      if (slot) {
        Sample& s = *slot;
        std::uint32_t count = 0;
        if (!i.clouds.fill(i.scan, instants.beam_step, s.memory(), count)) {
          health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
          count_lost(1);
          continue;
        }
        s.stamp = stamp;
        s.info = PointCloudInfo{count};
        s.size_bytes = count * sizeof(LidarPoint);
      }
      hand_over(std::move(slot));
    }
  }
}

}  // namespace rigor::sick
