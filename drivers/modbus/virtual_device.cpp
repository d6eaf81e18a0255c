#include "drivers/modbus/virtual_device.h"

#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <deque>

#include "drivers/modbus/register_channel.h"
#include "rt-core/heartbeat.h"

namespace rigor::modbus {

/// Each connection has a server thread, and they take turns by the bytes they wait for; the lock says so in a
/// way that the language (and a race detector) understands.
class VirtualDevice::LockedModel final : public RegisterModel {
 public:
  explicit LockedModel(std::shared_ptr<RegisterModel> model) : model_(std::move(model)) {}
  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) override {
    const std::lock_guard lock(mutex_);
    return model_->read(table, address, out, t);
  }
  [[nodiscard]] bool write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                           BenchTime t) override {
    const std::lock_guard lock(mutex_);
    return model_->write(table, address, in, t);
  }

 private:
  std::mutex mutex_;
  std::shared_ptr<RegisterModel> model_;
};

VirtualDevice::VirtualDevice(std::shared_ptr<RegisterModel> model)
    : model_(std::make_shared<LockedModel>(std::move(model))), time_(0) {}

Status VirtualDevice::connect(Connection& connection) {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0)
    return fail(ErrorCode::io, "", std::string("cannot make a socket pair: ") + std::strerror(errno));
  auto server = std::make_unique<Server>(
      model_, [this] { return time(); }, Server::Options{.idle_limit = Duration(0), .faults = {}});
  server->adopt(ends[0]);
  connection.link.adopt(ends[1], seconds(10));
  if (auto s = server->start(); !s) return s;
  connection.server = std::move(server);
  return {};
}

void VirtualDevice::join(Member* member, Rank rank) {
  const auto place = rank == Rank::read ? members_.end()
                                        : std::find_if(members_.begin(), members_.end(),
                                                       [](const Entry& e) { return e.rank == Rank::read; });
  members_.insert(place, {member, rank});
}

void VirtualDevice::leave(const Member* member) {
  std::erase_if(members_, [&](const Entry& e) { return e.member == member; });
}

void VirtualDevice::set_time(BenchTime t) noexcept {
  if (t > time()) time_.store(t.ns(), std::memory_order_release);
}

void VirtualDevice::advance(BenchTime now) {
  while (true) {
    Member* first = nullptr;
    BenchTime when = BenchTime::never();
    for (const auto& e : members_)  // writers stand first, so that at one instant they win
      if (const auto t = e.member->next_event(now); t < when) when = t, first = e.member;
    if (!first) return;
    set_time(when);
    first->happen();
  }
}

namespace {

class VirtualSource final : public Source, private VirtualDevice::Member {
 public:
  explicit VirtualSource(std::shared_ptr<VirtualDevice> device) : device_(std::move(device)) {}
  ~VirtualSource() override { (void)do_stop(); }

  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override {
    if (ready_.empty() || ready_.front()->stamp.t_release > now) return {};
    auto lease = std::move(ready_.front());
    ready_.pop_front();
    return lease;
  }
  void complete_until(BenchTime now) override { device_->advance(now); }

 protected:
  Status do_configure(const ChannelConfig& config) override {
    settings_ = SourceSettings::parse(config, description_);
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    if (!context.virtual_time)
      return fail(ErrorCode::wrong_state, config().name, "expected virtual time, got a wall-clock run");
    if (auto s = device_->connect(connection_); !s) return s;
    raw_.assign(settings_.map.raw_size(), 0);
    if (connection_.link.read(settings_.map, raw_) != LinkStatus::good) {
      const auto why = connection_.link.failure();
      connection_ = {};
      return fail(ErrorCode::bad_input, config().name,
                  "expected the emulated device to have these registers, got " + why);
    }
    ready_.clear();
    const auto slots = pool_slots(config());
    if (!pool_ || pool_->size() < slots) pool_ = make_sample_pool(slots, 0);
    health_.connected.store(true, std::memory_order_release);
    return {};
  }
  Status do_start(BenchTime t0) override {
    device_->set_time(t0);
    t0_ = t0;
    index_ = 0;
    lost_ = 0;
    device_->join(this, VirtualDevice::Rank::read);
    return {};
  }
  Status do_stop() override {
    device_->leave(this);
    ready_.clear();
    connection_.link.close();
    connection_.server.reset();
    health_.connected.store(false, std::memory_order_release);
    return {};
  }

 private:
  [[nodiscard]] BenchTime capture_time() const noexcept {
    return t0_ + config().period * static_cast<std::int64_t>(index_);
  }
  [[nodiscard]] BenchTime next_event(BenchTime now) const noexcept override {
    const auto t = capture_time();
    return t < now || t + config().latency <= now ? t : BenchTime::never();
  }
  void happen() override {
    const auto t = capture_time();
    const auto index = index_++;
    if (connection_.link.read(settings_.map, raw_) != LinkStatus::good) {
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      health_.lost.fetch_add(1, std::memory_order_relaxed);
      ++lost_;
      return;
    }
    health_.received.fetch_add(1, std::memory_order_relaxed);
    auto lease = pool_->try_acquire();
    if (!lease) {
      health_.no_slot.fetch_add(1, std::memory_order_relaxed);
      ++lost_;
      return;
    }
    auto& sample = lease.edit();
    fill_sample(sample, settings_.map, raw_);
    sample.stamp.sequence = index;
    sample.stamp.t_capture = t;
    sample.stamp.t_release = sample.stamp.t_arrival = t + config().latency;
    sample.stamp.sigma_capture = {};
    sample.stamp.lost_before = std::exchange(lost_, 0);
    ready_.push_back(std::move(lease));
  }

