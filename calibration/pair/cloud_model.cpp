#include "calibration/pair/cloud_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>
#include <optional>

#include "calibration/pair/clustered_fit.h"
#include "sensor-hal/channel/pair_watch/cloud_change.h"

namespace rigor::calibration {
namespace {

using Eigen::Vector3d;
using pair_watch::CloudChange;
using Row = CloudChange::Row;

enum Column : std::size_t { kBias, kScale, kTurn, kMove = kTurn + 3, kRemission = kMove + 3, kBeams };
constexpr std::size_t kSectors = 128;
constexpr std::size_t kNoiseLevels = 24;
constexpr double kLeastCosine = 0.2;

Vector3d vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }
double median(std::vector<double> values) {
  const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}
double azimuth(const Vector3d& d) { return std::atan2(d.y(), d.x()); }
double elevation(const Vector3d& d) { return std::atan2(d.z(), std::hypot(d.x(), d.y())); }
bool fired_before(const Row& a, const std::pair<std::uint16_t, std::int32_t>& firing) {
  return std::pair{a.ring, a.t_ns} < firing;
}

/// First returns by ring and firing.
struct Return {
  std::uint16_t ring;
  std::int32_t t_ns;
  double range, remission;
  friend bool operator<(const Return& a, const Return& b) {
    return a.ring != b.ring ? a.ring < b.ring : a.t_ns < b.t_ns;
  }
};
/// Calls `take(point, range_m)` for each first return.
template <class Take>
void for_each_return(const Sample& s, std::uint32_t rings, const Take& take) {
  for (std::size_t i = 0; i + sizeof(LidarPoint) <= s.size_bytes; i += sizeof(LidarPoint)) {
    LidarPoint p;
    std::memcpy(&p, s.bytes().data() + i, sizeof p);
    const double range = std::hypot(double{p.x_m}, double{p.y_m}, double{p.z_m});
    if (p.ring < rings && p.return_index == 0 && std::isfinite(range) && range > 0) take(p, range);
  }
}
void take_returns(const Sample& s, std::uint32_t rings, std::vector<Return>& out) {
  out.clear();
  for_each_return(s, rings, [&](const LidarPoint& p, double range) {
    out.push_back({p.ring, p.t_offset_ns, range, double{p.remission}});
  });
  std::sort(out.begin(), out.end());
}

/// The simulated side's pieces of surface by direction.
class Pieces {
 public:
  void take(std::span<const Row> rows, std::uint32_t rings) {
    rows_ = rows;
    by_ring_.assign(rings, {});
    height_.assign(rings, 0);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const Vector3d d = vector(rows[i].direction);
      by_ring_[rows[i].ring].push_back({azimuth(d), i});
      height_[rows[i].ring] += elevation(d);
    }
    for (std::size_t r = 0; r < rings; ++r) {
      std::sort(by_ring_[r].begin(), by_ring_[r].end());
      if (!by_ring_[r].empty()) height_[r] /= double(by_ring_[r].size());
    }
  }
  [[nodiscard]] const Row* towards(const Vector3d& d) const {
    std::size_t ring = 0;
    if (by_ring_.size() > 1) {
      const double e = elevation(d);
      double closest = 1e9;
      for (std::size_t r = 0; r < by_ring_.size(); ++r)
        if (!by_ring_[r].empty() && std::abs(height_[r] - e) < closest)
          closest = std::abs(height_[r] - e), ring = r;
    }
    const auto& at = by_ring_[ring];
    if (at.empty()) return nullptr;
    const double a = azimuth(d);
    const auto next = std::lower_bound(at.begin(), at.end(), std::pair{a, std::size_t{0}});
    const Row* best = nullptr;
    double closest = 0.03;  // rad
    const auto look = [&](const std::pair<double, std::size_t>& p) {
      const double off = std::abs(std::remainder(p.first - a, 2 * std::numbers::pi));
      if (off < closest) closest = off, best = &rows_[p.second];
    };
    look(next == at.end() ? at.front() : *next);
    look(next == at.begin() ? at.back() : *std::prev(next));
    return best;
  }

  [[nodiscard]] const Row* of_firing(std::uint16_t ring, std::int32_t t_ns) const {
    const auto same = std::lower_bound(rows_.begin(), rows_.end(), std::pair{ring, t_ns}, fired_before);
    return same != rows_.end() && same->ring == ring && same->t_ns == t_ns ? &*same : nullptr;
  }

