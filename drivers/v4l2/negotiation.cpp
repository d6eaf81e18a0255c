#include "drivers/v4l2/negotiation.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace rigor::v4l2 {
namespace {

/// What a device offers, for messages: "YUYV, MJPG, GREY".
std::string formats_text(const DeviceTable& table) {
  std::string text;
  for (const OfferedFormat& f : table.formats) text += (text.empty() ? "" : ", ") + fourcc_text(f.code);
  return text.empty() ? "no format" : text;
}

const OfferedSize* size_of(const OfferedFormat& format, std::uint32_t width_px, std::uint32_t height_px) {
  for (const OfferedSize& s : format.sizes)
    if (s.holds(width_px, height_px)) return &s;
  return nullptr;
}

/// 1/30 s for 30 Hz; in units of 100 ns, as UVC counts, what the fields of an interval cannot hold.
Interval exactly(const Period& period) {
  constexpr std::int64_t kMost = std::numeric_limits<std::uint32_t>::max();
  if (period.rate_num() <= kMost && period.rate_den() <= kMost)
    return {static_cast<std::uint32_t>(period.rate_den()), static_cast<std::uint32_t>(period.rate_num())};
  return {static_cast<std::uint32_t>(std::llround(period.seconds() * 1e7)), 10'000'000};
}

/// The interval for this rate; numerator 0 where the device leaves the rate to others.
std::optional<Interval> interval_of(const OfferedSize& size, const Period& period) {
  if (period.ns() <= 0 || size.intervals.empty()) return Interval{};
  const double rate_hz = period.hz();
  if (size.continuous) {
    const double fastest = size.intervals.front().rate_hz(), slowest = size.intervals.back().rate_hz();
    if (rate_hz > fastest * (1 + kRateTolerance) || rate_hz < slowest * (1 - kRateTolerance))
      return std::nullopt;
    return exactly(period);
  }
  for (const Interval& i : size.intervals)
    if (std::abs(i.rate_hz() - rate_hz) <= kRateTolerance * rate_hz) return i;
  return std::nullopt;
}

/// "nearest is 640x480", or nothing where there are only ranges.
std::string nearest_size(const OfferedFormat& format, std::uint32_t width_px, std::uint32_t height_px) {
  const OfferedSize* best = nullptr;
  const auto far = [&](const OfferedSize& s) {
    return std::abs(static_cast<double>(s.min_width_px) - width_px) +
           std::abs(static_cast<double>(s.min_height_px) - height_px);
  };
  for (const OfferedSize& s : format.sizes)
    if (s.discrete() && (!best || far(s) < far(*best))) best = &s;
  return best ? fmt::format("; nearest is {}x{}", best->min_width_px, best->min_height_px) : "";
}

/// Sizes are tried on one format: a choice, or the key at fault and what is offered.
Result<FormatChoice> choose_in(const DeviceTable& table, const OfferedFormat& format,
                               const FormatRequest& r) {
  FormatChoice c{format.code, r.width_px, r.height_px, {}};
  if (c.width_px == 0) {
    c.width_px = table.current_width_px, c.height_px = table.current_height_px;
    if (!format.sizes.empty() && !size_of(format, c.width_px, c.height_px))
      c.width_px = format.sizes.front().min_width_px, c.height_px = format.sizes.front().min_height_px;
  }
  if (format.sizes.empty()) {  // the driver will say what it makes of it
    if (r.period.ns() > 0 && table.sets_rate) c.interval = exactly(r.period);
    return c;
  }
  const OfferedSize* size = size_of(format, c.width_px, c.height_px);
  if (!size)
    return fail(ErrorCode::bad_input, "width_px",
                fmt::format("expected a size that {} offers for {}: {}; got {}x{}{}", table.card,
                            fourcc_text(format.code), sizes_text(format), c.width_px, c.height_px,
                            nearest_size(format, c.width_px, c.height_px)));
  const auto interval = interval_of(*size, r.period);
  if (!interval)
    return fail(
        ErrorCode::bad_input, "rate_hz",
        fmt::format("expected a rate that {} offers for {} at {}x{}: {}; got {:.6g} Hz", table.card,
                    fourcc_text(format.code), c.width_px, c.height_px, rates_text(*size), r.period.hz()));
  c.interval = *interval;
  return c;
}

}  // namespace

