#include "calibration/core/least_squares.h"

#include <ceres/ceres.h>
#include <glog/logging.h>
#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <thread>

#include "calibration/core/chi_squared.h"

namespace rigor::calibration {
namespace {

constexpr double kMadToSigma = 1.4826022185056018;  // of a normal distribution
constexpr int kMaxRounds = 12;

/// Ceres says on stderr, through glog, what it also returns. A program that has set up glog itself keeps its
/// settings.
void keep_the_solver_quiet() {
  static const bool done = [] {
    if (!google::IsGoogleLoggingInitialized()) FLAGS_minloglevel = google::GLOG_FATAL;
    return true;
  }();
  (void)done;
}

/// Standard deviation from the median of absolute residuals. A robust fit of p parameters to m residuals
/// passes through p of them nearly exactly, so that the median is that of the m − p + 1 largest (DuMouchel
/// and O'Brien, Computing and Graphics in Statistics, 1991).
double robust_sigma(std::vector<double> absolute, std::size_t parameters) {
  if (absolute.empty()) return 0;
  const std::size_t exact = parameters == 0 ? 0 : std::min(parameters - 1, absolute.size() - 1);
  const auto middle = absolute.begin() + static_cast<std::ptrdiff_t>((exact + absolute.size()) / 2);
  std::nth_element(absolute.begin(), middle, absolute.end());
  return kMadToSigma * *middle;
}

class Progress final : public ceres::IterationCallback {
 public:
  Progress(const FitOptions& options, double from, double to, std::size_t residuals)
      : options_(options), from_(from), to_(to), residuals_(residuals) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& s) override {
    if (options_.progress) {
      const double share = 1 - 1.0 / (1 + 0.2 * s.iteration);
      options_.progress(from_ + (to_ - from_) * share,
                        std::sqrt(2 * s.cost / static_cast<double>(std::max<std::size_t>(1, residuals_))));
    }
    return options_.stop.stop_requested() ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

 private:
  const FitOptions& options_;
  double from_, to_;
  std::size_t residuals_;
};

}  // namespace

struct LeastSquares::Impl {
  struct Wanted {
    double* values;
    std::vector<ParameterInfo> infos;
  };
  struct Nuisance {
    double* values;
    int size;
    std::shared_ptr<ceres::Manifold> manifold;
  };
  struct Function {
    std::unique_ptr<ceres::CostFunction> cost;
    std::vector<double*> blocks;
    std::vector<std::uint32_t> ids;
    std::size_t first;  ///< of its observations
    [[nodiscard]] std::size_t dimension() const {
      return static_cast<std::size_t>(cost->num_residuals()) / ids.size();
    }
  };
  std::vector<Wanted> wanted;
  std::vector<Nuisance> nuisance;
  std::vector<Function> functions;
  std::size_t observations = 0;

  /// A batch with some of its observations left out and each of the others under the loss: r·√(ρ(s)/s) has
  /// the cost ρ, and its Jacobian is the exact one.
  class Masked final : public ceres::CostFunction {
   public:
    Masked(const Function& f, const std::vector<bool>& used, const ceres::LossFunction* loss)
        : f_(f), loss_(loss), used_(f.ids.size()) {
      for (std::size_t i = 0; i < used_.size(); ++i) used_[i] = used[f.first + i];
      set_num_residuals(f.cost->num_residuals());
      *mutable_parameter_block_sizes() = f.cost->parameter_block_sizes();
    }
    bool Evaluate(const double* const* x, double* r, double** j) const override {
      if (!f_.cost->Evaluate(x, r, j)) return false;
      const auto d = static_cast<Eigen::Index>(f_.dimension());
      for (std::size_t i = 0; i < used_.size(); ++i) {
        const Eigen::Index row = d * static_cast<Eigen::Index>(i);
        Eigen::Map<Eigen::VectorXd> e(r + row, d);
        const double square = e.squaredNorm();
        double slope = 0, factor = 0;
        if (used_[i]) {
          if (!std::isfinite(square)) return false;
          if (!loss_) continue;
          double rho[3];
          loss_->Evaluate(square, rho);
          factor = square > 0 ? std::sqrt(rho[0] / square) : 1;
          // d√(ρ/s)/ds = (ρ' − ρ/s)/(2·s·√(ρ/s)), and ds = 2·rᵀJ
          slope = square > 0 ? (rho[1] - rho[0] / square) / (square * factor) : 0;
        }
        if (j)
          for (std::size_t b = 0; b < parameter_block_sizes().size(); ++b) {
            if (!j[b]) continue;
            const Eigen::Index n = parameter_block_sizes()[b];
            double* all = j[b] + row * n;
            if (factor == 0) {
              std::fill(all, all + d * n, 0.0);
              continue;
            }
            for (Eigen::Index c = 0; c < n; ++c) {
              double along = 0;
              for (Eigen::Index k = 0; k < d; ++k) along += e[k] * all[k * n + c];
              for (Eigen::Index k = 0; k < d; ++k)
                all[k * n + c] = factor * all[k * n + c] + slope * e[k] * along;
            }
          }
        if (factor == 0)
          e.setZero();
        else
          e *= factor;
      }
      return true;
    }

