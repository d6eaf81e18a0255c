#include "calibration/camera/camera_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "calibration/camera/camera_fit_internal.h"
#include "calibration/camera/camera_start.h"
#include "calibration/camera/projection_uncertainty.h"
#include "calibration/camera/view_cost.h"
#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "rt-core/numbers.h"

namespace rigor::calibration {
namespace {

constexpr double kFar = 1e6;  // of a corner that has no image
constexpr const char* kNames[kCameraParameters] = {"fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2",
                                                   "p1",    "p2",    "k3",    "k4",    "k5", "k6"};

bool is_fisheye(LensModel m) { return m == LensModel::fisheye4; }
/// Whether the model fits parameter i of the block.
bool fits(LensModel m, int i) {
  switch (m) {
    case LensModel::opencv0:
      return i < 4;
    case LensModel::opencv2:
      return i < 6;
    case LensModel::opencv4:
      return i < 8;
    case LensModel::opencv5:
      return i < 9;
    case LensModel::opencv8:
      return true;
    case LensModel::fisheye4:
      return i < 8;
  }
  return false;
}
std::string parameter_name(LensModel m, int i) {
  if (is_fisheye(m) && i >= 4 && i < 8) return "k" + std::to_string(i - 3);
  return kNames[i];
}

/// Change of each parameter that moves a corner of the picture by a hundredth of its width: beyond that
/// uncertainty it is of no use.
double resolution_of(LensModel m, int i, double focal_px, int width_px, int height_px) {
  const double limit = 0.01 * width_px;
  const double r = 0.5 * std::hypot(width_px, height_px) / focal_px;
  if (i < 2) return limit / r;
  if (i < 4) return limit;
  if (is_fisheye(m)) return limit / (focal_px * std::pow(r, 2 * (i - 3) + 1));
  static constexpr int kPower[] = {3, 5, 2, 2, 7, 3, 5, 7};
  return limit / (focal_px * std::pow(r, kPower[i - 4]));
}

struct State {
  CameraParameters camera{};
  std::vector<Pose> poses;
};

/// One corner: which view, which point.
struct Corner {
  std::size_t view, point;
};

class Problem {
 public:
  Problem(const std::vector<BoardView>& views, const CameraFitOptions& options)
      : views_(views), options_(options) {
    for (std::size_t v = 0; v < views.size(); ++v)
      for (std::size_t p = 0; p < views[v].points.size(); ++p) corners_.push_back({v, p});
    used_.assign(corners_.size(), true);
  }

  [[nodiscard]] const std::vector<Corner>& corners() const { return corners_; }
  std::vector<bool>& used() { return used_; }

  /// Fits the model from `state` to the corners that `take` lets in; `hold` keeps the intrinsics.
  Result<LeastSquares::Outcome> fit(LensModel model, State& state, bool robust, bool hold,
                                    const std::function<bool(std::size_t)>& take, bool rough = false) const {
    const int w = views_.front().width_px, h = views_.front().height_px;
    LeastSquares problem;
    problem.add_block(state.camera.data(), camera_infos(model, state.camera[0], w, h, hold));
    for (std::size_t v = 0, i = 0; v < views_.size(); ++v) {
      std::vector<BoardPoint> points;
      std::vector<std::uint32_t> ids;
      for (const BoardPoint& p : views_[v].points) {
        if (take(i)) {
          points.push_back(p);
          ids.push_back(static_cast<std::uint32_t>(i));
        }
        ++i;
      }
      if (points.empty()) continue;
      problem.add_nuisance(state.poses[v].data(), 6);
      problem.add_batch(view_cost(std::move(points), {.fisheye = is_fisheye(model)}),
                        {state.camera.data(), state.poses[v].data()}, std::move(ids));
    }
    FitOptions o;
    o.robust = robust;
    o.rough = rough;
    if (rough) o.max_iterations = 30;
    o.reject_sigmas = options_.reject_sigmas;
    o.threads = options_.threads;
    o.unit = "px";
    o.stop = options_.stop;
    o.progress = progress_;
    return problem.solve(o);
  }

  void set_progress(std::function<void(double, double)> p) { progress_ = std::move(p); }

