#include "drivers/usb/bulk_emulator.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "drivers/usb/device_ends.h"
#include "sensor-hal/config/rate.h"

namespace rigor::usb {

BulkEmulator::~BulkEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string BulkEmulator::endpoint() const {
  if (!gadget_) return "frames of " + config().name + " at " + (end_ ? end_->endpoint() : "(not armed)");
  char ids[16];
  std::snprintf(ids, sizeof ids, "%04x:%04x", gadget_settings_.vendor, gadget_settings_.product);
  return "USB device " + std::string(ids) + " of " + config().name + " on " + where();
}

Status BulkEmulator::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  (void)n.choice_or("protocol", {"bulk"}, "bulk");
  format_ = read_bulk_format(n.map("frame"));
  period_ = read_rate_or(n, "rate_hz", Period::of_rate(30), {.min = 0.01, .max = 10000});
  delay_ = seconds_from(n.number_or("delay_ms", 0, {.min = 0, .max = 10000}) * 1e-3);
  gadget_ = n.choice_or("as", {"gadget", "tcp"}, "gadget") == "gadget";
  if (gadget_) {
    gadget_settings_ = {};
    gadget_settings_.name = "rigor." + config.name;
    std::replace(gadget_settings_.name.begin(), gadget_settings_.name.end(), '/', '.');
    gadget_settings_.vendor = static_cast<std::uint16_t>(n.integer("vendor", {.min = 1, .max = 65535}));
    gadget_settings_.product = static_cast<std::uint16_t>(n.integer("product", {.min = 0, .max = 65535}));
    gadget_settings_.serial = n.text_or("serial", "");
    gadget_settings_.udc = n.text_or("udc", "");
    gadget_settings_.manufacturer = "Rigor";
    gadget_settings_.description = config.name;
  } else {
    address_ = n.text_or("address", "127.0.0.1");
    port_ = static_cast<std::uint16_t>(n.integer_or("port", 10941, {.min = 0, .max = 65535}));
  }
  description_.kind = format_.image() ? SampleKind::image : SampleKind::range_image;
  description_.frame_id = config.name;
  return {};
}

Status BulkEmulator::do_arm(const ArmContext&) {
  auto world = WorldFrames::create(parts_, format_, config().name);
  if (!world) return tl::unexpected<Error>(world.error());
  if (auto s = deadline_.open(); !s) return s;
  if (gadget_) {
    auto device = std::make_unique<FfsDevice>();
    if (auto s = device->open(gadget_settings_); !s)
      return fail(s.error().code, config().name, s.error().text());
    device_ = std::move(device);
  } else {
    auto end = make_tcp_end(address_, port_);
    if (auto s = end->open(); !s) return fail(s.error().code, config().name, s.error().text());
    end_ = std::move(end);
  }
  world_ = std::move(*world);
  return {};
}

Status BulkEmulator::do_start(BenchTime) {
  deadline_.reset();
  thread_ = std::thread([this] { run(); });
  return {};
}

Status BulkEmulator::do_stop() {
  deadline_.cut();
  if (device_) device_->unplug();  // ends a write that the host does not take
  if (thread_.joinable()) thread_.join();
  device_.reset();
  end_.reset();
  world_.reset();
  set_connected(false);
  return {};
}

bool BulkEmulator::send(std::string_view frame) {
  if (device_) return device_->write(frame);
  const MonotonicTime limit = monotonic_now() + seconds(2);
  while (!frame.empty()) {
    const ssize_t n = put_bytes(end_->fd(), frame.data(), frame.size());
    if (n > 0) {
      frame.remove_prefix(static_cast<std::size_t>(n));
      continue;
    }
    if (n < 0 && errno == EINTR) continue;
    if (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK) break;
    pollfd p[2] = {{end_->fd(), POLLOUT, 0}, {deadline_.cut_fd(), POLLIN, 0}};
    const timespec t{0, 100'000'000};
    if (::ppoll(p, 2, &t, nullptr) < 0 && errno != EINTR) break;
    if (p[1].revents != 0 || monotonic_now() > limit) break;
  }
  if (!frame.empty()) end_->lost();  // half a frame: the rest would be taken for the next one
  return frame.empty();
}

void BulkEmulator::run() {
  const MonotonicTime start = monotonic_now();
  std::string bytes;
  for (std::int64_t k = 0;; ++k) {
    const std::int64_t now = (monotonic_now() - start) / period_;
    if (now > k) {
      counters_.frames_skipped.fetch_add(static_cast<std::uint64_t>(now - k), std::memory_order_relaxed);
      k = now;
    }
    const MonotonicTime due = start + period_ * k;
    if (!deadline_.wait_until(due)) return;
    if (end_ && end_->fd() < 0) {
      set_connected(false);
      end_->await(deadline_.cut_fd(), std::min<Duration>(period_, milliseconds(100)));
      continue;
    }
    if (device_ && !device_->enabled()) {
      set_connected(false);
      continue;
    }
    set_connected(true);
    if (device_ && stall_.exchange(false)) (void)device_->stall();
    bytes.clear();
    if (!world_->frame(static_cast<std::uint64_t>(k), BenchTime(due.ns()), (due - start).ns(), bytes))
      continue;
    if (delay_.ns() > 0 && !deadline_.wait_until(due + delay_)) return;
    (send(bytes) ? counters_.frames_sent : counters_.frames_cut).fetch_add(1, std::memory_order_relaxed);
  }
}

}  // namespace rigor::usb
