#include "text_sensor.h"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>

#include "sensor-hal/plugin/plugin.h"

namespace text_sensor {
namespace {

using namespace rigor;

constexpr std::size_t kSlots = 16, kLongestLine = 64;

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return to;
}

std::string line_of(std::int64_t number, double range_m) {
  char line[kLongestLine];
  return {line, static_cast<std::size_t>(std::snprintf(line, sizeof line, "%lld %.3f\n",
                                                       static_cast<long long>(number), range_m))};
}

Status system_error(const std::string& who, const char* what) {
  return fail(ErrorCode::io, who, std::string(what) + ": " + std::strerror(errno));
}

}  // namespace

double range_at(BenchTime t) { return 2 + 0.5 * std::sin(static_cast<double>(t.ns()) * 1e-9); }

Status TextSource::do_configure(const ChannelConfig& config) {
  port_ = static_cast<std::uint16_t>(config.params.integer("port", {.min = 1, .max = 65535}));
  description_.kind = SampleKind::register_block;
  description_.frame_id = config.name;
  description_.names = {"range_m"};
  description_.units = {"m"};
  return {};
}

bool TextSource::take_line(std::string_view line, BenchTime t_capture, BenchTime t_arrival) {
  std::int64_t number = 0;
  double range_m = 0;
  const char* const end = line.data() + line.size();
  const auto n = std::from_chars(line.data(), end, number);
  if (n.ec != std::errc{} || n.ptr == end || *n.ptr != ' ' || number <= last_) return false;
  const auto r = std::from_chars(n.ptr + 1, end, range_m);
  if (r.ec != std::errc{} || r.ptr == end || *r.ptr != '\n' || !std::isfinite(range_m)) return false;
  const auto missing = static_cast<std::uint64_t>(number - last_ - 1);
  last_ = number;
  // Before the run is known to begin, what comes is read and dropped, so that nothing old waits.
  const auto place =
      sequence_.place(origin_, t_capture, config().period, static_cast<std::uint64_t>(number), missing);
  if (!place) return true;
  if (place->lost > 0) count_lost(place->lost);
  SampleSlot slot = take_slot();
  if (slot) {
    Sample& s = *slot;
    s.stamp = {};
    s.stamp.sequence = place->sequence;
    s.stamp.t_capture = t_capture;
    s.stamp.t_release = t_capture + config().latency;
    s.stamp.t_arrival = t_arrival;
    RegisterBlock block;
    block.count = 1;
    block.value[0] = range_m;
    s.info = block;
    s.size_bytes = 0;
  }
  hand_over(std::move(slot));
  return true;
}

NetworkSource::~NetworkSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status NetworkSource::do_arm(const ArmContext& context) {
  if (context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "a device on the network has no virtual time");
  socket_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  const sockaddr_in at = loopback(port_);
  if (socket_ < 0 || ::bind(socket_, reinterpret_cast<const sockaddr*>(&at), sizeof at) != 0) {
    const Status failed = system_error(config().name, ("UDP port " + std::to_string(port_)).c_str());
    if (socket_ >= 0) ::close(socket_);
    socket_ = -1;
    return failed;
  }
  stop_ = ::eventfd(0, EFD_CLOEXEC);
  open_stream(kSlots, 0, false);
  origin_.forget();
  sequence_.reset();
  last_ = -1;
  thread_ = std::thread([this] { receive(); });
  return {};
}

/// Brief: the thread runs since the device was opened.
Status NetworkSource::do_start(BenchTime t0) {
  origin_.publish(t0);
  return {};
}

Status NetworkSource::do_stop() {
  const std::uint64_t one = 1;
  (void)!::write(stop_, &one, sizeof one);
  if (thread_.joinable()) thread_.join();
  ::close(socket_);
  ::close(stop_);
  socket_ = stop_ = -1;
  close_stream();
  health_.connected = false;
  return {};
}

void NetworkSource::receive() {
  char line[kLongestLine];
  pollfd wait[2] = {{socket_, POLLIN, 0}, {stop_, POLLIN, 0}};
  while (::poll(wait, 2, -1) >= 0 || errno == EINTR) {
    if (wait[1].revents) return;
    const ssize_t size = ::recv(socket_, line, sizeof line, 0);
    if (size < 0) continue;
    const BenchTime arrival = bench_now(), capture = arrival - config().latency;
    health_.connected = true;
    if (!take_line({line, static_cast<std::size_t>(size)}, capture, arrival)) health_.protocol_errors += 1;
  }
}

Status VirtualSource::do_arm(const ArmContext& context) {
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time alone");
  if (config().period.ns() <= 0)
    return fail(ErrorCode::bad_input, config().name, "expected a rate_hz above 0 for virtual time");
  open_stream(kSlots, 0, true);
  health_.connected = true;
  return {};
}

Status VirtualSource::do_start(BenchTime t0) {
  origin_.publish(t0);
  sequence_.reset();
  next_ = 0;
  last_ = -1;
  return {};
}

Status VirtualSource::do_stop() {
  close_stream();
  health_.connected = false;
  return {};
}

void VirtualSource::complete_until(BenchTime now) {
  if (state() != ChannelState::running) return;
  for (;; ++next_) {
    const BenchTime t = *origin_.get() + config().period * next_;
    if (t + config().latency > now) return;
    (void)take_line(line_of(next_, range_at(t)), t, t + config().latency);
  }
}

TextEmulator::~TextEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string TextEmulator::endpoint() const {
  return "text sensor that sends to UDP port " + std::to_string(port_);
}

Status TextEmulator::do_configure(const ChannelConfig& config) {
  port_ = static_cast<std::uint16_t>(config.params.integer("port", {.min = 1, .max = 65535}));
  period_ = Period::of_rate(config.params.integer("rate_hz", {.min = 1, .max = 1000}));
  description_.kind = SampleKind::register_block;
  return {};
}

Status TextEmulator::do_arm(const ArmContext&) {
  socket_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (socket_ < 0) return system_error(config().name, "socket");
  return deadline_.open();
}

Status TextEmulator::do_start(BenchTime) {
  deadline_.reset();
  thread_ = std::thread([this] { send(); });
  return {};
}

Status TextEmulator::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  ::close(socket_);
  socket_ = -1;
  return {};
}

void TextEmulator::send() {
  const sockaddr_in to = loopback(port_);
  const MonotonicTime began = monotonic_now();
  for (std::int64_t n = 0; deadline_.wait_until(began + period_ * n); ++n) {
    const std::string line = line_of(n, range_at(bench_now()));
    health_.connected = ::sendto(socket_, line.data(), line.size(), 0, reinterpret_cast<const sockaddr*>(&to),
                                 sizeof to) == static_cast<ssize_t>(line.size());
  }
}

Backend backend() {
  Backend b;
  b.name = "text-sensor";
  b.summary = "range finders that send lines of text over UDP";
  b.make_source = [] { return std::make_unique<NetworkSource>(); };
  b.make_emulator = [] { return std::make_unique<TextEmulator>(); };
  b.make_virtual_source = [](DeviceParts, ConfigNode) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<VirtualSource>();
  };
  b.doctor = [] {
    return std::vector<rigor::DoctorFinding>{
        {rigor::DoctorFinding::Level::good, "text-sensor: needs a UDP port and nothing else", ""}};
  };
  return b;
}

}  // namespace text_sensor

namespace {
rigor::Status define(rigor::Registry& registry) {
  registry.add(text_sensor::backend());
  return {};
}
}  // namespace

RIGOR_PLUGIN("text-sensor", "1.0", "Range finders that send lines of text over UDP.", define)
