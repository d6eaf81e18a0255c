#include "drivers/gnss/gnss_virtual_source.h"

#include <cstdio>
#include <utility>

#include "rt-core/epoch.h"

namespace rigor::gnss {

GnssVirtualSource::~GnssVirtualSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status GnssVirtualSource::do_configure(const ChannelConfig& config) {
  settings_ = read_channel_settings(config, false);
  emulator_ = read_emulator_settings(emulator_params_);
  if (auto s = MeasuredFix::check(parts_, emulator_params_.place()); !s) return s;
  describe_channel(settings_, config.kind);
  return {};
}

/// The same requests and answers as over a line.
Status GnssVirtualSource::converse() {
  if (!settings_.receiver.configure) return {};
  ConfigDialog dialog(*settings_.receiver.configure, settings_.receiver.period, config().name);
  MessageStream answers;
  while (!dialog.done()) {
    device_->receive(dialog.request(), BenchTime(0));
    answers.add(device_->output());
    device_->output().clear();
    bool answered = false;
    while (const auto m = answers.next()) {
      auto taken = dialog.answer(*m);
      if (!taken) return tl::unexpected<Error>(taken.error());
      answered = answered || *taken;
    }
    if (!answered) return fail(ErrorCode::internal, config().name, "the receiver's model does not answer");
  }
  return {};
}

Status GnssVirtualSource::do_arm(const ArmContext& context) {
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time only");
  if (config().latency < emulator_.processing) {
    char text[32];
    std::snprintf(text, sizeof text, "%.4g", emulator_.processing.seconds() * 1e3);
    return tl::unexpected<Error>(
        config()
            .params
            .error("latency_ms",
                   std::string("expected at least ") + text +
                       ", the emulated receiver's `processing_ms`: no solution can be there earlier")
            .error());
  }
  device_.emplace(emulator_);
  measured_.emplace(parts_, config().name, config().seed, emulator_.velocity_sigma_mps);
  if (auto s = converse(); !s) return s;
  // The exact rate where the device has its own; whole milliseconds where it was set.
  period_ = device_->period() == Duration(emulator_.period) ? emulator_.period : Period(device_->period());
  if (config().kind != SampleKind::point_cloud && config().period.ns() > 0 &&
      Duration(config().period) != Duration(period_))
    return tl::unexpected<Error>(
        config()
            .params
            .error("rate_hz",
                   "expected that of the emulated receiver, or `configure: {}` to set it; got another")
            .error());
  open_samples(settings_.buffers, Feed::virtual_time);
  ReceiverStream::Options o;
  o.time = TimeSource::fixed;
  o.period = period_;
  o.epoch.range_error_m = settings_.receiver.range_error_m;
  stream_ = std::make_unique<ReceiverStream>(o, handler());
  bad_seen_ = 0;
  health_.connected = true;
  return {};
}

Status GnssVirtualSource::do_start(BenchTime t0) {
  t0_ = t0;
  next_ = 0;
  running_ = true;
  return {};
}

Status GnssVirtualSource::do_stop() {
  running_ = false;
  close_stream();
  stream_.reset();
  device_.reset();
  health_.connected = false;
  return {};
}

void GnssVirtualSource::complete_until(BenchTime now) {
  while (running_) {
    const BenchTime t = t0_ + period_ * next_;
    if (t + emulator_.processing > now) return;
    const auto k = static_cast<std::uint64_t>(next_++);
    const RealtimeTime utc = kVirtualEpoch.to_utc(t);
    device_->speak(measured_->at(k, t, t0_), utc, k, t);
    if (k == 0) {
      // What the receiver calls this instant is not known before it says it: a first look at its bytes.
      EpochAssembler first({}, {.solution =
                                    [&](const Solution& s, BenchTime) {
                                      stream_->clock().set_fixed_offset(Duration(t.ns() - s.t_device.ns()));
                                    },
                                .sky = {},
                                .pulse = {},
                                .raw = {}});
      MessageStream look;
      look.add(device_->output());
      while (const auto m = look.next()) first.take(*m, t);
      first.flush();
    }
    stream_->take(device_->output(), t);
    stream_->idle();
    device_->output().clear();
    const auto& m = stream_->messages().counters();
    const std::uint64_t bad = m.bad_checksums + m.bad_lengths + stream_->epochs().counters().malformed;
    health_.protocol_errors.fetch_add(bad - std::exchange(bad_seen_, bad), std::memory_order_relaxed);
  }
}

}  // namespace rigor::gnss