 private:
  std::span<const Row> rows_;
  std::vector<std::vector<std::pair<double, std::size_t>>> by_ring_;
  std::vector<double> height_;
};

class Fitter {
 public:
  Fitter(const ForEachPair& pairs, const CloudPairOptions& options)
      : pairs_(pairs), options_(options), beams_(options.rings > 1 ? std::min(options.rings, 16U) : 0) {
    columns_ = kBeams + beams_;
    const bool plane = options.rings == 1;
    held_.assign(columns_, false);
    for (std::size_t k = 0; k < 3; ++k) held_[kTurn + k] = held_[kMove + k] = !options.mount;
    if (plane) held_[kTurn] = held_[kTurn + 1] = held_[kMove + 2] = true;
    for (std::size_t k = 0; k < beams_; ++k) held_[kBeams + k] = true;
    state_ = Eigen::VectorXd::Zero(Eigen::Index(columns_));
    for (std::uint32_t r = 0; r < options.rings; ++r)
      fit_.beam_of_ring.push_back(beams_ > 0 ? r * std::uint32_t(beams_) / options.rings : 0);
    names_ = {{.name = "range_bias_m", .resolution = 0.2},   {.name = "range_scale", .resolution = 0.05},
              {.name = "mount_x_rad", .resolution = 0.05},   {.name = "mount_y_rad", .resolution = 0.05},
              {.name = "mount_z_rad", .resolution = 0.05},   {.name = "mount_move_x_m", .resolution = 0.2},
              {.name = "mount_move_y_m", .resolution = 0.2}, {.name = "mount_move_z_m", .resolution = 0.2},
              {.name = "remission_gain", .resolution = 0.2}};
    why_ = {"there are too few smooth surfaces; record walls, ground, trunks",
            "all surfaces are about equally far; record near and far ones",
            "surfaces to all sides are needed; record a place with ground and walls",
            "surfaces to all sides are needed; record a place with ground and walls",
            "surfaces to all sides are needed; record a place with walls in several directions",
            "no surface lies across x; record a place with walls in several directions",
            "no surface lies across y; record a place with walls in several directions",
            "no surface lies across z; record a place with ground or ceiling",
            "there are too few returns that both sides have"};
    for (std::size_t k = 0; k < beams_; ++k) {
      names_.push_back({.name = "beam_bias_m[" + std::to_string(k) + "]", .resolution = 0.2});
      why_.emplace_back("this beam meets too few smooth surfaces");
    }
  }

  Result<CloudPairFit> run() {
    if (auto s = prepare(); !s) return tl::unexpected<Error>(s.error());
    if (auto s = start_outlying_beams(); !s) return tl::unexpected<Error>(s.error());
    if (auto s = solve(); !s) return tl::unexpected<Error>(s.error());
    if (auto s = hold_the_open(); !s) return tl::unexpected<Error>(s.error());
    if (beams_ > 0 && fit_.pairs >= 2 && !fit_.change.interrupted)
      if (auto s = solve_with_beams(); !s) return tl::unexpected<Error>(s.error());
    finish();
    return std::move(fit_);
  }

 private:
  /// What is known to no use makes others worse: it stays as it is in the sensor model, and is told.
  Status hold_the_open() {
    bool again = false;
    for (std::size_t k = 0; k < columns_; ++k) {
      const auto i = Eigen::Index(k);
      if (held_[k] ||
          (solution_.determined[k] && std::sqrt(solution_.covariance(i, i)) <= names_[k].resolution))
        continue;
      held_[k] = true, again = true;
      open_.push_back(k);
      state_[i] = 0;
    }
    if (!again) return {};
    // Turns and moves start anew without those that are open.
    R_.setIdentity(), t_.setZero();
    return solve();
  }

  /// Single beams are kept where one stands out.
  Status solve_with_beams() {
    const auto before = std::tuple{state_, R_, t_};
    for (std::size_t k = 0; k < beams_; ++k) held_[kBeams + k] = false;
    const auto medians = beam_medians();
    if (!medians) return tl::unexpected<Error>(medians.error());
    double sum = 0, count = 0;
    for (const double m : *medians)
      if (std::isfinite(m)) sum += m, ++count;
    for (std::size_t k = 0; k < beams_; ++k)
      beam(k) = std::isfinite((*medians)[k]) ? (*medians)[k] - sum / count : 0;
    if (count > 0) state_[kBias] += sum / count;
    if (auto s = solve(); !s) return s;
    for (std::size_t k = 0; k < beams_; ++k) {
      const auto i = Eigen::Index(kBeams + k);
      if (solution_.determined[kBeams + k] &&
          std::abs(state_[i]) > 4.5 * std::sqrt(solution_.covariance(i, i)))
        return {};
    }
    std::tie(state_, R_, t_) = before;
    for (std::size_t k = 0; k < beams_; ++k) held_[kBeams + k] = true, beam(k) = 0;
    return solve();
  }

