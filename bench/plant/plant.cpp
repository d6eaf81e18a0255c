#include "bench/plant/plant.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "rt-core/time_slice.h"
#include "sim/fmu/variable_access.h"

namespace rigor::plant {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::vector<SignalModel::Signal> signals_of(const PlantSettings& settings) {
  std::vector<SignalModel::Signal> all;
  for (const PlantSignal& s : settings.signals) all.push_back({s.name, s.unit, s.commanded});
  return all;
}
std::vector<double> register_steps_of(const PlantSettings& settings) {
  std::vector<double> all;
  for (const PlantSignal& s : settings.signals) all.push_back(s.register_step);
  return all;
}

}  // namespace

Result<std::shared_ptr<Plant>> Plant::make(const PlantEntry& entry) {
  auto file = catch_config([&] { return fmu_file_of(entry); });
  if (!file) return tl::unexpected<Error>(file.error());
  auto fmu = fmu::UnpackedFmu::open(*file);
  if (!fmu) {
    const Error& e = fmu.error();
    if (e.code != ErrorCode::bad_input && e.code != ErrorCode::not_found) return tl::unexpected<Error>(e);
    Error placed = entry.node.error("fmu", e.text()).error();
    placed.code = e.code;
    return tl::unexpected<Error>(std::move(placed));
  }
  fmu::ModelDescription description = (*fmu)->description();
  auto settings = catch_config([&] { return read_plant(entry, description); });
  if (!settings) return tl::unexpected<Error>(settings.error());
  return std::shared_ptr<Plant>(new Plant(std::move(*settings), std::move(*fmu), std::move(description)));
}

Plant::Plant(PlantSettings settings, std::unique_ptr<fmu::UnpackedFmu> fmu, fmu::ModelDescription description)
    : settings_(std::move(settings)),
      fmu_(std::move(fmu)),
      description_(std::move(description)),
      signals_(signals_of(settings_)),
      registers_(*this, signals_, register_steps_of(settings_)) {}

Plant::~Plant() { stop(); }

void Plant::keep(Duration age) { kept_ = std::max(kept_, age / settings_.step + 2); }

Result<std::unique_ptr<fmu::FmuInstance>> Plant::make_instance(double t_s) {
  const fmu::InstanceSetup setup{settings_.name,         fmu_->folder(),   t_s,
                                 settings_.start_values, settings_.inputs, settings_.outputs};
  if (!settings_.sandbox) return fmu::load_instance(description_, setup);
  ProcessLimits limits = settings_.limits;
  limits.interrupted = &interrupted_;
  return start_instance(description_, setup, limits, stop_token_);
}

Status Plant::arm(bool virtual_time, StopToken stop_token) {
  stop();
  interrupted_ = false;
  virtual_time_ = virtual_time;
  stop_token_ = stop_token;
  origin_.forget();
  inputs_ = settings_.input_start;
  step_inputs_ = inputs_;
  inputs_changed_ = true;
  pending_.clear();
  outputs_.assign(fmu::values_of(description_, settings_.outputs), 0);
  history_.assign(outputs_.size() * static_cast<std::size_t>(kept_), 0);
  history_k_.assign(static_cast<std::size_t>(kept_), -1);
  history_valid_.assign(static_cast<std::size_t>(kept_), 0);
  now_k_ = restart_k_ = 0;
  fault_.clear();
  faulty_ = false;
  steps_ = late_ = faults_ = restarts_ = 0;
  longest_ = {};
  const auto with_place = [&](Error e) -> Status {
    e.where = "plants." + settings_.name;
    return tl::unexpected<Error>(std::move(e));
  };
  auto made = make_instance(fmu_time(0));
  if (!made) return with_place(made.error());
  instance_ = std::move(*made);
  if (auto s = instance_->read(outputs_); !s) return with_place(s.error());
  if (auto s = check_outputs(fmu_time(0)); !s) return with_place(s.error());
  publish(0, true);
  if (virtual_time_) return {};
  if (auto s = deadline_.open(); !s) return s;
  deadline_.reset();
  thread_ = std::thread([this] { run(); });
  return {};
}

void Plant::stop() {
  if (thread_.joinable()) {
    interrupted_ = true;
    deadline_.cut();
    thread_.join();
  }
  instance_.reset();
}

