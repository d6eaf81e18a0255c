#include "sim/render/view/particles.h"

#include <algorithm>
#include <cmath>

#include "sensor-hal/models/philox.h"

namespace rigor::render {
namespace {

constexpr double kCell_m = 2.0;
constexpr double kReach_m = 14.0;
constexpr std::size_t kMost = 30000;
constexpr double kOutOfFocus_m = 0.6;      // nearer than this nothing of a drop is seen
constexpr double kRainExposure_s = 0.016;  // the streak of an eye or a video camera
constexpr double kSnowExposure_s = 0.004;
constexpr models::PhiloxKey kKey{0x5261696EU, 0x536E6F77U};

double unit(std::uint32_t word) { return (word + 0.5) * (1.0 / 4294967296.0); }

}  // namespace

std::vector<Particle> make_particles(const ViewCamera& camera, const Precipitation& p, BenchTime t) {
  std::vector<Particle> all;
  if (p.kind == Precipitation::Kind::none || !(p.drops_per_m3 > 0) || !(p.diameter_m > 0) ||
      !p.velocity_m_per_s.allFinite())
    return all;
  const bool rain = p.kind == Precipitation::Kind::rain;
  const double seconds = static_cast<double>(t.ns()) * 1e-9;
  const Eigen::Vector3d v = p.velocity_m_per_s.cast<double>();
  const Eigen::Vector3d streak = v * (rain ? kRainExposure_s : kSnowExposure_s);
  // Cells drift with the drops: in their frame each drop stands still. Dense rain is thinned by drawing fewer
  // drops, each the wider.
  const double reach = kReach_m, volume = 4.0 / 3.0 * 3.14159265358979 * reach * reach * reach;
  const double share =
      std::min(1.0, static_cast<double>(kMost) / (static_cast<double>(p.drops_per_m3) * volume));
  const double per_cell = static_cast<double>(p.drops_per_m3) * share * kCell_m * kCell_m * kCell_m;
  const double diameter = static_cast<double>(p.diameter_m) / std::sqrt(share);
  const Eigen::Vector3d eye = camera.eye - v * seconds;
  const double pixel_rad = 1.0 / camera.focal_px;
  std::array<std::int64_t, 3> low{}, high{};
  for (int i = 0; i < 3; ++i) {
    low[static_cast<std::size_t>(i)] = static_cast<std::int64_t>(std::floor((eye[i] - reach) / kCell_m));
    high[static_cast<std::size_t>(i)] = static_cast<std::int64_t>(std::floor((eye[i] + reach) / kCell_m));
  }
  for (std::int64_t cz = low[2]; cz <= high[2]; ++cz)
    for (std::int64_t cy = low[1]; cy <= high[1]; ++cy)
      for (std::int64_t cx = low[0]; cx <= high[0]; ++cx) {
        const Eigen::Vector3d corner =
            Eigen::Vector3d(static_cast<double>(cx), static_cast<double>(cy), static_cast<double>(cz)) *
            kCell_m;
        const Eigen::Vector3d middle = corner - eye + Eigen::Vector3d::Constant(0.5 * kCell_m);
        const double cell_radius = 0.87 * kCell_m + streak.norm();
        bool outside = middle.norm() > reach + cell_radius;
        for (const Eigen::Vector4d& plane : camera.planes)
          outside = outside || plane.head<3>().dot(middle) + plane.w() < -cell_radius;
        if (outside) continue;
        const std::array<std::uint32_t, 3> cell{
            static_cast<std::uint32_t>(cx), static_cast<std::uint32_t>(cy), static_cast<std::uint32_t>(cz)};
        const auto words = models::philox({cell[0], cell[1], cell[2], 0xFFFFFFFFU}, kKey);
        const auto n = static_cast<std::uint32_t>(std::floor(per_cell + unit(words[0])));
        for (std::uint32_t k = 0; k < n; ++k) {
          const auto w = models::philox({cell[0], cell[1], cell[2], k}, kKey);
          const Eigen::Vector3d head =
              corner - eye + kCell_m * Eigen::Vector3d(unit(w[0]), unit(w[1]), unit(w[2]));
          const double distance = head.norm();
          if (distance > reach || camera.forward.dot(head) < camera.pinhole.near_m) continue;
          const double d = diameter * (rain ? 0.6 + 0.8 * unit(w[3]) : 0.5 + unit(w[3]));
          // Thinner than a pixel: a pixel wide and the fainter. A drop that flies past covers each point of
          // its way for a part of the exposure.
          const double wide = std::max(d, distance * pixel_rad);
          double covers = rain ? 0.55 * d / wide : 0.9 * (d / wide) * (d / wide);
          covers *=
              std::min(1.0, d / std::max(streak.norm(), 1e-9) * (rain ? 8.0 : 1.0) + (rain ? 0.0 : 0.3));
          // Fades out at the end of what is drawn.
          covers *= std::clamp((reach - distance) / (0.25 * reach), 0.0, 1.0);
          // Right before the lens a drop is out of focus: a veil, not a stroke.
          covers *= std::clamp((distance - kOutOfFocus_m) / (3 * kOutOfFocus_m), 0.0, 1.0);
          if (!(covers > 1.0 / 512)) continue;
          all.push_back({view_gpu::xyz(head, wide), view_gpu::xyz(head - streak, covers)});
        }
      }
  std::stable_sort(all.begin(), all.end(), [](const Particle& a, const Particle& b) {
    const auto d2 = [](const view_gpu::vec4& q) { return q.x * q.x + q.y * q.y + q.z * q.z; };
    return d2(a.head) > d2(b.head);
  });
  return all;
}

}  // namespace rigor::render
