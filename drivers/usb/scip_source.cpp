#include "drivers/usb/scip_source.h"

#include <fmt/format.h>

#include <cmath>

namespace rigor::usb {
namespace {

std::int64_t now_ns() { return monotonic_now().ns(); }

}  // namespace

ScipSource::~ScipSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status ScipSource::do_configure(const ChannelConfig& config) {
  settings_ = read_scip_settings(config);
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = config.name;
  description_.max_bytes = most_points(settings_.client.scan) * sizeof(LidarPoint);
  return {};
}

Status check_rate(const ChannelConfig& config, const ScannerParameters& p, std::uint32_t skip) {
  const double hz = p.rpm / 60.0 / (skip + 1);
  if (config.period.ns() > 0 && std::abs(hz * config.period.seconds() - 1) > 0.02)
    return fail(ErrorCode::bad_input, config.params.place(),
                fmt::format("{}: rate_hz: expected {:g}, {} turns a second and `skip: {}`, got {:g}",
                            config.name, hz, p.rpm / 60.0, skip, 1 / config.period.seconds()));
  return {};
}

Status ScipSource::check_scanner() const {
  const ScannerParameters& p = client_->parameters();
  if (!settings_.serial.empty() && client_->identity().serial != settings_.serial)
    return tl::unexpected<Error>(config()
                                     .params
                                     .error("serial", "expected the scanner " + settings_.serial + " at " +
                                                          link_->name() + ", found " +
                                                          client_->identity().serial)
                                     .error());
  if (const auto refusal = client_->check())
    return tl::unexpected<Error>(config().params.error(refusal->key, refusal->message).error());
  return check_rate(config(), p, settings_.client.scan.skip);
}

Status ScipSource::do_arm(const ArmContext&) {
  link_ = links_(settings_.link);
  if (!link_)
    return fail(ErrorCode::unavailable, config().name, "this build has no libusb; use `transport: tty`");
  if (auto s = link_->open(); !s) return fail(s.error().code, config().name, s.error().text());
  client_ = std::make_unique<ScipClient>(settings_.client);
  buffer_.resize(16 * 1024);
  broken_seen_ = retries_seen_ = 0;
  keeper_.forget_clock();
  client_->begin(now_ns());
  while (client_->phase() != ScipClient::Phase::ready)
    if (!exchange(MonotonicTime(client_->due_ns()))) {
      const std::string name = link_->name();
      link_.reset();
      return fail(ErrorCode::protocol, config().name, name + ": " + why_);
    }
  if (auto s = check_scanner(); !s) {
    link_.reset();
    return s;
  }
  const ScannerParameters& p = client_->parameters();
  const ScanRequest request = client_->request();
  description_.max_bytes = request.count() * sizeof(LidarPoint);
  open_stream(settings_.slots, description_.max_bytes, false);
  warnings_.clear();
  const double scan_ms = (p.last_step - p.first_step + 1) * p.step_s() * 1e3;
  if (config().latency.seconds() * 1e3 < scan_ms)
    warnings_.push_back(
        fmt::format("{}: a scan is sent when its last step is measured, {:.1f} ms after the first: every "
                    "sample will be late with latency_ms: {:g}",
                    config().name, scan_ms, config().latency.seconds() * 1e3));
  if (keeper_.clock().state().pairs == 0)
    warnings_.push_back(config().name +
                        ": the scanner did not tell its clock (TM); scans are stamped by their arrival");
  health_.connected.store(true, std::memory_order_release);
  keeper_.begin(config().latency, client_->request(), client_->parameters());
  backoff_.reset();
  link_->uncut();
  cut_ = false;
  thread_ = std::thread([this] { run(); });
  return {};
}

Status ScipSource::do_stop() {
  link_->cut();
  if (thread_.joinable()) thread_.join();
  // The laser goes off; whether the scanner says so is not waited for long.
  link_->uncut();
  if (link_->is_open()) {
    const std::int64_t limit = now_ns() + milliseconds(200).ns();
    client_->stop(now_ns());
    while (client_->phase() == ScipClient::Phase::stopping && now_ns() < limit)
      if (!exchange(MonotonicTime(limit))) break;
  }
  link_counters_ = link_->counters();
  link_.reset();
  close_stream();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

bool ScipSource::exchange(MonotonicTime until) {
  if (!client_->output().empty()) {
    const std::int64_t before = now_ns();
    const bool sent = link_->send(client_->output());
    client_->sent(before);
    if (!sent) {
      why_ = "it took no more bytes";
      return false;
    }
  }
  const ByteLink::Received r = link_->receive(buffer_, until);
  if (r.state == ByteLink::State::cut) {
    cut_ = true;
    why_.clear();
    return false;
  }
  if (r.state == ByteLink::State::gone) {
    why_ = "it went away";
    return false;
  }
  if (r.state == ByteLink::State::data)
    client_->receive(std::string_view(buffer_.data(), r.bytes), r.arrival.ns());
  client_->tick(now_ns());
  ScipClient::Reading reading;
  while (client_->next_reading(reading)) keeper_.reading(reading);
  const auto& c = client_->counters();
  const std::uint64_t broken = c.broken + client_->dropped_replies();
  health_.protocol_errors.fetch_add(broken - std::exchange(broken_seen_, broken), std::memory_order_relaxed);
  health_.retries.fetch_add(c.retries - std::exchange(retries_seen_, c.retries), std::memory_order_relaxed);
  if (client_->phase() == ScipClient::Phase::failed) {
    why_ = client_->failure();
    return false;
  }
  return true;
}

void ScipSource::take_scans() {
  std::int64_t arrival_ns = 0;
  while (client_->next_scan(scan_, arrival_ns)) {
    backoff_.reset();
    const auto kept = keeper_.place(scan_, BenchTime(arrival_ns), origin());
    if (!kept.in_run) continue;
    if (!kept.in_order) {
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    if (kept.lost > 0) count_lost(kept.lost);
    SampleSlot slot = take_slot();
    if (slot) keeper_.fill(scan_, *slot);
    hand_over(std::move(slot));
  }
}

void ScipSource::lose() {
  link_->close();
  health_.connected.store(false, std::memory_order_release);
}

void ScipSource::run() {
  client_->start(now_ns());
  while (true) {
    if (!link_->is_open()) {
      if (!backoff_.due(monotonic_now())) {
        if (!link_->wait(backoff_.next())) break;
        // Woken before its time: the system says that a device came.
        if (!backoff_.due(monotonic_now())) backoff_.reset();
      }
      backoff_.failed(monotonic_now());
      if (!link_->open()) continue;
      keeper_.forget_clock();
      client_->begin(now_ns());
    }
    if (!exchange(MonotonicTime(client_->due_ns()))) {
      if (cut_) break;
      lose();
      continue;
    }
    if (client_->phase() == ScipClient::Phase::ready) {
      if (!check_scanner()) {  // another one was plugged in, and it cannot do this
        health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
        lose();
        continue;
      }
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
      health_.connected.store(true, std::memory_order_release);
      client_->start(now_ns());
    }
    take_scans();
  }
  if (!link_->is_open()) count_lost(keeper_.missing_by(BenchTime(now_ns())));
}

}  // namespace rigor::usb
