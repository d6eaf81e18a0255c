#include "calibration/shading/shading_twin.h"

#include <cmath>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"

namespace rigor::calibration {

std::vector<double> shading_twin(const std::vector<ShadingCell>& cells, const ShadingFit& fit,
                                 std::uint64_t seed) {
  using Noise = models::NoiseMath<double>;
  const auto key = models::channel_key(seed, models::channel_id_from_name("calibration twin"));
  const Parameter* scale = fit.result.find("scale");
  std::vector<double> out;
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const auto words =
        models::draw_words(key, models::NoiseEffect::camera_shot_and_read, 0, static_cast<std::uint32_t>(i));
    const double z = Noise::normal_quantile(Noise::unit_from_bits(words[0]));
    out.push_back(std::isfinite(fit.residual[i]) ? cells[i].sigma * z / scale->value : std::nan(""));
  }
  return out;
}

}  // namespace rigor::calibration
