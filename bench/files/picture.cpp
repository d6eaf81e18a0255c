// Samples as pictures for people.
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "bench/files/picture.h"
#include "bench/files/picture_file.h"

namespace rigor {
namespace {

/// PFNC Mono12p: two pixels in three bytes, least significant bits first.
cv::Mat unpack_mono12p(const ImageInfo& info, std::span<const std::byte> bytes) {
  cv::Mat out(static_cast<int>(info.height_px), static_cast<int>(info.width_px), CV_16U);
  auto* pixel = out.ptr<std::uint16_t>();
  const std::size_t n = std::size_t{info.width_px} * info.height_px;
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t at = i / 2 * 3 + i % 2;
    const unsigned lo = std::to_integer<unsigned>(bytes[at]), hi = std::to_integer<unsigned>(bytes[at + 1]);
    pixel[i] = static_cast<std::uint16_t>(i % 2 == 0 ? lo | (hi & 15u) << 8 : lo >> 4 | hi << 4);
  }
  return out;
}

cv::Mat to_eight_bits(const cv::Mat& words, PixelFormat format) {
  cv::Mat out;
  words.convertTo(out, CV_8U, 255.0 / ((1 << significant_bits(format)) - 1));
  return out;
}

/// Eight bits of grey or BGR; depths as they are. Null: fewer bytes than the size says.
cv::Mat shown(const ImageInfo& info, std::span<const std::byte> bytes) {
  if (info.width_px == 0 || info.height_px == 0 ||
      bytes.size() < image_bytes(info.format, info.width_px, info.height_px))
    return {};
  const int width = static_cast<int>(info.width_px), height = static_cast<int>(info.height_px);
  auto* data = const_cast<std::byte*>(bytes.data());
  cv::Mat out;
  switch (info.format) {
    case PixelFormat::mono8:
      out = cv::Mat(height, width, CV_8U, data);
      break;
    case PixelFormat::mono10:
    case PixelFormat::mono12:
    case PixelFormat::mono16:
      out = to_eight_bits(cv::Mat(height, width, CV_16U, data), info.format);
      break;
    case PixelFormat::mono12p:
      unpack_mono12p(info, bytes).convertTo(out, CV_8U, 1.0 / 16.06);
      break;
    // OpenCV names a Bayer pattern by its second row: RGGB is its BayerBG.
    case PixelFormat::bayer_rg8:
      cv::cvtColor(cv::Mat(height, width, CV_8U, data), out, cv::COLOR_BayerBG2BGR);
      break;
    case PixelFormat::bayer_rg10:
    case PixelFormat::bayer_rg12:
    case PixelFormat::bayer_rg16:
      cv::cvtColor(cv::Mat(height, width, CV_16U, data), out, cv::COLOR_BayerBG2BGR);
      out = to_eight_bits(out, info.format);
      break;
    case PixelFormat::rgb8:
      cv::cvtColor(cv::Mat(height, width, CV_8UC3, data), out, cv::COLOR_RGB2BGR);
      break;
    case PixelFormat::yuv422_8:
      cv::cvtColor(cv::Mat(height, width, CV_8UC2, data), out, cv::COLOR_YUV2BGR_YUY2);
      break;
    case PixelFormat::yuv420_sp:
      cv::cvtColor(cv::Mat(height * 3 / 2, width, CV_8U, data), out, cv::COLOR_YUV2BGR_NV12);
      break;
    case PixelFormat::coord3d_c16:  // numbers, not brightness: as they are
      out = cv::Mat(height, width, CV_16U, data);
      break;
  }
  return out;
}

tl::unexpected<Error> too_few(const std::string& where) {
  return fail(ErrorCode::internal, where, "a picture with fewer bytes than its size says");
}

/// Empty: it cannot be written.
std::vector<std::uint8_t> encoded_png(const cv::Mat& picture) {
  std::vector<std::uint8_t> file;
  try {
    if (!cv::imencode(".png", picture, file)) file.clear();
  } catch (const cv::Exception&) {
    file.clear();
  }
  return file;
}

}  // namespace

