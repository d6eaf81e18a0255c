#include "drivers/v4l2/v4l2_emulator.h"

#include <fmt/format.h>
#include <linux/usb/g_uvc.h>
#include <linux/videodev2.h>
#include <poll.h>

#include <algorithm>
#include <cmath>
#include <cstring>

namespace rigor::v4l2 {
namespace {

constexpr std::uint32_t kBuffers = 4;

}  // namespace

V4l2Emulator::~V4l2Emulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string V4l2Emulator::endpoint() const {
  if (usb_)
    return fmt::format("USB camera \"{}\" ({:04x}:{:04x}) on {}", settings_.card, vendor_, product_,
                       gadget_.controller());
  return fmt::format("video device {} ({} {}x{} at {:g} Hz)", node_, fourcc_text(settings_.codes.front()),
                     pictures_ ? pictures_->width_px() : 0, pictures_ ? pictures_->height_px() : 0,
                     settings_.rate_hz);
}

Status V4l2Emulator::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  settings_ = read_emulated_video(n, config.name, config.period);
  usb_ = n.choice_or("as", {"video", "usb"}, "video") == "usb";
  device_ = usb_ ? n.text_or("device", "") : n.text("device");
  way_ = n.choice_or("io", {"mmap", "write"}, "mmap") == "write" ? OutputWay::write : OutputWay::mmap;
  controller_ = n.text_or("controller", "");
  vendor_ = static_cast<std::uint16_t>(n.integer_or("vendor", 0x1d6b, {.min = 1, .max = 65535}));
  product_ = static_cast<std::uint16_t>(n.integer_or("product", 0x0102, {.min = 0, .max = 65535}));
  if (!usb_ && settings_.codes.size() != 1)
    throw n.error("formats", "expected one format: a loop-back device has one at a time");
  for (const std::uint32_t code : settings_.codes)
    if (usb_ && !uvc_can(code))
      throw n.error("formats",
                    "expected formats that USB cameras have: YUYV, UYVY, NV12, GREY, Y10, Y12, Y16, Z16, "
                    "MJPG; got " +
                        fourcc_text(code));
  description_.kind = SampleKind::image;
  return {};
}

Result<VideoOutput> V4l2Emulator::open_output() {
  auto path = find_node(device_, true);
  if (!path) {
    const auto error = config().params.error("device", path.error().message).error();
    return fail(ErrorCode::not_found, error.where, error.message + "; sudo modprobe v4l2loopback makes one");
  }
  node_ = *path;
  const FormatChoice choice{settings_.codes.front(),
                            pictures_->width_px(),
                            pictures_->height_px(),
                            {static_cast<std::uint32_t>(std::llround(1e7 / settings_.rate_hz)), 10'000'000}};
  auto output = VideoOutput::open(node_, choice, way_);
  if (!output) return output;
  if (auto s = output->allocate(kBuffers); !s) return tl::unexpected<Error>(s.error());
  return output;
}

Status V4l2Emulator::do_arm(const ArmContext&) {
  if (auto s = deadline_.open(); !s) return s;
  auto pictures = EmulatedPictures::create(settings_, parts_, config().name);
  if (!pictures) return tl::unexpected<Error>(pictures.error());
  pictures_.emplace(std::move(*pictures));
  description_.width_px = pictures_->width_px(), description_.height_px = pictures_->height_px();
  description_.format = made_from(settings_.codes.front()).value_or(PixelFormat::mono8);
  grid_.period = Period::of_hz(settings_.rate_hz);
  shutter_ = {.exposure = pictures_->exposure(), .readout = settings_.readout, .period = grid_.period};
  if (usb_) return arm_usb();
  auto output = open_output();
  if (!output) return tl::unexpected<Error>(output.error());
  output_ = std::move(*output);
  output_open_ = true;
  return {};
}