  std::shared_ptr<VirtualDevice> device_;
  VirtualDevice::Connection connection_;
  SourceSettings settings_;
  std::vector<std::uint16_t> raw_;
  std::unique_ptr<SamplePool> pool_;
  std::deque<SampleLease> ready_;
  BenchTime t0_;
  std::uint64_t index_ = 0;
  std::uint32_t lost_ = 0;
};

class VirtualSink final : public Sink, private VirtualDevice::Member {
 public:
  explicit VirtualSink(std::shared_ptr<VirtualDevice> device) : device_(std::move(device)) {}
  ~VirtualSink() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)do_stop();
  }

  [[nodiscard]] bool command(const Command& c) noexcept override {
    if (pending_.size() == pending_.capacity()) {
      counters_.dropped.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    // By t_effect, and of equal ones in the order in which they were given.
    const auto place =
        std::upper_bound(pending_.begin(), pending_.end(), c,
                         [](const Command& a, const Command& b) { return a.t_effect < b.t_effect; });
    pending_.insert(place, c);
    counters_.accepted.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  void complete_until(BenchTime now) override { device_->advance(now); }
  void watch(const Heartbeat* heartbeat, Duration) override { heartbeat_ = heartbeat; }

 protected:
  Status do_configure(const ChannelConfig& config) override {
    settings_ = SinkSettings::parse(config, description_);
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    if (!context.virtual_time)
      return fail(ErrorCode::wrong_state, config().name, "expected virtual time, got a wall-clock run");
    if (auto s = device_->connect(connection_); !s) return s;
    raw_.assign(settings_.map.raw_size(), 0);
    pending_.clear();
    pending_.reserve(kPlaces);
    if (connection_.link.write(settings_.safe_map, settings_.safe_raw) != LinkStatus::good) {
      const auto why = connection_.link.failure();
      connection_ = {};
      return fail(ErrorCode::bad_input, config().name,
                  "expected the emulated device to take its safe values, got " + why);
    }
    health_.connected.store(true, std::memory_order_release);
    return {};
  }
  Status do_start(BenchTime t0) override {
    device_->set_time(t0);
    device_->join(this, VirtualDevice::Rank::write);
    return {};
  }
  Status do_stop() override {
    device_->leave(this);
    counters_.dropped.fetch_add(pending_.size(), std::memory_order_relaxed);
    pending_.clear();
    if (connection_.link.write(settings_.safe_map, settings_.safe_raw) != LinkStatus::good)
      counters_.failed.fetch_add(1, std::memory_order_relaxed);
    connection_.link.close();
    connection_.server.reset();
    health_.connected.store(false, std::memory_order_release);
    return {};
  }

 private:
  static constexpr std::size_t kPlaces = 256;

  [[nodiscard]] BenchTime next_event(BenchTime now) const noexcept override {
    if (pending_.empty() || pending_.front().t_effect > now) return BenchTime::never();
    return pending_.front().t_effect;
  }
  void happen() override {
    const Command c = pending_.front();
    pending_.erase(pending_.begin());
    if (heartbeat_ && heartbeat_->stop_reason() != StopReason::none) {
      // The loop has ended: what it wanted last no longer counts.
      counters_.dropped.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    if (c.t_effect < device_->time()) counters_.late.fetch_add(1, std::memory_order_relaxed);
    const auto count = settings_.map.values().size();
    std::size_t bad = 0;
    const bool good = c.count == count &&
                      settings_.map.encode(std::span<const double>(c.value.data(), count), raw_, bad) ==
                          EncodeStatus::good &&
                      connection_.link.write(settings_.map, raw_) == LinkStatus::good;
    (good ? counters_.applied : counters_.failed).fetch_add(1, std::memory_order_relaxed);
  }

  std::shared_ptr<VirtualDevice> device_;
  VirtualDevice::Connection connection_;
  SinkSettings settings_;
  std::vector<std::uint16_t> raw_;
  std::vector<Command> pending_;
  const Heartbeat* heartbeat_ = nullptr;
};

}  // namespace

std::unique_ptr<Source> make_virtual_source(std::shared_ptr<VirtualDevice> device) {
  return std::make_unique<VirtualSource>(std::move(device));
}

std::unique_ptr<Sink> make_virtual_sink(std::shared_ptr<VirtualDevice> device) {
  return std::make_unique<VirtualSink>(std::move(device));
}

}  // namespace rigor::modbus