   private:
    const Function& f_;
    const ceres::LossFunction* loss_;
    std::vector<bool> used_;
  };

  std::vector<std::unique_ptr<ceres::CostFunction>> masked;

  [[nodiscard]] std::unique_ptr<ceres::Problem> problem(const std::vector<bool>& used,
                                                        ceres::LossFunction* loss) {
    masked.clear();  // of the problem before: there is one at a time
    ceres::Problem::Options o;
    o.cost_function_ownership = o.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    o.manifold_ownership = ceres::TAKE_OWNERSHIP;
    o.disable_all_safety_checks = true;
    auto p = std::make_unique<ceres::Problem>(o);
    for (const Wanted& w : wanted) {
      const int n = static_cast<int>(w.infos.size());
      p->AddParameterBlock(w.values, n);
      std::vector<int> held;
      for (int i = 0; i < n; ++i) {
        const ParameterInfo& info = w.infos[static_cast<std::size_t>(i)];
        if (info.held) held.push_back(i);
        if (info.lower > -1e299) p->SetParameterLowerBound(w.values, i, info.lower);
        if (info.upper < 1e299) p->SetParameterUpperBound(w.values, i, info.upper);
      }
      if (static_cast<int>(held.size()) == n)
        p->SetParameterBlockConstant(w.values);
      else if (!held.empty())
        p->SetManifold(w.values, new ceres::SubsetManifold(n, held));
    }
    for (const Nuisance& b : nuisance) {
      p->AddParameterBlock(b.values, b.size);
      if (b.manifold) p->SetManifold(b.values, new SharedManifold(b.manifold));
    }
    for (const Function& f : functions) {
      if (f.ids.size() == 1) {
        if (used[f.first]) p->AddResidualBlock(f.cost.get(), loss, f.blocks);
        continue;
      }
      bool any = false;
      for (std::size_t i = f.first; i < f.first + f.ids.size(); ++i) any = any || used[i];
      if (!any) continue;
      masked.push_back(std::make_unique<Masked>(f, used, loss));
      p->AddResidualBlock(masked.back().get(), nullptr, f.blocks);
    }
    return p;
  }

  /// Lets one manifold serve many problems.
  class SharedManifold final : public ceres::Manifold {
   public:
    explicit SharedManifold(std::shared_ptr<ceres::Manifold> m) : m_(std::move(m)) {}
    int AmbientSize() const override { return m_->AmbientSize(); }
    int TangentSize() const override { return m_->TangentSize(); }
    bool Plus(const double* x, const double* d, double* y) const override { return m_->Plus(x, d, y); }
    bool PlusJacobian(const double* x, double* j) const override { return m_->PlusJacobian(x, j); }
    bool Minus(const double* y, const double* x, double* d) const override { return m_->Minus(y, x, d); }
    bool MinusJacobian(const double* x, double* j) const override { return m_->MinusJacobian(x, j); }