Status V4l2Emulator::arm_usb() {
  UvcGadgetOptions o;
  o.name = "rigor-" + config().name;
  o.controller = controller_;
  o.vendor = vendor_, o.product = product_;
  o.product_name = settings_.card, o.serial = config().name;
  o.offer.intervals = {static_cast<std::uint32_t>(std::llround(1e7 / settings_.rate_hz))};
  for (const std::uint32_t code : settings_.codes)
    o.offer.formats.push_back(
        {code, static_cast<std::uint16_t>(pictures_->width_px()),
         static_cast<std::uint16_t>(pictures_->height_px()),
         static_cast<std::uint32_t>(frame_bytes(code, pictures_->width_px(), pictures_->height_px()))});
  o.offer.payload_bytes = 1024;
  auto gadget = UvcGadget::create(o);
  if (!gadget) return tl::unexpected<Error>(gadget.error());
  if (auto s = gadget->bind(); !s) return s;
  auto node = gadget->node();
  if (!node) return tl::unexpected<Error>(node.error());
  auto fd = open_node(*node);
  if (!fd) return tl::unexpected<Error>(fd.error());
  gadget_ = std::move(*gadget);
  gadget_fd_ = std::move(*fd);
  node_ = *node;
  pipe_.emplace(o.offer);
  streaming_ = false;
  return {};
}

Status V4l2Emulator::do_start(BenchTime t0) {
  grid_.t0 = t0, grid_.next = 0;
  deadline_.reset();
  if (usb_) {
    // Listening to setup requests is what plugs the camera in.
    for (std::uint32_t type = UVC_EVENT_FIRST; type <= UVC_EVENT_LAST; ++type) {
      v4l2_event_subscription s;
      std::memset(&s, 0, sizeof s);
      s.type = type;
      if (const int e = call(gadget_fd_.get(), VIDIOC_SUBSCRIBE_EVENT, &s); e != 0)
        return fail(ErrorCode::io, node_, std::string("cannot listen to the USB host: ") + std::strerror(-e));
    }
  } else {
    health_.connected = true;
  }
  thread_ = std::thread([this] { usb_ ? run_usb() : run_video(); });
  return {};
}

Status V4l2Emulator::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  output_.stop();
  output_ = {};
  output_open_ = false;
  gadget_fd_.reset();
  gadget_ = {};
  pipe_.reset();
  streaming_ = false;
  health_.connected = false;
  return {};
}

void V4l2Emulator::skip_to_now() {
  const std::int64_t passed = grid_.period.first_index_from(bench_now() - grid_.t0);
  grid_.next = std::max<std::uint64_t>(grid_.next, static_cast<std::uint64_t>(passed));
}

bool V4l2Emulator::hand_over_one(bool& refused) {
  refused = false;
  const std::uint64_t index = grid_.next++;
  const BenchTime t = grid_.at(index);
  if (!wait_until(t)) return false;
  if (usb_ && !streaming_) return true;
  const auto memory = output_.next();
  if (memory.empty()) {
    lose(1);
    return true;
  }
  const std::size_t bytes = pictures_->capture(index, t, {}, memory);
  if (bytes == 0) {
    lose(1);
    return true;
  }
  if (!wait_until(t - event_to_capture(TimestampEvent::end_of_frame, shutter_))) return false;
  if (usb_ && !streaming_) return true;
  const BenchTime stamp = t - event_to_capture(settings_.event, shutter_);
  if (output_.send(bytes, MonotonicTime(stamp.ns()), static_cast<std::uint32_t>(index))) {
    health_.received.fetch_add(1, std::memory_order_relaxed);
  } else {
    lose(1);
    refused = true;
  }
  // A picture that took longer than the period has cost the instants it ran over; the grid stays where it is.
  const std::uint64_t due = grid_.next;
  if (bench_now() > grid_.at(due)) {
    skip_to_now();
    lose(grid_.next - due);
  }
  return true;
}

