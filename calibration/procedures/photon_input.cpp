#include "calibration/procedures/photon_input.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <regex>
#include <sstream>

#include "calibration/procedures/input_files.h"
#include "calibration/procedures/recording_input.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
using calibration::PhotonFrame;

std::string lower(std::string s) {
  std::transform(s.begin(), s.end(), s.begin(), [](unsigned char c) { return std::tolower(c); });
  return s;
}

/// What a file's name says.
PhotonFrame frame_of_name(const fs::path& file, bool dark, double temperature_c) {
  PhotonFrame f;
  f.name = file.filename().string();
  const std::string name = lower(file.stem().string());
  f.light = !dark && name.find("dark") == std::string::npos;
  f.temperature_c = temperature_c;
  static const std::regex exposure(R"((?:^|[_\- ])([0-9]+(?:\.[0-9]+)?)(us|ms|s)(?=$|[_\- ]))");
  static const std::regex temperature(R"((?:^|[_\- ])(-?[0-9]+(?:\.[0-9]+)?)(?:deg)?c(?=$|[_\- ]))");
  std::smatch m;
  if (std::regex_search(name, m, exposure))
    f.exposure_s = std::stod(m[1]) * (m[2] == "us" ? 1e-6 : m[2] == "ms" ? 1e-3 : 1);
  if (std::regex_search(name, m, temperature)) f.temperature_c = std::stod(m[1]);
  return f;
}

Status read_picture(const fs::path& file, PhotonPicture& p) {
  if (lower(file.extension().string()) == ".exr")
    return fail(ErrorCode::bad_input, file.string(),
                "expected the converter's whole numbers (PNG, TIFF, PGM …), got OpenEXR, whose values are "
                "fractions and "
                "may be none (NaN): write the raw picture, as in rigor sense … -o flat_20ms_1.png");
  const cv::Mat image = cv::imread(file.string(), cv::IMREAD_UNCHANGED);
  if (image.empty())
    return fail(ErrorCode::bad_input, file.string(),
                "expected a picture (PNG, TIFF, PGM …), got none that can be read");
  if (image.depth() != CV_8U && image.depth() != CV_16U)
    return fail(
        ErrorCode::bad_input, file.string(),
        "expected the converter's whole numbers of 8 or 16 bits, got fractions (float): write raw pictures");
  p.width_px = image.cols, p.height_px = image.rows;
  p.bits = image.depth() == CV_8U ? 8 : 0;
  const int channels = image.channels();
  p.pixels.resize(static_cast<std::size_t>(image.cols) * static_cast<std::size_t>(image.rows));
  std::size_t i = 0;
  for (int y = 0; y < image.rows; ++y)
    for (int x = 0; x < image.cols; ++x, ++i) {
      const auto at = [&](int c) {
        return image.depth() == CV_8U ? image.ptr<std::uint8_t>(y)[x * channels + c]
                                      : image.ptr<std::uint16_t>(y)[x * channels + c];
      };
      p.pixels[i] = static_cast<std::uint16_t>(at(0));
      for (int c = 1; c < std::min(3, channels); ++c)
        if (at(c) != at(0))
          return fail(
              ErrorCode::bad_input, file.string(),
              "expected grey or a raw mosaic, one number for each pixel, got colours that were worked out of "
              "them (demosaicing averages the noise away): take raw pictures");
    }
  return {};
}

Status read_sample(const Sample& sample, PhotonPicture& p) {
  const auto* info = sample.as<ImageInfo>();
  p.width_px = static_cast<int>(info->width_px), p.height_px = static_cast<int>(info->height_px);
  p.frame.exposure_s = info->exposure.seconds();
  p.frame.gain_db = info->gain_db;
  const std::size_t n = static_cast<std::size_t>(info->width_px) * info->height_px;
  p.pixels.resize(n);
  const auto bytes = sample.bytes();
  p.mosaic = false;
  switch (info->format) {
    case PixelFormat::bayer_rg8:
      p.mosaic = true;
      [[fallthrough]];
    case PixelFormat::mono8:
      p.bits = 8;
      for (std::size_t i = 0; i < n; ++i) p.pixels[i] = std::to_integer<std::uint16_t>(bytes[i]);
      return {};
    case PixelFormat::mono12p:
      p.bits = 12;
      for (std::size_t i = 0; i < n; ++i) {
        const std::size_t at = i / 2 * 3;
        const auto b = [&](std::size_t k) { return std::to_integer<unsigned>(bytes[at + k]); };
        p.pixels[i] =
            static_cast<std::uint16_t>(i % 2 == 0 ? b(0) | (b(1) & 15u) << 8 : b(1) >> 4 | b(2) << 4);
      }
      return {};
    case PixelFormat::bayer_rg10:
    case PixelFormat::bayer_rg12:
    case PixelFormat::bayer_rg16:
      p.mosaic = true;
      [[fallthrough]];
    case PixelFormat::mono10:
    case PixelFormat::mono12:
    case PixelFormat::mono16:
      p.bits = info->format == PixelFormat::mono10 || info->format == PixelFormat::bayer_rg10   ? 10
               : info->format == PixelFormat::mono12 || info->format == PixelFormat::bayer_rg12 ? 12
                                                                                                : 0;
      std::memcpy(p.pixels.data(), bytes.data(), 2 * n);
      return {};
    default:
      return fail(ErrorCode::bad_input, p.frame.name,
                  "expected grey or raw mosaic images, got colours that the camera worked out of them");
  }
}