std::int64_t Plant::grid(BenchTime t) const noexcept {
  const auto t0 = origin_.get();
  if (!t0) return 0;
  return std::max<std::int64_t>(0, (t - *t0).ns() / settings_.step.ns());
}
double Plant::fmu_time(std::int64_t k) const noexcept {
  return settings_.start_time_s + static_cast<double>(k) * settings_.step.seconds();
}

// ------------------------------------------------------------------ stepping

void Plant::run() {
  ask_for_time_slice(kShortTimeSlice);
  const auto t0 = origin_.wait(deadline_);
  if (!t0) return;
  for (std::int64_t k = 0; deadline_.wait_until(MonotonicTime((*t0 + settings_.step * k).ns())); ++k) {
    {
      const std::lock_guard lock(listeners_mutex_);
      for (PlantListener* listener : listeners_) listener->plant_reached(*t0 + settings_.step * k);
    }
    std::unique_lock lock(mutex_);
    step_once(lock);
    if (monotonic_now().ns() > (*t0 + settings_.step * k + settings_.deadline).ns()) ++late_;
  }
}

void Plant::step_once(std::unique_lock<std::mutex>& lock) {
  while (!pending_.empty() && pending_.front().k <= now_k_) {
    inputs_changed_ |= inputs_[pending_.front().position] != pending_.front().value;
    inputs_[pending_.front().position] = pending_.front().value;
    pending_.pop_front();
  }
  const bool restarts = faulty_ && settings_.restart && now_k_ >= restart_k_;
  if (faulty_ && !restarts) return publish(now_k_ + 1, false);
  step_inputs_ = inputs_;
  const bool changed = std::exchange(inputs_changed_, false) || restarts;
  const double t_s = fmu_time(now_k_);

  if (!virtual_time_) lock.unlock();
  Status status;
  if (restarts) {
    auto made = make_instance(t_s);
    if (made)
      instance_ = std::move(*made);
    else
      status = tl::unexpected<Error>(made.error());
  }
  const MonotonicTime before = monotonic_now();
  if (status) status = instance_->step(t_s, settings_.step.seconds(), step_inputs_, changed, outputs_);
  const Duration took = monotonic_now() - before;
  if (status) status = check_outputs(fmu_time(now_k_ + 1));
  if (!status) instance_.reset();  // which may take a moment: nobody waits for it
  if (!virtual_time_) lock.lock();

  if (interrupted_) return;
  if (!status) return failed(status.error().message);
  if (restarts) {
    faulty_ = false;
    ++restarts_;
  }
  ++steps_;
  longest_ = std::max(longest_, took);
  publish(now_k_ + 1, true);
}

Status Plant::check_outputs(double t_s) const {
  for (const PlantSignal& s : settings_.signals)
    if (!s.commanded && !std::isfinite(outputs_[s.position]))
      return fail(ErrorCode::protocol, settings_.name,
                  fmt::format("the FMU gave {} for {} at t = {:.9g} s", outputs_[s.position], s.name, t_s));
  return {};
}

void Plant::failed(std::string why) {
  fault_ = std::move(why);
  faulty_ = true;
  ++faults_;
  constexpr std::uint64_t kMostLines = 20;
  if (announces_ && faults_ <= kMostLines)
    std::fprintf(stderr, "rigor: plant %s: %s%s\n", settings_.name.c_str(), fault_.c_str(),
                 faults_ == kMostLines ? "; further faults are not printed" : "");
  inputs_changed_ = true;
  restart_k_ = now_k_ + 1 + (settings_.restart_after.ns() + settings_.step.ns() - 1) / settings_.step.ns();
  publish(now_k_ + 1, false);
}

void Plant::publish(std::int64_t k, bool valid) {
  const auto row = static_cast<std::size_t>(k % kept_);
  std::copy(outputs_.begin(), outputs_.end(),
            history_.begin() + static_cast<std::ptrdiff_t>(row * outputs_.size()));
  history_k_[row] = k;
  history_valid_[row] = valid;
  now_k_ = k;
}

void Plant::advance(BenchTime t, std::unique_lock<std::mutex>& lock) {
  if (!virtual_time_ || !origin_.get()) return;
  for (const std::int64_t k = grid(t); now_k_ < k;) step_once(lock);
}

// ------------------------------------------------------------------ values

const double* Plant::outputs_at(std::int64_t k) const noexcept {
  const auto row = static_cast<std::size_t>(k % kept_);
  return history_k_.empty() || history_k_[row] != k || !history_valid_[row]
             ? nullptr
             : history_.data() + row * outputs_.size();
}