std::span<const std::uint32_t> codes_for(PixelFormat format) noexcept {
#ifdef RIGOR_V4L2_WITH_JPEG
  static constexpr std::array kMono8{kGrey, kNv12, kYu12, kYuyv, kUyvy, kMjpg, kJpeg};
  static constexpr std::array kRgb8{kRgb3, kBgr3, kYuyv, kUyvy, kNv12, kYu12, kMjpg, kJpeg};
#else
  static constexpr std::array kMono8{kGrey, kNv12, kYu12, kYuyv, kUyvy};
  static constexpr std::array kRgb8{kRgb3, kBgr3, kYuyv, kUyvy, kNv12, kYu12};
#endif
  static constexpr std::array kMono10{kY10}, kMono12{kY12}, kBayer8{kRggb}, kBayer10{kRg10}, kBayer12{kRg12},
      kBayer16{kRg16}, kDepth{kZ16};
  static constexpr std::array kMono16{kY16, kY16Be}, kYuv422{kYuyv, kUyvy}, kYuv420{kNv12, kYu12};
  switch (format) {
    case PixelFormat::mono8:
      return kMono8;
    case PixelFormat::rgb8:
      return kRgb8;
    case PixelFormat::mono10:
      return kMono10;
    case PixelFormat::mono12:
      return kMono12;
    case PixelFormat::mono16:
      return kMono16;
    case PixelFormat::bayer_rg8:
      return kBayer8;
    case PixelFormat::bayer_rg10:
      return kBayer10;
    case PixelFormat::bayer_rg12:
      return kBayer12;
    case PixelFormat::bayer_rg16:
      return kBayer16;
    case PixelFormat::yuv422_8:
      return kYuv422;
    case PixelFormat::yuv420_sp:
      return kYuv420;
    case PixelFormat::coord3d_c16:
      return kDepth;
    case PixelFormat::mono12p:
      break;
  }
  return {};
}

std::optional<PixelFormat> same_bytes(std::uint32_t code) noexcept {
  for (const auto& list :
       {std::span<const PixelFormat>(kPixelFormats), std::span<const PixelFormat>(kVideoFormats)})
    for (const PixelFormat f : list)
      if (const auto codes = codes_for(f); !codes.empty() && codes.front() == code) return f;
  return std::nullopt;
}

Result<FormatChoice> negotiate(const DeviceTable& table, const FormatRequest& r) {
  const auto possible = codes_for(r.format);
  std::string names;
  for (const std::uint32_t code : possible) names += (names.empty() ? "" : ", ") + fourcc_text(code);
  if (possible.empty())
    return fail(ErrorCode::bad_input, "pixel_format",
                fmt::format("expected a format that video devices have, got {}", pfnc_name(r.format)));
  if (r.code != 0 && std::find(possible.begin(), possible.end(), r.code) == possible.end())
    return fail(ErrorCode::bad_input, "device_format",
                fmt::format("expected a format that gives {} samples: {}; got {}", pfnc_name(r.format), names,
                            fourcc_text(r.code)));
  if (r.code != 0 && !table.format(r.code))
    return fail(ErrorCode::bad_input, "device_format",
                fmt::format("expected a format that {} offers: {}; got {}", table.card, formats_text(table),
                            fourcc_text(r.code)));
  std::optional<Error> first;
  for (const std::uint32_t code : possible) {
    if (r.code != 0 && code != r.code) continue;
    const OfferedFormat* format = table.format(code);
    if (!format) continue;
    auto choice = choose_in(table, *format, r);
    if (choice) return choice;
    if (!first) first = choice.error();
  }
  if (first) return tl::unexpected<Error>(*first);
  return fail(
      ErrorCode::bad_input, "pixel_format",
      fmt::format("expected a format that {} offers or that can be made of one ({} is made of {}); it "
                  "offers {}",
                  table.card, pfnc_name(r.format), names, formats_text(table)));
}

}  // namespace rigor::v4l2
