#include "drivers/sick/sick_emulator.h"

#include "drivers/sick/point_capture.h"
#include "drivers/sick/sick_settings.h"

namespace rigor::sick {

class SickEmulator::Capture {
 public:
  explicit Capture(const DeviceParts& parts) : points(parts) {}
  PointCapture points;
  BenchTime t0;
};

SickEmulator::SickEmulator() = default;
SickEmulator::~SickEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

void SickEmulator::attach(DeviceParts parts) { parts_ = std::move(parts); }
std::uint16_t SickEmulator::port() const noexcept {
  return server_ && server_->port() != 0 ? server_->port() : port_;
}

std::string SickEmulator::endpoint() const {
  const bool six = address_.find(':') != std::string::npos;
  return "SICK scanner " + scanner_.name + " at " + (six ? "[" + address_ + "]" : address_) + ":" +
         std::to_string(port());
}

Status SickEmulator::do_configure(const ChannelConfig& config) {
  const auto& n = config.params;
  address_ = n.text_or("address", "127.0.0.1");
  port_ = static_cast<std::uint16_t>(n.integer_or("port", 2112, {.min = 0, .max = 65535}));
  options_ = {};
  options_.max_clients = static_cast<unsigned>(n.integer_or("max_clients", 8, {.min = 1, .max = 1000}));
  options_.idle_limit = seconds_from(n.number_or("idle_limit_s", 60, {.min = 0, .max = 1e6}));
  if (!parts_.samples || parts_.samples->geometry().kind != SampleKind::point_cloud)
    return fail(ErrorCode::bad_input, n.place(),
                config.name + ": expected the `sensor` of a LiDAR (configs/sensors/sick-*.yaml), got none");
  scanner_ = read_scanner(n, parts_.samples->scan());
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = parts_.samples->geometry().frame_id;
  description_.max_bytes = parts_.samples->geometry().max_bytes;
  return {};
}

Status SickEmulator::do_arm(const ArmContext&) {
  capture_ = std::make_unique<Capture>(parts_);
  auto server = std::make_unique<ScannerServer>(
      scanner_,
      [this](std::uint64_t k, BenchTime t) {
        auto points = capture_->points.points(k, t, capture_->t0);
        health_.received.store(server_->counters().scans.load(), std::memory_order_relaxed);
        health_.lost.store(server_->counters().scans_late.load(), std::memory_order_relaxed);
        health_.protocol_errors.store(server_->counters().malformed.load(), std::memory_order_relaxed);
        return points;
      },
      options_);
  server->on_clients(
      [this](unsigned clients) { health_.connected.store(clients != 0, std::memory_order_release); });
  if (auto s = server->listen(address_, port_); !s)
    return fail(s.error().code, config().name, s.error().text());
  server_ = std::move(server);
  return {};
}

Status SickEmulator::do_start(BenchTime t0) {
  capture_->t0 = t0;
  return server_->start();
}

Status SickEmulator::do_stop() {
  server_->stop();
  server_.reset();
  capture_.reset();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

}  // namespace rigor::sick
