#include "drivers/can/can_source.h"

#include <net/if.h>
#include <poll.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <cstring>

#include "drivers/can/can_interfaces.h"

namespace rigor::can {
namespace {

constexpr Duration kEpochAge = milliseconds(100);
/// How often the thread looks for what the socket does not tell: frames dropped at the end of a burst.
constexpr Duration kLook = milliseconds(50);

bool is_up(const RawSocket& socket, const std::string& interface) {
  ifreq r{};
  std::copy_n(interface.begin(), std::min<std::size_t>(interface.size(), IFNAMSIZ - 1), r.ifr_name);
  return ::ioctl(socket.fd(), SIOCGIFFLAGS, &r) == 0 && (r.ifr_flags & IFF_UP) != 0;
}

}  // namespace

CanSource::~CanSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status CanSource::do_configure(const ChannelConfig& config) {
  settings_ = SourceSettings::parse(config, description_);
  return {};
}

Status CanSource::open() {
  RawOptions o;
  o.filters = settings_.filters;
  o.fd = settings_.fd;
  o.errors = true;  // also where they are no samples: bus-off has to be known
  o.receive_buffer_bytes = settings_.receive_buffer_bytes;
  drops_seen_ = 0;
  return socket_.open(settings_.interface, o);
}

Status CanSource::do_arm(const ArmContext&) {
  if (auto s = stop_.open(); !s) return s;
  if (auto s = open(); !s) return fail(s.error().code, config().name, s.error().text());
  warnings_.clear();
  clock_.want(settings_.time.value_or(StampKind::kernel));
  if (!is_up(socket_, settings_.interface)) {
    socket_.close();
    const auto info = find_interface(settings_.interface);
    const bool real = !info || info->kind == "can";
    return fail(ErrorCode::unavailable, config().name,
                settings_.interface +
                    ": expected an interface that is up, got one that is down; sudo ip link set " +
                    settings_.interface + (real ? " up type can bitrate 500000 (the bus's rate)" : " up"));
  }
  if (const auto info = find_interface(settings_.interface)) {
    bus_state_.store(info->state, std::memory_order_relaxed);
    if (!settings_.time && info->hardware_stamps) clock_.want(StampKind::hardware);
    if (clock_.wanted() == StampKind::hardware && !info->hardware_stamps)
      warnings_.push_back(settings_.interface + " has no hardware stamps (ethtool -T " + settings_.interface +
                          "): its frames have the kernel's, and their samples are marked as of an unsure "
                          "clock; `time: kernel` wants no others");
    if (settings_.fd && !info->fd)
      warnings_.push_back(settings_.interface + " takes no CAN FD frames as it is set up: sudo ip link set " +
                          settings_.interface +
                          (info->kind == "can" ? " type can fd on dbitrate 2000000" : " mtu 72"));
    if (info->state == BusState::bus_off) warnings_.push_back(settings_.interface + " is bus-off");
  }
  if (!settings_.log.empty())
    if (auto s = log_.open(settings_.log); !s) {
      socket_.close();
      return s;
    }
  table_ = SignalTable(settings_);
  batch_.resize(RawSocket::kBatch);
  open_stream(settings_.slots, 0, false);
  backoff_.reset();
  epoch_until_ = restart_at_ = next_look_ = {};
  last_capture_ = {};
  index_ = 0;
  link_is_up_ = true;
  health_.connected.store(true, std::memory_order_release);
  thread_ = std::thread([this] { run(); });
  return {};
}

Status CanSource::do_stop() {
  stop_.cut();
  if (thread_.joinable()) thread_.join();
  socket_.close();
  close_stream();
  health_.connected.store(false, std::memory_order_release);
  return log_.close();
}

std::vector<std::string> CanSource::warnings() const {
  std::vector<std::string> all = warnings_;
  std::uint64_t other = 0;
  for (const StampKind k : {StampKind::kernel, StampKind::arrival})
    if (k > clock_.wanted()) other += clock_.count(k);
  if (const std::uint64_t total = other + clock_.count(clock_.wanted()); other > 0)
    all.push_back(config().name + ": " + std::to_string(other) + " of " + std::to_string(total) +
                  " frames of " + settings_.interface + " had no " + stamp_name(clock_.wanted()) + " stamp");
  return all;
}

bool CanSource::wait(MonotonicTime until) noexcept {
  while (true) {
    pollfd fds[2] = {{stop_.cut_fd(), POLLIN, 0}, {link_is_up_ ? socket_.fd() : -1, POLLIN, 0}};
    const std::int64_t left = std::max<std::int64_t>(0, (until - monotonic_now()).ns());
    const timespec timeout{left / 1'000'000'000, left % 1'000'000'000};
    const int n = ::ppoll(fds, 2, &timeout, nullptr);
    if (n < 0 && errno == EINTR) continue;
    return (fds[0].revents & POLLIN) == 0;
  }
}

void CanSource::run() {
  const Period period = config().period;
  std::optional<BenchTime> t0;
  std::int64_t k = 0;
  while (true) {
    if (!t0 && (t0 = origin().get()) && settings_.sampled) k = period.first_index_from(bench_now() - *t0);
    const bool on_grid = settings_.sampled && t0;
    auto wake = monotonic_now() + (t0 ? kLook : RunOrigin::kLook);
    // Bench time is CLOCK_MONOTONIC.
    const auto grid = [&] { return MonotonicTime((*t0 + period * k).ns()); };
    if (on_grid) wake = std::min(wake, grid());
    if (!link_is_up_) wake = std::min(wake, std::max(backoff_.next(), monotonic_now()));
    if (restart_at_.ns() != 0) wake = std::min(wake, restart_at_);
    if (!wait(wake)) break;
    if (link_is_up_) read_all();
    if (!link_is_up_ && backoff_.due(monotonic_now())) try_again();
    const auto now = monotonic_now();
    if (now >= next_look_) {
      if (link_is_up_) count_drops();
      next_look_ = now + kLook;
    }
    if (restart_at_.ns() != 0 && now >= restart_at_) {
      health_.retries.fetch_add(1, std::memory_order_relaxed);
      // Refused (no right, no controller): it is asked again as long as the bus is off.
      restart_at_ = restart_controller(settings_.interface) ? MonotonicTime{}
                                                            : now + std::max(settings_.restart, seconds(1));
    }
    for (; on_grid && grid() <= now; ++k) {
      if (now - grid() > period || !link_is_up_)
        count_lost(1);  // too late for this instant, or nothing to be known at it
      else
        sample_at(BenchTime(grid().ns()), static_cast<std::uint64_t>(k));
    }
  }
  if (link_is_up_) {
    read_all();
    count_drops();
  }
}

void CanSource::read_all() {
  // Bounded, so that a flood does not keep the thread from its grid.
  for (int rounds = 0; rounds < 64; ++rounds) {
    const int n = socket_.receive(batch_);
    if (n < 0) return link_lost();
    const auto now = monotonic_now();
    if (now >= epoch_until_) {
      epoch_ = read_epoch();
      epoch_until_ = now + kEpochAge;
    }
    for (int i = 0; i < n; ++i) take(batch_[static_cast<std::size_t>(i)]);
    if (n < static_cast<int>(batch_.size())) return;
  }
}

void CanSource::take(const ReceivedFrame& r) {
  const FrameClock::Placed placed = clock_.place(r.stamps, epoch_, r.read);
  const BenchTime t = placed.t;
  const bool in_run = origin().covers(t, {});
  if (in_run && log_.is_open()) {
    LogEntry e;
    e.t = r.t;
    e.set_interface(settings_.interface);
    e.frame = r.frame;
    e.fd_flags = r.fd_flags;
    log_.write(e);
  }
  if (r.frame.error) {
    if (in_run) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    take_error(r.frame);
    if (!settings_.errors) return;
  } else if (bus_state_.load(std::memory_order_relaxed) == BusState::bus_off) {
    // Whoever hears a frame takes part again, whether it was told of the restart or not.
    bus_state_.store(BusState::error_active, std::memory_order_relaxed);
    restart_at_ = {};
    health_.connected.store(true, std::memory_order_release);
  }
  if (!settings_.raw()) {
    if (!table_.take(r.frame, t) || settings_.sampled || !in_run) return;
    auto slot = take_slot();
    if (slot) table_.fill(*slot, t);
    return give(std::move(slot), placed);
  }
  if (!in_run) return;
  auto slot = take_slot();
  if (slot) {
    auto& sample = *slot;
    sample.info = r.frame;
    sample.size_bytes = 0;
    sample.stamp.validity = kValid;
  }
  give(std::move(slot), placed);
}

void CanSource::give(SampleSlot&& slot, const FrameClock::Placed& placed) {
  BenchTime t = placed.t;
  // Two frames of one tick, or a step of CLOCK_REALTIME: the order in which they came stands.
  if (t <= last_capture_) t = last_capture_ + nanoseconds(1);
  last_capture_ = t;
  if (slot) {
    auto& stamp = slot->stamp;
    stamp.sequence = index_;
    stamp.t_capture = t;
    stamp.t_release = t + config().latency;
    stamp.t_arrival = bench_now();
    stamp.sigma_capture = placed.sigma;
    if (placed.kind > clock_.wanted()) stamp.validity |= kClockUnsure;
  }
  ++index_;
  hand_over(std::move(slot));
}

void CanSource::take_error(const CanFrame& f) {
  const BusState before = bus_state_.load(std::memory_order_relaxed), after = state_after(f, before);
  bus_state_.store(after, std::memory_order_relaxed);
  if (after == BusState::bus_off) {
    health_.connected.store(false, std::memory_order_release);
    if (settings_.restart.ns() > 0 && restart_at_.ns() == 0)
      restart_at_ = monotonic_now() + settings_.restart;
  } else if (before == BusState::bus_off) {
    restart_at_ = {};
    health_.reconnects.fetch_add(1, std::memory_order_relaxed);
    health_.connected.store(true, std::memory_order_release);
  }
}

void CanSource::link_lost() {
  // The kernel tells the error before what still waits in the queue.
  for (int errors = 0, n = 0; errors < 3 && (n = socket_.receive(batch_)) != 0;) {
    if (n < 0) ++errors;
    for (int i = 0; i < n; ++i) take(batch_[static_cast<std::size_t>(i)]);
  }
  count_drops();
  socket_.close();  // one of that name that comes back may be another interface
  link_is_up_ = false;
  health_.connected.store(false, std::memory_order_release);
  backoff_.failed(monotonic_now());
}

void CanSource::try_again() {
  if (!open() || !is_up(socket_, settings_.interface)) {
    socket_.close();
    return backoff_.failed(monotonic_now());
  }
  backoff_.reset();
  link_is_up_ = true;
  table_.clear();
  clock_.reset();
  restart_at_ = {};
  bus_state_.store(BusState::unknown, std::memory_order_relaxed);
  health_.reconnects.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(true, std::memory_order_release);
}

void CanSource::count_drops() {
  if (!socket_.is_open()) return;
  const std::uint64_t now = socket_.dropped();
  if (now <= drops_seen_) return;
  const std::uint64_t lost = now - drops_seen_;
  drops_seen_ = now;
  if (!origin().get()) return;
  count_lost(lost);
  if (!settings_.sampled) index_ += lost;
  log_.flush();
}

void CanSource::sample_at(BenchTime t, std::uint64_t index) {
  auto slot = take_slot();
  if (slot) {
    auto& sample = *slot;
    table_.fill(sample, t);
    sample.stamp.sequence = index;
    sample.stamp.t_capture = t;
    sample.stamp.t_release = t + config().latency;
    sample.stamp.t_arrival = bench_now();
    sample.stamp.sigma_capture = {};
  }
  hand_over(std::move(slot));
}

}  // namespace rigor::can
