#include "calibration/photon/frame_stacks.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <tuple>

namespace rigor::calibration {
namespace {

bool same(double a, double b) { return (std::isnan(a) && std::isnan(b)) || a == b; }

std::uint64_t hash_of(std::span<const std::uint16_t> pixels) {
  std::uint64_t h = 14695981039346656037u;  // FNV-1a over words
  for (const std::uint16_t p : pixels) h = (h ^ p) * 1099511628211u;
  return h;
}

}  // namespace

std::string PhotonLevel::text() const {
  char text[96];
  std::snprintf(text, sizeof text, "%s %.6g ms", settings.light ? "light" : "dark",
                settings.exposure_s * 1e3);
  std::string s = text;
  if (std::isfinite(settings.temperature_c)) {
    std::snprintf(text, sizeof text, " at %.3g °C", settings.temperature_c);
    s += text;
  }
  return s;
}

Status FrameStacks::add(const PhotonFrame& frame, std::span<const std::uint16_t> pixels, int width_px,
                        int height_px) {
  if (!(frame.exposure_s > 0) || !std::isfinite(frame.exposure_s))
    return fail(ErrorCode::bad_input, frame.name,
                "expected an exposure time above 0, got " + std::to_string(frame.exposure_s) + " s");
  if (levels_.empty()) {
    width_px_ = width_px, height_px_ = height_px, first_ = frame.name;
  } else if (width_px != width_px_ || height_px != height_px_) {
    return fail(ErrorCode::bad_input, frame.name,
                "expected pictures of one size, got " + std::to_string(width_px) + "x" +
                    std::to_string(height_px) + " and before it " + std::to_string(width_px_) + "x" +
                    std::to_string(height_px_) + " (" + first_ + "): one camera, one mode at a time");
  }
  const std::size_t n = static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  if (pixels.size() != n || n == 0)
    return fail(ErrorCode::bad_input, frame.name,
                "expected " + std::to_string(n) + " pixels, got " + std::to_string(pixels.size()));
  if (levels_.size() > 0 && levels_.front().settings.gain_db != frame.gain_db)
    return fail(ErrorCode::bad_input, frame.name,
                "expected one gain, got " + std::to_string(frame.gain_db) + " dB and before it " +
                    std::to_string(levels_.front().settings.gain_db) + " dB (" + first_ +
                    "): calibrate each gain by itself");
  auto it = std::find_if(levels_.begin(), levels_.end(), [&](const PhotonLevel& l) {
    return l.settings.light == frame.light && l.settings.exposure_s == frame.exposure_s &&
           same(l.settings.temperature_c, frame.temperature_c);
  });
  if (it == levels_.end()) {
    PhotonLevel level;
    level.settings = frame;
    level.sum.assign(n, 0);
    level.square.assign(n, 0);
    level.least.assign(n, 65535);
    level.most.assign(n, 0);
    const auto key = [](const PhotonFrame& f) {
      return std::tuple(f.light, std::isnan(f.temperature_c) ? -1e9 : f.temperature_c, f.exposure_s);
    };
    it = std::find_if(levels_.begin(), levels_.end(),
                      [&](const PhotonLevel& l) { return key(frame) < key(l.settings); });
    it = levels_.insert(it, std::move(level));
  }
  PhotonLevel& level = *it;
  const auto [low, high] = std::minmax_element(pixels.begin(), pixels.end());
  const std::uint64_t hash = hash_of(pixels);
  if (*low != *high && std::find(level.hashes.begin(), level.hashes.end(), hash) != level.hashes.end()) {
    copies_.push_back(frame.name);
    return {};
  }
  level.hashes.push_back(hash);
  level.frames.push_back(frame.name);
  level.last.assign(pixels.begin(), pixels.end());
  std::array<double, 4> mean{};
  std::array<std::uint64_t, 4> number{};
  for (int y = 0; y < height_px; ++y)
    for (int x = 0; x < width_px; ++x) {
      const std::size_t i =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px) + static_cast<std::size_t>(x);
      const std::uint16_t p = pixels[i];
      level.sum[i] += p;
      level.square[i] += std::uint64_t{p} * p;
      level.least[i] = std::min(level.least[i], p);
      level.most[i] = std::max(level.most[i], p);
      seen_[p] = true;
      const auto phase = static_cast<std::size_t>((y & 1) * 2 + (x & 1));
      mean[phase] += p;
      ++number[phase];
    }
  for (std::size_t k = 0; k < 4; ++k) mean[k] /= static_cast<double>(std::max<std::uint64_t>(1, number[k]));
  level.frame_mean.push_back(mean);
  largest_ = std::max<int>(largest_, *high);
  return {};
}

int FrameStacks::step() const {
  int g = 0;
  for (int v = 1; v < 65536; ++v)
    if (seen_[static_cast<std::size_t>(v)]) g = std::gcd(g, v);
  // 4095 << 4 and 0 alone would give 65520: only powers of two are shifts.
  return g == 0 ? 1 : (g & -g);
}

}  // namespace rigor::calibration