bool V4l2Emulator::wait_until(BenchTime t) {
  if (!usb_) return deadline_.wait_until(MonotonicTime(t.ns()));
  while (true) {
    const std::int64_t left = (t - bench_now()).ns();
    pollfd fds[2] = {{deadline_.cut_fd(), POLLIN, 0}, {gadget_fd_.get(), POLLPRI, 0}};
    const timespec wait{std::max<std::int64_t>(left, 0) / 1'000'000'000,
                        std::max<std::int64_t>(left, 0) % 1'000'000'000};
    const int n = ::ppoll(fds, 2, &wait, nullptr);
    if ((fds[0].revents & POLLIN) != 0) return false;
    if (n > 0 && (fds[1].revents & POLLPRI) != 0)
      answer_host();
    else if (left <= 0)
      return true;
  }
}

void V4l2Emulator::run_video() {
  Backoff backoff;
  skip_to_now();
  while (true) {
    if (!output_open_) {
      if (!wait_until(std::max(BenchTime(backoff.next().ns()), bench_now()))) return;
      const std::uint64_t before = grid_.next;
      auto output = open_output();
      skip_to_now();
      lose(grid_.next - before);
      if (!output) {
        backoff.failed(monotonic_now());
        continue;
      }
      output_ = std::move(*output);
      output_open_ = true;
      backoff.reset();
      health_.connected = true;
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
    }
    bool refused = false;
    if (!hand_over_one(refused)) return;
    if (refused) {
      output_.stop();
      output_ = {};
      output_open_ = false;
      health_.connected = false;
    }
  }
}

void V4l2Emulator::run_usb() {
  skip_to_now();
  while (true) {
    bool refused = false;
    if (!streaming_) skip_to_now();
    if (!hand_over_one(refused)) break;
    if (refused && streaming_) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  }
  host_stops();
}

void V4l2Emulator::answer_host() {
  v4l2_event event;
  std::memset(&event, 0, sizeof event);
  if (call(gadget_fd_.get(), VIDIOC_DQEVENT, &event) != 0) return;
  uvc_event u;
  std::memcpy(&u, &event.u, sizeof u);
  const auto respond = [&](const uvc::Answer& a) {
    uvc_request_data r;
    std::memset(&r, 0, sizeof r);
    r.length = a.kind == uvc::Answer::Kind::stall ? -1 : static_cast<__s32>(a.length);
    std::memcpy(r.data, a.bytes.data(), std::min(sizeof r.data, a.bytes.size()));
    if (a.kind == uvc::Answer::Kind::stall) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    (void)call(gadget_fd_.get(), UVCIOC_SEND_RESPONSE, &r);
  };
  switch (event.type) {
    case UVC_EVENT_SETUP:
      respond(pipe_->setup({u.req.bRequestType, u.req.bRequest, u.req.wValue, u.req.wIndex, u.req.wLength}));
      break;
    case UVC_EVENT_DATA:
      (void)pipe_->data(
          {u.data.data, static_cast<std::size_t>(std::clamp<__s32>(u.data.length, 0, sizeof u.data.data))});
      break;
    case UVC_EVENT_STREAMON:
      host_starts();
      break;
    case UVC_EVENT_STREAMOFF:
    case UVC_EVENT_DISCONNECT:
      host_stops();
      break;
    default:
      break;
  }
}

void V4l2Emulator::host_starts() {
  host_stops();
  const uvc::StreamFormat& f = pipe_->offer().formats[pipe_->committed().format_index - 1U];
  auto output = VideoOutput::use(gadget_fd_.get(), node_, {f.code, f.width_px, f.height_px, {}});
  if (!output || !output->allocate(kBuffers)) {
    health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  output_ = std::move(*output);
  pictures_->set_code(f.code);
  // The host waits for this: the kernel completes its request when the stream is on, and wants a frame for
  // that.
  streaming_ = true;
  skip_to_now();
  const auto memory = output_.next();
  const std::uint64_t index = grid_.next++;
  const BenchTime t = grid_.at(index);
  const std::size_t bytes = memory.empty() ? 0 : pictures_->capture(index, t, {}, memory);
  if (bytes == 0 || !output_.send(bytes, MonotonicTime(t.ns()), static_cast<std::uint32_t>(index))) {
    host_stops();
    return;
  }
  health_.received.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(true, std::memory_order_release);
}

void V4l2Emulator::host_stops() {
  if (!streaming_) return;
  output_.stop();
  output_ = {};
  streaming_ = false;
  health_.connected.store(false, std::memory_order_release);
}

}  // namespace rigor::v4l2