  Status solve() {
    fit_.converged = false;
    for (int pass = 0; pass < options_.most_passes; ++pass) {
      if (options_.progress) options_.progress(fit_.passes + 1);
      if (auto s = one_pass(); !s) return s;
      const bool first = fit_.passes++ == 0;
      const Eigen::VectorXd& step = solution_.step;
      if (first) fit_.one_step.assign(step.data(), step.data() + step.size());
      if (fit_.pairs < 2) return {};
      // Pieces that are looked up change with the state: steps do not get as small as a smooth model's.
      const bool small = solution_.is_small(0.1);
      if (small || options_.stop.stop_requested()) {
        fit_.converged = small, fit_.change.interrupted = options_.stop.stop_requested();
        return {};
      }
      state_ += step;
      const Vector3d turn = step.segment<3>(kTurn);
      // About the device's own axes; moves are in the simulated side's.
      t_ += R_ * Vector3d(step.segment<3>(kMove));
      if (turn.norm() > 0) R_ = R_ * Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
    }
    return {};
  }

  [[nodiscard]] double& beam(std::size_t k) { return state_[Eigen::Index(kBeams + k)]; }

  /// Of each beam's ranges against the simulated side, as the state carries it over; NaN: too few. They need
  /// no surfaces of the device, which has a step at a beam that is far off.
  Result<std::vector<double>> beam_medians() {
    std::vector<ResidualSample> left(beams_);
    auto said = pairs_([&](const Sample& real, const Sample& simulated) {
      if (!simulated_change_->add(real, simulated)) return;
      pieces_.take(simulated_change_->rows(), options_.rings);
      for_each_return(real, options_.rings, [&](const LidarPoint& p, double range) {
        const Vector3d d = Vector3d{p.x_m, p.y_m, p.z_m} / range;
        if (const auto met = intersect({d, range, p.t_offset_ns, p.ring}))
          left[fit_.beam_of_ring[p.ring]].add(residual(range, met->range));
      });
      pair_watch::Estimate nobody;
      simulated_change_->finish(nobody);
    });
    if (!said) return tl::unexpected<Error>(said.error());
    std::vector<double> medians;
    for (const ResidualSample& s : left)
      medians.push_back(s.values().size() < 16 ? std::nan("") : median(s.values()));
    return medians;
  }

  /// A beam that is far off from the others bends the device's surfaces and takes their neighbours with it:
  /// it is put right roughly before anything else is solved for.
  Status start_outlying_beams() {
    if (beams_ < 4) return {};
    const auto medians = beam_medians();
    if (!medians) return tl::unexpected<Error>(medians.error());
    std::vector<double> known;
    for (const double m : *medians)
      if (std::isfinite(m)) known.push_back(m);
    if (known.size() < 4) return {};
    const double middle = median(known);
    for (double& m : known) m = std::abs(m - middle);
    const double limit = std::max(2 * options_.sigma_m, 4 * 1.4826 * median(known));
    for (std::size_t k = 0; k < beams_; ++k)
      if (std::abs((*medians)[k] - middle) > limit) beam(k) = (*medians)[k] - middle;
    return {};
  }

  Status prepare() {
    pair_watch::CloudChangeOptions o;
    o.points = o.rows = options_.points;
    o.rings = options_.rings, o.sigma_m = options_.sigma_m;
    for (auto* change : {&simulated_change_, &real_change_}) {
      auto made = CloudChange::make(o);
      if (!made) return tl::unexpected<Error>(made.error());
      *change = std::make_unique<CloudChange>(std::move(*made));
    }
    fit_rows_ = std::make_unique<ClusteredFit>(columns_, std::size_t{options_.rings} * kSectors);
    if (beams_ > 0) {
      std::vector<double> sum(columns_, 0);
      std::fill(sum.begin() + kBeams, sum.end(), 1);
      fit_rows_->constrain(sum);
    }
    return {};
  }

