// What the solved changes of a pair make of the simulated side's sensor model, and of its mount in the rig.
#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "calibration/core/fit_output.h"
#include "calibration/pair/cloud_model.h"
#include "calibration/pair/image_model.h"
#include "calibration/pair/range_model.h"
#include "calibration/pair/value_model.h"
#include "calibration/procedures/pair_input.h"
#include "sensor-hal/models/lidar/lidar_model.h"

namespace rigor {

/// New values of the sensor model as linear functions of the solved changes around the solution.
class PairProposal {
 public:
  explicit PairProposal(const calibration::FitResult& change);

  /// A further estimate that is independent of the changes: noise. Then it can be named in `add`.
  void estimate(const std::string& name, double value, double sigma);
  struct Term {
    std::string change;
    double derivative = 1;
  };
  /// A parameter of the proposal. `path`: of the sensor model, which gets value · scale; empty: it has none
  /// for it. Terms whose change was not determined make it one that stays as it is: it is then left out.
  void add(const std::string& name, double value, const std::vector<Term>& terms,
           const std::string& path = {}, double scale = 1, bool at_bound = false);
  [[nodiscard]] const calibration::Parameter* change(const std::string& name) const;
  /// Beyond `sigmas` of its own uncertainty.
  [[nodiscard]] bool changed(const std::string& name, double sigmas = 3) const;
  /// A key of the sensor model that is not one parameter's: a list.
  void set(const std::string& path, const std::string& yaml) { recipe_.set.emplace_back(path, yaml); }
  void place(const std::string& parameter, const std::string& path, double scale) {
    recipe_.places.push_back({parameter, path, scale});
  }
  void say(std::string note) { notes_.push_back(std::move(note)); }
  void warn(std::string warning) { change_.warnings.push_back(std::move(warning)); }
  void leave_open(std::string name, std::string why) {
    change_.not_identifiable.emplace_back(std::move(name), std::move(why));
  }

  /// The mount of the device in the simulated side's parent frame, in words, in the answer, and as `--set`.
  void mount(const RecordedPair& pair, const Eigen::Matrix3d& R_simulated_real,
             const Eigen::Vector3d& t_simulated_real_m);

  [[nodiscard]] calibration::FitResult result() const;
  [[nodiscard]] const calibration::SensorModelRecipe& recipe() const { return recipe_; }
  [[nodiscard]] const std::vector<std::string>& notes() const { return notes_; }
  nlohmann::json more;

 private:
  calibration::FitResult change_, out_;
  std::vector<Eigen::VectorXd> rows_;
  calibration::SensorModelRecipe recipe_;
  std::vector<std::string> notes_;
};

[[nodiscard]] Result<PairProposal> propose_camera(const RecordedPair& pair,
                                                  const calibration::ImagePairFit& fit,
                                                  const CameraModel& simulated);
[[nodiscard]] Result<PairProposal> propose_lidar(const RecordedPair& pair,
                                                 const calibration::CloudPairFit& fit);
[[nodiscard]] Result<PairProposal> propose_tof(const RecordedPair& pair,
                                               const calibration::RangePairFit& fit);
/// Registers, or an inertial unit (six numbers: specific force, angular rate).
[[nodiscard]] Result<PairProposal> propose_values(const RecordedPair& pair,
                                                  const std::vector<calibration::ValueFit>& fits);

/// Standard deviation that a LiDAR's sensor model gives a return.
[[nodiscard]] double model_sigma_m(const models::LidarModel& model, double remission, double range_m);

}  // namespace rigor