  /// Residual of a corner; NaN where it has no image.
  [[nodiscard]] std::array<double, 2> residual(LensModel model, const State& state, std::size_t i) const {
    const BoardPoint& p = views_[corners_[i].view].points[corners_[i].point];
    double r[2];
    if (!Reprojection{p.x_m, p.y_m, p.u_px, p.v_px, is_fisheye(model)}(
            state.camera.data(), state.poses[corners_[i].view].data(), r))
      return {kNaN, kNaN};
    return {r[0], r[1]};
  }

 private:
  const std::vector<BoardView>& views_;
  const CameraFitOptions& options_;
  std::vector<Corner> corners_;
  std::vector<bool> used_;
  std::function<void(double, double)> progress_;
};

bool start(const std::vector<BoardView>& views, LensModel model, double focal_px, State& state) {
  const BoardView& first = views.front();
  state.camera = {};
  state.camera[0] = state.camera[1] = focal_px;
  state.camera[2] = (first.width_px - 1) / 2.0;
  state.camera[3] = (first.height_px - 1) / 2.0;
  state.poses.assign(views.size(), Pose{});
  std::size_t good = 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    const bool ok = pose_from_view(views[v], focal_px, focal_px, state.camera[2], state.camera[3],
                                   is_fisheye(model), state.poses[v]);
    if (!ok) state.poses[v] = {0, 0, 0, 0, 0, 1};
    good += ok;
  }
  return good > 0;
}

/// What the model does not have is 0, not what a larger one made of it.
void drop_what_does_not_fit(LensModel model, State& state) {
  for (int i = 4; i < kCameraParameters; ++i)
    if (!fits(model, i)) state.camera[static_cast<std::size_t>(i)] = 0;
}

/// A flat board has two poses that look almost alike, and a fit ends in the one that it began near. With the
/// lens known better than at the start each view takes the pose that fits best of the present one and the two
/// that its points give. Whether any changed.
bool pose_again(const std::vector<BoardView>& views, LensModel model, State& state) {
  const CameraModel camera =
      camera_of(state.camera, is_fisheye(model), views.front().width_px, views.front().height_px);
  bool changed = false;
  for (std::size_t v = 0; v < views.size(); ++v) {
    const auto median_square = [&](const Pose& pose) {
      std::vector<double> squares;
      for (const BoardPoint& p : views[v].points) {
        double r[2] = {kFar, kFar};
        if (!Reprojection{p.x_m, p.y_m, p.u_px, p.v_px, is_fisheye(model)}(state.camera.data(), pose.data(),
                                                                           r))
          r[0] = r[1] = kFar;
        squares.push_back(r[0] * r[0] + r[1] * r[1]);
      }
      const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
      std::nth_element(squares.begin(), middle, squares.end());
      return *middle;
    };
    if (views[v].points.empty()) continue;
    double least = median_square(state.poses[v]);
    // Wrong corners spoil a pose that is made of all of them.
    const bool far = least > 4e-6 * views[v].width_px * views[v].width_px;
    for (const Pose& pose : poses_from_view(views[v], camera, far)) {
      const double square = median_square(pose);
      if (!(square < 0.5 * least)) continue;
      least = square;
      state.poses[v] = pose;
      changed = true;
    }
  }
  return changed;
}

/// Fits from several focal lengths where the first leads nowhere: a wrong start ends in a false minimum.
Result<State> best_start(const std::vector<BoardView>& views, LensModel model,
                         const CameraFitOptions& options, const Problem& problem) {
  const double w = views.front().width_px;
  std::vector<double> focal;
  if (options.start_fx_px > 0) focal.push_back(options.start_fx_px);
  if (const double f = is_fisheye(model) ? 0 : focal_length_from_views(views); f > 0) focal.push_back(f);
  for (const double f : is_fisheye(model) ? std::vector<double>{0.35, 0.25, 0.5, 0.8}
                                          : std::vector<double>{1.0, 0.5, 2.0, 4.0})
    focal.push_back(f * w);
  State best;
  double least = std::numeric_limits<double>::infinity();
  // The simplest lens that has the shape: its minimum is wide.
  const LensModel simple = is_fisheye(model) ? LensModel::fisheye4 : LensModel::opencv2;
  for (const double f : focal) {
    State state;
    if (!start(views, model, f, state)) continue;
    const auto all = [](std::size_t) { return true; };
    auto out = problem.fit(simple, state, true, false, all, true);
    if (!out) continue;
    for (int round = 0; round < 3 && pose_again(views, simple, state); ++round) {
      auto again = problem.fit(simple, state, true, false, all, true);
      if (again) out = std::move(again);
    }
    if (!(state.camera[0] > 0) || !(state.camera[1] > 0)) continue;
    const double rms = out->fit.residuals.rms;
    if (out->fit.residuals.rejected * 2 < problem.corners().size() && rms < least) {
      least = rms;
      best = state;
    }
    if (least < 0.002 * w) break;  // a good fit: another minimum is not looked for
  }
  if (best.poses.empty())
    return fail(
        ErrorCode::bad_input, "",
        "expected views of one flat board, got points that no camera puts there; is the target's size "
        "(columns x rows) right?");
  return best;
}

/// Of many views a share finds the lens, and the others are posed in it: the first iterations, far from the
/// minimum, are the most and need not see all.
Result<State> start_of_all(const std::vector<BoardView>& views, LensModel model,
                           const CameraFitOptions& options, const Problem& problem) {
  constexpr std::size_t kEnough = 40;
  if (views.size() < 2 * kEnough) return best_start(views, model, options, problem);
  std::vector<BoardView> share;
  for (std::size_t k = 0; k < kEnough; ++k) share.push_back(views[k * views.size() / kEnough]);
  auto few = best_start(share, model, options, Problem(share, options));
  if (!few) return best_start(views, model, options, problem);
  State state;
  if (!start(views, model, few->camera[0], state)) return best_start(views, model, options, problem);
  state.camera = few->camera;
  (void)pose_again(views, model, state);
  return state;
}

double rms_of(const std::vector<double>& squares) {
  double sum = 0;
  for (double s : squares) sum += s;
  return squares.empty() ? kNaN : std::sqrt(sum / static_cast<double>(squares.size()));
}

/// Mean squared error per corner of each view that the fit has not seen. Folds are blocks of views in their
/// order: in a video the frames before and after a withheld one show the same, and a model that follows their
/// noise would predict it well.
void cross_validate(const std::vector<BoardView>& views, LensModel model, const Problem& problem,
                    const std::vector<bool>& used, const State& full, int folds, Candidate& candidate) {
  candidate.cross_validation = kNaN;
  const auto n = std::min(static_cast<std::size_t>(std::max(0, folds)), views.size());
  if (n < 2) return;
  std::vector<double> square(views.size(), 0), count(views.size(), 0);
  for (std::size_t k = 0; k < n; ++k) {
    State state = full;
    const auto in_fold = [&](std::size_t i) { return problem.corners()[i].view * n / views.size() == k; };
    if (!problem.fit(model, state, false, false, [&](std::size_t i) { return used[i] && !in_fold(i); }))
      return;
    (void)problem.fit(model, state, false, true, [&](std::size_t i) { return used[i] && in_fold(i); });
    for (std::size_t i = 0; i < problem.corners().size(); ++i) {
      if (!used[i] || !in_fold(i)) continue;
      const auto r = problem.residual(model, state, i);
      const double e = r[0] * r[0] + r[1] * r[1];
      if (!std::isfinite(e)) return;
      square[problem.corners()[i].view] += e;
      ++count[problem.corners()[i].view];
    }
  }
  for (std::size_t v = 0; v < views.size(); ++v) square[v] = count[v] > 0 ? square[v] / count[v] : kNaN;
  set_cross_validation(candidate, std::move(square), std::move(count));
}

/// The odd and the even views, fitted apart.
struct Halves {
  std::array<CameraParameters, 2> camera;
  double apart_p95_px = 0;  ///< how far they put the same ray apart
};
std::optional<Halves> fit_halves(const std::vector<BoardView>& views, LensModel model, const Problem& problem,
                                 const std::vector<bool>& used, const State& full) {
  if (views.size() < 4) return std::nullopt;
  Halves out;
  std::array<CameraModel, 2> half;
  for (std::size_t k = 0; k < 2; ++k) {
    State state = full;
    if (!problem.fit(model, state, false, false,
                     [&](std::size_t i) { return used[i] && problem.corners()[i].view % 2 == k; }))
      return std::nullopt;
    out.camera[k] = state.camera;
    half[k] = camera_of(state.camera, is_fisheye(model), views.front().width_px, views.front().height_px);
  }
  out.apart_p95_px = projection_difference_p95_px(half[0], half[1]);
  return out;
}

/// A sigma from the covariance holds where corners err independently. Each half of the views has √2 of it, so
/// the halves differ by 2 sigma in the mean square. Where they differ by far more, views share errors (a
/// board that hardly moves, a lens that the model does not have), and the sigma is too small by an unknown
/// factor.
void judge_halves(CameraFit& fit, const Halves& halves, const std::vector<Eigen::Index>& index) {
  constexpr double kContradiction = 4;  // in standard deviations of the difference
  fit.halves_apart_px = halves.apart_p95_px;
  if (!std::isfinite(halves.apart_p95_px)) return;
  std::vector<double> sigmas;
  for (std::size_t i = 0; i < index.size(); ++i) {
    Parameter& p = fit.result.parameters[i];
    const auto k = static_cast<std::size_t>(index[i]);
    p.halves_apart = std::abs(halves.camera[0][k] - halves.camera[1][k]);
    sigmas.push_back(p.sigma > 0 && std::isfinite(p.sigma) ? p.halves_apart / (2 * p.sigma) : 0);
  }
  // What lies within the corners' own errors harms nobody.
  if (halves.apart_p95_px <= 2 * fit.rms_per_corner_px) return;
  for (std::size_t i = 0; i < index.size(); ++i) {
    if (sigmas[i] <= kContradiction) continue;
    const Parameter& p = fit.result.parameters[i];
    char text[240];
    std::snprintf(text, sizeof text,
                  "halves of the views are %.3g apart, %.0f times what its sigma of %.2g allows; the halves "
                  "put a ray %.2g px apart (p95)",
                  p.halves_apart, sigmas[i], p.sigma, halves.apart_p95_px);
    fit.result.not_identifiable.emplace_back(p.name, text);
  }
  if (fit.result.not_identifiable.empty()) return;
  fit.result.warnings.emplace_back(
      "the sigmas do not hold: fits to halves of the views contradict them. Record the board near and far, "
      "tilted by 30 to 45 degrees about both of its axes, and in the corners of the picture");
}

/// Empties the views that are copies of an earlier one (a frame that was recorded twice): they would count as
/// new evidence. How many.
std::size_t leave_out_copies(std::vector<BoardView>& views, std::vector<std::string>& notes) {
  const auto same = [](const BoardView& a, const BoardView& b) {
    return a.points.size() == b.points.size() &&
           std::equal(a.points.begin(), a.points.end(), b.points.begin(),
                      [](const BoardPoint& p, const BoardPoint& q) {
                        return p.column == q.column && p.row == q.row && p.u_px == q.u_px && p.v_px == q.v_px;
                      });
  };
  std::size_t copies = 0;
  for (std::size_t i = 1; i < views.size(); ++i)
    for (std::size_t k = 0; k < i; ++k)
      if (!views[i].points.empty() && same(views[i], views[k])) {
        notes.push_back(views[i].name + ": left out, its corners are those of " + views[k].name +
                        " to the last digit: the same picture says nothing new");
        views[i].points.clear();
        ++copies;
        break;
      }
  return copies;
}

void advise(FitResult& result) {
  for (WeakDirection& w : result.weak) {
    bool focal = false, centre = false, lens = false;
    for (const auto& part : w.parts) {
      focal = focal || part.name.starts_with("f");
      centre = centre || part.name.starts_with("c");
      lens = lens || part.name.starts_with("k") || part.name.starts_with("p");
    }
    if (focal) w.words += "; with them the distances of the board";
    if (focal || centre)
      w.cure = "record views with the board tilted by 30 to 45 degrees about both of its axes, near and far";
    if (centre && !focal)
      w.cure += ", some with the camera turned by 90 degrees";
    else if (lens && !focal)
      w.cure = "record views with the board in the corners of the picture";
  }
}

}  // namespace

