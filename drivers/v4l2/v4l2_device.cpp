#include "drivers/v4l2/v4l2_device.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "drivers/v4l2/system_error.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::v4l2 {
namespace {

v4l2_ext_controls one_control(v4l2_ext_control& control) {
  v4l2_ext_controls c;
  std::memset(&c, 0, sizeof c);
  c.which = V4L2_CTRL_WHICH_CUR_VAL;
  c.count = 1;
  c.controls = &control;
  return c;
}

bool is_integer64(int fd, std::uint32_t id) {
  v4l2_query_ext_ctrl q;
  std::memset(&q, 0, sizeof q);
  q.id = id;
  return call(fd, VIDIOC_QUERY_EXT_CTRL, &q) == 0 && q.type == V4L2_CTRL_TYPE_INTEGER64;
}

}  // namespace

V4l2Device::V4l2Device(FileDescriptor fd, std::string path, BufferMemory memory)
    : fd_(std::move(fd)), path_(std::move(path)), memory_(memory) {}
V4l2Device::~V4l2Device() { stop(); }

Result<std::unique_ptr<V4l2Device>> V4l2Device::open(const std::string& path, BufferMemory memory) {
  auto fd = open_node(path);
  if (!fd) return tl::unexpected<Error>(fd.error());
  return std::unique_ptr<V4l2Device>(new V4l2Device(std::move(*fd), path, memory));
}

Result<DeviceTable> V4l2Device::table() {
  auto t = read_table(fd_.get(), path_, false);
  if (!t) return t;
  if (!t->captures)
    return fail(
        ErrorCode::bad_input, path_,
        t->multiplanar
            ? "expected a device with the single-planar API, got one of the multi-planar API alone"
            : "expected a device that captures, got one that does not; `rigor devices` says which do");
  if (!t->streams)
    return fail(ErrorCode::bad_input, path_, "expected a device that streams, got one that can only be read");
  sets_rate_ = t->sets_rate;
  return t;
}

Result<ActualFormat> V4l2Device::set_format(const FormatChoice& choice) {
  auto a = set_node_format(fd_.get(), path_, choice, false, sets_rate_);
  if (a) size_bytes_ = a->size_bytes;
  return a;
}

Status V4l2Device::set_control(std::uint32_t id, std::int64_t value) {
  v4l2_ext_control c;
  std::memset(&c, 0, sizeof c);
  c.id = id;
  if (is_integer64(fd_.get(), id))
    c.value64 = value;
  else
    c.value = static_cast<__s32>(value);
  v4l2_ext_controls all = one_control(c);
  if (const int e = call(fd_.get(), VIDIOC_S_EXT_CTRLS, &all); e != 0)
    return fail(ErrorCode::bad_input, path_, std::string("the device refuses it: ") + std::strerror(-e));
  return {};
}

Result<std::int64_t> V4l2Device::get_control(std::uint32_t id) {
  v4l2_ext_control c;
  std::memset(&c, 0, sizeof c);
  c.id = id;
  v4l2_ext_controls all = one_control(c);
  if (const int e = call(fd_.get(), VIDIOC_G_EXT_CTRLS, &all); e != 0)
    return system_error(path_, "VIDIOC_G_EXT_CTRLS", e);
  return is_integer64(fd_.get(), id) ? std::int64_t{c.value64} : std::int64_t{c.value};
}

Status V4l2Device::allocate(std::uint32_t count) {
  auto b = NodeBuffers::create(fd_.get(), path_, false, memory_, count, size_bytes_);
  if (!b) return tl::unexpected<Error>(b.error());
  buffers_ = std::move(*b);
  return {};
}

int V4l2Device::queue(std::uint32_t index) noexcept {
  v4l2_buffer b;
  std::memset(&b, 0, sizeof b);
  buffers_.describe(b, index);
  return call(fd_.get(), VIDIOC_QBUF, &b);
}

Status V4l2Device::start(std::uint32_t count) {
  if (buffers_.count() == 0)
    if (auto s = allocate(count); !s) return s;
  for (std::uint32_t i = 0; i < buffers_.count(); ++i)
    if (const int e = queue(i); e != 0) return system_error(path_, "VIDIOC_QBUF", e);
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (const int e = call(fd_.get(), VIDIOC_STREAMON, &type); e != 0)
    return fail(e == -EIO ? ErrorCode::unavailable : ErrorCode::io, path_,
                std::string("the device does not begin to capture (VIDIOC_STREAMON: ") + std::strerror(-e) +
                    "); of a loop-back device, start the program that writes to it first");
  streaming_ = true;
  return {};
}

