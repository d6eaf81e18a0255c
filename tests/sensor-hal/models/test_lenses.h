// Lenses that the tests of the models share: real calibrations and hard cases.
#pragma once

#include <array>

#include "sensor-hal/models/camera_model.h"

namespace rigor::test {

inline CameraModel camera_with(const OpenCvLens& lens) {
  CameraModel c;
  c.fx_px = 533.0;
  c.fy_px = 531.5;
  c.cx_px = 318.7;
  c.cy_px = 236.2;
  c.lens = lens;
  return c;
}

inline const std::array<OpenCvLens, 5> kLenses{
    OpenCvLens{}, OpenCvLens{.k1 = -0.28, .k2 = 0.09, .p1 = 0.0012, .p2 = -0.0007},  // a common webcam
    OpenCvLens{.k1 = -0.33, .k2 = 0.14, .p1 = 0.0005, .p2 = -0.0004, .k3 = -0.03},   // wide
    OpenCvLens{.k1 = 0.12, .k2 = -0.05, .p1 = -0.001, .p2 = 0.002, .k3 = 0.01},      // pincushion
    OpenCvLens{
        .k1 = 6.1, .k2 = -1.3, .p1 = 0.0007, .p2 = 0.0003, .k3 = 0.6, .k4 = 6.5, .k5 = -1.2, .k6 = 0.2}};

inline CameraModel fisheye_camera_with(const KannalaBrandtLens& lens) {
  CameraModel c;
  c.projection = Projection::kannala_brandt;
  c.fx_px = 190.0;
  c.fy_px = 191.5;
  c.cx_px = 321.7;
  c.cy_px = 238.2;
  c.fisheye = lens;
  return c;
}

inline const std::array<KannalaBrandtLens, 4> kFisheyes{
    KannalaBrandtLens{},
    KannalaBrandtLens{.k1 = -0.013, .k2 = 0.0021, .k3 = -0.0016, .k4 = 0.0003},  // a common 190 degree module
    KannalaBrandtLens{.k1 = 0.09, .k2 = -0.04, .k3 = 0.012, .k4 = -0.0015},
    KannalaBrandtLens{.k1 = -0.05, .k2 = 0.0, .k3 = 0.0, .k4 = 0.0}};  // folds at 148 degrees

}  // namespace rigor::test
