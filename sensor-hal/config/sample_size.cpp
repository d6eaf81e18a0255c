#include "sensor-hal/config/sample_size.h"

#include <unistd.h>

#include <cstdio>
#include <string>

namespace rigor {
namespace {

std::string gib(double bytes) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g GiB", bytes / (1 << 30));
  return text;
}

}  // namespace

void check_picture_size(const ConfigNode& n, std::uint64_t width_px, std::uint64_t height_px) {
  if (height_px == 0 || width_px <= kMostPicturePixels / height_px) return;
  throw n.error("width_px", "expected a picture of at most " + std::to_string(kMostPicturePixels) +
                                " pixels (16384 x 16384), got " + std::to_string(width_px) + " x " +
                                std::to_string(height_px));
}

void check_buffer_memory(const ConfigNode& n, std::string_view key, std::uint64_t count,
                         std::uint64_t bytes) {
  const double wanted = static_cast<double>(count) * static_cast<double>(bytes);
  const double there =
      static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  if (wanted <= there) return;
  throw n.error(key, "expected buffers that fit in this machine's memory of " + gib(there) + ", got " +
                         std::to_string(count) + " of " + gib(static_cast<double>(bytes)) +
                         " each; give fewer, or smaller samples");
}

}  // namespace rigor