  Status one_pass() {
    const std::uint64_t stretch = std::max<std::uint64_t>(1, fit_.pairs / 50);
    fit_.pairs = fit_.unlike = 0, fit_.after = {};
    both_ = lost_ = gained_ = 0;
    noise_ = NoiseByLevel(kNoiseLevels);
    fit_rows_->clear();
    auto said = pairs_([&](const Sample& real, const Sample& simulated) {
      if (!simulated_change_->add(real, simulated) || !real_change_->add(simulated, without_beams(real))) {
        ++fit_.unlike;
        return;
      }
      ++fit_.pairs;
      take_rows();
      take_returns(real, options_.rings, real_);
      take_returns(simulated, options_.rings, simulated_);
      take_remission_and_noise();
      pair_watch::Estimate nobody;
      simulated_change_->finish(nobody), real_change_->finish(nobody);
      if (fit_.pairs % stretch == 0) fit_rows_->end_stretch();
    });
    if (!said) return said;
    fit_rows_->end_stretch();
    solution_ = fit_rows_->solve(held_);
    return {};
  }

  [[nodiscard]] std::size_t place(std::uint32_t ring, double azimuth_rad) const {
    const double turn = azimuth_rad / (2 * std::numbers::pi) + 0.5;
    return ring * kSectors + std::min(kSectors - 1, std::size_t(std::max(0.0, turn * double(kSectors))));
  }

  struct Equation {
    std::vector<double> z, j;
    double residual = 0, weight = 0;
    std::size_t place = 0;
  };

  /// The device's cloud less the biases of beams found so far. Where its surfaces have edges and how they are
  /// turned is judged by this one: with a beam's bias in it, points whose noise makes up for the bias would
  /// pass and others would not.
  const Sample& without_beams(const Sample& real) {
    if (state_.tail(Eigen::Index(beams_)).isZero(0) || !real.as<PointCloudInfo>()) return real;
    if (corrected_.memory().size() < real.size_bytes) corrected_.reserve(real.size_bytes);
    corrected_.stamp = real.stamp, corrected_.info = real.info, corrected_.size_bytes = real.size_bytes;
    for (std::size_t i = 0; i + sizeof(LidarPoint) <= real.size_bytes; i += sizeof(LidarPoint)) {
      LidarPoint p;
      std::memcpy(&p, real.bytes().data() + i, sizeof p);
      const double range = std::hypot(double{p.x_m}, double{p.y_m}, double{p.z_m});
      if (p.ring < options_.rings && range > 0) {
        const double bias = state_[Eigen::Index(kBeams + fit_.beam_of_ring[p.ring])];
        const auto part = float(std::max(0.0, 1 - bias / range));
        p.x_m *= part, p.y_m *= part, p.z_m *= part;
      }
      std::memcpy(corrected_.memory().data() + i, &p, sizeof p);
    }
    return corrected_;
  }

  struct Firing {
    Vector3d direction;
    double range;  ///< measured, less the beam's bias
    std::int32_t t_ns;
    std::uint16_t ring;
  };
  struct Intersection {
    Vector3d normal;  ///< in the device's frame
    double range;     ///< from the device
  };
  /// Where a firing of the device meets the simulated side's pieces, by the mount found so far.
  [[nodiscard]] std::optional<Intersection> intersect(const Firing& fired) const {
    const Row* piece = nullptr;
    double range = 0;
    if (!R_.isIdentity(0) || !t_.isZero(0)) {
      const Vector3d ray = R_ * fired.direction;
      range = (fired.range - state_[kBias]) / (1 + state_[kScale]);
      for (int again = 0; again < 2; ++again) {
        piece = pieces_.towards(t_ + ray * range);
        if (!piece) return {};
        const Vector3d n = vector(piece->normal), p = piece->range * vector(piece->direction);
        const double across = n.dot(ray);
        if (std::abs(across) < kLeastCosine) return {};
        range = n.dot(p - t_) / across;
      }
    } else {
      piece = pieces_.of_firing(fired.ring, fired.t_ns);
      if (!piece) return {};
      range = piece->range;
    }
    if (!(range > 0) || std::abs(range - piece->range) > 0.1 * piece->range + 1) return {};
    const Vector3d n = R_.transpose() * vector(piece->normal);
    if (std::abs(n.dot(fired.direction)) < kLeastCosine) return {};
    return Intersection{n, range};
  }
  [[nodiscard]] double residual(double measured, double range) const {
    return measured - (1 + state_[kScale]) * range - state_[kBias];
  }

