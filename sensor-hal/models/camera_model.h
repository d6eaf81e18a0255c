// A camera as numbers: geometry, lens, optics and the EMVA 1288 noise of its sensor. The simulator renders
// with it, a calibrator fits it, a recording names its hash. Units are in the names; frames are those of
// docs/conventions.md: optical frame x right, y down, z forward, pixel centres at integers.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "rt-core/result.h"

namespace rigor {

/// Coefficients of OpenCV's rational lens model; all zero is an ideal pinhole. Dimensionless.
struct OpenCvLens {
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0;
  bool operator==(const OpenCvLens&) const = default;
};

/// V = (1 - G + G cos^4) (1 + a2 r^2 + a4 r^4 + a6 r^6), r = tan of the ideal ray's angle:
/// models/vignetting.glsl.h. A fisheye has the first factor alone, 1 - G from 90° on.
struct Vignetting {
  double cos4_weight = 0, a2 = 0, a4 = 0, a6 = 0;
};

enum class Projection : std::uint8_t { opencv, kannala_brandt };

/// Fisheye after Kannala & Brandt (PAMI 2006) as OpenCV has it: r = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), θ
/// the angle of the ideal ray, (x, y) = r (cos φ, sin φ).
struct KannalaBrandtLens {
  double k1 = 0, k2 = 0, k3 = 0, k4 = 0;
  bool operator==(const KannalaBrandtLens&) const = default;
};

/// Red, green, blue; near infrared goes with red. All at their defaults: none, and no cost.
struct ChromaticAberration {
  std::array<double, 3> magnification{
      1, 1, 1};  ///< lateral: of the distorted coordinates, about the principal point
  std::array<double, 3> focus_shift_m{0, 0, 0};  ///< longitudinal: of the distance in focus
  [[nodiscard]] bool lateral() const { return magnification != std::array<double, 3>{1, 1, 1}; }
  [[nodiscard]] bool longitudinal() const { return focus_shift_m != std::array<double, 3>{0, 0, 0}; }
};

/// Thin lens: a point at depth d is a disc of diameter f²·|d − U| / (N·C·d·(U − f)) pixels (focal length f,
/// distance in focus U, f-number N, pixel pitch C).
struct DepthOfField {
  double focus_distance_m = 0;  ///< 0: everything is sharp
  double focal_length_m = 0;    ///< 0: fx times the pixel pitch
  [[nodiscard]] bool active() const { return focus_distance_m > 0; }
};

struct Shutter {
  double line_time_s = 0;    ///< rolling: row i exposes this much later than row i − 1; 0: global
  bool motion_blur = false;  ///< off: the middle of the exposure stands for it
};

/// Light that the lens and the sensor's cover spread over the picture, energy kept: of every pixel's light
/// the share `fraction` goes to a kernel 1/(1 + (r/radius)²)^exponent, and `veiling_glare` evenly to all
/// pixels.
struct Bloom {
  double fraction = 0, radius_px = 4, exponent = 1.5;
  double veiling_glare = 0;
  [[nodiscard]] bool active() const { return fraction > 0 || veiling_glare > 0; }
};

/// What the camera's own processing does; all off: raw. Works on digital numbers at the converter's bits, in
/// this order: median, white balance, demosaicing, gamma (models/image_processing.glsl.h). White balance
/// counts where there are colours.
struct ImageProcessing {
  bool median_filter = false;  ///< of the 3x3 nearest pixels of the same colour
  std::array<double, 3> white_balance{1, 1, 1};
  bool demosaic = false;        ///< RGB8 from the mosaic; off: every pixel measures all three colours
  double gamma = 1;             ///< output = input^(1/gamma)
  bool subtract_black = false;  ///< off: what is black stays at black_level_dn
};

/// From radiance to electrons per second. Bands: red, green, blue, near infrared (850 nm).
struct CameraOptics {
  double f_number = 5.6;
  double transmission = 0.9;
  double pixel_pitch_m = 4.8e-6;
  static constexpr std::array<double, 4> kBandWavelength_m{620e-9, 535e-9, 460e-9, 850e-9};
  /// Quantum efficiency times filter transmission per band, for a monochrome sensor.
  std::array<double, 4> mono_efficiency{0.55, 0.65, 0.55, 0.0};
  /// The same behind the red, green and blue filters (row = filter) of a colour sensor.
  std::array<std::array<double, 4>, 3> colour_efficiency{
      {{0.50, 0.05, 0.02, 0.0}, {0.05, 0.58, 0.08, 0.0}, {0.02, 0.06, 0.52, 0.0}}};
};

/// EMVA 1288 linear model of the sensor: models/emva_noise.glsl.h. Electrons are photo-electrons in the
/// pixel.
struct EmvaNoise {
  double system_gain_dn_per_e =
      0.0;  ///< K at gain 1; 0: chosen so that the full well is the converter's full scale
  double black_level_dn = 0.0;  ///< at the converter's bits
  double full_well_e = 10000.0;
  double read_noise_e = 5.0;
  double dark_current_e_per_s = 10.0;
  double dsnu_e = 1.0;  ///< standard deviation of the offset pattern
  double prnu = 0.005;  ///< relative standard deviation of the gain pattern
  bool shot_noise = true;
  /// Dark current doubles every `dark_doubling_k` above its reference temperature.
  double temperature_c = 25, dark_reference_c = 25, dark_doubling_k = 7;
  double hot_pixel_share = 0;            ///< of all pixels
  double hot_pixel_dark_e_per_s = 5000;  ///< their mean additional dark current, exponentially distributed
  int adc_bits = 12;                     ///< 8 to 16; an 8-bit picture carries the upper eight of them
  /// Of the response x (1 + c2 s + c3 s²), x = K n in DN above black, s = x over the converter's range above
  /// black. Both 0: linear, and no cost.
  double response_c2 = 0, response_c3 = 0;

