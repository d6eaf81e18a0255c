#include "drivers/can/can_emulator.h"

#include <poll.h>

#include <algorithm>
#include <cerrno>

#include "drivers/can/can_interfaces.h"

namespace rigor::can {

CanEmulator::~CanEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

void CanEmulator::attach(DeviceParts parts) { parts_ = std::move(parts); }

std::string CanEmulator::endpoint() const {
  std::string what = settings_.replay.empty() ? "" : "candump log " + settings_.replay.filename().string();
  if (!settings_.messages.empty())
    what += (what.empty() ? "" : ", ") + std::to_string(settings_.messages.size()) + " messages of " +
            settings_.dbc->name;
  return "CAN node " + config().name + " on " + settings_.interface + " (" + what + ")";
}

EmulatedNode::Counters CanEmulator::counters() const {
  const std::lock_guard lock(counters_mutex_);
  return counters_;
}

Status CanEmulator::do_configure(const ChannelConfig& config) {
  settings_ = NodeSettings::parse(config.params);
  description_.kind = SampleKind::can_frame;
  description_.frame_id = config.name;
  return {};
}

Status CanEmulator::open() {
  RawOptions o;
  o.fd = true;
  if (auto s = socket_.open(settings_.interface, o); s || s.error().code != ErrorCode::io) return s;
  o.fd = false;  // an old kernel, or an interface that has no FD
  return socket_.open(settings_.interface, o);
}

Status CanEmulator::do_arm(const ArmContext&) {
  auto node = EmulatedNode::make(settings_, parts_.signals);
  if (!node)
    return fail(node.error().code, config().params.place(), config().name + ": " + node.error().text());
  if (auto s = stop_.open(); !s) return s;
  if (const auto missing = can_missing(); !missing.empty())
    return fail(
        ErrorCode::unavailable, config().name,
        "this kernel has no CAN (" + missing + "): sudo modprobe can-raw, or run with --clock virtual");
  auto interface = find_interface(settings_.interface);
  if (!interface && interface.error().code == ErrorCode::not_found && settings_.create) {
    if (auto s = create_vcan(settings_.interface); !s)
      return fail(s.error().code, config().name, s.error().text());
    interface = find_interface(settings_.interface);
  }
  if (!interface) return fail(interface.error().code, config().name, interface.error().text());
  if (!interface->up)
    return fail(ErrorCode::unavailable, config().name,
                settings_.interface +
                    ": expected an interface that is up, got one that is down; sudo ip link set " +
                    settings_.interface + (interface->kind == "can" ? " up type can bitrate 500000" : " up"));
  if (auto s = open(); !s) return fail(s.error().code, config().name, s.error().text());
  if (!settings_.log.empty())
    if (auto s = log_.open(settings_.log); !s) {
      socket_.close();
      return s;
    }
  node_ = std::move(*node);
  batch_.resize(RawSocket::kBatch);
  backoff_.reset();
  link_is_up_ = true;
  health_.connected.store(true, std::memory_order_release);
  return {};
}

Status CanEmulator::do_start(BenchTime t0) {
  stop_.reset();
  node_->start(t0);
  thread_ = std::thread([this] { run(); });
  return {};
}

Status CanEmulator::do_stop() {
  stop_.cut();
  if (thread_.joinable()) thread_.join();
  socket_.close();
  health_.connected.store(false, std::memory_order_release);
  return log_.close();
}

void CanEmulator::log_frame(const CanFrame& frame, std::uint8_t fd_flags, RealtimeTime t) {
  if (!log_.is_open()) return;
  LogEntry e;
  e.t = t;
  e.set_interface(settings_.interface);
  e.frame = frame;
  e.fd_flags = fd_flags;
  log_.write(e);
}

bool CanEmulator::send(const CanFrame& frame) {
  const int error = link_is_up_ ? socket_.send(frame) : -ENETDOWN;
  if (error == 0) {
    log_frame(frame, frame.fd ? static_cast<std::uint8_t>(4 | (frame.bit_rate_switch ? 1 : 0)) : 0,
              realtime_now());
    return true;
  }
  health_.lost.fetch_add(1, std::memory_order_relaxed);
  if (error == -ENETDOWN || error == -ENODEV || error == -ENXIO) {
    if (link_is_up_) backoff_.failed(monotonic_now());
    link_is_up_ = false;
    health_.connected.store(false, std::memory_order_release);
  }
  return false;
}

void CanEmulator::read_all() {
  for (int rounds = 0; rounds < 64; ++rounds) {
    const int n = socket_.receive(batch_);
    if (n < 0) {
      if (link_is_up_) backoff_.failed(monotonic_now());
      link_is_up_ = false;
      health_.connected.store(false, std::memory_order_release);
      return;
    }
    for (int i = 0; i < n; ++i) {
      const auto& r = batch_[static_cast<std::size_t>(i)];
      log_frame(r.frame, r.fd_flags, r.t);
      node_->receive(r.frame, bench_now());
    }
    if (n < static_cast<int>(batch_.size())) return;
  }
}

void CanEmulator::run() {
  const std::function<bool(const CanFrame&)> out = [this](const CanFrame& f) { return send(f); };
  while (true) {
    // Emulators run on the wall clock, where bench time is CLOCK_MONOTONIC.
    auto wake = std::min(MonotonicTime(node_->next_event().ns()), monotonic_now() + milliseconds(100));
    if (!link_is_up_) wake = std::min(wake, std::max(backoff_.next(), monotonic_now()));
    pollfd fds[2] = {{stop_.cut_fd(), POLLIN, 0}, {link_is_up_ ? socket_.fd() : -1, POLLIN, 0}};
    const std::int64_t left = std::max<std::int64_t>(0, (wake - monotonic_now()).ns());
    const timespec timeout{left / 1'000'000'000, left % 1'000'000'000};
    const int n = ::ppoll(fds, 2, &timeout, nullptr);
    if (n < 0 && errno != EINTR) return;
    if (n > 0 && (fds[0].revents & POLLIN) != 0) return;
    if (n > 0 && fds[1].revents != 0) read_all();
    if (!link_is_up_ && backoff_.due(monotonic_now())) {
      socket_.close();
      const auto interface = find_interface(settings_.interface);
      if (interface && interface->up && open()) {
        link_is_up_ = true;
        backoff_.reset();
        health_.reconnects.fetch_add(1, std::memory_order_relaxed);
        health_.connected.store(true, std::memory_order_release);
      } else {
        backoff_.failed(monotonic_now());
      }
    }
    const BenchTime now(monotonic_now().ns());
    if (node_->next_event() <= now) node_->act(now, out);
    const auto& c = node_->counters();
    health_.received.store(c.received, std::memory_order_relaxed);
    const std::lock_guard lock(counters_mutex_);
    counters_ = c;
  }
}

}  // namespace rigor::can