std::vector<ParameterInfo> camera_infos(LensModel model, double focal_px, int width_px, int height_px,
                                        bool hold) {
  std::vector<ParameterInfo> infos;
  for (int i = 0; i < kCameraParameters; ++i)
    infos.push_back({.name = parameter_name(model, i),
                     .resolution = resolution_of(model, i, focal_px, width_px, height_px),
                     .held = hold || !fits(model, i)});
  return infos;
}

std::string_view lens_model_name(LensModel m) {
  static constexpr std::string_view kModelNames[] = {"opencv0", "opencv2", "opencv4",
                                                     "opencv5", "opencv8", "fisheye4"};
  return kModelNames[static_cast<std::size_t>(m)];
}

Result<LensModel> parse_lens_model(const std::string& name) {
  std::string names;
  for (const LensModel m : {LensModel::opencv0, LensModel::opencv2, LensModel::opencv4, LensModel::opencv5,
                            LensModel::opencv8, LensModel::fisheye4}) {
    if (lens_model_name(m) == name) return m;
    names += (names.empty() ? "" : ", ") + std::string(lens_model_name(m));
  }
  return fail(ErrorCode::bad_input, "--model", "expected auto or one of " + names + ", got " + name);
}

Result<CameraFit> fit_camera(const std::vector<BoardView>& given, const CameraFitOptions& options) {
  if (given.empty()) return fail(ErrorCode::bad_input, "", "expected views of a board, got none");
  std::vector<BoardView> views = given;
  std::vector<std::string> notes;
  const std::size_t distinct = views.size() - leave_out_copies(views, notes);
  if (distinct < 2)
    return fail(
        ErrorCode::bad_input, views.front().name,
        "expected at least 2 views, better 10 or more, got 1: a single view fits almost any camera, with "
        "small residuals and a wrong focal length");
  const BoardView& first = views.front();
  for (const BoardView& v : views)
    if (v.width_px != first.width_px || v.height_px != first.height_px)
      return fail(ErrorCode::bad_input, v.name,
                  "expected pictures of one size, got " + std::to_string(v.width_px) + "x" +
                      std::to_string(v.height_px) + " and before it " + std::to_string(first.width_px) + "x" +
                      std::to_string(first.height_px) + " (" + first.name +
                      "): one camera, one mode at a time");
  std::vector<LensModel> models = options.models;
  if (models.empty())
    models = {LensModel::opencv0, LensModel::opencv2, LensModel::opencv4, LensModel::opencv5};

  CameraFit out;
  Problem problem(views, options);
  const LensModel largest = models.back();
  // Start, outliers, each model, the last fit: how far it is.
  const double steps = static_cast<double>(models.size()) + 3;
  double done = 0;
  if (options.progress)
    problem.set_progress([&](double share, double rms) {
      // Models are fitted many times for the cross-validation: their share stays where it is.
      options.progress((done + (done >= 2 && done < steps - 1 ? 0 : share)) / steps, rms);
    });
  auto begun = start_of_all(views, largest, options, problem);
  if (!begun) return tl::unexpected<Error>(begun.error());
  // Outliers are what the most flexible model cannot explain: all models are compared on the rest.
  State flexible = *begun;
  drop_what_does_not_fit(largest, flexible);
  done = 1;
  auto judged = problem.fit(largest, flexible, options.robust, false, [](std::size_t) { return true; });
  if (!judged) return tl::unexpected<Error>(judged.error());
  std::vector<bool> used(problem.corners().size(), true);
  for (const std::uint32_t id : judged->rejected_ids) used[id] = false;

  std::vector<Candidate> candidates;
  std::vector<State> states;
  State state = models.size() > 1 ? *begun : flexible;
  LeastSquares::Outcome fitted = *judged;
  const auto stopped = [&] { return options.stop.stop_requested(); };
  for (std::size_t m = 0; m < models.size() && !stopped(); ++m) {
    done = 2 + static_cast<double>(m);
    drop_what_does_not_fit(models[m], state);
    if (models.size() > 1) {
      auto refit = problem.fit(models[m], state, false, false, [&](std::size_t i) { return used[i]; });
      if (!refit) return tl::unexpected<Error>(refit.error());
      fitted = std::move(*refit);
    }
    Candidate c;
    c.name = std::string(lens_model_name(models[m]));
    for (int i = 0; i < kCameraParameters; ++i) c.parameters += fits(models[m], i);
    double sum = 0;
    for (double r : fitted.residuals) sum += r * r;
    c.rms = fitted.fit.residuals.rms;
    c.bic = bic(sum, static_cast<double>(fitted.residuals.size()),
                static_cast<std::size_t>(c.parameters) + 6 * distinct);
    if (models.size() > 1) {
      cross_validate(views, models[m], problem, used, state, options.folds, c);
      if (const auto halves = fit_halves(views, models[m], problem, used, state);
          halves && std::isfinite(halves->apart_p95_px)) {
        char text[80];
        std::snprintf(text, sizeof text, "halves of the views apart by %.2f px (p95)", halves->apart_p95_px);
        c.note = text;
      }
    }
    candidates.push_back(c);
    states.push_back(state);
  }
  // Asked to stop, what is known best is the fit that judged the outliers.
  const bool cut_short = stopped();
  done = steps - 1;
  if (cut_short) {
    candidates.clear();
    if (models.size() > 1)
      notes.push_back("interrupted before the models were compared: the largest was taken");
  }
  const std::size_t chosen = cut_short ? models.size() - 1 : choose_model(candidates);
  state = cut_short ? flexible : states[chosen];
  out.lens_model = models[chosen];
  // A single model has had its outliers judged by itself.
  auto final_fit = models.size() == 1 || cut_short ? std::move(judged)
                                                   : problem.fit(out.lens_model, state, options.robust, false,
                                                                 [](std::size_t) { return true; });
  if (!final_fit) return tl::unexpected<Error>(final_fit.error());

  out.result = final_fit->fit;
  out.result.interrupted = out.result.interrupted || cut_short;
  out.result.model = std::string(lens_model_name(out.lens_model));
  out.result.candidates = candidates;
  advise(out.result);
  const bool fisheye = is_fisheye(out.lens_model);
  out.camera = camera_of(state.camera, fisheye, first.width_px, first.height_px);
  out.uncertainty = uncertainty_map(out.camera, out.result.covariance);
  // What the model does not have is not reported.
  std::vector<Eigen::Index> kept;
  std::vector<Parameter> parameters;
  for (std::size_t i = 0; i < out.result.parameters.size(); ++i)
    if (fits(out.lens_model, static_cast<int>(i))) {
      kept.push_back(static_cast<Eigen::Index>(i));
      parameters.push_back(out.result.parameters[i]);
    }
  out.result.parameters = std::move(parameters);
  out.result.covariance = out.result.covariance(kept, kept).eval();

  std::vector<bool> kept_corner(problem.corners().size(), true);
  for (std::size_t k = 0; k < final_fit->rejected_ids.size(); ++k) {
    const Corner& c = problem.corners()[final_fit->rejected_ids[k]];
    const BoardPoint& p = views[c.view].points[c.point];
    kept_corner[final_fit->rejected_ids[k]] = false;
    out.result.rejected[k].what =
        views[c.view].name + " corner (" + std::to_string(p.column) + ", " + std::to_string(p.row) + ")";
  }
  std::vector<double> all;
  std::vector<std::vector<double>> by_view(views.size());
  for (std::size_t i = 0; i < problem.corners().size(); ++i) {
    const auto r = problem.residual(out.lens_model, state, i);
    const Corner& c = problem.corners()[i];
    const BoardPoint& p = views[c.view].points[c.point];
    out.residuals.push_back({c.view, p.u_px, p.v_px, r[0], r[1], kept_corner[i]});
    if (!kept_corner[i]) continue;
    all.push_back(r[0] * r[0] + r[1] * r[1]);
    by_view[c.view].push_back(all.back());
  }
  out.rms_per_corner_px = rms_of(all);
  if (!cut_short && !stopped())
    if (const auto halves = fit_halves(views, out.lens_model, problem, kept_corner, state))
      judge_halves(out, *halves, kept);
  for (std::size_t v = 0; v < views.size(); ++v) {
    out.view_rms_px.push_back(rms_of(by_view[v]));
    if (by_view[v].empty() && !views[v].points.empty())
      out.result.warnings.push_back(views[v].name + ": none of its corners agrees with the others");
    const Pose& pose = state.poses[v];
    const Eigen::Vector3d turn(pose[0], pose[1], pose[2]);
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    if (turn.norm() > 0) t.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
    t.translation() = Eigen::Vector3d(pose[3], pose[4], pose[5]);
    out.T_camera_board.push_back(t);
  }
  out.result.warnings.insert(out.result.warnings.end(), notes.begin(), notes.end());
  if (distinct < 3)
    out.result.warnings.push_back("expected at least 3 views, better 10 or more, got " +
                                  std::to_string(distinct) +
                                  ": small residuals then say little about the camera");
  if (auto s = out.camera.validate(); !s)
    out.result.warnings.push_back("the fitted model is not one that a simulator takes: " + s.error().text());
  double nearest = 1e300, farthest = 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (views[v].points.empty()) continue;
    const auto& t = out.T_camera_board[v];
    nearest = std::min(nearest, t.translation().norm());
    farthest = std::max(farthest, t.translation().norm());
  }
  out.result.validity = {{"board_distance_m", nearest, farthest}};
  return out;
}

}  // namespace rigor::calibration
