#include "drivers/sick/sick_source.h"

#include <algorithm>
#include <thread>

#include "drivers/network/tcp_stream.h"
#include "drivers/sick/scan_receiver.h"
#include "drivers/sick/sick_settings.h"
#include "rt-core/clock_map.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::sick {
namespace {

using network::TcpStream;

constexpr std::size_t kPiece = 32 * 1024;

}  // namespace

struct SickSource::Impl {
  ChannelSettings settings;
  Deadline deadline;
  network::TcpStream stream;
  FrameParser parser;
  std::optional<ClientDialog> dialog;
  DeviceFacts armed;  ///< what the pool's slots were made for
  ScanData scan;
  CloudMaker clouds;
  MicrosecondClock device_clock;
  std::optional<ClockMap> clock;
  ScanSequence sequence;
  BenchTime last_capture;
  Backoff backoff;
  std::uint64_t bad_frames = 0;
  std::thread thread;

  Status connect();
  Status converse();
  [[nodiscard]] Status silent(TcpStream::Outcome outcome) const;
};

SickSource::SickSource() : impl_(std::make_unique<Impl>()) {}
SickSource::~SickSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status SickSource::do_configure(const ChannelConfig& config) {
  impl_->settings = read_channel_settings(config, true);
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = impl_->settings.frame_id;
  return {};
}

Status SickSource::Impl::silent(TcpStream::Outcome outcome) const {
  const std::string where = settings.wish.where;
  if (outcome == TcpStream::Outcome::cut) return fail(ErrorCode::unavailable, where, "stopped");
  if (outcome == TcpStream::Outcome::closed)
    return fail(
        ErrorCode::protocol, where,
        "expected the device to go on answering, it closed the connection; check that no other client holds "
        "it and that its port speaks CoLa-B (binary)");
  return fail(
      ErrorCode::timeout, where,
      "expected an answer from the device within `timeout_ms`, got none; check that its port speaks CoLa-B "
      "(binary), in SOPAS under the interface's dialect");
}

/// Until the dialog is done or something goes wrong.
Status SickSource::Impl::converse() {
  while (!dialog->done()) {
    Buffer request;
    dialog->request(request);
    const auto limit = monotonic_now() + settings.timeout;
    if (!stream.send(request, limit)) return silent(TcpStream::Outcome::closed);
    for (bool answered = false; !answered;) {
      if (const Bytes body = parser.next(); body.data()) {
        const auto t = parse_telegram(body);
        auto taken = t ? dialog->answer(*t) : Result<bool>(false);
        if (!taken) return tl::unexpected<Error>(taken.error());
        answered = *taken;
        continue;
      }
      std::size_t size = 0;
      const auto outcome = stream.receive(parser.room(kPiece), limit, size);
      if (outcome != TcpStream::Outcome::data) return silent(outcome);
      parser.added(size);
    }
  }
  return {};
}

Status SickSource::Impl::connect() {
  parser.reset();
  dialog.emplace(settings.wish);
  if (auto s = stream.connect(settings.address, settings.port, monotonic_now() + settings.timeout,
                              deadline.cut_fd());
      !s)
    return fail(
        s.error().code, s.error().where,
        s.error().message +
            "; check that the scanner is on and that `address` and `port` (2112 or 2111) are its own, "
            "or start an emulated one with `rigor emulate`");
  if (auto s = converse(); !s) {
    stream.close();
    return s;
  }
  return {};
}

std::vector<std::string> SickSource::warnings() const {
  std::vector<std::string> out;
  const auto& f = impl_->armed;
  const auto& w = impl_->settings.wish;
  if (!f.scan_config_known && (w.scan_frequency_hz || w.resolution_deg))
    out.push_back(config().name +
                  ": the device does not tell its scan frequency and resolution; they are what it is set to");
  return out;
}

Status SickSource::do_arm(const ArmContext&) {
  Impl& i = *impl_;
  if (auto s = i.deadline.open(); !s) return s;
  i.deadline.reset();
  if (auto s = i.connect(); !s) return fail(s.error().code, config().name, s.error().text());
  i.armed = i.dialog->facts();
  description_.max_bytes = i.dialog->max_points() * sizeof(LidarPoint);
  open_stream(i.settings.buffers, description_.max_bytes, false);
  ClockMapOptions o;
  o.resolution = microseconds(1);
  o.min_delay = i.settings.transport_delay;
  o.min_delay_sigma = i.settings.transport_sigma;
  i.clock.emplace(o);
  i.device_clock.reset();
  i.sequence.reset();
  i.last_capture = {};
  i.backoff.reset();
  health_.connected.store(true, std::memory_order_release);
  i.thread = std::thread([this] { run(); });
  return {};
}

