#include "drivers/modbus/virtual_device.h"

#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "drivers/modbus/register_channel.h"
#include "rt-core/heartbeat.h"
#include "sensor-hal/channel/pending_commands.h"
#include "sensor-hal/channel/stream_source.h"

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

VirtualDevice::VirtualDevice(std::shared_ptr<RegisterModel> model, const EmulatorSettings& settings)
    : model_(std::make_shared<LockedModel>(std::move(model))),
      options_(settings.options),
      framing_(settings.serial ? Server::Framing::rtu : Server::Framing::tcp),
      faults_(std::make_shared<FaultBox>(settings.faults)),
      time_(0) {
  options_.idle_limit = {};
  options_.silence_closes = true;
}

Status VirtualDevice::connect(Connection& connection, const Endpoint& endpoint) {
  connection.link.close();
  connection.server.reset();
  if (endpoint.serial.has_value() != (framing_ == Server::Framing::rtu))
    return fail(ErrorCode::bad_input, endpoint.text(),
                "expected the same `transport` as that of the emulator that stands for the device");
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0)
    return fail(ErrorCode::io, "", std::string("cannot make a socket pair: ") + std::strerror(errno));
  auto server = std::make_unique<Server>(
      model_, [this] { return time(); }, options_, faults_);
  server->adopt(ends[0], framing_);
  connection.link.adopt(ends[1], seconds(10), framing_ == Server::Framing::rtu, endpoint.unit);
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

class VirtualSource final : public StreamSource, private VirtualDevice::Member {
 public:
  explicit VirtualSource(std::shared_ptr<VirtualDevice> device) : device_(std::move(device)) {}
  ~VirtualSource() override { (void)do_stop(); }

  void complete_until(BenchTime now) override { device_->advance(now); }
  [[nodiscard]] std::vector<std::string> warnings() const override {
    const auto trouble = connection_.link.counters().trouble();
    if (trouble.empty()) return {};
    return {config().name + ": the emulated device answered " +
            std::to_string(connection_.link.counters().requests.load()) + " requests with " + trouble};
  }

 protected:
  Status do_configure(const ChannelConfig& config) override {
    settings_ = SourceSettings::parse(config, description_);
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    if (!context.virtual_time)
      return fail(ErrorCode::wrong_state, config().name, "expected virtual time, got a wall-clock run");
    raw_.assign(settings_.map.raw_size(), 0);
    poller_ = Poller(settings_.map);
    Duration took;
    if (auto s = device_->connect(connection_, settings_.endpoint); !s) return s;
    if (ask(0, BenchTime(0), took) != LinkStatus::good) {
      const auto why = connection_.link.failure();
      disconnect();
      return fail(ErrorCode::bad_input, config().name,
                  "expected the emulated device to have these registers, got " + why);
    }
    poller_.forget();
    open_stream(pool_slots(config()), 0, true);
    health_.connected.store(true, std::memory_order_release);
    return {};
  }
  Status do_start(BenchTime t0) override {
    device_->set_time(t0);
    t0_ = t0;
    index_ = 0;
    device_->join(this, VirtualDevice::Rank::read);
    return {};
  }
  Status do_stop() override {
    device_->leave(this);
    close_stream();
    disconnect();
    health_.connected.store(false, std::memory_order_release);
    return {};
  }

 private:
  void disconnect() {
    connection_.link.close();
    connection_.server.reset();
  }
  [[nodiscard]] BenchTime capture_time() const noexcept {
    return t0_ + config().period * static_cast<std::int64_t>(index_);
  }
  [[nodiscard]] BenchTime next_event(BenchTime now) const noexcept override {
    const auto t = capture_time();
    return t < now || t + config().latency <= now ? t : BenchTime::never();
  }

  /// One instant's requests; `took`: how long they would have taken of bench time.
  LinkStatus ask(std::uint64_t index, BenchTime t, Duration& took) {
    const auto delay = device_->answer_delay(t);
    const auto& endpoint = settings_.endpoint;
    LinkStatus s = LinkStatus::timeout;
    for (unsigned attempt = 0; attempt <= endpoint.retries; ++attempt) {
      if (attempt > 0) health_.retries.fetch_add(1, std::memory_order_relaxed);
      if (delay > endpoint.timeout) {
        took += endpoint.timeout;
        continue;
      }
      // A device that is silent closes a connection of virtual time: nobody can wait for it here.
      if (!connection_.link.is_open() && !device_->connect(connection_, endpoint))
        return LinkStatus::disconnected;
      s = poller_.poll(connection_.link, index, raw_);
      took += s == LinkStatus::good || s == LinkStatus::exception ? delay : endpoint.timeout;
      if (s == LinkStatus::good || s == LinkStatus::exception) return s;
    }
    return s;
  }