double Plant::value_of(const PlantSignal& s, const double* outputs) const noexcept {
  if (s.commanded) {
    double told = inputs_.empty() ? settings_.input_start[s.position] : inputs_[s.position];
    for (const Pending& p : pending_)
      if (p.position == s.position) told = p.value;
    return s.conversion.to_asked(told);
  }
  return outputs ? s.conversion.to_asked(outputs[s.position]) : kNaN;
}

double Plant::read(std::size_t signal, BenchTime t) {
  if (signal >= settings_.signals.size()) return kNaN;
  std::unique_lock lock(mutex_);
  advance(t, lock);
  return value_of(settings_.signals[signal], outputs_at(std::min(grid(t), now_k_)));
}

bool Plant::read_all(std::span<const std::size_t> signals, BenchTime t, std::span<double> out) {
  std::unique_lock lock(mutex_);
  advance(t, lock);
  const double* const outputs = outputs_at(std::min(grid(t), now_k_));
  if (!outputs) return false;
  for (std::size_t i = 0; i < signals.size(); ++i) out[i] = value_of(settings_.signals[signals[i]], outputs);
  return true;
}

Plant::Slope Plant::slope(std::size_t signal, BenchTime t) {
  std::unique_lock lock(mutex_);
  advance(t, lock);
  const std::int64_t k = std::min(grid(t), now_k_);
  const double *now = outputs_at(k), *before = k > 0 ? outputs_at(k - 1) : nullptr;
  Slope s;
  s.t = origin_.get().value_or(t) + settings_.step * k;
  if (!now) return s;  // at rest at zero, as joints that nothing moves
  s.value = value_of(settings_.signals[signal], now);
  if (before) s.per_s = (s.value - value_of(settings_.signals[signal], before)) / settings_.step.seconds();
  return s;
}

bool Plant::write(std::size_t signal, double value, BenchTime t) {
  if (signal >= settings_.signals.size() || !settings_.signals[signal].commanded) return false;
  const PlantSignal& s = settings_.signals[signal];
  const double own = s.conversion.to_own(value);
  if (!fmu::fits(s.type, own)) return false;
  const std::lock_guard lock(mutex_);
  if (faulty_ && !settings_.restart) return false;
  std::int64_t k = 0;
  if (const auto t0 = origin_.get(); t0 && t > *t0)
    k = ((t - *t0).ns() + settings_.step.ns() - 1) / settings_.step.ns();
  k = std::max(k, now_k_);
  // Instants of one sink do not decrease; another one's may lie between.
  const auto at = std::upper_bound(pending_.begin(), pending_.end(), k,
                                   [](std::int64_t at_k, const Pending& p) { return at_k < p.k; });
  pending_.insert(at, {k, s.position, own});
  return true;
}

bool Plant::read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out, BenchTime t) {
  return registers_.read(table, address, out, t);
}
bool Plant::write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                  BenchTime t) {
  return registers_.write(table, address, in, t);
}

// ------------------------------------------------------------------ for others

void Plant::subscribe(PlantListener* listener) {
  const std::lock_guard lock(listeners_mutex_);
  listeners_.push_back(listener);
}
void Plant::unsubscribe(PlantListener* listener) {
  const std::lock_guard lock(listeners_mutex_);
  std::erase(listeners_, listener);
}

PlantFacts Plant::facts() const {
  const std::lock_guard lock(mutex_);
  return {steps_, late_, faults_, restarts_, longest_, faulty_, fault_};
}

std::vector<std::string> Plant::warnings() const {
  const PlantFacts f = facts();
  std::vector<std::string> all;
  if (f.late > 0)
    all.push_back(fmt::format(
        "plant {}: {} of {} steps missed their deadline of {:g} ms; the longest took {:.3g} ms",
        settings_.name, f.late, f.steps, settings_.deadline.seconds() * 1e3, f.longest.seconds() * 1e3));
  if (f.faults > 0)
    all.push_back(fmt::format("plant {}: {}{}", settings_.name, f.fault,
                              f.faults == 1 && f.restarts == 0
                                  ? std::string()
                                  : fmt::format(" (fault {}, restarted {} times)", f.faults, f.restarts)));
  return all;
}

WorldMotion PlantJoint::motion_at(BenchTime t) const noexcept {
  const Plant::Slope s = plant_->slope(signal_, t);
  WorldMotion motion;
  motion.count = 1;
  motion.joint[0] = {s.t, s.value * rad_per_unit_, s.per_s * rad_per_unit_};
  return motion;
}

}  // namespace rigor::plant
