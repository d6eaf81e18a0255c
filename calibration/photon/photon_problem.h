// The joint fit of photon transfer in parts: which levels count (photon_levels.cpp), the fit itself
// (photon_fit.cpp), what is said of it (photon_answer.cpp). Internal to calibration/photon.
#pragma once

#include <string>
#include <vector>

#include "calibration/core/least_squares.h"
#include "calibration/photon/photon_fit.h"
#include "calibration/photon/response.h"
#include "calibration/photon/rounding.h"

namespace rigor::calibration {

/// Of PhotonModel::p.
enum PhotonParameter : std::size_t { kGain, kBlack, kRead, kDark, kDoubling, kOffset, kModelParameters };

/// Below it a temporal variance is that of a few pixels on the edge of a step.
inline constexpr double kNoNoise_dn2 = 0.02;

[[nodiscard]] std::string photon_text(const char* format, double a, double b = 0, double c = 0);

/// Whitens (mean, variance) by the Cholesky factor of their covariance.
struct Whitening {
  double mean = 0, variance = 0;     // measured
  double l11 = 1, l21 = 0, l22 = 1;  // of the covariance
  double pixel_variance = 0;
  bool with_variance = true;
  /// Of mean and Gaussian variance before the converter, and photo-electrons on top: `signal` of the mean.
  template <class T>
  void residual(const T& model_mean, const T& gaussian, const T& gain, const T& signal, T* r) const {
    T m, v;
    rounded_moments(model_mean, gaussian, gain, signal, pixel_variance, m, v);
    r[0] = (T(mean) - m) / T(l11);
    if (with_variance) r[1] = (T(variance) - v - T(l21) * r[0]) / T(l22);
  }
};

/// What is asked of the data, and what they answered.
struct PhotonPlan {
  bool dark_level = false;    ///< usable dark frames: black and the noise of the dark
  bool dark_current = false;  ///< at exposure times that differ
  bool doubling = false;
  bool light = false;
  bool dsnu_rounded = false;  ///< the converter's steps hide it
  bool dsnu = false, prnu = false, full_well = false;
};

/// Values of the parameters while they are fitted.
struct PhotonModel {
  double p[kModelParameters] = {0, 0, 0, 0, 7, 0};
  double upper[2] = {0, 0}, break_dn = 0, break_sigma_dn = 0;
  bool two_gains = false;
  double dsnu = 0, prnu = 0, full_well = 0;
  std::vector<double> signal;
};

class PhotonProblem {
 public:
  PhotonProblem(const FrameStacks& stacks, PhotonFit& out, const PhotonFitOptions& options)
      : stacks_(stacks), out_(out), st_(out.statistics), options_(options) {}

  Status prepare();
  Status fit();

 private:
  [[nodiscard]] const PhotonLevel& level(std::size_t k) const {
    return stacks_.levels()[st_.points[k].level];
  }
  [[nodiscard]] Whitening whitening(std::size_t k, const PhotonModel& m) const;
  Result<LeastSquares::Outcome> run(PhotonModel& m, bool robust, std::size_t without) const;
  Result<LeastSquares::Outcome> iterate(PhotonModel& m, bool robust, std::size_t without) const;
  void choose_range();
  /// The pattern of the dark as it is before the converter rounds it.
  void unround_dark_pattern(const PhotonModel& m);
  void start(PhotonModel& m) const;
  /// Fits the model and predicts each level of light by the others.
  [[nodiscard]] bool judge(PhotonModel& m, const char* name, int parameters, Candidate& c) const;
  [[nodiscard]] Result<PhotonModel> choose(PhotonModel m, std::vector<Candidate>& candidates);
  Status dark_only();
  /// The signal over exposure times, and whether it bends: sets `bend_`.
  void look_for_bend(double black_dn);
  /// Puts the points as they would be if the response were linear; `terms` 0: as they are.
  void linearise(const PhotonResponse& response, double black_dn);
  void add_response(const PhotonModel& m, LeastSquares::Outcome& outcome);
  [[nodiscard]] double best_break(PhotonModel& two) const;
  void say_not_identifiable(const PhotonModel& m);
  void after(PhotonModel& m, LeastSquares::Outcome& outcome);
  void hot_pixels(const PhotonModel& m);
  void stripes(const PhotonModel& m);
  void curve(const PhotonModel& m);
  std::vector<std::size_t> of(bool light) const {
    std::vector<std::size_t> v;
    for (std::size_t k = 0; k < st_.points.size(); ++k)
      if (out_.in_range[k] && level(k).settings.light == light) v.push_back(k);
    return v;
  }

  const FrameStacks& stacks_;
  PhotonFit& out_;
  StackStatistics& st_;
  const PhotonFitOptions& options_;
  PhotonPlan plan_;
  double plateau_dn_ = 0, plateau_sigma_dn_ = 0;
  PhotonResponse response_;  ///< in force: the points are linearised by it
  struct Bend {
    std::vector<ResponsePoint> points;
    double flicker = 0;
    ResponseFit straight, bent;
    bool found = false;
  } bend_;
  PatternVariance dark_pattern_;
  std::vector<LevelPoint> raw_points_;
  PatternVariance raw_light_pattern_;
  double raw_plateau_dn_ = 0;
};

/// Single frames of a still scene: the scatter between exposures is all there is.
[[nodiscard]] Status fit_single_frames(const FrameStacks& stacks, const PhotonFitOptions& options,
                                       PhotonFit& out);

}  // namespace rigor::calibration
