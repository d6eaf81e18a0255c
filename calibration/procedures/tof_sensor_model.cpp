#include "calibration/procedures/tof_sensor_model.h"

#include <fmt/format.h>

#include <cmath>

namespace rigor {
namespace {

using namespace calibration;

struct SensorModelWriter {
  SensorModelRecipe& recipe;
  const FitResult& fit;

  const Parameter* known(const std::string& name) const {
    const Parameter* p = fit.find(name);
    return p && std::isfinite(p->sigma) && std::isfinite(p->value) ? p : nullptr;
  }
  void place(const std::string& name, const std::string& path, double scale, bool above_zero = true) const {
    const Parameter* p = known(name);
    if (!p || (above_zero && !(p->value > 0))) return;
    recipe.set.emplace_back(path, exact_text(p->value * scale));
    recipe.places.push_back({name, path, scale});
  }
  void lens(const CameraFit& lens_fit) const {
    recipe.remove.emplace_back("lens");
    for (const Parameter& p : lens_fit.result.parameters)
      place(p.name, (p.name.ends_with("_px") ? "intrinsics." : "lens.") + p.name, 1, false);
  }
  void ranges(const RangeFit& ranges_fit, double electrons) const {
    const RangeModel& m = ranges_fit.model;
    bool all = true;
    if (m.spline)
      for (std::size_t j = 1; j < ranges_fit.spline.coefficients_m.size(); ++j)
        all = all && known(fmt::format("spline_m[{}]", j));
    for (int h = 0; h < m.harmonics; ++h) all = all && known(fmt::format("harmonic_{}", 3 + 2 * h));
    if (!all) return;  // what the planes leave open stays as it is in the base
    recipe.remove.emplace_back("modulation.harmonics");
    recipe.remove.emplace_back("range_error");
    recipe.set.emplace_back("modulation.waveform", m.harmonics > 0 ? "harmonics" : "sine");
    if (m.harmonics > 0) {
      std::string list;
      for (int h = 0; h < m.harmonics; ++h) {
        list += (h > 0 ? ", " : "") + exact_text(ranges_fit.harmonics[static_cast<std::size_t>(h)]);
        recipe.places.push_back(
            {fmt::format("harmonic_{}", 3 + 2 * h), fmt::format("modulation.harmonics.{}", h), 1});
      }
      recipe.set.emplace_back("modulation.harmonics", "[" + list + "]");
    }
    place("range_offset_m", "range_error.offset_mm", 1e3, false);
    if (std::isfinite(electrons))
      place("amplitude_error_m", "range_error.amplitude_error_mm_e", 1e3 * electrons, false);
    if (!m.spline) return;
    const auto& w = ranges_fit.spline;
    std::string list;
    for (std::size_t j = 0; j < w.coefficients_m.size(); ++j) {
      list += (j > 0 ? ", " : "") + exact_text(1e3 * w.coefficients_m[j]);
      if (j > 0)
        recipe.places.push_back({fmt::format("spline_m[{}]", j),
                                 fmt::format("range_error.wiggling_spline.coefficients_mm.{}", j), 1e3});
    }
    recipe.set.emplace_back("range_error.wiggling_spline.from_m", exact_text(w.from_m));
    recipe.set.emplace_back("range_error.wiggling_spline.to_m", exact_text(w.to_m));
    recipe.set.emplace_back("range_error.wiggling_spline.coefficients_mm", "[" + list + "]");
  }
};

}  // namespace

void set_tof_model(SensorModelRecipe& recipe, const FitResult& fit, const TofModelParts& parts) {
  recipe.kind = "tof";
  const SensorModelWriter writer{recipe, fit};
  if (parts.lens) writer.lens(*parts.lens);
  if (parts.ranges) writer.ranges(*parts.ranges, parts.electrons_per_amplitude);
  if (fit.find("pixel_offset_sigma_m"))
    writer.place("pixel_offset_sigma_m", "pixel.range_offset_sigma_mm", 1e3);
  else
    writer.place("pixel_floor_m", "pixel.range_offset_sigma_mm", 1e3);
  writer.place("contrast", "modulation.contrast", 1);
  writer.place("read_noise_e", "pixel.read_noise_e", 1);
  writer.place("full_well_e", "pixel.full_well_e", 1);
}

}  // namespace rigor
