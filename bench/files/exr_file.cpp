#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>

#include <algorithm>

#include "bench/files/picture_file.h"

namespace rigor {
namespace {

/// OpenEXR writes its line offsets when the rest is there: it goes back.
class MemoryStream final : public Imf::OStream {
 public:
  MemoryStream() : Imf::OStream("memory") {}
  void write(const char c[], int n) override {
    const auto size = static_cast<std::size_t>(n);
    if (bytes_.size() < at_ + size) bytes_.resize(at_ + size);
    std::copy_n(c, size, bytes_.begin() + static_cast<std::ptrdiff_t>(at_));
    at_ += size;
  }
  std::uint64_t tellp() override { return at_; }
  void seekp(std::uint64_t to) override { at_ = static_cast<std::size_t>(to); }
  [[nodiscard]] std::string take() { return std::move(bytes_); }

 private:
  std::string bytes_;
  std::size_t at_ = 0;
};

}  // namespace

Result<std::string> exr_bytes(std::uint32_t width_px, std::uint32_t height_px,
                              const std::vector<ExrPlane>& planes, const std::string& class_names) {
  try {
    Imf::Header header(static_cast<int>(width_px), static_cast<int>(height_px));
    if (!class_names.empty()) header.insert("class_names", Imf::StringAttribute(class_names));
    Imf::FrameBuffer buffer;
    for (const ExrPlane& p : planes) {
      const Imf::PixelType type = p.whole_numbers ? Imf::UINT : Imf::FLOAT;
      header.channels().insert(p.name, Imf::Channel(type));
      auto* base = const_cast<char*>(static_cast<const char*>(p.data));  // OpenEXR reads only
      buffer.insert(p.name, Imf::Slice(type, base, p.stride, p.stride * width_px));
    }
    MemoryStream stream;
    {
      Imf::OutputFile out(stream, header);
      out.setFrameBuffer(buffer);
      out.writePixels(static_cast<int>(height_px));
    }
    return stream.take();
  } catch (const std::exception& e) {
    return fail(ErrorCode::internal, "OpenEXR", e.what());
  }
}

}  // namespace rigor
