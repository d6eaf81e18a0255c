#include "drivers/v4l2/v4l2_source.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <cerrno>

namespace rigor::v4l2 {

V4l2Source::~V4l2Source() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Result<Plan> V4l2Source::open_device() {
  device_.reset();
  auto path = find_node(settings_.device, false);
  if (!path) {
    const auto error = config().params.error("device", path.error().message).error();
    return fail(ErrorCode::not_found, error.where, error.message);
  }
  auto device = V4l2Device::open(*path, settings_.dmabuf ? BufferMemory::dmabuf : BufferMemory::mmap);
  if (!device) return tl::unexpected<Error>(device.error());
  auto plan = set_up(**device, settings_, config());
  if (!plan) return plan;
  if (auto s = (*device)->allocate(settings_.queue); !s) return tl::unexpected<Error>(s.error());
  device_ = std::move(*device);
  return plan;
}

Status V4l2Source::do_arm(const ArmContext&) {
  if (auto s = deadline_.open(); !s) return s;
  auto plan = open_device();
  if (!plan) return tl::unexpected<Error>(plan.error());
  if (settings_.dmabuf) plan->notes.push_back("frames' memory: " + device_->buffers().origin());
  open_samples(std::move(*plan), false);
  if (auto s = device_->start(settings_.queue); !s) {
    device_.reset();
    close_stream();
    return s;
  }
  backoff_.reset();
  stopping_ = false;
  t_heard_ = monotonic_now();
  health_.connected = true;
  thread_ = std::thread([this] { run(); });
  return {};
}

Status V4l2Source::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  device_.reset();
  close_stream();
  health_.connected = false;
  return {};
}

void V4l2Source::run() {
  while (!stopping_) {
    if (!device_) {
      if (backoff_.due(monotonic_now()))
        try_again();
      else
        stopping_ = !deadline_.wait_until(backoff_.next());
      continue;
    }
    const std::int64_t left_ms = (settings_.silence - (monotonic_now() - t_heard_)).ns() / 1'000'000;
    pollfd fds[2] = {{deadline_.cut_fd(), POLLIN, 0}, {device_->fd(), POLLIN, 0}};
    const int n = ::poll(fds, 2, static_cast<int>(std::clamp<std::int64_t>(left_ms + 1, 0, 1'000'000)));
    if (n < 0 && errno != EINTR) break;
    if ((fds[0].revents & POLLIN) != 0) break;
    if (n > 0 && fds[1].revents != 0) take_frames();
    if (device_ && monotonic_now() - t_heard_ > settings_.silence) lose();
    // A queue in error is readable for ever.
    if (device_ && n > 0 && (fds[1].revents & (POLLERR | POLLHUP | POLLNVAL)) != 0 &&
        (fds[1].revents & POLLIN) == 0)
      lose();
  }
  // What never came while the device was away is lost, too.
  if (!device_) give_up_until(bench_now());
}

void V4l2Source::take_frames() {
  while (true) {
    RawFrame frame;
    const FrameStatus status = device_->next(frame);
    if (status == FrameStatus::none) return;
    if (status != FrameStatus::frame) {
      if (status == FrameStatus::broken) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      return lose();
    }
    t_heard_ = monotonic_now();
    if (!health_.connected.load(std::memory_order_relaxed)) {
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
      health_.connected.store(true, std::memory_order_release);
    }
    deliver(frame);
    if (!device_->release(frame)) return lose();
  }
}

void V4l2Source::lose() {
  health_.connected.store(false, std::memory_order_release);
  device_.reset();
  restart_count();
  backoff_.reset();
}

void V4l2Source::try_again() {
  auto plan = open_device();
  // Samples keep the size that applications were told of.
  const bool same = plan && plan->format.width_px == description_.width_px &&
                    plan->format.height_px == description_.height_px &&
                    plan->format.code == plan_.format.code &&
                    plan->format.stride_bytes == plan_.format.stride_bytes;
  if (same && device_->start(settings_.queue)) {
    t_heard_ =
        monotonic_now();  // connected once a frame comes: a loop-back device can be opened without a writer
    return;
  }
  if (plan && !same) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  device_.reset();
  health_.retries.fetch_add(1, std::memory_order_relaxed);
  backoff_.failed(monotonic_now());
}

}  // namespace rigor::v4l2
