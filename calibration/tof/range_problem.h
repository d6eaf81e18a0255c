// The least-squares problem of range_fit.h. Internal to calibration/tof.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <vector>

#include "calibration/tof/range_fit.h"

namespace rigor::calibration {

/// tof_spline (tof.glsl.h) over [from, to] with `count` coefficients (4 or more).
struct Spline {
  double from = 0, to = 1;
  int count = 4;
  /// Values of the four that are not 0 at x, and the index of the first; slopes.
  int basis(double x, std::array<double, 4>& value, std::array<double, 4>& slope) const;
};

struct RangeState {
  std::array<double, 4> harmonics{};
  std::vector<double> spline;
  double amplitude_m = 0;                       ///< k over the amplitude that all are in units of
  std::vector<double> error_m, tilt_x, tilt_y;  ///< of the scenes
  std::vector<double> pixel_m;                  ///< o + δ_p
  std::vector<double> weight;                   ///< Σ1/σ² of a pixel's samples; 0: has none
  double scale = 1;                             ///< of residuals in their standard deviations
  double scale_m = 0, rms_m = 0;
  double distance_sigma_m = 0, distance_freedom = 0;
  double minus_two_log_likelihood = 0;
  std::size_t samples = 0;
};

/// The wiggling of a model's harmonics and its derivatives over the range, sampled once for all pixels and
/// interpolated by cubics: to 1e-8 of itself. Beyond the samples it is evaluated.
class WigglingCurve {
 public:
  WigglingCurve(const std::vector<double>& turns_per_m, const std::array<double, 4>& harmonics, int count,
                double from_m, double to_m);
  /// Returns the wiggling; its derivatives by the harmonics (`count` of them) and by the range.
  double at(double range_m, double* by_harmonic, double& by_range) const;

 private:
  const std::vector<double>& turns_per_m_;
  std::array<double, 4> harmonics_;
  std::size_t count_;
  double from_m_, per_m_;
  std::vector<double> samples_;  ///< wiggling, by range, by harmonics: count_ + 2 for each node
};

class RangeProblem {
 public:
  RangeProblem(const TofScenes& scenes, const models::TofModel& model, const NoiseCoefficients* noise,
               double distance_sigma_m, double reject_sigmas);

  [[nodiscard]] const std::vector<const TofScene*>& scenes() const { return scenes_; }
  [[nodiscard]] bool has_amplitudes() const { return amplitudes_; }
  [[nodiscard]] bool estimates_distance_sigma() const { return given_distance_sigma_m_ < 0; }
  [[nodiscard]] const Spline& spline() const { return spline_; }
  [[nodiscard]] double samples_per_pixel() const;
  /// Without o.
  [[nodiscard]] int parameters(const RangeModel& m) const;
  [[nodiscard]] double amplitude_error(const RangeState& s) const { return s.amplitude_m * unit_amplitude_; }

  [[nodiscard]] RangeState start(const RangeModel& m) const;
  /// Another model's, with what both have.
  [[nodiscard]] RangeState start_from(const RangeModel& m, const RangeState& s) const;
  /// After reject(): Gauss–Newton on what is used; every `stride`-th pixel, of the scenes in `take`.
  void solve(const RangeModel& m, RangeState& s, int iterations, std::size_t stride,
             const std::vector<bool>* take) const;
  /// Finds what does not belong: robust fit, then limits, until the set stays.
  void reject(const RangeModel& m, RangeState& s, const StopToken& stop);
  /// RMS over a scene that was not fitted, its tilt taken out; NaN: no pixel in common.
  [[nodiscard]] double withheld_error_m(const RangeModel& m, const RangeState& s, std::size_t scene,
                                        std::size_t stride) const;

  struct Information {
    std::vector<Parameter> parameters;  ///< o first
    Eigen::MatrixXd matrix;
  };
  [[nodiscard]] Information information(const RangeModel& m, const RangeState& s) const;
  /// Covariance of a model's parameters where the next harmonic, which makes the same error to first order (5
  /// of 3, 9 of 7), is not 0 but unknown: they are off by its square's expectation, of what `next`, the fit
  /// of both, found of it and of what a waveform may have. `covariance` is that with 0.
  [[nodiscard]] Eigen::MatrixXd with_next_harmonic(const RangeModel& m, const RangeState& s,
                                                   const RangeState& next,
                                                   const Eigen::MatrixXd& covariance) const;
  void report_rejected(const RangeState& s, FitResult& r) const;
  [[nodiscard]] std::vector<double> residuals(const RangeModel& m, const RangeState& s,
                                              std::vector<NoiseSample>& share) const;
  [[nodiscard]] std::vector<SceneFit> scene_fits(const RangeModel& m, const RangeState& s) const;
  [[nodiscard]] std::vector<RangeFit::CurvePoint> curve(const RangeModel& m, const RangeState& s,
                                                        const Eigen::MatrixXd& covariance) const;

