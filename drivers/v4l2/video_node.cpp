#include "drivers/v4l2/video_node.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/dma-buf.h>
#include <linux/dma-heap.h>
#include <linux/udmabuf.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "drivers/v4l2/system_error.h"
#include "rt-core/device_text.h"

namespace rigor::v4l2 {
namespace {

// A device that lists more than this is not believed.
constexpr std::uint32_t kMostEntries = 512;
constexpr std::size_t kPage = 4096;

std::string text_of(const __u8* s, std::size_t size) {
  const auto* c = reinterpret_cast<const char*>(s);
  return device_text({c, strnlen(c, size)});
}

template <class T>
T zeroed() {
  T t;
  std::memset(&t, 0, sizeof t);
  return t;
}

std::uint32_t buffer_type(bool output) {
  return output ? V4L2_BUF_TYPE_VIDEO_OUTPUT : V4L2_BUF_TYPE_VIDEO_CAPTURE;
}

void read_intervals(int fd, std::uint32_t code, OfferedSize& size) {
  for (std::uint32_t i = 0; i < kMostEntries; ++i) {
    auto e = zeroed<v4l2_frmivalenum>();
    e.index = i, e.pixel_format = code;
    e.width = size.max_width_px, e.height = size.max_height_px;
    if (call(fd, VIDIOC_ENUM_FRAMEINTERVALS, &e) != 0) return;
    if (e.type == V4L2_FRMIVAL_TYPE_DISCRETE) {
      size.intervals.push_back({e.discrete.numerator, e.discrete.denominator});
    } else {
      size.continuous = true;
      size.intervals = {{e.stepwise.min.numerator, e.stepwise.min.denominator},
                        {e.stepwise.max.numerator, e.stepwise.max.denominator}};
      return;
    }
  }
}

void read_sizes(int fd, OfferedFormat& format) {
  for (std::uint32_t i = 0; i < kMostEntries; ++i) {
    auto e = zeroed<v4l2_frmsizeenum>();
    e.index = i, e.pixel_format = format.code;
    if (call(fd, VIDIOC_ENUM_FRAMESIZES, &e) != 0) return;
    OfferedSize s;
    const bool discrete = e.type == V4L2_FRMSIZE_TYPE_DISCRETE;
    if (discrete) {
      s.min_width_px = s.max_width_px = e.discrete.width;
      s.min_height_px = s.max_height_px = e.discrete.height;
    } else {
      s.min_width_px = e.stepwise.min_width, s.max_width_px = e.stepwise.max_width;
      s.min_height_px = e.stepwise.min_height, s.max_height_px = e.stepwise.max_height;
      s.step_width_px = e.stepwise.step_width, s.step_height_px = e.stepwise.step_height;
    }
    read_intervals(fd, format.code, s);
    format.sizes.push_back(std::move(s));
    if (!discrete) return;
  }
}

ControlType type_of(std::uint32_t type) {
  switch (type) {
    case V4L2_CTRL_TYPE_INTEGER:
      return ControlType::integer;
    case V4L2_CTRL_TYPE_BOOLEAN:
      return ControlType::boolean;
    case V4L2_CTRL_TYPE_MENU:
      return ControlType::menu;
    case V4L2_CTRL_TYPE_BUTTON:
      return ControlType::button;
    case V4L2_CTRL_TYPE_INTEGER64:
      return ControlType::integer64;
    case V4L2_CTRL_TYPE_BITMASK:
      return ControlType::bitmask;
    case V4L2_CTRL_TYPE_INTEGER_MENU:
      return ControlType::integer_menu;
    default:
      return ControlType::other;
  }
}

void read_controls(int fd, DeviceTable& table) {
  auto q = zeroed<v4l2_query_ext_ctrl>();
  q.id = V4L2_CTRL_FLAG_NEXT_CTRL;
  for (std::uint32_t seen = 0; seen < kMostEntries && call(fd, VIDIOC_QUERY_EXT_CTRL, &q) == 0; ++seen) {
    const std::uint32_t id = q.id;
    if (q.type != V4L2_CTRL_TYPE_CTRL_CLASS && (q.flags & V4L2_CTRL_FLAG_DISABLED) == 0) {
      Control c;
      c.id = id;
      c.name = control_key(std::string_view(q.name, strnlen(q.name, sizeof q.name)));
      c.type = type_of(q.type);
      c.minimum = q.minimum, c.maximum = q.maximum;
      c.step = static_cast<std::int64_t>(q.step);
      c.fallback = q.default_value;
      c.read_only = (q.flags & V4L2_CTRL_FLAG_READ_ONLY) != 0;
      c.inactive = (q.flags & V4L2_CTRL_FLAG_INACTIVE) != 0;
      if (c.type == ControlType::menu || c.type == ControlType::integer_menu)
        for (std::int64_t i = q.minimum; i <= q.maximum && i - q.minimum < std::int64_t{kMostEntries}; ++i) {
          auto m = zeroed<v4l2_querymenu>();
          m.id = id, m.index = static_cast<std::uint32_t>(i);
          if (call(fd, VIDIOC_QUERYMENU, &m) != 0) continue;
          c.items.push_back(
              {i, c.type == ControlType::menu ? text_of(m.name, sizeof m.name) : std::to_string(m.value)});
        }
      table.controls.push_back(std::move(c));
    }
    q = zeroed<v4l2_query_ext_ctrl>();
    q.id = id | V4L2_CTRL_FLAG_NEXT_CTRL;
  }
}

/// A dma-buf of at least `size` bytes that no device made; `from` says what made it.
FileDescriptor make_dmabuf(std::size_t size, std::string& from) {
  static constexpr const char* kHeap = "/dev/dma_heap/system";
  if (const FileDescriptor heap(open(kHeap, O_RDWR | O_CLOEXEC)); heap.is_open()) {
    auto a = zeroed<dma_heap_allocation_data>();
    a.len = size, a.fd_flags = O_RDWR | O_CLOEXEC;
    if (call(heap.get(), DMA_HEAP_IOCTL_ALLOC, &a) == 0) {
      from = kHeap;
      return FileDescriptor(static_cast<int>(a.fd));
    }
  }
  const FileDescriptor maker(open("/dev/udmabuf", O_RDWR | O_CLOEXEC));
  if (!maker.is_open()) return {};
  const FileDescriptor memory(memfd_create("rigor-v4l2", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  // udmabuf wants memory that cannot shrink under it.
  if (!memory.is_open() || ftruncate(memory.get(), static_cast<off_t>(size)) != 0 ||
      fcntl(memory.get(), F_ADD_SEALS, F_SEAL_SHRINK) != 0)
    return {};
  auto c = zeroed<udmabuf_create>();
  c.memfd = static_cast<__u32>(memory.get());
  c.flags = UDMABUF_FLAGS_CLOEXEC;
  c.size = size;
  const int fd = ioctl(maker.get(), UDMABUF_CREATE, &c);
  if (fd < 0) return {};
  from = "/dev/udmabuf";
  return FileDescriptor(fd);
}

int request(int fd, bool output, std::uint32_t memory, std::uint32_t& count) {
  auto r = zeroed<v4l2_requestbuffers>();
  r.count = count, r.type = buffer_type(output), r.memory = memory;
  const int status = call(fd, VIDIOC_REQBUFS, &r);
  count = r.count;
  return status;
}

}  // namespace

int call(int fd, unsigned long request, void* argument) noexcept {
  int status = 0;
  do {
    status = ioctl(fd, request, argument);
  } while (status < 0 && errno == EINTR);
  return status < 0 ? -errno : 0;
}

Result<FileDescriptor> open_node(const std::string& path) {
  FileDescriptor fd(open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  if (fd.is_open()) return fd;
  const int error = errno;
  if (error == ENOENT || error == ENODEV || error == ENXIO)
    return fail(ErrorCode::not_found, path,
                "expected a video device, found none; `rigor devices` lists what is there");
  if (error == EACCES || error == EPERM)
    return fail(ErrorCode::unavailable, path,
                "expected the right to open it: sudo usermod -aG video $USER, and log in again");
  return system_error(path, "cannot open it", -error);
}

Result<DeviceTable> read_table(int fd, const std::string& path, bool output, bool enumerate) {
  auto caps = zeroed<v4l2_capability>();
  if (const int e = call(fd, VIDIOC_QUERYCAP, &caps); e != 0)
    return e == -ENOTTY ? Result<DeviceTable>(
                              fail(ErrorCode::not_found, path, "expected a video device, found another"))
                        : system_error(path, "VIDIOC_QUERYCAP", e);
  DeviceTable t;
  t.path = path;
  t.driver = text_of(caps.driver, sizeof caps.driver);
  t.card = text_of(caps.card, sizeof caps.card);
  t.bus = text_of(caps.bus_info, sizeof caps.bus_info);
  const std::uint32_t c =
      (caps.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? caps.device_caps : caps.capabilities;
  t.captures = (c & V4L2_CAP_VIDEO_CAPTURE) != 0;
  t.outputs = (c & V4L2_CAP_VIDEO_OUTPUT) != 0;
  t.streams = (c & V4L2_CAP_STREAMING) != 0;
  t.writes = (c & V4L2_CAP_READWRITE) != 0;
  t.multiplanar =
      !t.captures && !t.outputs &&
      (c & (V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_VIDEO_OUTPUT_MPLANE | V4L2_CAP_VIDEO_M2M_MPLANE)) != 0;
  if (!(output ? t.outputs : t.captures)) return t;

  auto parm = zeroed<v4l2_streamparm>();
  parm.type = buffer_type(output);
  if (call(fd, VIDIOC_G_PARM, &parm) == 0)
    t.sets_rate =
        ((output ? parm.parm.output.capability : parm.parm.capture.capability) & V4L2_CAP_TIMEPERFRAME) != 0;
  auto format = zeroed<v4l2_format>();
  format.type = buffer_type(output);
  if (call(fd, VIDIOC_G_FMT, &format) == 0) {
    t.current_code = format.fmt.pix.pixelformat;
    t.current_width_px = format.fmt.pix.width, t.current_height_px = format.fmt.pix.height;
  }
  if (!enumerate) return t;
  for (std::uint32_t i = 0; i < kMostEntries; ++i) {
    auto f = zeroed<v4l2_fmtdesc>();
    f.index = i, f.type = buffer_type(output);
    if (call(fd, VIDIOC_ENUM_FMT, &f) != 0) break;
    OfferedFormat offered{f.pixelformat, text_of(f.description, sizeof f.description), {}};
    if (!output) read_sizes(fd, offered);
    t.formats.push_back(std::move(offered));
  }
  read_controls(fd, t);
  return t;
}

Result<ActualFormat> set_node_format(int fd, const std::string& path, const FormatChoice& choice, bool output,
                                     bool set_rate) {
  auto f = zeroed<v4l2_format>();
  f.type = buffer_type(output);
  f.fmt.pix.width = choice.width_px, f.fmt.pix.height = choice.height_px;
  f.fmt.pix.pixelformat = choice.code;
  f.fmt.pix.field = V4L2_FIELD_NONE;
  f.fmt.pix.colorspace = V4L2_COLORSPACE_SRGB;
  f.fmt.pix.ycbcr_enc = V4L2_YCBCR_ENC_601;
  if (const int e = call(fd, VIDIOC_S_FMT, &f); e != 0) return system_error(path, "VIDIOC_S_FMT", e);
  ActualFormat a;
  a.code = f.fmt.pix.pixelformat, a.width_px = f.fmt.pix.width, a.height_px = f.fmt.pix.height;
  a.stride_bytes = f.fmt.pix.bytesperline, a.size_bytes = f.fmt.pix.sizeimage;
  auto parm = zeroed<v4l2_streamparm>();
  parm.type = buffer_type(output);
  v4l2_fract& rate = output ? parm.parm.output.timeperframe : parm.parm.capture.timeperframe;
  const std::uint32_t& capability = output ? parm.parm.output.capability : parm.parm.capture.capability;
  if (call(fd, VIDIOC_G_PARM, &parm) != 0) return a;
  // v4l2loopback takes a writer's rate and hands it on to readers, but does not announce that it does.
  if (set_rate && choice.interval.numerator != 0 && (output || (capability & V4L2_CAP_TIMEPERFRAME) != 0)) {
    rate.numerator = choice.interval.numerator, rate.denominator = choice.interval.denominator;
    const int e = call(fd, VIDIOC_S_PARM, &parm);
    if (e != 0 && !output) return system_error(path, "VIDIOC_S_PARM", e);
  }
  if (rate.denominator != 0) a.interval = {rate.numerator, rate.denominator};
  return a;
}

NodeBuffers& NodeBuffers::operator=(NodeBuffers&& o) noexcept {
  std::swap(buffers_, o.buffers_);
  std::swap(origin_, o.origin_);
  std::swap(output_, o.output_);
  std::swap(imported_, o.imported_);
  return *this;
}
NodeBuffers::~NodeBuffers() { clear(); }
void NodeBuffers::clear() noexcept {
  for (Buffer& b : buffers_)
    if (b.at) munmap(b.at, b.size);
  buffers_.clear();
}

Result<NodeBuffers> NodeBuffers::create(int fd, const std::string& path, bool output, BufferMemory memory,
                                        std::uint32_t count, std::uint32_t size_bytes) {
  NodeBuffers all;
  all.output_ = output;
  all.origin_ = "mmap";
  const std::size_t size = (std::size_t{size_bytes} + kPage - 1) / kPage * kPage;
  const auto map = [&](Buffer& b, int from, off_t offset) {
    void* at = ::mmap(nullptr, b.size, PROT_READ | PROT_WRITE, MAP_SHARED, from, offset);
    if (at == MAP_FAILED) return false;
    b.at = static_cast<std::byte*>(at);
    return true;
  };
  if (memory == BufferMemory::dmabuf) {
    std::string from;
    std::uint32_t wanted = count;
    Buffer first;
    first.size = size;
    first.dmabuf = make_dmabuf(size, from);
    if (first.dmabuf.is_open() && request(fd, output, V4L2_MEMORY_DMABUF, wanted) == 0 && wanted != 0) {
      bool good = map(first, first.dmabuf.get(), 0);
      all.buffers_.push_back(std::move(first));
      while (good && all.buffers_.size() < wanted) {
        Buffer b;
        b.size = size;
        b.dmabuf = make_dmabuf(size, from);
        good = b.dmabuf.is_open() && map(b, b.dmabuf.get(), 0);
        all.buffers_.push_back(std::move(b));
      }
      if (good) {
        all.imported_ = true;
        all.origin_ = "dmabuf imported from " + from;
        return all;
      }
      all.clear();
      wanted = 0;
      (void)request(fd, output, V4L2_MEMORY_DMABUF, wanted);
    }
  }
  std::uint32_t got = count;
  if (const int e = request(fd, output, V4L2_MEMORY_MMAP, got); e != 0)
    return system_error(path, "VIDIOC_REQBUFS", e);
  if (got == 0) return fail(ErrorCode::io, path, "expected buffers from the device, got none");
  for (std::uint32_t i = 0; i < got; ++i) {
    auto q = zeroed<v4l2_buffer>();
    q.index = i, q.type = buffer_type(output), q.memory = V4L2_MEMORY_MMAP;
    if (const int e = call(fd, VIDIOC_QUERYBUF, &q); e != 0) return system_error(path, "VIDIOC_QUERYBUF", e);
    Buffer b;
    b.size = q.length;
    if (memory == BufferMemory::dmabuf) {
      auto x = zeroed<v4l2_exportbuffer>();
      x.type = buffer_type(output), x.index = i, x.flags = O_RDWR | O_CLOEXEC;
      if (const int e = call(fd, VIDIOC_EXPBUF, &x); e != 0)
        return fail(ErrorCode::unavailable, path,
                    std::string("expected a device that imports or exports dma-bufs, got VIDIOC_EXPBUF: ") +
                        std::strerror(-e) + "; use `memory: mmap`");
      b.dmabuf = FileDescriptor(x.fd);
      all.origin_ = "dmabuf exported by the device";
    }
    if (!map(b, b.dmabuf.is_open() ? b.dmabuf.get() : fd,
             b.dmabuf.is_open() ? 0 : static_cast<off_t>(q.m.offset)))
      return system_error(path, "cannot map a frame's memory", -errno);
    all.buffers_.push_back(std::move(b));
  }
  return all;
}

std::span<std::byte> NodeBuffers::memory(std::uint32_t index) const noexcept {
  return index < buffers_.size() ? std::span<std::byte>(buffers_[index].at, buffers_[index].size)
                                 : std::span<std::byte>{};
}

void NodeBuffers::describe(v4l2_buffer& b, std::uint32_t index) const noexcept {
  b.index = index;
  b.type = buffer_type(output_);
  b.memory = imported_ ? V4L2_MEMORY_DMABUF : V4L2_MEMORY_MMAP;
  if (imported_ && index < buffers_.size()) {
    b.m.fd = buffers_[index].dmabuf.get();
    b.length = static_cast<__u32>(buffers_[index].size);
  }
}

namespace {
void sync(int fd, std::uint64_t flags) {
  if (fd < 0) return;
  dma_buf_sync s{};
  s.flags = flags;
  (void)call(fd, DMA_BUF_IOCTL_SYNC, &s);
}
}  // namespace

void NodeBuffers::begin_access(std::uint32_t index, bool write) const noexcept {
  sync(dmabuf_fd(index), DMA_BUF_SYNC_START | (write ? DMA_BUF_SYNC_WRITE : DMA_BUF_SYNC_READ));
}
void NodeBuffers::end_access(std::uint32_t index, bool write) const noexcept {
  sync(dmabuf_fd(index), DMA_BUF_SYNC_END | (write ? DMA_BUF_SYNC_WRITE : DMA_BUF_SYNC_READ));
}
int NodeBuffers::dmabuf_fd(std::uint32_t index) const noexcept {
  return index < buffers_.size() ? buffers_[index].dmabuf.get() : -1;
}

}  // namespace rigor::v4l2