Result<std::vector<std::uint8_t>> grey_picture(const ImageInfo& info, std::span<const std::byte> bytes) {
  if (info.format == PixelFormat::coord3d_c16)
    return fail(ErrorCode::bad_input, "picture", "expected brightness, got depths (Coord3D_C16)");
  cv::Mat out = shown(info, bytes);
  if (out.empty()) return too_few("picture");
  if (out.channels() == 3) cv::cvtColor(out, out, cv::COLOR_BGR2GRAY);
  if (!out.isContinuous()) out = out.clone();
  return std::vector<std::uint8_t>(out.ptr(), out.ptr() + out.total());
}

Result<std::vector<std::uint8_t>> small_jpeg(const ImageInfo& info, std::span<const std::byte> bytes,
                                             std::uint32_t width_px) {
  if (info.format == PixelFormat::coord3d_c16)
    return fail(ErrorCode::bad_input, "picture", "expected brightness, got depths (Coord3D_C16)");
  const cv::Mat full = shown(info, bytes);
  if (full.empty()) return too_few("picture");
  cv::Mat small = full;
  if (info.width_px > width_px) {
    const double scale = static_cast<double>(width_px) / info.width_px;
    cv::resize(full, small, {}, scale, scale, cv::INTER_AREA);
  }
  std::vector<std::uint8_t> file;
  try {
    if (cv::imencode(".jpg", small, file, {cv::IMWRITE_JPEG_QUALITY, 80})) return file;
  } catch (const cv::Exception& e) {
    return fail(ErrorCode::internal, "picture", e.what());
  }
  return fail(ErrorCode::internal, "picture", "it cannot be written as JPEG");
}

std::vector<std::uint8_t> png_of(std::span<const std::uint8_t> pixels, int width_px, int height_px,
                                 int channels) {
  const cv::Mat given(height_px, width_px, CV_8UC(channels), const_cast<std::uint8_t*>(pixels.data()));
  cv::Mat out = given;
  if (channels == 3) cv::cvtColor(given, out, cv::COLOR_RGB2BGR);
  return encoded_png(out);
}

std::vector<std::uint8_t> png16_of(std::span<const std::uint16_t> values, int width_px, int height_px) {
  return encoded_png(cv::Mat(height_px, width_px, CV_16UC1, const_cast<std::uint16_t*>(values.data())));
}

Result<std::vector<double>> pixel_values(const ImageInfo& info, std::span<const std::byte> bytes) {
  const std::size_t size = image_bytes(info.format, info.width_px, info.height_px);
  if (bytes.size() < size) return too_few("picture");
  std::vector<double> values;
  if (info.format == PixelFormat::mono12p) {
    const cv::Mat words = unpack_mono12p(info, bytes);
    values.assign(words.ptr<std::uint16_t>(), words.ptr<std::uint16_t>() + words.total());
  } else if (significant_bits(info.format) > 8) {
    for (std::size_t i = 0; i + 1 < size; i += 2)
      values.push_back(std::to_integer<int>(bytes[i]) | std::to_integer<int>(bytes[i + 1]) << 8);
  } else {
    for (std::size_t i = 0; i < size; ++i) values.push_back(std::to_integer<int>(bytes[i]));
  }
  return values;
}

Result<std::string> picture_bytes(const std::string& extension, const ImageInfo& info,
                                  std::span<const std::byte> bytes) {
  cv::Mat out = shown(info, bytes);
  if (out.empty()) return too_few("picture");
  if (extension == ".exr") {
    // OpenEXR keeps the sensor's numbers as they are, in 32-bit float; PNG is for people.
    const int channels = out.channels();
    out.convertTo(out, CV_MAKETYPE(CV_32F, channels));
    if (!out.isContinuous()) out = out.clone();
    std::vector<ExrPlane> planes;
    const char* const names[] = {"B", "G", "R"};
    for (int c = 0; c < channels; ++c)
      planes.push_back({channels == 1 ? "Y" : names[c], false, out.ptr<float>() + c,
                        sizeof(float) * static_cast<std::size_t>(channels)});
    return exr_bytes(static_cast<std::uint32_t>(out.cols), static_cast<std::uint32_t>(out.rows), planes);
  }
  std::vector<std::uint8_t> file;
  try {
    if (cv::imencode(".png", out, file)) return std::string(file.begin(), file.end());
  } catch (const cv::Exception& e) {
    return fail(ErrorCode::internal, "picture", e.what());
  }
  return fail(ErrorCode::internal, "picture", "it cannot be made a PNG");
}

}  // namespace rigor
