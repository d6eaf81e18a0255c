#include "drivers/gnss/solution.h"

#include <cmath>

namespace rigor::gnss {

std::uint16_t nmea_number(SatelliteId id) noexcept {
  if (id.satellite == 0 || id.satellite == 255) return 0;
  switch (id.gnss) {
    case Gnss::gps:
      return id.satellite;
    case Gnss::sbas:
      return id.satellite >= 120 && id.satellite < 152 ? static_cast<std::uint16_t>(id.satellite - 87)
                                                       : id.satellite;
    case Gnss::glonass:
      return static_cast<std::uint16_t>(64 + id.satellite);
    case Gnss::galileo:
      return static_cast<std::uint16_t>(300 + id.satellite);
    case Gnss::beidou:
      return static_cast<std::uint16_t>(400 + id.satellite);
    case Gnss::imes:
      return static_cast<std::uint16_t>(172 + id.satellite);
    case Gnss::qzss:
      return static_cast<std::uint16_t>(192 + id.satellite);
  }
  return 0;
}

NavFix nav_fix_of(const Solution& s) noexcept {
  NavFix fix;
  fix.status = s.status;
  fix.satellites = s.satellites_used;
  const bool placed = s.has_fix() && std::isfinite(s.latitude_deg) && std::isfinite(s.longitude_deg);
  if (!placed) {
    fix.status = FixStatus::none;
    fix.latitude_deg = fix.longitude_deg = fix.height_m = Solution::kNone;
    return fix;
  }
  fix.latitude_deg = s.latitude_deg;
  fix.longitude_deg = s.longitude_deg;
  fix.height_m = s.height_m;
  for (std::size_t i = 0; i < 9; ++i)
    fix.covariance_enu_m2[i] = std::isfinite(s.covariance_enu_m2[i]) ? s.covariance_enu_m2[i] : 0;
  return fix;
}

}  // namespace rigor::gnss