void SickSource::run() {
  Impl& i = *impl_;
  const auto take_scan = [&](Bytes values, BenchTime arrival) {
    if (decode_scan(values, i.scan) != ScanError::none) {
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      return;  // its number is missing: the next scan counts it as lost
    }
    const ScanInstants t = scan_instants(i.scan, i.device_clock, i.settings.zero_index_deg);
    (void)i.clock->add_arrival(t.transmission, arrival);
    const Mapped m = i.clock->map(t.first_beam);
    Stamp stamp;
    stamp.t_capture = m.known ? m.t : arrival - config().latency;
    stamp.validity = (m.known ? kValid : kClockUnsure) | (in_error(i.scan) ? kCorrupt : kValid);
    // A map that is being learned may step back by its own uncertainty; samples do not.
    if (i.last_capture.ns() != 0)
      stamp.t_capture = std::max(stamp.t_capture, i.last_capture + nanoseconds(1));
    i.last_capture = stamp.t_capture;
    if (!origin().covers(stamp.t_capture, config().period)) return;  // it taught the clock
    const auto interval = i.settings.wish.output_interval;
    const auto step = i.sequence.step(i.scan.scan_counter, interval, stamp.t_capture, t.period * interval);
    count_lost(step.lost);
    stamp.sequence = step.sequence;
    stamp.t_release = stamp.t_capture + config().latency;
    stamp.t_arrival = arrival;
    stamp.sigma_capture = m.sigma;
    SampleSlot slot = take_slot();
    if (slot) {
      Sample& s = *slot;
      std::uint32_t count = 0;
      if (!i.clouds.fill(i.scan, t.beam_step, s.memory(), count)) {
        // No ranges, or more beams than the device had at arm.
        health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
        count_lost(1);
        return;
      }
      s.stamp = stamp;
      s.info = PointCloudInfo{count};
      s.size_bytes = count * sizeof(LidarPoint);
    }
    hand_over(std::move(slot));
  };
  /// False: the connection is to be given up.
  const auto stream_once = [&](bool& cut) {
    for (Bytes body = i.parser.next(); body.data(); body = i.parser.next()) {
      const auto t = parse_telegram(body);
      if (t && t->name == "LMDscandata" && t->type == "sSN") take_scan(t->values, bench_now());
    }
    const auto bad = i.parser.bad_checksums() + i.parser.bad_lengths();
    health_.protocol_errors.fetch_add(bad - i.bad_frames, std::memory_order_relaxed);
    i.bad_frames = bad;
    const Duration silence = std::max(i.settings.timeout, config().period * 3);
    std::size_t size = 0;
    const auto outcome = i.stream.receive(i.parser.room(kPiece), monotonic_now() + silence, size);
    cut = outcome == TcpStream::Outcome::cut;
    if (outcome == TcpStream::Outcome::timeout) health_.retries.fetch_add(1, std::memory_order_relaxed);
    if (outcome != TcpStream::Outcome::data) return false;
    i.parser.added(size);
    return true;
  };

  bool cut = false, first = true;
  while (!cut) {
    if (!i.stream.is_open()) {
      if (!i.deadline.wait_until(i.backoff.next())) break;
      if (!i.connect()) {
        i.backoff.failed(monotonic_now());
        continue;
      }
    }
    i.dialog->begin_stream();
    if (!i.converse()) {
      i.stream.close();
      i.backoff.failed(monotonic_now());
      health_.connected.store(false, std::memory_order_release);
      first = false;
      continue;
    }
    if (!first) {
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
      i.sequence.resume();
      i.device_clock.reset();
      i.clock->reset();
    }
    first = false;
    i.backoff.reset();
    health_.connected.store(true, std::memory_order_release);
    while (stream_once(cut)) {
    }
    if (cut) break;
    i.stream.close();
    health_.connected.store(false, std::memory_order_release);
  }
}

Status SickSource::do_stop() {
  Impl& i = *impl_;
  i.deadline.cut();
  if (i.thread.joinable()) i.thread.join();
  if (i.stream.is_open()) {
    Buffer bye;
    ClientDialog::end_stream(bye);
    (void)i.stream.send(bye, monotonic_now());
  }
  i.stream.close();
  close_stream();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

}  // namespace rigor::sick
