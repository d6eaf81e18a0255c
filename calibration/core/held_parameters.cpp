#include "calibration/core/held_parameters.h"

#include <utility>
#include <vector>

namespace rigor::calibration {

void drop_held(FitResult& result) {
  std::vector<Eigen::Index> kept;
  std::vector<Parameter> parameters;
  for (std::size_t i = 0; i < result.parameters.size(); ++i)
    if (!result.parameters[i].held) {
      kept.push_back(static_cast<Eigen::Index>(i));
      parameters.push_back(result.parameters[i]);
    }
  result.parameters = std::move(parameters);
  result.covariance = result.covariance(kept, kept).eval();
}

}  // namespace rigor::calibration
