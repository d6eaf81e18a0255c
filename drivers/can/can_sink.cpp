#include "drivers/can/can_sink.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "drivers/can/can_interfaces.h"

namespace rigor::can {
namespace {

constexpr Duration kLookAtBus = milliseconds(20);
/// A frame that no other node acknowledges is repeated by the controller for ever.
constexpr Duration kOnBusLimit = seconds(1);
/// A stamp of the kernel and a reading of the bench's clock differ by as much.
constexpr Duration kStampTolerance = microseconds(200);

bool same(const CanFrame& a, const CanFrame& b) {
  return a.id == b.id && a.extended == b.extended && a.length == b.length &&
         std::equal(a.data.begin(), a.data.begin() + a.length, b.data.begin());
}

}  // namespace

CanSink::~CanSink() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status CanSink::do_configure(const ChannelConfig& config) {
  settings_ = SinkSettings::parse(config, description_);
  return {};
}

Status CanSink::do_arm(const ArmContext& context) {
  if (auto s = open_ring(context.loop_period); !s) return s;
  if (auto s = bcm_.open(settings_.interface); !s)
    return fail(s.error().code, config().name, s.error().text());
  if (auto s = open_watcher(); !s) return fail(s.error().code, config().name, s.error().text());
  frames_ = CommandFrames(settings_);
  frames_.make_safe();
  backoff_.reset();
  next_look_ = {};
  const auto info = find_interface(settings_.interface);
  clock_.want(info && info->hardware_stamps ? StampKind::hardware : StampKind::kernel);
  batch_.resize(RawSocket::kBatch);
  awaited_.reset();
  not_seen_ = 0;
  const int error = info && !info->up ? -ENETDOWN : start_all();
  if (error != 0) {
    bcm_.close();
    watcher_.close();
    return fail(
        ErrorCode::unavailable, config().name,
        settings_.interface + ": expected the bus to take the safe values, got: " + std::strerror(-error) +
            (error == -ENETDOWN ? "; sudo ip link set " + settings_.interface +
                                      (info && info->kind != "can" ? " up" : " up type can bitrate 500000")
                                : std::string()));
  }
  safe_ = true;
  link_is_up_ = true;
  health_.connected.store(true, std::memory_order_release);
  start_thread();
  return {};
}

Status CanSink::do_stop() {
  stop_thread();
  // One try: a bus that is gone now cannot be told anything from here.
  if (!safe_ && bcm_.is_open()) make_safe();
  if (watcher_.is_open()) take_transmissions();
  bcm_.close();
  watcher_.close();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

void CanSink::tick() {
  if (monotonic_now() >= next_look_) look_at_link();
}

void CanSink::keep_safe() {
  if (!safe_) make_safe();
}

void CanSink::apply(const Command& c) {
  const bool late = is_late(bench_now() - c.t_effect);
  if (late) counters_.late.fetch_add(1, std::memory_order_relaxed);
  if (!frames_.apply(c)) {
    counters_.failed.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  safe_ = false;
  expect_on_bus(c, late);
  const int error = link_is_up_ ? send_all() : -ENETDOWN;
  (error == 0 ? counters_.applied : counters_.failed).fetch_add(1, std::memory_order_relaxed);
  if (error != 0) {
    awaited_.reset();
    failed(error);
  }
}

void CanSink::expect_on_bus(const Command& c, bool late) {
  take_transmissions();
  for (std::size_t i = 0; i < settings_.messages.size(); ++i)
    if (settings_.announce || settings_.messages[i].period.ns() == 0) {
      awaited_ = Awaited{frames_.frames()[i], c.t_effect, bench_now(), late};
      return;
    }
}

void CanSink::take_transmissions() {
  const EpochPair epoch = read_epoch();
  int n = 0;
  // Bounded: what others send under the same identifiers comes here as well.
  for (int rounds = 0; rounds < 16 && (n = watcher_.receive(batch_)) > 0; ++rounds)
    for (int i = 0; i < n; ++i) {
      const ReceivedFrame& r = batch_[static_cast<std::size_t>(i)];
      if (!r.own || r.frame.error) continue;
      const auto placed = clock_.place(r.stamps, epoch, r.read);
      if (!awaited_ || !same(r.frame, awaited_->frame) || placed.t + kStampTolerance < awaited_->t_sent)
        continue;
      const Duration took = placed.t - awaited_->t_effect;
      if (!awaited_->late && is_late(took)) counters_.late.fetch_add(1, std::memory_order_relaxed);
      awaited_.reset();
    }
  if (n < 0) failed(n);
  if (awaited_ && bench_now() - awaited_->t_sent > kOnBusLimit) {
    not_seen_.fetch_add(1, std::memory_order_relaxed);
    awaited_.reset();
  }
}

std::vector<std::string> CanSink::warnings() const {
  const std::uint64_t n = not_seen_.load(std::memory_order_relaxed);
  if (n == 0) return {};
  return {config().name + ": " + std::to_string(n) + (n == 1 ? " command" : " commands") + " did not leave " +
          settings_.interface +
          " within a second: is another node there to acknowledge frames, at this bit "
          "rate?"};
}

Status CanSink::open_watcher() {
  RawOptions o;
  for (const CommandMessage& m : settings_.messages)
    o.filters.push_back({m.start.id, m.start.extended ? kExtendedMask : kStandardMask, m.start.extended});
  o.fd = std::any_of(settings_.messages.begin(), settings_.messages.end(),
                     [](const CommandMessage& m) { return m.start.fd; });
  return watcher_.open(settings_.interface, o);
}

int CanSink::start_all() noexcept {
  int worst = 0;
  for (std::size_t i = 0; i < settings_.messages.size(); ++i) {
    const auto& m = settings_.messages[i];
    const int error =
        m.period.ns() > 0 ? bcm_.start(frames_.frames()[i], m.period) : bcm_.send_once(frames_.frames()[i]);
    if (error != 0) worst = error;
  }
  if (worst == 0) health_.received.fetch_add(1, std::memory_order_relaxed);
  return worst;
}

int CanSink::send_all() noexcept {
  int worst = 0;
  for (std::size_t i = 0; i < settings_.messages.size(); ++i) {
    const auto& m = settings_.messages[i];
    const int error = m.period.ns() > 0 ? bcm_.update(frames_.frames()[i], settings_.announce)
                                        : bcm_.send_once(frames_.frames()[i]);
    if (error != 0) worst = error;
  }
  if (worst == 0) health_.received.fetch_add(1, std::memory_order_relaxed);
  return worst;
}

void CanSink::failed(int error) noexcept {
  if (error == -ENOBUFS || error == -EAGAIN) {
    health_.protocol_errors.fetch_add(
        1, std::memory_order_relaxed);  // the interface's queue is full; it stays up
    return;
  }
  if (!link_is_up_) return;
  link_is_up_ = false;
  health_.connected.store(false, std::memory_order_release);
}

void CanSink::make_safe() {
  frames_.make_safe();
  safe_ = true;  // the frames are; what is sent after an interruption is they
  const int error = link_is_up_ ? send_all() : -ENETDOWN;
  if (error == 0) return;
  counters_.failed.fetch_add(1, std::memory_order_relaxed);
  failed(error);
}

void CanSink::look_at_link() {
  next_look_ = monotonic_now() + kLookAtBus;
  if (link_is_up_) {
    // The kernel sends without us; that it cannot is told to the sockets alone.
    if (const int error = bcm_.pending_error(); error != 0) failed(error);
    if (const int error = watcher_.pending_error(); error != 0) failed(error);
    take_transmissions();
    return;
  }
  if (!backoff_.due(monotonic_now())) return;
  const auto info = find_interface(settings_.interface);
  if (!info || !info->up) return backoff_.failed(monotonic_now());
  bcm_.close();
  watcher_.close();
  clock_.reset();
  awaited_.reset();
  if (!bcm_.open(settings_.interface) || !open_watcher() || start_all() != 0)
    return backoff_.failed(monotonic_now());
  backoff_.reset();
  link_is_up_ = true;
  health_.reconnects.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(true, std::memory_order_release);
}

}  // namespace rigor::can
