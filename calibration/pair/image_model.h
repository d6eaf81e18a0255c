// A camera pair: what has to change in the simulated side's camera, so that its pictures are those of the
// device.
//
// Of a pixel p of the device's camera C′, mounted with T_simulated_real = R (a rotation), the simulated
// side's picture S is
//
//   S′(p) = black + g (S(q) − black) V′/V + o,   q = project_C(R unproject_C′(p))
//
// with gain g, offset o [DN], and the fall-off of the light V. Each pass resamples S (bicubic), and takes a
// step from the regression rows of pair_watch's ImageChange (mean gradient of both pictures; for the gain the
// device's light beside as instrument, clustered_fit.h). A shift of the
// principal point and a turn of the mount are all but the same: one of them is solved for.
//
// Noise: squares of what Immerkær's operator leaves of both pictures, each on its own, at places where the
// simulated side is smooth; real less g² times simulated, so that texture cancels.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "calibration/pair/pair_model.h"
#include "sensor-hal/channel/pair_watch/image_change.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

struct ImagePairOptions : PairOptions {
  bool mount = true;             ///< turns of the mount, about the axes of the optical frame
  bool principal_point = false;  ///< with `mount`: only where the lens is wide enough to tell them apart
  bool distortion = false;       ///< the first radial coefficient, k1
  std::size_t cells = 4096;
};

struct ImagePairFit : PairFit {
  CameraModel camera;  ///< geometry and vignetting of the proposal; noise is the caller's to solve
  Eigen::Matrix3d R_simulated_real = Eigen::Matrix3d::Identity();
  double gain = 1, offset_dn = 0;  ///< DN of the pictures' format
  double format_scale = 1;         ///< DN of the format for one of the converter
  struct Tile {
    std::string name;
    double change = 0, sigma = 0;
  };
  std::vector<Tile> tiles;  ///< what is left on parts of the picture, relative: dirt
};

/// bad_input: no pairs, pictures that cannot be compared.
[[nodiscard]] Result<ImagePairFit> fit_image_pair(const ForEachPair& pairs, const CameraModel& simulated,
                                                  const ImagePairOptions& options);

/// Where the light of a changed brightness was gained or lost: in the sensor's electronics, or before them.
/// The noise tells: electronics multiply it, light adds its own.
struct ImageNoiseFit {
  enum class Gain : std::uint8_t { none, electronics, light } gain = Gain::none;
  double read_noise_e = 0, sigma_e = 0;
  bool at_bound = false;  ///< less noise than shot noise alone
  double chi2 = 0;
  double chi2_electronics = 0, chi2_light = 0;
  int levels = 0;
};
/// Of a linear camera. nullopt-like: `levels` 0 where there are less than two.
[[nodiscard]] ImageNoiseFit fit_image_noise(const ImagePairFit& fit, const CameraModel& simulated,
                                            double gain_sigma);

}  // namespace rigor::calibration
