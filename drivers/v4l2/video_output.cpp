#include "drivers/v4l2/video_output.h"

#include <linux/videodev2.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fmt/format.h>

namespace rigor::v4l2 {

Result<VideoOutput> VideoOutput::open(const std::string& path, const FormatChoice& choice, OutputWay way) {
  auto fd = open_node(path);
  if (!fd) return tl::unexpected<Error>(fd.error());
  const auto table = read_table(fd->get(), path, true, false);
  if (!table) return tl::unexpected<Error>(table.error());
  if (!table->outputs)
    return fail(ErrorCode::bad_input, path,
                "expected a device that takes frames (v4l2loopback, an output of vivid), got " + table->card +
                    ", which does not; a loop-back device that another program writes to does not either");
  if (!(way == OutputWay::write ? table->writes : table->streams))
    return fail(ErrorCode::bad_input, path,
                std::string("expected a device that takes frames by ") +
                    (way == OutputWay::write ? "write" : "mmap"));
  auto out = use(fd->get(), path, choice);
  if (!out) return out;
  out->own_ = std::move(*fd);
  out->way_ = way;
  return out;
}

Result<VideoOutput> VideoOutput::use(int fd, const std::string& path, const FormatChoice& choice) {
  VideoOutput out;
  auto format = set_node_format(fd, path, choice, true, true);
  if (!format) return tl::unexpected<Error>(format.error());
  out.format_ = *format;
  if (format->code != choice.code || format->width_px != choice.width_px ||
      format->height_px != choice.height_px)
    return fail(
        ErrorCode::bad_input, path,
        fmt::format("expected a device that takes {} {}x{}, got one that takes {} {}x{} instead (a loop-back "
                    "device keeps what its readers hold)",
                    fourcc_text(choice.code), choice.width_px, choice.height_px, fourcc_text(format->code),
                    format->width_px, format->height_px));
  const std::size_t row = frame_stride(choice.code, choice.width_px);
  if (row != 0 && format->stride_bytes > row)
    return fail(ErrorCode::unavailable, path,
                "expected a device that takes rows without padding, got one that does not");
  if (row != 0 && format->size_bytes < frame_bytes(choice.code, choice.width_px, choice.height_px))
    return fail(
        ErrorCode::unavailable, path,
        fmt::format(
            "expected a device with room for {} bytes in a frame of {}, got one with {}: v4l2loopback "
            "0.12 counts its pixels of 10 and 12 bits too short; use Y16",
            frame_bytes(choice.code, choice.width_px, choice.height_px), fourcc_text(choice.code),
            format->size_bytes));
  out.fd_ = fd;
  out.path_ = path;
  return out;
}

Status VideoOutput::allocate(std::uint32_t count) {
  fresh_ = current_ = 0;
  holds_ = streaming_ = false;
  const std::size_t size = std::max<std::size_t>(
      format_.size_bytes, frame_bytes(format_.code, format_.width_px, format_.height_px) *
                              (frame_stride(format_.code, format_.width_px) == 0 ? 0 : 1));
  if (way_ == OutputWay::write) {
    frame_.resize(size);
    return {};
  }
  buffers_ = {};
  auto b = NodeBuffers::create(fd_, path_, true, BufferMemory::mmap, count, format_.size_bytes);
  if (!b) return tl::unexpected<Error>(b.error());
  buffers_ = std::move(*b);
  return {};
}

std::span<std::byte> VideoOutput::next() noexcept {
  if (way_ == OutputWay::write) return frame_;
  if (holds_) return buffers_.memory(current_);
  if (fresh_ < buffers_.count()) {
    current_ = fresh_++;
  } else {
    v4l2_buffer b;
    std::memset(&b, 0, sizeof b);
    buffers_.describe(b, 0);
    if (call(fd_, VIDIOC_DQBUF, &b) != 0 || b.index >= buffers_.count()) return {};
    current_ = b.index;
  }
  holds_ = true;
  return buffers_.memory(current_);
}

bool VideoOutput::send(std::size_t bytes, MonotonicTime t, std::uint32_t sequence) noexcept {
  if (way_ == OutputWay::write) {
    const ssize_t n = ::write(fd_, frame_.data(), std::min(bytes, frame_.size()));
    return n == static_cast<ssize_t>(bytes);
  }
  if (!holds_) return false;
  v4l2_buffer b;
  std::memset(&b, 0, sizeof b);
  buffers_.describe(b, current_);
  b.bytesused = static_cast<__u32>(bytes);
  b.field = V4L2_FIELD_NONE;
  b.sequence = sequence;
  b.flags = V4L2_BUF_FLAG_TIMESTAMP_COPY;
  b.timestamp.tv_sec = t.ns() / 1'000'000'000;
  b.timestamp.tv_usec = t.ns() % 1'000'000'000 / 1000;
  if (call(fd_, VIDIOC_QBUF, &b) != 0) return false;
  holds_ = false;
  if (streaming_) return true;
  int type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
  streaming_ = call(fd_, VIDIOC_STREAMON, &type) == 0;
  return streaming_;
}

void VideoOutput::stop() noexcept {
  if (streaming_) {
    int type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    (void)call(fd_, VIDIOC_STREAMOFF, &type);
  }
  streaming_ = holds_ = false;
  buffers_ = {};
  fresh_ = 0;
}

}  // namespace rigor::v4l2
