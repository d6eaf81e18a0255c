// Pinhole views that together see what a lens sees, and where in them each pixel of the sensor looks.
// Internal to sim/sensors/camera.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "sim/render/view/view_renderer.h"
#include "sim/sensors/camera/lens_grid.h"

namespace rigor {

/// One view, or the faces of a cube (those that are needed) where the lens sees further than a pinhole can.
struct LensView {
  Eigen::Matrix3d R_sensor_view = Eigen::Matrix3d::Identity();
  render::Pinhole pinhole;
  std::size_t first = 0;  ///< its first pixel among those of all views
};

/// A bilinear reading of a view.
struct ViewTap {
  static constexpr std::uint32_t kNowhere = 0xFFFFFFFFU;
  std::uint32_t index = kNowhere;  ///< of the top left of four pixels, among those of all views
  std::uint32_t view = 0;
  float x = 0, y = 0;  ///< weights of the right and of the lower ones
};

/// Every pixel of a grid (with its border), row by row: the mean of `taps_per_pixel` readings.
struct ResampleMap {
  int taps_per_pixel = 1;
  std::vector<ViewTap> taps;
};

class LensViews {
 public:
  /// `channels`: one, or red, green and blue. Errors: bad_input (a lens whose views would be too large).
  [[nodiscard]] static Result<LensViews> of(const CameraModel& camera, const std::vector<int>& channels,
                                            double supersampling, int border_px);

  [[nodiscard]] const std::vector<LensView>& views() const { return views_; }
  [[nodiscard]] std::size_t pixels() const { return pixels_; }  ///< of all views
  [[nodiscard]] const std::vector<LensGrid>& grids() const { return grids_; }
  [[nodiscard]] const std::vector<ResampleMap>& maps() const { return maps_; }
  /// Rows of the only view that rows [first, last) of the sensor read, with the border. All where there are
  /// several views.
  struct Rows {
    int first = 0, last = 0;
  };
  [[nodiscard]] Rows rows_read(int first, int last) const;

 private:
  std::vector<LensView> views_;
  std::vector<LensGrid> grids_;
  std::vector<ResampleMap> maps_;
  std::vector<Rows> rows_of_;  ///< per row of the grid
  std::size_t pixels_ = 0;
};

}  // namespace rigor
