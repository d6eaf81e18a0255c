#include "drivers/gnss/gnss_source.h"

#include <pthread.h>

#include <array>
#include <utility>

namespace rigor::gnss {

GnssSource::~GnssSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

LineCounters GnssSource::line_counters() const {
  const std::lock_guard lock(counters_mutex_);
  return counters_;
}

Status GnssSource::do_configure(const ChannelConfig& config) {
  settings_ = read_channel_settings(config, true);
  describe_channel(settings_, config.kind);
  return {};
}

Status GnssSource::do_arm(const ArmContext& context) {
  warnings_.clear();
  seen_ = {};
  counters_ = {};
  was_connected_ = false;
  if (!settings_.file.empty()) return arm_file(context.virtual_time);
  open_samples(settings_.buffers, Feed::live);
  auto joined = Receiver::join(settings_.receiver, this, config().name);
  if (!joined) return tl::unexpected<Error>(joined.error());
  receiver_ = std::move(*joined);
  return {};
}

void GnssSource::on_connection(bool connected) {
  health_.connected.store(connected, std::memory_order_release);
  if (connected && std::exchange(was_connected_, true))
    health_.reconnects.fetch_add(1, std::memory_order_relaxed);
}

void GnssSource::on_counters(const LineCounters& c) {
  health_.protocol_errors.fetch_add(c.bad - std::exchange(seen_.bad, c.bad), std::memory_order_relaxed);
  health_.retries.fetch_add(c.silences - std::exchange(seen_.silences, c.silences),
                            std::memory_order_relaxed);
  const std::lock_guard lock(counters_mutex_);
  counters_ = c;
}

Status GnssSource::arm_file(bool virtual_time) {
  file_ = std::ifstream(settings_.file, std::ios::binary);
  if (!file_)
    return fail(ErrorCode::not_found, settings_.file.string(),
                "expected a recording of a receiver, found no such file");
  if (auto s = deadline_.open(); !s) return s;
  deadline_.reset();
  open_samples(settings_.buffers, virtual_time ? Feed::virtual_time : Feed::recording);
  ReceiverStream::Options o;
  o.time = TimeSource::fixed;
  o.period = settings_.receiver.period;
  o.epoch.range_error_m = settings_.receiver.range_error_m;
  auto h = handler();
  stream_ = std::make_unique<ReceiverStream>(o, std::move(h));
  // The first solution is that of the run's start.
  first_.reset();
  ReceiverStream probe(o, {.solution =
                               [this](const Solution& s, const ReceiverStream::Place&) {
                                 if (!first_) first_ = s.t_device;
                               },
                           .sky = {},
                           .pulse = {},
                           .raw = {},
                           .message = {}});
  std::array<char, 4096> buffer;
  while (!first_ && file_) {
    file_.read(buffer.data(), buffer.size());
    const auto n = static_cast<std::size_t>(file_.gcount());
    probe.take({reinterpret_cast<const std::uint8_t*>(buffer.data()), n}, BenchTime(0));
    if (!file_) probe.finish();
  }
  if (!first_)
    return fail(ErrorCode::bad_input, settings_.file.string(),
                "expected UBX (NAV-PVT) or NMEA (RMC, GGA) of a receiver, found no solution in " +
                    std::to_string(probe.messages().counters().bytes) + " bytes");
  file_.clear();
  file_.seekg(0);
  ended_ = false;
  health_.connected = true;
  if (!virtual_time) thread_ = std::thread([this] { run_file(); });
  return {};
}

Status GnssSource::do_start(BenchTime t0) {
  t0_ = t0;
  if (stream_) stream_->clock().set_fixed_offset(Duration(t0.ns() - first_->ns()));
  return {};
}

void GnssSource::read_file(BenchTime now) {
  std::array<char, 512> buffer;
  while (!ended_ && !handed_beyond(now)) {
    file_.read(buffer.data(), buffer.size());
    stream_->take(
        {reinterpret_cast<const std::uint8_t*>(buffer.data()), static_cast<std::size_t>(file_.gcount())},
        t0_);
    if (file_) continue;
    stream_->finish();
    ended_ = true;
    health_.connected.store(false, std::memory_order_release);
  }
  const auto& m = stream_->messages().counters();
  const std::uint64_t bad = m.bad_checksums + m.bad_lengths + stream_->epochs().counters().malformed;
  health_.protocol_errors.fetch_add(bad - std::exchange(seen_.bad, bad), std::memory_order_relaxed);
}

void GnssSource::run_file() {
  pthread_setname_np(pthread_self(), "gnss-file");
  const auto t0 = origin().wait(deadline_);
  if (!t0) return;
  while (!ended_) {
    const BenchTime now = bench_now();
    read_file(now);
    if (!deadline_.wait_until(MonotonicTime((now + milliseconds(5)).ns()))) return;
  }
}

void GnssSource::complete_until(BenchTime now) {
  if (stream_ && !ended_) read_file(now);
}

Status GnssSource::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  if (receiver_) receiver_->leave(this);
  receiver_.reset();
  stream_.reset();
  file_.close();
  close_stream();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

}  // namespace rigor::gnss