FrameStatus V4l2Device::next(RawFrame& out) {
  v4l2_buffer b;
  std::memset(&b, 0, sizeof b);
  buffers_.describe(b, 0);
  const int e = call(fd_.get(), VIDIOC_DQBUF, &b);
  if (e == -EAGAIN) return FrameStatus::none;
  if (e == -ENODEV || e == -ENXIO) return FrameStatus::gone;
  if (e != 0 || b.index >= buffers_.count()) return FrameStatus::broken;
  const auto memory = buffers_.memory(b.index);
  buffers_.begin_access(b.index, false);
  out.bytes = memory.first(std::min<std::size_t>(b.bytesused, memory.size()));
  out.index = b.index;
  out.sequence = b.sequence;
  out.timestamp_ns =
      std::int64_t{b.timestamp.tv_sec} * 1'000'000'000 + std::int64_t{b.timestamp.tv_usec} * 1000;
  const std::uint32_t clock = b.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK;
  out.clock = clock == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC ? TimestampClock::monotonic
              : clock == V4L2_BUF_FLAG_TIMESTAMP_COPY    ? TimestampClock::copied
                                                         : TimestampClock::unknown;
  out.event = (b.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE
                  ? TimestampEvent::start_of_exposure
                  : TimestampEvent::end_of_frame;
  out.error = (b.flags & V4L2_BUF_FLAG_ERROR) != 0;
  out.t_taken = bench_now();
  return FrameStatus::frame;
}

bool V4l2Device::release(const RawFrame& frame) {
  buffers_.end_access(frame.index, false);
  return queue(frame.index) == 0;
}

void V4l2Device::stop() {
  if (streaming_) {
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    (void)call(fd_.get(), VIDIOC_STREAMOFF, &type);
  }
  streaming_ = false;
  buffers_ = {};
}

std::vector<DeviceTable> list_nodes(bool enumerate) {
  std::vector<std::pair<int, std::string>> paths;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", ignored)) {
    const std::string name = entry.path().filename();
    if (!name.starts_with("video") || name.size() == 5 || name.size() > 9 ||
        !std::all_of(name.begin() + 5, name.end(), [](unsigned char c) { return std::isdigit(c) != 0; }))
      continue;
    paths.emplace_back(std::stoi(name.substr(5)), entry.path());
  }
  std::sort(paths.begin(), paths.end());
  std::vector<DeviceTable> all;
  for (const auto& [number, path] : paths) {
    auto fd = open_node(path);
    if (!fd) continue;
    auto table = read_table(fd->get(), path, false, enumerate);
    if (table && !table->captures && table->outputs) table = read_table(fd->get(), path, true, enumerate);
    if (table) all.push_back(std::move(*table));
  }
  return all;
}

Result<std::string> find_node(const std::string& selector, bool output) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  if (selector.starts_with('/')) {
    if (fs::exists(selector, ignored)) return selector;
  } else if (const fs::path by_id = fs::path("/dev/v4l/by-id") / selector; fs::exists(by_id, ignored)) {
    return by_id.string();
  }
  std::string seen;
  std::vector<std::string> names;
  for (const DeviceTable& t : list_nodes(false)) {
    if (!(output ? t.outputs : t.captures)) continue;
    if (t.card == selector) return t.path;
    seen += fmt::format("{}{} ({})", seen.empty() ? "" : ", ", t.path, t.card);
    names.push_back(t.card);
    names.push_back(t.path);
  }
  const std::string near = nearest(selector, names);
  return fail(
      ErrorCode::not_found, "",
      fmt::format(
          "expected the path, card or link in /dev/v4l/by-id of a video device that {}, got \"{}\"{}; "
          "there {}",
          output ? "takes frames" : "captures", selector, near.empty() ? "" : "; did you mean " + near + "?",
          seen.empty() ? "is none (rigor doctor says why)" : "are " + seen));
}

}  // namespace rigor::v4l2