std::vector<std::string> fields(const std::string& line) {
  std::vector<std::string> out;
  std::stringstream in(line);
  for (std::string f; std::getline(in, f, ',');) {
    const auto a = f.find_first_not_of(" \t\r\""), b = f.find_last_not_of(" \t\r\"");
    out.push_back(a == std::string::npos ? "" : f.substr(a, b - a + 1));
  }
  return out;
}

Status read_list(const fs::path& file, double temperature_c, PhotonInput& input,
                 const std::function<Status(const PhotonPicture&)>& take) {
  std::ifstream in(file);
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    const auto f = fields(line);
    if (f.empty() || f[0].empty() || f[0][0] == '#' || (number == 1 && lower(f[0]) == "file")) continue;
    const auto wrong = [&](const std::string& what) {
      return fail(ErrorCode::bad_input, fmt::format("{}:{}", file.string(), number),
                  "expected `file, exposure_ms, light|dark[, temperature_c[, gain_db]]`, got " + what);
    };
    if (f.size() < 3) return wrong(fmt::format("{} fields", f.size()));
    PhotonPicture p;
    p.frame.name = f[0];
    p.frame.temperature_c = temperature_c;
    try {
      p.frame.exposure_s = std::stod(f[1]) * 1e-3;
      if (f.size() > 3 && !f[3].empty()) p.frame.temperature_c = std::stod(f[3]);
      if (f.size() > 4 && !f[4].empty()) p.frame.gain_db = std::stod(f[4]);
    } catch (const std::exception&) {
      return wrong("\"" + line + "\"");
    }
    if (f[2] != "light" && f[2] != "dark") return wrong("\"" + f[2] + "\"");
    p.frame.light = f[2] == "light";
    const fs::path picture = fs::path(f[0]).is_absolute() ? fs::path(f[0]) : file.parent_path() / f[0];
    if (auto s = read_picture(picture, p); !s) return s;
    input.files.push_back(picture);
    if (auto s = take(p); !s) return s;
  }
  return {};
}

}  // namespace

Result<PhotonInput> read_photon_pictures(const CalibrationInputs& options, const PhotonInputOptions& more,
                                         const std::function<Status(const PhotonPicture&)>& take) {
  PhotonInput input;
  const std::vector<std::string> extensions{".png", ".tif", ".tiff", ".pgm",
                                            ".bmp", ".jpg", ".jpeg", ".mcap"};
  for (const bool dark : {false, true}) {
    const auto& given = dark ? more.dark : options.inputs;
    if (given.empty()) continue;
    const auto files = input_files(given, extensions);
    if (!files) return tl::unexpected<Error>(files.error());
    for (const fs::path& file : *files) {
      if (lower(file.extension().string()) == ".csv") {
        input.files.push_back(file);
        if (auto s = read_list(file, more.temperature_c, input, take); !s)
          return tl::unexpected<Error>(s.error());
        continue;
      }
      input.files.push_back(file);
      PhotonPicture p;
      p.frame = frame_of_name(file, dark, more.temperature_c);
      if (is_recording(file)) {
        Status status;
        const PhotonFrame frame = p.frame;
        std::uint64_t index = 0;
        const auto read = read_samples(file, options.channel, SampleKind::image, [&](const Sample& sample) {
          p.frame = frame;
          p.frame.name += fmt::format(" sample {}", index++);
          status = read_sample(sample, p);
          if (status && !(p.frame.exposure_s > 0)) {
            if (more.exposure_needed && !(frame.exposure_s > 0))
              status = fail(
                  ErrorCode::bad_input, p.frame.name,
                  "expected images with their exposure (a topic `…/settings` beside them), got none; name it "
                  "in the file's name, as in dark_20ms.mcap");
            p.frame.exposure_s = frame.exposure_s > 0 ? frame.exposure_s : 1;
          }
          if (status) status = take(p);
          return status.has_value();
        });
        if (!status) return tl::unexpected<Error>(status.error());
        if (!read) return tl::unexpected<Error>(read.error());
        for (const std::string& w : read->warnings)
          input.warnings.push_back(file.filename().string() + ": " + w);
        continue;
      }
      if (auto s = read_picture(file, p); !s) return tl::unexpected<Error>(s.error());
      if (!(p.frame.exposure_s > 0)) {
        if (more.exposure_needed)
          return fail(
              ErrorCode::bad_input, file.string(),
              "expected the exposure time in the file's name, as in flat_20ms_1.png or dark_20ms_1.png, or a "
              "list (.csv) that states it");
        p.frame.exposure_s = 1;
      }
      if (auto s = take(p); !s) return tl::unexpected<Error>(s.error());
    }
  }
  return input;
}

}  // namespace rigor