  void take_rows() {
    const auto real_rows = real_change_->rows();
    pieces_.take(simulated_change_->rows(), options_.rings);
    equations_.clear();
    for (std::size_t i = 0; i < real_rows.size(); ++i) {
      const Row& fired = real_rows[i];
      const Vector3d d = vector(fired.direction), n_real = vector(fired.normal);
      const auto met = intersect({d, fired.range, fired.t_ns, fired.ring});
      // One surface, as both see it.
      if (!met || std::abs(met->normal.dot(n_real)) < 0.95 || std::abs(n_real.dot(d)) < kLeastCosine)
        continue;
      // The piece's range has noise, which is in the residual, too; the device's ranges beside have none of
      // it.
      double beside = 0, neighbours = 0;
      for (const std::size_t at : {i - 1, i + 1})
        if (at < real_rows.size() && real_rows[at].ring == fired.ring)
          beside += real_rows[at].range, ++neighbours;
      if (neighbours == 0) continue;
      Equation e;
      const std::size_t beam_column = kBeams + fit_.beam_of_ring[fired.ring];
      const auto columns = [&](const Vector3d& normal, double at_m) {
        std::vector<double> c(columns_, 0);
        const double across = normal.dot(d);
        c[kBias] = 1, c[kScale] = at_m;
        for (Eigen::Index k = 0; k < 3; ++k) {
          c[kTurn + std::size_t(k)] = -at_m * d.cross(normal)[k] / across;
          c[kMove + std::size_t(k)] = -normal[k] / across;
        }
        if (beams_ > 0) c[beam_column] = 1;
        return c;
      };
      e.j = columns(met->normal, met->range), e.z = columns(n_real, beside / neighbours);
      e.residual = residual(fired.range, met->range);
      e.place = place(fired.ring, azimuth(d));
      equations_.push_back(std::move(e));
    }
    if (equations_.size() < 16) return;
    scratch_.clear();
    for (const Equation& e : equations_) scratch_.push_back(std::abs(e.residual));
    const double limit = kHuberLimit * std::max(1.4826 * median(scratch_), 1e-6);
    const double weight = 1 / (2 * options_.sigma_m * options_.sigma_m);
    for (Equation& e : equations_) {
      if (fit_.passes == 0) fit_.before.add(e.residual);
      fit_.after.add(e.residual);
      fit_rows_->add(e.place, e.z, e.j, e.residual, huber_weight(weight, std::abs(e.residual) / limit));
    }
  }

  void take_remission_and_noise() {
    std::size_t k = 0;
    const auto n = simulated_.size();
    matched_.assign(n, nullptr);
    double both = 0;
    for (std::size_t i = 0; i < n; ++i) {
      while (k < real_.size() && real_[k] < simulated_[i]) ++k;
      if (k == real_.size() || simulated_[i] < real_[k]) continue;
      matched_[i] = &real_[k], ++both;
    }
    both_ += both, lost_ += double(n) - both, gained_ += double(real_.size()) - both;
    const double top = options_.remission_max;
    for (std::size_t i = 0; i < n; ++i) {
      const Return* r = matched_[i];
      if (!r) continue;
      const Return& s = simulated_[i];
      if (s.remission > 0 && (top <= 0 || (s.remission < 0.95 * top && r->remission < 0.95 * top))) {
        // A ratio of sums: noise of the simulated side's own remission does not make it smaller.
        scratch_.assign(columns_, 0), instrument_.assign(columns_, 0);
        scratch_[kRemission] = s.remission, instrument_[kRemission] = 1;
        fit_rows_->add(place(s.ring, 2 * std::numbers::pi * (double(i) / double(n) - 0.5)), instrument_,
                       scratch_, r->remission - (1 + state_[kRemission]) * s.remission, {1e-6, 1e-6});
      }
    }
    // Three in a row, and the next three: no return counts twice. Where the simulated side has an edge near
    // by, the device may have it here.
    const auto sigma_of = [&](const Return& r) {
      return options_.model_sigma_m ? options_.model_sigma_m(r.remission, r.range) : options_.sigma_m;
    };
    const auto smooth = [&](std::size_t i) {
      const Return &a = simulated_[i - 1], &b = simulated_[i], &c = simulated_[i + 1];
      return a.ring == c.ring && std::abs(a.range - 2 * b.range + c.range) < 6 * std::sqrt(6.0) * sigma_of(b);
    };
    constexpr std::size_t kAround = 4;
    for (std::size_t i = kAround; i + kAround + 2 < n; i += 3) {
      const Return &a = simulated_[i], &b = simulated_[i + 1], &c = simulated_[i + 2];
      if (!matched_[i] || !matched_[i + 1] || !matched_[i + 2] || a.ring != c.ring) continue;
      const double sigma = sigma_of(b);
      if (!(sigma > 0)) continue;
      bool even = true;
      double bend = 0;
      for (std::size_t m = i + 1 - kAround; m <= i + 1 + kAround && even; ++m) {
        even = smooth(m);
        bend += simulated_[m - 1].range - 2 * simulated_[m].range + simulated_[m + 1].range;
      }
      // A wall seen along itself bends by more than the noise, and after a turn by another amount.
      if (!even || std::abs(bend) / (2 * kAround + 1) > 0.5 * sigma) continue;
      const double second[2] = {matched_[i]->range - 2 * matched_[i + 1]->range + matched_[i + 2]->range,
                                a.range - 2 * b.range + c.range};
      const double octave = std::log2(sigma / 1e-3) * 3;
      const auto level = std::size_t(std::clamp(octave, 0.0, double(kNoiseLevels - 1)));
      noise_.add(level, sigma * sigma, std::min(second[0] * second[0] / 6, 60 * sigma * sigma),
                 second[1] * second[1] / 6);
    }
  }