   private:
    std::shared_ptr<ceres::Manifold> m_;
  };

  /// Of all observations, function by function: infinite where one has none.
  void residuals(std::vector<double>& r) const {
    std::size_t n = 0;
    for (const Function& f : functions) n += static_cast<std::size_t>(f.cost->num_residuals());
    r.resize(n);
    double* at = r.data();
    for (const Function& f : functions) {
      const int m = f.cost->num_residuals();
      if (!f.cost->Evaluate(f.blocks.data(), at, nullptr))
        std::fill(at, at + m, std::numeric_limits<double>::infinity());
      at += m;
    }
  }
  /// Calls `f(observation, its id, its residuals, how many)` for all of `r`.
  template <class F>
  void each(const std::vector<double>& r, F&& call) const {
    const double* at = r.data();
    for (const Function& f : functions)
      for (std::size_t i = 0; i < f.ids.size(); ++i, at += f.dimension())
        call(f.first + i, f.ids[i], at, f.dimension());
  }
  [[nodiscard]] std::size_t residual_count(const std::vector<bool>& used) const {
    std::size_t m = 0;
    for (const Function& f : functions)
      for (std::size_t i = 0; i < f.ids.size(); ++i)
        if (used[f.first + i]) m += f.dimension();
    return m;
  }
  [[nodiscard]] std::size_t free_wanted() const {
    std::size_t n = 0;
    for (const Wanted& w : wanted)
      for (const ParameterInfo& i : w.infos) n += !i.held;
    return n;
  }
  /// Tangent dimensions of what is solved for and touches a used observation.
  [[nodiscard]] std::size_t free_parameters(const std::vector<bool>& used) const {
    std::map<const double*, bool> seen;
    for (const Function& f : functions)
      for (std::size_t i = 0; i < f.ids.size(); ++i)
        if (used[f.first + i]) {
          for (const double* b : f.blocks) seen[b] = true;
          break;
        }
    std::size_t n = 0;
    for (const Wanted& w : wanted)
      if (seen.count(w.values))
        for (const ParameterInfo& i : w.infos) n += !i.held;
    for (const Nuisance& b : nuisance)
      if (seen.count(b.values))
        n += static_cast<std::size_t>(b.manifold ? b.manifold->TangentSize() : b.size);
    return n;
  }
  [[nodiscard]] bool joint_nuisance() const {
    std::map<const double*, bool> is;
    for (const Nuisance& b : nuisance) is[b.values] = true;
    for (const Function& f : functions) {
      int n = 0;
      for (const double* b : f.blocks) n += static_cast<int>(is.count(b));
      if (n > 1) return true;
    }
    return false;
  }

  ceres::Solver::Summary run(ceres::Problem& p, const FitOptions& options, double from, double to,
                             std::size_t residuals, bool joint, double tolerance) const {
    ceres::Solver::Options o;
    o.max_num_iterations = options.max_iterations;
    // Threads cost more than they bring where an iteration takes less than a millisecond.
    o.num_threads = options.threads > 0 ? options.threads
                    : residuals < 10'000
                        ? 1
                        : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
    o.function_tolerance = tolerance;
    o.parameter_tolerance = tolerance;
    o.gradient_tolerance = 1e-14;
    o.logging_type = ceres::SILENT;
    o.update_state_every_iteration = false;
    if (!nuisance.empty() && !joint) {
      o.linear_solver_type = ceres::DENSE_SCHUR;
      auto order = std::make_shared<ceres::ParameterBlockOrdering>();
      for (const Nuisance& b : nuisance) order->AddElementToGroup(b.values, 0);
      for (const Wanted& w : wanted) order->AddElementToGroup(w.values, 1);
      o.linear_solver_ordering = order;
    } else if (nuisance.empty()) {
      o.linear_solver_type =
          residuals * free_wanted() <= 2'000'000 ? ceres::DENSE_QR : ceres::DENSE_NORMAL_CHOLESKY;
    } else {
      o.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    }
    Progress progress(options, from, to, residuals);
    o.callbacks.push_back(&progress);
    ceres::Solver::Summary s;
    ceres::Solve(o, &p, &s);
    return s;
  }