  void happen() override {
    const auto t = capture_time();
    const auto index = index_;
    Duration took;
    const auto status = ask(index, t, took);
    if (status == LinkStatus::good) {
      auto slot = take_slot();
      if (slot) {
        auto& sample = *slot;
        fill_sample(sample, settings_.map, raw_);
        sample.stamp.sequence = index;
        // The middle of request and answer, as on the wall clock.
        sample.stamp.t_capture = t + took / 2;
        sample.stamp.t_release = sample.stamp.t_arrival = sample.stamp.t_capture + config().latency;
        sample.stamp.sigma_capture =
            Duration(static_cast<std::int64_t>(static_cast<double>(took.ns()) * 0.2886751));
      }
      hand_over(std::move(slot));
    } else {
      if (status == LinkStatus::exception || status == LinkStatus::protocol)
        health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      count_lost(1);
    }
    // What an answer ran over is lost; the grid stays where it is.
    const Period& period = config().period;
    const auto next = std::max<std::int64_t>(static_cast<std::int64_t>(index) + 1,
                                             period.first_index_from(t - t0_ + took - period / 2));
    count_lost(static_cast<std::uint64_t>(next) - index - 1);
    index_ = static_cast<std::uint64_t>(next);
  }

  std::shared_ptr<VirtualDevice> device_;
  VirtualDevice::Connection connection_;
  SourceSettings settings_;
  Poller poller_;
  std::vector<std::uint16_t> raw_;
  BenchTime t0_;
  std::uint64_t index_ = 0;
};

class VirtualSink final : public Sink, private VirtualDevice::Member {
 public:
  explicit VirtualSink(std::shared_ptr<VirtualDevice> device) : device_(std::move(device)) {}
  ~VirtualSink() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)do_stop();
  }

  [[nodiscard]] bool command(const Command& c) noexcept override {
    if (!pending_.push(c)) {
      counters_.dropped.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
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
    if (auto s = device_->connect(connection_, settings_.endpoint); !s) return s;
    raw_.assign(settings_.map.raw_size(), 0);
    check_.assign(
        std::max({settings_.map.raw_size(), settings_.safe_map.raw_size(), settings_.watchdog_raw.size()}),
        0);
    (void)pending_.clear();
    if (!write(settings_.safe_map, settings_.safe_raw)) {
      const auto why = connection_.link.failure();
      connection_.link.close();
      connection_.server.reset();
      return fail(ErrorCode::bad_input, config().name,
                  "expected the emulated device to take its safe values, got " + why);
    }
    if (!settings_.watchdog_raw.empty() && !write(settings_.watchdog_map, settings_.watchdog_raw)) {
      const auto why = connection_.link.failure();
      connection_.link.close();
      connection_.server.reset();
      return fail(ErrorCode::bad_input, config().name,
                  "expected the emulated device to take the timeout of its watchdog, got " + why);
    }
    refresh_at_ = BenchTime::never();
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
    counters_.dropped.fetch_add(pending_.clear(), std::memory_order_relaxed);
    if (!write(settings_.safe_map, settings_.safe_raw))
      counters_.failed.fetch_add(1, std::memory_order_relaxed);
    connection_.link.close();
    connection_.server.reset();
    health_.connected.store(false, std::memory_order_release);
    return {};
  }

 private:
  [[nodiscard]] BenchTime next_event(BenchTime now) const noexcept override {
    const BenchTime t = std::min(refresh_at_, pending_.next());
    return t > now ? BenchTime::never() : t;
  }
  /// As ModbusSink writes: tried again, and read back where the rig says so.
  bool write(const RegisterMap& map, const std::vector<std::uint16_t>& raw) {
    const auto& endpoint = settings_.endpoint;
    if (device_->answer_delay(device_->time()) > endpoint.timeout) return false;
    for (unsigned attempt = 0; attempt <= endpoint.retries; ++attempt) {
      if (attempt > 0) health_.retries.fetch_add(1, std::memory_order_relaxed);
      if (!connection_.link.is_open() && !device_->connect(connection_, endpoint)) return false;
      auto s = connection_.link.write(map, raw);
      if (s == LinkStatus::good && settings_.verify) {
        s = connection_.link.read(map, check_);
        if (s == LinkStatus::good && !map.same(raw, check_)) s = LinkStatus::protocol;
      }
      if (s == LinkStatus::exception || s == LinkStatus::protocol)
        health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      if (s == LinkStatus::good || s == LinkStatus::exception) return s == LinkStatus::good;
    }
    return false;
  }

  void happen() override {
    if (refresh_at_ < pending_.next() || pending_.next() == BenchTime::never()) return refresh();
    const Command c = pending_.pop();
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
                      write(settings_.map, raw_);
    (good ? counters_.applied : counters_.failed).fetch_add(1, std::memory_order_relaxed);
    if (good && settings_.refresh.ns() > 0) refresh_at_ = c.t_effect + settings_.refresh;
  }

  /// For the device's watchdog, as ModbusSink does.
  void refresh() {
    const bool over = heartbeat_ && heartbeat_->stop_reason() != StopReason::none;
    refresh_at_ = over ? BenchTime::never() : refresh_at_ + settings_.refresh;
    if (!over) (void)write(settings_.map, raw_);
  }

  std::shared_ptr<VirtualDevice> device_;
  VirtualDevice::Connection connection_;
  SinkSettings settings_;
  BenchTime refresh_at_ = BenchTime::never();
  std::vector<std::uint16_t> raw_, check_;
  PendingCommands pending_;
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