  void finish() {
    fit_.bias_m = state_[kBias], fit_.scale = state_[kScale];
    fit_.R_simulated_real = R_, fit_.t_simulated_real_m = t_;
    if (beams_ > 0 && !held_[kBeams])
      for (std::size_t k = 0; k < beams_; ++k) fit_.beam_m.push_back(state_[Eigen::Index(kBeams + k)]);
    if (const double all = both_ + lost_ + gained_; all > 0)
      fit_.lost = lost_ / all, fit_.gained = gained_ / all;
    fit_.noise = noise_.levels();
    fit_.change.residuals.unit = "m";
    fit_.change.model = std::string("range bias, range scale, remission") +
                        (options_.mount ? ", mount" : "") + (fit_.beam_m.empty() ? "" : ", beams");
    Eigen::VectorXd value = state_;
    const Eigen::AngleAxisd turned(R_);
    value.segment<3>(kTurn) = turned.angle() * turned.axis();
    value.segment<3>(kMove) = t_;
    keep_solution(fit_, names_, value, solution_.covariance, held_, why_);
    for (const std::size_t k : open_) fit_.change.not_identifiable.emplace_back(names_[k].name, why_[k]);
  }

  const ForEachPair& pairs_;
  CloudPairOptions options_;
  std::size_t beams_, columns_ = 0;
  std::vector<bool> held_;
  std::vector<std::size_t> open_;
  std::vector<Parameter> names_;
  std::vector<std::string> why_;
  Eigen::VectorXd state_;
  Eigen::Matrix3d R_ = Eigen::Matrix3d::Identity();
  Vector3d t_ = Vector3d::Zero();
  CloudPairFit fit_;
  ClusteredFit::Solution solution_;
  std::unique_ptr<CloudChange> simulated_change_, real_change_;
  std::unique_ptr<ClusteredFit> fit_rows_;
  Pieces pieces_;
  std::vector<Equation> equations_;
  std::vector<double> scratch_, instrument_;
  std::vector<Return> real_, simulated_;
  Sample corrected_;
  std::vector<const Return*> matched_;
  NoiseByLevel noise_{kNoiseLevels};
  double both_ = 0, lost_ = 0, gained_ = 0;
};

}  // namespace

Result<CloudPairFit> fit_cloud_pair(const ForEachPair& pairs, const CloudPairOptions& options) {
  return Fitter(pairs, options).run();
}

NoiseFactor noise_factor(const std::vector<NoiseLevel>& levels) {
  NoiseFactor out;
  double weights = 0, sum = 0;
  for (const NoiseLevel& l : levels) {
    if (!(l.level > 0) || !(l.sigma > 0)) continue;
    const double w = std::pow(l.level / l.sigma, 2);
    weights += w, sum += w * (1 + l.difference / l.level);
    ++out.levels;
  }
  if (out.levels == 0) return out;
  const double square = std::max(1e-6, sum / weights);
  for (const NoiseLevel& l : levels)
    if (l.level > 0 && l.sigma > 0)
      out.chi2 += std::pow((1 + l.difference / l.level - square) * l.level / l.sigma, 2);
  out.factor = std::sqrt(square);
  out.sigma = 1 / std::sqrt(weights) / (2 * out.factor);
  return out;
}

}  // namespace rigor::calibration
