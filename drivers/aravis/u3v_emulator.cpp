#include "drivers/aravis/u3v_emulator.h"

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>
#include <utility>

#include "drivers/aravis/u3v_usb_device.h"
#include "drivers/network/tcp_server.h"
#include "drivers/network/usbip_session.h"
#include "rt-core/time_slice.h"

namespace rigor::u3v {
namespace {

constexpr std::size_t kMostOutgoing = 4;

DeviceTime now() { return DeviceTime(monotonic_now().ns()); }

std::chrono::steady_clock::time_point as_steady(DeviceTime t) {
  return std::chrono::steady_clock::time_point(std::chrono::nanoseconds(t.ns()));
}

/// What a host may make the server keep: a transfer on its way in, and all that it has asked for on its way
/// out.
network::TcpServer::Limits server_limits() {
  return {.clients = 8,
          .request = usbip::kMaxOutBytes + 4096,
          .pending = std::size_t{64} << 20,
          .idle = seconds(1'000'000'000)};
}

}  // namespace

struct Emulator::Impl {
  Impl(Camera camera, const std::string& bus_id) : device(std::move(camera), bus_id) {}

  /// One host's connection; the device is free again when it ends.
  struct Connection {
    explicit Connection(Impl& i) : impl(&i), session(i.device) {}
    ~Connection() {
      const std::scoped_lock lock(impl->mutex);
      session.end();
      impl->bus_errors += session.counters().malformed;
      impl->frame_due.notify_one();
    }
    Connection(const Connection&) = delete;
    Connection& operator=(const Connection&) = delete;
    Impl* impl;
    usbip::Session session;
  };

  // `mutex` guards all but the threads and the server.
  mutable std::mutex mutex;
  std::condition_variable frame_due, send_due;
  UsbDevice device;
  gige::FillFrame fill;
  double link_bits_per_s = 0;
  std::deque<std::pair<DeviceTime, Frame>> outgoing;  ///< and when the link has carried it
  DeviceTime link_free;
  bool stopping = false;
  std::uint64_t bus_errors = 0, pictures_late = 0, outgoing_dropped = 0;

  std::uint16_t port = 0;
  network::TcpServer server;
  std::thread frame_thread, send_thread;

  void serve(network::TcpServer::Client& client);
  void frame_loop();
  void send_loop();
  void queue(Frame&& frame);
};

void Emulator::Impl::serve(network::TcpServer::Client& client) {
  if (!client.state) client.state = std::make_shared<Connection>(*this);
  auto& session = static_cast<Connection*>(client.state.get())->session;
  const std::scoped_lock lock(mutex);
  device.set_now(now());
  if (!device.plugged() && session.attached()) {
    client.out.clear();  // what was on the cable is gone
    client.close = true;
    return;
  }
  if (!session.receive(client.in, client.out)) client.close = true;
  frame_due.notify_one();
  send_due.notify_one();
}

void Emulator::Impl::frame_loop() {
  ask_for_time_slice(kLongTimeSlice);
  pthread_setname_np(pthread_self(), "u3v-frames");
  std::unique_lock lock(mutex);
  while (!stopping) {
    const DeviceTime due = device.camera().next_exposure();
    if (due == DeviceTime::never()) {
      frame_due.wait(lock);
      continue;
    }
    if (now() < due) {
      frame_due.wait_until(lock, as_steady(due));
      continue;
    }
    FrameJob job;
    if (!device.camera().begin_frame(now(), job)) continue;
    device.advance(now());  // an event may say so
    lock.unlock();
    server.wake();
    const bool filled = fill(job.request, job.picture());
    lock.lock();
    if (filled && now() > job.t_send) ++pictures_late;
    if (auto frame = device.camera().finish_frame(std::move(job), filled)) queue(std::move(*frame));
  }
}

void Emulator::Impl::queue(Frame&& f) {
  if (outgoing.size() >= kMostOutgoing) {
    ++outgoing_dropped;
    return;
  }
  const double bits = static_cast<double>(f.payload->size() + kLeaderBytes + kTrailerBytes) * 8;
  link_free = std::max({link_free, f.t_send, now()}) + seconds_from(bits / link_bits_per_s);
  outgoing.emplace_back(link_free, std::move(f));
  send_due.notify_one();
}

void Emulator::Impl::send_loop() {
  pthread_setname_np(pthread_self(), "u3v-send");
  std::unique_lock lock(mutex);
  while (!stopping) {
    const DeviceTime frame = outgoing.empty() ? DeviceTime::never() : outgoing.front().first;
    const DeviceTime due = std::min(frame, device.next_due());
    if (due == DeviceTime::never()) {
      send_due.wait(lock);
      continue;
    }
    if (now() < due) {
      send_due.wait_until(lock, as_steady(due));
      continue;
    }
    device.advance(now());
    if (frame <= now()) {
      const Frame f = std::move(outgoing.front().second);
      outgoing.pop_front();
      (void)device.send_frame(f);
    }
    lock.unlock();
    server.wake();
    lock.lock();
  }
}

Emulator::Emulator() = default;
Emulator::~Emulator() { stop(); }

Result<std::unique_ptr<Emulator>> Emulator::start(const EmulatorOptions& options, gige::FillFrame fill) {
  if (!fill)
    return fail(ErrorCode::bad_input, options.address, "expected a function that fills pictures, got none");
  if (!(options.link_bits_per_s >= 1e6))
    return fail(ErrorCode::bad_input, options.address, "link_bits_per_s: expected at least 1e6");
  if (options.bus_id.empty() || options.bus_id.size() >= usbip::kBusIdBytes)
    return fail(ErrorCode::bad_input, options.bus_id, "expected a bus id of 1 to 31 characters, such as 1-1");
  auto camera = Camera::create(options.camera);
  if (!camera) return tl::unexpected<Error>(camera.error());
  std::unique_ptr<Emulator> self(new Emulator);
  self->impl_ = std::make_unique<Impl>(std::move(*camera), options.bus_id);
  Impl* p = self->impl_.get();
  p->fill = std::move(fill);
  p->link_bits_per_s = options.link_bits_per_s;
  auto port = p->server.listen(options.address, options.port, server_limits(),
                               [p](network::TcpServer::Client& c) { p->serve(c); });
  if (!port) return tl::unexpected<Error>(port.error());
  p->port = *port;
  if (auto s = p->server.start(); !s) return tl::unexpected<Error>(s.error());
  p->frame_thread = std::thread([p] { p->frame_loop(); });
  p->send_thread = std::thread([p] { p->send_loop(); });
  return self;
}

void Emulator::stop() {
  if (!impl_ || !impl_->frame_thread.joinable()) return;
  {
    const std::scoped_lock lock(impl_->mutex);
    impl_->stopping = true;
  }
  impl_->frame_due.notify_all();
  impl_->send_due.notify_all();
  impl_->frame_thread.join();
  impl_->send_thread.join();
  impl_->server.stop();
}

void Emulator::unplug() {
  {
    const std::scoped_lock lock(impl_->mutex);
    impl_->device.set_plugged(false);
  }
  impl_->server.wake();
}

void Emulator::plug() {
  const std::scoped_lock lock(impl_->mutex);
  impl_->device.set_plugged(true);
}

std::uint16_t Emulator::port() const { return impl_->port; }

EmulatorHealth Emulator::health() const {
  const std::scoped_lock lock(impl_->mutex);
  const UsbDevice& d = impl_->device;
  const UsbDeviceCounters& u = d.counters();
  const CameraCounters& c = d.camera().counters();
  const auto& e = d.camera().exposures();
  EmulatorHealth h;
  h.frames_sent = u.frames_sent, h.frames_cut = u.frames_cut, h.bytes_sent = u.bytes_sent;
  h.frames_dropped = u.frames_dropped + impl_->outgoing_dropped;
  h.exposures_skipped = e.skipped, h.line_edges = e.line_edges, h.line_missed = e.line_missed;
  h.pictures_missing = c.pictures_missing, h.truncated = c.truncated;
  h.pictures_late = impl_->pictures_late;
  h.commands = c.commands, h.malformed = c.malformed, h.refused = c.refused;
  h.attached = u.attached, h.bus_errors = impl_->bus_errors;
  h.imported = d.imported(), h.acquiring = d.camera().state().acquiring != 0;
  return h;
}

}  // namespace rigor::u3v