 private:
  /// What the model says of a pixel in a scene, without the pixel's offset; and its derivatives.
  struct Cell {
    double value_m = 0, wiggling_m = 0, range_m = 0;
    std::array<double, 32> global{};
    std::array<double, 3> scene{};
  };
  struct Normal {
    Eigen::MatrixXd h;
    Eigen::VectorXd b, g;  ///< g: mean over the pixels of how much an offset gives way to each parameter
    /// Sums over the pixels for how their offsets run across the picture, along x and y: of u, u², c, u·c,
    /// and of u times what g is the mean of.
    struct Run {
      double u = 0, uu = 0, c = 0, cc = 0, uc = 0;
      Eigen::VectorXd uq;
    };
    std::array<Run, 2> run;
    double squares = 0, squares_m = 0, inverse_weights = 0;
    std::size_t samples = 0, pixels = 0, compared = 0;  ///< compared: pixels with two scenes or more
  };
  /// Of the state's harmonics, for evaluate().
  [[nodiscard]] WigglingCurve wiggling(const RangeModel& m, const RangeState& s) const;
  void evaluate(const RangeModel& m, const RangeState& s, const WigglingCurve& w, std::size_t scene,
                std::size_t pixel, Cell& c) const;
  /// `cauchy` > 0: robust weights of that width (in standard deviations). Moves the pixels to their best.
  Normal accumulate(const RangeModel& m, RangeState& s, std::size_t stride, const std::vector<bool>* take,
                    double cauchy) const;
  /// Returns the square of the step in standard uncertainties: below a ten-thousandth the next one, whose
  /// length goes with the square of this one's, is none.
  double step(const RangeModel& m, RangeState& s, const Normal& n, const std::vector<bool>* take,
              double damping = 0) const;
  void add_priors(const RangeModel& m, const RangeState& s, Eigen::MatrixXd& h, Eigen::VectorXd* b,
                  const std::vector<bool>* take) const;
  [[nodiscard]] double robust_scale(const RangeModel& m, const RangeState& s) const;
  [[nodiscard]] double residual(const TofFrame& f, std::size_t pixel, double predicted, bool* wrapped) const {
    const double r = f.range_m[pixel] - predicted;
    const bool turned = std::abs(r) > 0.5 * wrap_m_;
    if (wrapped) *wrapped = turned;
    return turned ? r - std::round(r / wrap_m_) * wrap_m_ : r;
  }
  /// Collects what is used of each pixel in each scene: what a fit without robust weights needs of it.
  void gather(const RangeModel& m, const RangeState& s);

  const TofScenes& all_;
  const models::TofModel& model_;
  std::vector<const TofScene*> scenes_;
  std::vector<double> turns_per_m_;
  std::vector<std::array<float, 3>> rays_;
  std::vector<float> sigma_m_;                   ///< of one sample: [scene][pixel]
  std::vector<float> inverse_;                   ///< unit amplitude over the cell's
  std::vector<std::vector<std::uint8_t>> used_;  ///< [frame of all_][pixel]
  std::vector<bool> scene_used_, scene_empty_;
  /// Of the samples of a pixel in a scene that are used: number, mean, sum of squares about it.
  struct Gathered {
    double mean_m = 0;
    float count = 0, squares_m2 = 0;
  };
  std::vector<Gathered> gathered_;  ///< [scene][pixel]; by reject()
  struct Left {
    std::size_t frame, pixel;
    double residual_m, sigmas;
  };
  std::vector<Left> left_;  ///< the worst of those left out
  std::size_t left_count_ = 0;
  Spline spline_;
  double wrap_m_ = 0, unit_amplitude_ = 1, given_distance_sigma_m_ = -1, assumed_distance_sigma_m_ = 0;
  double reject_sigmas_ = 5;
  bool amplitudes_ = false;
};

}  // namespace rigor::calibration