  [[nodiscard]] bool linear() const { return response_c2 == 0 && response_c3 == 0; }
  [[nodiscard]] double dark_current_at_temperature_e_per_s() const;
  [[nodiscard]] double hot_pixel_dark_at_temperature_e_per_s() const;
};

struct CameraModel {
  int width_px = 640;
  int height_px = 480;
  double fx_px = 600.0;
  double fy_px = 600.0;
  double cx_px = 319.5;
  double cy_px = 239.5;
  Projection projection = Projection::opencv;
  OpenCvLens lens;            ///< in force for Projection::opencv
  KannalaBrandtLens fisheye;  ///< in force for Projection::kannala_brandt
  ChromaticAberration chromatic;
  DepthOfField depth_of_field;
  Shutter shutter;
  Bloom bloom;
  ImageProcessing processing;
  Vignetting vignetting;
  CameraOptics optics;
  EmvaNoise noise;

  /// Says which value is out of its bounds, what was expected and what came. Setup.
  [[nodiscard]] Status validate() const;

  /// K at gain 1, with the default for 0 resolved.
  [[nodiscard]] double system_gain_dn_per_e() const;
  /// Photo-electrons per second and per unit of radiance (W m^-2 sr^-1) in each band, on the axis, for a row
  /// of efficiencies: pi/(4 N^2) tau A eta lambda/(h c).
  [[nodiscard]] std::array<double, 4> electron_rate_per_radiance(
      const std::array<double, 4>& efficiency) const;
};

struct PixelPosition {
  double u_px = 0;
  double v_px = 0;
};
struct NormalisedPosition {
  double x = 0;  ///< X/Z in the optical frame
  double y = 0;
};
struct OpticalPoint {
  double x_m = 0, y_m = 0, z_m = 0;
};
/// A direction in the optical frame, of unit length where a function returns it.
struct OpticalRay {
  double x = 0, y = 0, z = 1;
};

/// The colour that a ray is asked for: index into ChromaticAberration. The reference has magnification 1; it
/// is what `project` and `unproject` mean.
enum ColourChannel : int { kReferenceChannel = -1, kRed = 0, kGreen = 1, kBlue = 2 };

/// Where light of a colour from a direction (of any length, not zero) falls; empty where the lens takes none:
/// behind the camera, beyond the lens model's fold, and for a fisheye straight backwards. Any thread, no
/// allocation.
[[nodiscard]] std::optional<PixelPosition> project_ray(const CameraModel& camera, const OpticalRay& direction,
                                                       int channel = kReferenceChannel);
/// The ideal ray of a pixel in a colour; empty where no ray of the lens reaches it. Inverse of `project_ray`
/// to 1e-9 px. Any thread, no allocation.
[[nodiscard]] std::optional<OpticalRay> unproject_ray(const CameraModel& camera, const PixelPosition& pixel,
                                                      int channel = kReferenceChannel);

/// Where a point in the optical frame appears; empty behind the camera and beyond the lens model's fold
/// (where the formula would put the point back into the picture although no light takes that way). Any
/// thread, no allocation.
[[nodiscard]] std::optional<PixelPosition> project(const CameraModel& camera, const OpticalPoint& p_camera);

/// The ideal ray of a pixel; empty where no ray of the lens reaches it, or one at 90° and more to the axis
/// (see unproject_ray). Inverse of `project` to 1e-9 px. Any thread.
[[nodiscard]] std::optional<NormalisedPosition> unproject(const CameraModel& camera,
                                                          const PixelPosition& pixel);

/// Largest angle to the axis that a fisheye takes: where r(θ) folds, at most π.
[[nodiscard]] double fisheye_theta_max_rad(const KannalaBrandtLens& lens);

/// Diameter of the disc of a point at this depth (infinity included), in this colour; 0 where everything is
/// sharp. models/depth_of_field.glsl.h.
[[nodiscard]] double blur_diameter_px(const CameraModel& camera, double depth_m,
                                      int channel = kReferenceChannel);
/// f/N, and the focal length in force.
[[nodiscard]] double aperture_diameter_m(const CameraModel& camera);
[[nodiscard]] double focal_length_m(const CameraModel& camera);
/// Distance in focus of a colour.
[[nodiscard]] double focus_distance_m(const CameraModel& camera, int channel = kReferenceChannel);

/// Middle of the exposure of a row against that of the centre row, (height − 1)/2, which is t_capture.
[[nodiscard]] double row_delay_s(const CameraModel& camera, double row_px);

}  // namespace rigor
