// A time-of-flight camera as numbers: geometry, modulation, light, pixel, errors. The arithmetic is
// tof.glsl.h. What has its default of nothing (0, off) costs nothing in the simulator.
//
// Three different things are called wiggling, and have three switches:
//   TofModulation::wiggling_bias     range error from the correlation's odd harmonics, period c/(8 f)
//   TofModulation::sine_like_noise   noise that varies with the range, because harmonics vary the amplitude
//   TofPixel::trembling              the noise itself, from frame to frame: shot and read noise
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::models {

enum class TofTaps : std::uint8_t {
  single,       ///< four exposures a frequency, one tap each
  differential  ///< two exposures a frequency: taps 0 and 2 at once, then 1 and 3
};
enum class TofWaveform : std::uint8_t { sine, harmonics, triangle };

struct TofModulation {
  std::vector<double> frequencies_hz{30e6};  ///< several: ranges are unwrapped from all of them
  double contrast = 0.75;                    ///< demodulation contrast C of the fundamental
  TofTaps taps = TofTaps::single;
  TofWaveform waveform = TofWaveform::sine;
  std::array<double, 4> harmonics{};  ///< amplitudes a3, a5, a7, a9 relative to the fundamental's
  bool wiggling_bias = true;
  bool sine_like_noise = true;
  double integration_time_s = 1e-3;  ///< of one tap
  /// From the begin of the first exposure to the end of the last: exposure m of N is measured at
  /// t_capture + (m − (N − 1)/2)·window/N. 0: N integration times.
  double tap_window_s = 0;
  /// Several frequencies: a pixel whose ranges disagree by more (RMS) has no return. 0: keeps all.
  double unwrap_tolerance_m = 0;
};

struct TofIllumination {
  double wavelength_m = 850e-9;
  double radiant_intensity_w_per_sr = 1;  ///< on the axis, mean while a tap integrates
  double cosine_exponent = 0;             ///< I(θ) = I(0) cos^n θ from the optical axis; 0: even
};

struct TofOptics {
  double f_number = 1.4;
  double transmission = 0.9;
  double cos4_weight = 0;     ///< of the natural fall-off: Vignetting::cos4_weight
  double filter_width_m = 0;  ///< band that the filter lets in around the wavelength; 0: no ambient light
};

struct TofPixel {
  double pitch_m = 12e-6;
  double fill_factor = 1;
  double quantum_efficiency = 0.8;  ///< at the wavelength
  double full_well_e = 100e3;       ///< per tap
  double read_noise_e = 0;          ///< per tap
  double dark_current_e_per_s = 0;
  int adc_bits = 0;                 ///< full well at full scale, 1 to 24; 0: not rounded
  double ambient_suppression = 0;   ///< share of the background that is drained before the well fills
  bool trembling = true;            ///< shot and read noise
  double range_offset_sigma_m = 0;  ///< fixed pattern: of the pixels' range offsets
  double gain_sigma = 0;            ///< fixed pattern: relative, of the pixels' gains
};

/// Errors of the range that calibration finds and no pixel explains. A sensor model's `range_error`.
struct TofRangeError {
  double offset_m = 0;             ///< of all pixels
  double amplitude_error_m_e = 0;  ///< k of k/A, A = E C / 2 as it was measured
  /// Wiggling bias of light from a range as a cubic B-spline (tof_spline), beside the harmonics' or in place
  /// of it. `wiggling_bias` switches it too. Empty: none; else 4 to 64 coefficients.
  struct Spline {
    double from_m = 0, to_m = 0;
    std::vector<double> coefficients_m;
  } wiggling;
};

struct TofSampling {
  int samples = 1;  ///< rays per pixel: 1, 4, 9, 16. Jittered ones are cast where they differ, elsewhere one
  bool bilinear = false;   ///< samples on a lattice, light between them bilinear: shared with the neighbours.
                           ///< Off: one jittered sample in each cell of the pixel (1: its centre)
  bool motion = true;      ///< exposures at their own instants; off: all at t_capture
  int multipath_rays = 0;  ///< per pixel, for light that came over one more surface; 0: none
  bool sun_shadows = true;  ///< ambient light: one ray per pixel asks whether the sun is hidden
  double retro_gain = 300;  ///< radiance of retro_reflection 1 in terms of a white Lambertian surface
};

/// What has no return. Ranges are those that are measured, after wrapping.
struct TofLimits {
  double min_range_m = 0;
  double max_range_m = 0;      ///< 0: none
  double min_amplitude_e = 0;  ///< E C / 2
};

/// In this order. All off by default.
struct TofFilters {
  double flying_pixel_m = 0;    ///< drops a pixel between two surfaces whose steps to both are larger
  int median_px = 0;            ///< 3 or 5: side of the window; NaN stays, and does not count
  int bilateral_radius_px = 0;  ///< up to 5
  double bilateral_sigma_px = 1, bilateral_sigma_m = 0.05;
};

struct TofModel {
  int width_px = 176, height_px = 144;
  double fx_px = 220, fy_px = 220, cx_px = 87.5, cy_px = 71.5;
  OpenCvLens lens;
  TofModulation modulation;
  TofIllumination illumination;
  TofOptics optics;
  TofPixel pixel;
  TofRangeError range_error;
  TofSampling sampling;
  TofLimits limits;
  TofFilters filters;

  static constexpr int kMaxSize_px = 4096;
  static constexpr int kMaxFrequencies = 8;
  static constexpr std::size_t kMaxSplineCoefficients = 64;
  static constexpr double kMaxRays = 33554432;  ///< of a frame: what a simulator holds at once

  /// bad_input says which value is out of its bounds, what was expected and what came. Setup.
  [[nodiscard]] Status validate() const;

  /// Range at which what is reported starts anew: c/(2f), with several frequencies c/(2·their greatest
  /// common divisor), frequencies taken as whole hertz. Beyond it a range comes back too short by it.
  [[nodiscard]] double unambiguous_range_m() const;
  /// Electrons of one integration per W m⁻² sr⁻¹ of radiance, on the axis: π/4 τ/N² · area · fill factor ·
  /// efficiency · λ/(hc) · integration time.
  [[nodiscard]] double electrons_per_radiance() const;
  /// E of a white (1) Lambertian surface square to the axis at this range: what "amplitude" is half the C
  /// of.
  [[nodiscard]] double active_electrons(double range_m, double reflectance = 1) const;
  /// Exposures of a frame.
  [[nodiscard]] int exposures() const;
  /// Of exposure m relative to t_capture.
  [[nodiscard]] double exposure_offset_s(int exposure) const;
  [[nodiscard]] double effective_tap_window_s() const;
  /// Geometry as a camera's, for `project` and `unproject`.
  [[nodiscard]] CameraModel camera() const;
};

}  // namespace rigor::models
