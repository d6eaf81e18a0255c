#include "drivers/usb/scip_virtual_source.h"

#include <fmt/format.h>

#include <cmath>
#include <utility>

#include "drivers/usb/scip_source.h"

namespace rigor::usb {
namespace {

// The scanner ran before the bench did; whole turns of every model, so that its grid is the bench's.
constexpr Duration kDeviceAhead = seconds(12);
// The pauses between questions before the run: not of the clock's own grid, so that they see its ticks at
// different places.
constexpr Duration kPause = nanoseconds(1'618'034);

}  // namespace

ScipVirtualSource::ScipVirtualSource(DeviceParts parts, ConfigNode emulator_params)
    : parts_(std::move(parts)), emulator_params_(std::move(emulator_params)) {}

ScipVirtualSource::~ScipVirtualSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status ScipVirtualSource::do_configure(const ChannelConfig& config) {
  settings_ = read_scip_settings(config);
  scanner_ = read_emulated_scanner(emulator_params_);
  if (!parts_.samples || parts_.samples->geometry().kind != SampleKind::point_cloud)
    return fail(ErrorCode::bad_input, emulator_params_.place(),
                config.name +
                    ": expected something that scans: give the emulator that stands for this scanner a "
                    "LiDAR's sensor model as `sensor`");
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = config.name;
  description_.max_bytes = most_points(settings_.client.scan) * sizeof(LidarPoint);
  return {};
}

void ScipVirtualSource::open_session(BenchTime from) {
  const ScannerParameters& p = scanner_.model.parameters;
  ScipDevice::Options options = scanner_.options;
  power_on_ = from - kDeviceAhead;
  options.phase = seconds_from(p.turn_s()) - seconds_from(p.step_s() * p.first_step);
  const auto turns = static_cast<std::uint64_t>(std::llround(kDeviceAhead.seconds() / p.turn_s()));
  world_ = std::make_unique<WorldScans>(parts_, scanner_.model, power_on_, turns - 1);
  device_ = std::make_unique<ScipDevice>(
      scanner_.model,
      [this](std::uint64_t scan, DeviceTime t, std::span<std::uint32_t> range,
             std::span<std::uint32_t> intensity) { return world_->measure(scan, t, range, intensity); },
      options);
  client_ = std::make_unique<ScipClient>(settings_.client);
  keeper_.forget_clock();
  broken_seen_ = 0;
  BenchTime now = from - seconds(1);
  client_->begin(now.ns());
  for (int i = 0; i < 200 && client_->phase() != ScipClient::Phase::ready; ++i, now = now + kPause) {
    if (client_->output().empty()) client_->tick(now.ns());
    const std::string bytes = client_->output();
    client_->sent(now.ns());
    const DeviceTime t((now - power_on_).ns());
    device_->receive(bytes, t);
    client_->receive(std::exchange(device_->output(), {}), now.ns());
  }
  ScipClient::Reading reading;
  while (client_->next_reading(reading)) keeper_.reading(reading);
}

Status ScipVirtualSource::do_arm(const ArmContext& context) {
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time only");
  open_session(BenchTime(0));
  if (client_->phase() != ScipClient::Phase::ready)
    return fail(ErrorCode::internal, config().name, "the emulated scanner: " + client_->failure());
  if (!settings_.serial.empty() && client_->identity().serial != settings_.serial)
    return tl::unexpected<Error>(config()
                                     .params
                                     .error("serial", "expected the emulated scanner's serial, " +
                                                          client_->identity().serial + ", got " +
                                                          settings_.serial)
                                     .error());
  if (const auto refusal = client_->check())
    return tl::unexpected<Error>(config().params.error(refusal->key, refusal->message).error());
  const ScannerParameters& p = client_->parameters();
  if (settings_.client.scan.intensity && !scanner_.model.intensity)
    return tl::unexpected<Error>(
        config().params.error("intensity", "expected false: a " + scanner_.model.name + " has none").error());
  if (auto s = check_rate(config(), p, settings_.client.scan.skip); !s) return s;
  // What the stamp may be off by its milliseconds comes on top.
  const double scan_ms = (p.last_step - p.first_step + 1) * p.step_s() * 1e3 + 2;
  if (config().latency.seconds() * 1e3 < scan_ms)
    return fail(
        ErrorCode::bad_input, config().params.place(),
        fmt::format(
            "{}: latency_ms: expected at least {:.1f}: a scan is sent when its last step is measured; "
            "got {:g}",
            config().name, scan_ms, config().latency.seconds() * 1e3));
  description_.max_bytes = client_->request().count() * sizeof(LidarPoint);
  open_stream(settings_.slots, description_.max_bytes, true);
  health_.connected.store(true, std::memory_order_release);
  return {};
}

Status ScipVirtualSource::do_start(BenchTime t0) {
  open_session(t0);
  keeper_.begin(config().latency, client_->request(), client_->parameters());
  // Asked for just before the turn that brings the first step to its place at t0.
  const BenchTime begin =
      t0 - seconds_from(scanner_.model.parameters.step_s() * scanner_.model.parameters.first_step);
  next_begin_ = t0;
  client_->start((begin - microseconds(1)).ns());
  exchange(begin - microseconds(1));
  return {};
}

Status ScipVirtualSource::do_stop() {
  close_stream();
  client_.reset();
  device_.reset();
  world_.reset();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

void ScipVirtualSource::exchange(BenchTime now) {
  const DeviceTime t((now - power_on_).ns());
  device_->advance(t);
  for (int i = 0; i < 16; ++i) {
    if (!client_->output().empty()) {
      const std::string bytes = client_->output();
      client_->sent(now.ns());
      device_->receive(bytes, t);
    }
    if (device_->output().empty()) break;
    client_->receive(std::exchange(device_->output(), {}), now.ns());
  }
  ScipClient::Reading reading;
  while (client_->next_reading(reading)) keeper_.reading(reading);
}

void ScipVirtualSource::complete_until(BenchTime now) {
  if (!client_ || state() != ChannelState::running) return;
  for (const Duration period = keeper_.period(); next_begin_ <= now; next_begin_ = next_begin_ + period)
    world_->remember_motion(DeviceTime((next_begin_ - power_on_).ns()));
  // Every scan and every question about the clock at its own instant, however far apart the cycles are.
  while (true) {
    const BenchTime scan = device_->next_event() == DeviceTime::never()
                               ? BenchTime::never()
                               : power_on_ + Duration(device_->next_event().ns());
    const BenchTime next = std::min(scan, BenchTime(client_->due_ns()));
    if (next > now) break;
    client_->tick(next.ns());
    exchange(next);
    take_scans();
    if (client_->phase() == ScipClient::Phase::failed) break;
  }
}

void ScipVirtualSource::take_scans() {
  std::int64_t arrival_ns = 0;
  while (client_->next_scan(scan_, arrival_ns)) {
    const auto kept = keeper_.place(scan_, BenchTime(arrival_ns), origin());
    if (!kept.in_run) continue;
    if (kept.lost > 0) count_lost(kept.lost);
    SampleSlot slot = take_slot();
    if (slot) {
      keeper_.fill(scan_, *slot);
      slot->stamp.t_arrival = slot->stamp.t_release;
    }
    hand_over(std::move(slot));
  }
  const std::uint64_t broken = client_->counters().broken;
  health_.protocol_errors.fetch_add(broken - std::exchange(broken_seen_, broken), std::memory_order_relaxed);
}

}  // namespace rigor::usb
