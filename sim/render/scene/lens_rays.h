// The ideal ray of each pixel of a sensor behind its lens, and how wide a pixel is there. Internal to
// sim/render/scene.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::render {

/// So many numbers may be read behind the last ray of a row: loops over rays need no remainder.
inline constexpr int kRayPadding = 64;

/// Rays are tried against each body by the boxes around so many of them.
inline constexpr int kRayTile = 32;
[[nodiscard]] constexpr int tiles_of(int rays) { return (rays + kRayTile - 1) / kRayTile; }

/// Rays in the optical frame: (u, v, 1) times the distance along the optical axis. The widths are those of
/// what is averaged about a ray, in the same units, of either sign.
struct RayRow {
  const float* u = nullptr;
  const float* v = nullptr;
  const float* width_u = nullptr;
  const float* width_v = nullptr;
  int count = 0;
  const Eigen::AlignedBox2f* tiles = nullptr;  ///< around each kRayTile of (u, v): tiles_of(count) of them
};

class LensRays {
 public:
  /// Setup: a microsecond a pixel, on all threads. Errors: bad_input (no light reaches a pixel).
  [[nodiscard]] static Result<LensRays> create(const CameraModel& camera);

  /// `count` pixels from (x, y) of the sensor on; x is a multiple of kRayTile.
  [[nodiscard]] RayRow row(int x_px, int y_px, int count) const;
  /// Whether the lens images a ray there; the row has a ray (0, 0) where it does not.
  [[nodiscard]] bool lit(int x_px, int y_px) const;
  [[nodiscard]] bool all_lit() const { return dark_.empty(); }
  /// Rays of a pixel's finer average: one in each of eight columns and rows of the pixel, so that an edge
  /// along either is cut into eighths.
  static constexpr int kFine = 8;
  /// Writes kFine rays of a lit pixel to the four arrays, and extends a box by them.
  void fine(int x_px, int y_px, float* u, float* v, float* width_u, float* width_v,
            Eigen::AlignedBox2f& box) const;
  /// Around all rays.
  [[nodiscard]] Eigen::AlignedBox2f field() const;
  /// The ideal ray (x/z, y/z) of each pixel; no number where the lens images none.
  [[nodiscard]] std::vector<std::array<float, 2>> rays() const;

 private:
  [[nodiscard]] std::size_t at(int x_px, int y_px) const {
    return static_cast<std::size_t>(y_px) * static_cast<std::size_t>(width_px_) +
           static_cast<std::size_t>(x_px);
  }
  void set_steps(int x_px, int y_px);

  int width_px_ = 0, height_px_ = 0;
  std::vector<float> u_, v_;
  /// Change of the ray from a column to the next, and from a row to the next.
  std::vector<float> column_u_, column_v_, row_u_, row_v_;
  std::vector<Eigen::AlignedBox2f> tiles_;  ///< row by row
  std::vector<bool> dark_;                  ///< empty: none
};

}  // namespace rigor::render