  /// Returns the rank of the whole Jacobian.
  std::size_t information(ceres::Problem& p, Eigen::MatrixXd& reduced,
                          std::vector<Eigen::MatrixXd>* nuisance_cov) const;
};

LeastSquares::LeastSquares() : impl_(std::make_unique<Impl>()) {}
LeastSquares::~LeastSquares() = default;

void LeastSquares::add_block(double* values, std::vector<ParameterInfo> infos) {
  impl_->wanted.push_back({values, std::move(infos)});
}
void LeastSquares::add_nuisance(double* values, int size, std::shared_ptr<ceres::Manifold> manifold) {
  impl_->nuisance.push_back({values, size, std::move(manifold)});
}
void LeastSquares::add(ceres::CostFunction* cost, std::vector<double*> blocks, std::uint32_t id) {
  add_batch(cost, std::move(blocks), {id});
}
void LeastSquares::add_batch(ceres::CostFunction* cost, std::vector<double*> blocks,
                             std::vector<std::uint32_t> ids) {
  std::unique_ptr<ceres::CostFunction> owned(cost);
  if (ids.empty()) return;
  const std::size_t first = impl_->observations;
  impl_->observations += ids.size();
  impl_->functions.push_back({std::move(owned), std::move(blocks), std::move(ids), first});
}

/// JᵀJ of the free wanted parameters with the nuisance blocks eliminated. Nuisance blocks that meet in a
/// residual are eliminated together. Columns are scaled to unit length first, so that elimination loses
/// nothing to units.
std::size_t LeastSquares::Impl::information(ceres::Problem& p, Eigen::MatrixXd& reduced,
                                            std::vector<Eigen::MatrixXd>* nuisance_cov) const {
  ceres::Problem::EvaluateOptions eo;
  eo.apply_loss_function = false;
  std::vector<int> wanted_columns, nuisance_first;
  int columns = 0;
  for (const Wanted& w : wanted) {
    int free = 0;
    for (const ParameterInfo& i : w.infos) free += !i.held;
    if (free == 0) continue;
    eo.parameter_blocks.push_back(w.values);
    columns += free;
  }
  const int nw = columns;
  for (const Nuisance& b : nuisance) {
    eo.parameter_blocks.push_back(b.values);
    nuisance_first.push_back(columns);
    columns += b.manifold ? b.manifold->TangentSize() : b.size;
  }
  nuisance_first.push_back(columns);
  ceres::CRSMatrix jacobian;
  double cost = 0;
  p.Evaluate(eo, &cost, nullptr, nullptr, &jacobian);

  Eigen::VectorXd norm = Eigen::VectorXd::Zero(columns);
  for (int row = 0; row < jacobian.num_rows; ++row)
    for (int k = jacobian.rows[static_cast<std::size_t>(row)];
         k < jacobian.rows[static_cast<std::size_t>(row) + 1]; ++k) {
      const double v = jacobian.values[static_cast<std::size_t>(k)];
      norm[jacobian.cols[static_cast<std::size_t>(k)]] += v * v;
    }
  const Eigen::VectorXd scale = norm.unaryExpr([](double n) { return n > 0 ? 1 / std::sqrt(n) : 1.0; });

  const std::size_t groups_n = nuisance.size();
  std::vector<std::size_t> parent(groups_n);
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&](std::size_t i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  const auto block_of = [&](int column) {
    return static_cast<std::size_t>(std::upper_bound(nuisance_first.begin(), nuisance_first.end(), column) -
                                    nuisance_first.begin() - 1);
  };
  for (int row = 0; row < jacobian.num_rows; ++row) {
    std::size_t first = groups_n;
    for (int k = jacobian.rows[static_cast<std::size_t>(row)];
         k < jacobian.rows[static_cast<std::size_t>(row) + 1]; ++k) {
      const int c = jacobian.cols[static_cast<std::size_t>(k)];
      if (c < nw) continue;
      const std::size_t b = block_of(c);
      if (first == groups_n)
        first = b;
      else
        parent[root(b)] = root(first);
    }
  }
  // Position of each nuisance column in its group.
  std::vector<int> group_size(groups_n, 0), offset(groups_n, 0);
  for (std::size_t b = 0; b < groups_n; ++b) {
    const std::size_t r = root(b);
    offset[b] = group_size[r];
    group_size[r] += nuisance_first[b + 1] - nuisance_first[b];
  }
  struct Group {
    Eigen::MatrixXd nn, nw;
  };
  std::vector<Group> groups(groups_n);
  for (std::size_t b = 0; b < groups_n; ++b)
    if (root(b) == b) {
      groups[b].nn = Eigen::MatrixXd::Zero(group_size[b], group_size[b]);
      groups[b].nw = Eigen::MatrixXd::Zero(group_size[b], nw);
    }
  reduced = Eigen::MatrixXd::Zero(nw, nw);
  std::vector<std::pair<int, double>> w, n;
  for (int row = 0; row < jacobian.num_rows; ++row) {
    w.clear();
    n.clear();
    std::size_t g = groups_n;
    for (int k = jacobian.rows[static_cast<std::size_t>(row)];
         k < jacobian.rows[static_cast<std::size_t>(row) + 1]; ++k) {
      const int c = jacobian.cols[static_cast<std::size_t>(k)];
      const double v = jacobian.values[static_cast<std::size_t>(k)] * scale[c];
      if (v == 0) continue;
      if (c < nw) {
        w.emplace_back(c, v);
      } else {
        const std::size_t b = block_of(c);
        g = root(b);
        n.emplace_back(offset[b] + c - nuisance_first[b], v);
      }
    }
    for (const auto& [i, a] : w)
      for (const auto& [j, b] : w) reduced(i, j) += a * b;
    if (g == groups_n) continue;
    for (const auto& [i, a] : n) {
      for (const auto& [j, b] : n) groups[g].nn(i, j) += a * b;
      for (const auto& [j, b] : w) groups[g].nw(i, j) += a * b;
    }
  }
  std::size_t rank = 0;
  std::vector<Eigen::MatrixXd> inverse(groups_n);
  for (std::size_t b = 0; b < groups_n; ++b) {
    if (root(b) != b || group_size[b] == 0) continue;
    // What a nuisance block leaves free has no part in nw either: the pseudo-inverse is the right one.
    Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(groups[b].nn);
    const double limit = 1e-13 * std::max(1.0, eigen.eigenvalues().cwiseAbs().maxCoeff());
    const Eigen::VectorXd inv =
        eigen.eigenvalues().unaryExpr([&](double l) { return l > limit ? 1 / l : 0.0; });
    rank += static_cast<std::size_t>((inv.array() > 0).count());
    inverse[b] = eigen.eigenvectors() * inv.asDiagonal() * eigen.eigenvectors().transpose();
    reduced.noalias() -= groups[b].nw.transpose() * inverse[b] * groups[b].nw;
  }
  if (nw > 0) {
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(reduced, Eigen::EigenvaluesOnly);
    rank += static_cast<std::size_t>((eigen.eigenvalues().array() > 1e-13 * nw).count());
  }
  if (nuisance_cov) {
    // (JᵀJ)⁻¹ of block b, scaled back: N⁻¹ + N⁻¹·W·S⁻¹·Wᵀ·N⁻¹.
    const Eigen::MatrixXd s_inverse = reduced.completeOrthogonalDecomposition().pseudoInverse();
    nuisance_cov->clear();
    for (std::size_t b = 0; b < groups_n; ++b) {
      const std::size_t g = root(b);
      const Eigen::MatrixXd half = inverse[g] * groups[g].nw;
      const Eigen::MatrixXd all = inverse[g] + half * s_inverse * half.transpose();
      const int size = nuisance_first[b + 1] - nuisance_first[b];
      Eigen::MatrixXd c = all.block(offset[b], offset[b], size, size);
      const Eigen::VectorXd sc = scale.segment(nuisance_first[b], size);
      nuisance_cov->push_back(sc.asDiagonal() * c * sc.asDiagonal());
    }
  }
  const Eigen::VectorXd back = scale.head(nw).cwiseInverse();
  reduced = back.asDiagonal() * reduced * back.asDiagonal();
  return rank;
}

Result<LeastSquares::Outcome> LeastSquares::solve(const FitOptions& options) {
  keep_the_solver_quiet();
  Impl& d = *impl_;
  std::vector<bool> used(d.observations, true);
  std::vector<double> residuals;
  const std::size_t m_all = d.residual_count(used), p_all = d.free_parameters(used);
  if (m_all <= p_all)
    return fail(ErrorCode::bad_input, "",
                "expected more measurements than unknowns, got " + std::to_string(m_all) + " for " +
                    std::to_string(p_all) + ": more recordings are needed, or a smaller model");
  const bool joint = d.joint_nuisance();
  Outcome out;
  FitResult& fit = out.fit;
  double scale = 0;
  const auto scalar_scale = [&] {
    std::vector<double> absolute;
    d.residuals(residuals);
    absolute.reserve(residuals.size());
    for (double r : residuals)
      if (std::isfinite(r)) absolute.push_back(std::abs(r));
    // The median alone is 0 where most residuals are (quantised data): then the mean square has to do.
    double s = robust_sigma(absolute, p_all);
    if (s == 0) {
      double sum = 0;
      for (double a : absolute) sum += a * a;
      s = absolute.empty() ? 0 : std::sqrt(sum / static_cast<double>(absolute.size()));
    }
    return s;
  };
  const auto stopped = [&] { return options.stop.stop_requested(); };
  auto* const nuisance_covariance = want_nuisance_covariance ? &out.nuisance_covariance : nullptr;

  if (options.robust) {
    // A scale that comes from a fit which the outliers have pulled agrees with that fit: so the loss is made
    // narrower than the scale says, and narrower again for as long as the median residual falls.
    scale = scalar_scale();
    double narrow = 1;
    for (int round = 0; round < (options.rough ? 2 : kMaxRounds) && scale > 0 && !stopped(); ++round) {
      ceres::CauchyLoss loss(2.385 * scale * narrow);
      auto problem = d.problem(used, &loss);
      // A rough fit is stopped where it creeps: that is a view in a false minimum, which no step mends.
      const auto s = d.run(*problem, options, 0, 0.6, m_all, joint, options.rough ? 1e-4 : 1e-6);
      out.iterations += static_cast<int>(s.iterations.size());
      const double now = scalar_scale();
      const bool falls = now < 0.98 * scale;
      scale = now;
      if (!falls && narrow < 0.3) break;
      narrow = falls ? narrow : narrow / 2;
    }
  }
  // Few residuals leave their scale uncertain: the limit is that of Student's t, which tends to
  // `reject_sigmas` for many. What was rejected by too narrow a limit fits again and comes back.
  double freedom = static_cast<double>(m_all - p_all);
  std::size_t null_directions = 0;
  bool rank_known = false, information_is_current = false;
  Eigen::MatrixXd information;
  std::vector<bool> before;
  for (int round = 0; round < kMaxRounds; ++round) {
    if (options.robust && scale > 0) {
      const double limit = student_limit(options.reject_sigmas, freedom) * scale;
      d.residuals(residuals);
      d.each(residuals, [&](std::size_t i, std::uint32_t, const double* r, std::size_t n) {
        double square = 0;
        for (std::size_t k = 0; k < n; ++k) square += r[k] * r[k];
        used[i] = std::sqrt(square / static_cast<double>(n)) <= limit;
      });
    }
    if (used == before) break;
    before = used;
    information_is_current = false;
    if (options.rough) break;
    auto problem = d.problem(used, nullptr);
    const std::size_t m = d.residual_count(used), p = d.free_parameters(used);
    if (m + null_directions <= p)
      return fail(ErrorCode::bad_input, "",
                  "expected measurements that agree with each other, got " + std::to_string(m) +
                      " residuals within the limits for " + std::to_string(p) +
                      " unknowns: most of them are outliers of any one model");
    const auto s = d.run(*problem, options, 0.6, 0.95, m, joint, 1e-12);
    out.iterations += static_cast<int>(s.iterations.size());
    out.cost = s.final_cost;
    if (s.termination_type == ceres::FAILURE)
      return fail(ErrorCode::bad_input, "",
                  "the fit failed: " + s.message + "; the start values or the data make no sense together");
    if (s.termination_type == ceres::NO_CONVERGENCE && !stopped())
      fit.warnings.push_back("the fit had not converged after " + std::to_string(options.max_iterations) +
                             " iterations: its values are the best so far");
    if (!rank_known) {
      // Directions that the data leave exactly free take no degree of freedom.
      const std::size_t rank = d.information(*problem, information, nuisance_covariance);
      null_directions = p - std::min(p, rank);
      rank_known = information_is_current = true;
    }
    freedom = static_cast<double>(m + null_directions) - static_cast<double>(p);
    scale = std::sqrt(2 * s.final_cost / freedom);
    if (!options.robust || stopped()) break;
  }
  fit.interrupted = stopped();

  for (const Impl::Wanted& w : d.wanted)
    for (std::size_t i = 0; i < w.infos.size(); ++i) {
      const ParameterInfo& info = w.infos[i];
      Parameter parameter{info.name, w.values[i], 0, info.resolution, info.held, false};
      const double span = 1e-9 * std::max(1.0, std::abs(w.values[i]));
      parameter.at_bound =
          !info.held && (w.values[i] <= info.lower + span || w.values[i] >= info.upper - span);
      fit.parameters.push_back(parameter);
    }
  {
    if (!information_is_current)
      (void)d.information(*d.problem(used, nullptr), information, nuisance_covariance);
    fit.scale = scale;
    // Beyond what chance makes of known noise (1e-4; Wilson and Hilferty 1931) the noise was not known.
    const double a = 2 / (9 * freedom);
    if (options.whitened && scale * scale > std::pow(1 - a + 3.719 * std::sqrt(a), 3)) out.enlarged = scale;
    const double variance = options.whitened ? out.enlarged * out.enlarged : scale * scale;
    const double tiny = variance > 0 ? variance : 1e-300;
    fit.weak = weak_directions(fit.parameters, information / tiny);
    fit.covariance = covariance_from(fit.parameters, information / tiny);
    for (auto& c : out.nuisance_covariance) c *= variance;
  }
  struct Bad {
    double norm, sigmas;
    std::size_t observation;
    std::uint32_t id;
  };
  std::vector<Bad> bad;
  d.residuals(residuals);
  d.each(residuals, [&](std::size_t i, std::uint32_t id, const double* r, std::size_t n) {
    if (used[i]) {
      out.residuals.insert(out.residuals.end(), r, r + n);
      return;
    }
    double square = 0;
    for (std::size_t k = 0; k < n; ++k) square += r[k] * r[k];
    const double norm = std::sqrt(square);
    bad.push_back({norm, scale > 0 ? norm / (scale * std::sqrt(static_cast<double>(n))) : 0, i, id});
  });
  std::sort(bad.begin(), bad.end(), [](const Bad& a, const Bad& b) {
    return a.norm != b.norm ? a.norm > b.norm : a.observation < b.observation;
  });
  for (const Bad& b : bad) {
    fit.rejected.push_back({"", b.norm, b.sigmas});
    out.rejected_ids.push_back(b.id);
  }
  std::vector<double> copy = out.residuals;
  fit.residuals = statistics_of(copy, options.unit);
  fit.residuals.rejected = bad.size();
  if (options.progress) options.progress(1, fit.residuals.rms);
  return out;
}

}  // namespace rigor::calibration
