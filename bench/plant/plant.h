// An FMU as a device of the bench: stepped on its own grid t0 + k·step, known by named values.
//
//   inputs     what was commanded at or before instant k holds from k to k + 1
//   outputs    those of instant k + 1 hold from there until k + 2
//
// So the values at an instant depend on the commands and their instants alone, never on who asked when.
//
//   virtual time   whoever asks for an instant steps the FMU up to it, and waits
//   wall clock     a thread of the plant steps from k to k + 1 when instant k has come: outputs are there
//   before they
//                  are due, if the step takes less than a step. One that takes longer than the deadline is
//                  counted; the grid stays, and the plant catches up. Nobody else waits for the FMU.
//
// When the FMU fails (an error status, NaN or infinity among the outputs, a crash, a hang, the end of its
// simulation), there are no values from the next instant on. With `on_fault: restart` a new instance begins
// `restart_after_ms` later at that instant, with the start values and the last commands.
#pragma once

#include <atomic>
#include <deque>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "bench/plant/plant_settings.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/channel/run_origin.h"
#include "sim/fmu/fmu_instance.h"
#include "sim/platform/signal_registers.h"

namespace rigor::plant {

/// What became of a plant up to now.
struct PlantFacts {
  std::uint64_t steps = 0, late = 0, faults = 0, restarts = 0;
  Duration longest;  ///< of a step
  bool faulty = false;
  std::string fault;  ///< the last one; empty: none
};

/// Told by the plant's thread, on the wall clock, that an instant has come and its values are there.
class PlantListener {
 public:
  virtual ~PlantListener() = default;
  virtual void plant_reached(BenchTime t) noexcept = 0;
};

class Plant final : public SignalModel, public RegisterModel {
 public:
  /// Unpacks the FMU and checks the rig's keys against it; starts nothing. bad_input, not_found. Setup
  /// context.
  [[nodiscard]] static Result<std::shared_ptr<Plant>> make(const PlantEntry& entry);
  ~Plant() override;

  /// Before arm: values are asked for that are so old, because the channel that has them has such a latency.
  void keep(Duration age);
  /// Before arm: faults are printed on stderr at once, for a process that makes no report.
  void announce_faults() noexcept { announces_ = true; }
  /// Setup: makes and initialises the instance. Errors name the plant.
  [[nodiscard]] Status arm(bool virtual_time, StopToken stop = {});
  /// Instant 0 of the grid. Wait-free.
  void start(BenchTime t0) noexcept { origin_.publish(t0); }
  /// Setup: ends thread and instance.
  void stop();

  [[nodiscard]] const PlantSettings& settings() const noexcept { return settings_; }
  [[nodiscard]] PlantFacts facts() const;
  /// For reports: steps that missed their deadline, faults. Empty: nothing went wrong.
  [[nodiscard]] std::vector<std::string> warnings() const;

  // Any thread but the loop's on the wall clock; a lock is held for moments.

  [[nodiscard]] const std::vector<Signal>& signals() const override { return signals_; }
  /// NaN where the FMU has failed.
  [[nodiscard]] double read(std::size_t signal, BenchTime t) override;
  /// From the first instant of the grid at or after `t`. False: not commanded, a value that the variable
  /// cannot hold, or a plant that stays failed.
  [[nodiscard]] bool write(std::size_t signal, double value, BenchTime t) override;
  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) override;
  [[nodiscard]] bool write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                           BenchTime t) override;
  /// Several values of one instant. False: the FMU had failed then, or it is too long ago.
  [[nodiscard]] bool read_all(std::span<const std::size_t> signals, BenchTime t, std::span<double> out);
  /// Value at the last instant of the grid, and its slope from the one before.
  struct Slope {
    BenchTime t;
    double value = 0, per_s = 0;
  };
  [[nodiscard]] Slope slope(std::size_t signal, BenchTime t);

  void subscribe(PlantListener* listener);
  void unsubscribe(PlantListener* listener);

 private:
  struct Pending {
    std::int64_t k = 0;
    std::size_t position = 0;
    double value = 0;
  };

  explicit Plant(PlantSettings settings, std::unique_ptr<fmu::UnpackedFmu> fmu,
                 fmu::ModelDescription description);
  [[nodiscard]] Result<std::unique_ptr<fmu::FmuInstance>> make_instance(double t_s);
  void run();
  /// From now_k_ to the next instant. The lock is let go while the FMU works, on the wall clock.
  void step_once(std::unique_lock<std::mutex>& lock);
  void advance(BenchTime t, std::unique_lock<std::mutex>& lock);
  /// Whether what the rig reads are numbers. By who steps.
  [[nodiscard]] Status check_outputs(double t_s) const;
  void failed(std::string why);
  /// The outputs become those of instant k, which is the newest then.
  void publish(std::int64_t k, bool valid);
  [[nodiscard]] std::int64_t grid(BenchTime t) const noexcept;
  [[nodiscard]] double fmu_time(std::int64_t k) const noexcept;
  /// Null: none are known of instant k.
  [[nodiscard]] const double* outputs_at(std::int64_t k) const noexcept;
  [[nodiscard]] double value_of(const PlantSignal& signal, const double* outputs) const noexcept;

  PlantSettings settings_;
  std::unique_ptr<fmu::UnpackedFmu> fmu_;
  fmu::ModelDescription description_;  ///< with the rig's structural parameters
  std::vector<Signal> signals_;
  SignalRegisters registers_;
  bool virtual_time_ = false, announces_ = false;
  StopToken stop_token_;

  std::atomic<bool> interrupted_{false};  ///< the run is over: no step is waited for

  // Of who steps: the thread on the wall clock, who holds the lock in virtual time.
  std::unique_ptr<fmu::FmuInstance> instance_;
  std::vector<double> step_inputs_, outputs_;

  mutable std::mutex mutex_;  // guards all down to listeners_mutex_
  std::int64_t now_k_ = 0, restart_k_ = 0;
  std::vector<double> inputs_;
  bool inputs_changed_ = true;
  std::deque<Pending> pending_;
  std::int64_t kept_ = 256;      ///< instants
  std::vector<double> history_;  ///< outputs of instant k in row k % kept_
  std::vector<std::int64_t> history_k_;
  std::vector<char> history_valid_;
  std::string fault_;
  bool faulty_ = false;
  std::uint64_t steps_ = 0, late_ = 0, faults_ = 0, restarts_ = 0;
  Duration longest_;

  std::mutex listeners_mutex_;
  std::vector<PlantListener*> listeners_;
  RunOrigin origin_;
  Deadline deadline_;
  std::thread thread_;
};

/// A joint that a value of a plant turns. Any thread; a lock is held for moments.
class PlantJoint final : public MotionSource {
 public:
  PlantJoint(std::shared_ptr<Plant> plant, std::size_t signal, double rad_per_unit)
      : plant_(std::move(plant)), signal_(signal), rad_per_unit_(rad_per_unit) {}
  [[nodiscard]] WorldMotion motion_at(BenchTime t) const noexcept override;

 private:
  std::shared_ptr<Plant> plant_;
  std::size_t signal_;
  double rad_per_unit_;
};

}  // namespace rigor::plant
