#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include "calibration/photon/exposure_pairs.h"
#include "calibration/photon/photon_problem.h"

namespace rigor::calibration {

Status fit_single_frames(const FrameStacks& stacks, const PhotonFitOptions& options, PhotonFit& out) {
  auto pairs = fit_exposure_pairs(stacks, out.statistics, options.stop);
  if (!pairs) return tl::unexpected<Error>(pairs.error());
  out.pairs = pairs->bins;
  out.result = pairs->result;
  FitResult& r = out.result;
  r.model = "exposure_pairs";
  const Parameter* gain = r.find("system_gain_dn_per_e");
  bool clipped = false, dark = false, white = false, usable = false;
  for (const LevelPoint& p : out.statistics.points) {
    const bool light = stacks.levels()[p.level].settings.light;
    dark = dark || !light;
    if (!light && p.why == "clipped at black") clipped = true;
    if (!light && p.usable) usable = true;
    white = white || (light && p.white_share > 0.001);
  }
  const std::string why =
      clipped && !usable
          ? "the dark frames are clipped at black: their noise and their level are cut off; raise "
            "the camera's black level"
      : dark ? "it takes two dark frames of one exposure, and light frames of which two are alike"
             : "there are no dark frames";
  for (const char* name : {"black_level_dn", "read_noise_e", "dark_current_e_per_s", "dsnu_e"})
    r.not_identifiable.emplace_back(name, why);
  r.not_identifiable.emplace_back("prnu",
                                  "it takes frames of an even light, averaged until their noise is small");
  char text[160];
  std::snprintf(text, sizeof text, "the converter is full first: it is at least %.4g e",
                gain ? out.statistics.max_dn / gain->value : 0);
  r.not_identifiable.emplace_back("full_well_e",
                                  white && gain ? text : "no plateau below the converter's end was seen");
  out.converter_saturates = white;
  std::map<int, std::vector<const PairBin*>> sets;
  double sum = 0, top = 0, counted = 0;
  for (const PairBin& b : out.pairs) {
    LinearityPoint l{b.second_s, b.second_dn, 0, 0, b.set % 4};
    l.deviation = b.second_dn / b.first_dn / (b.second_s / b.first_s) - 1;
    l.sigma = std::sqrt(b.variance_dn2 / b.pixels) / b.first_dn;
    out.linearity.push_back(l);
    // Below 5 % of the range the unknown black level is what deviates.
    if (b.first_dn >= 0.05 * out.statistics.max_dn) sum += std::abs(l.deviation), ++counted;
    top = std::max(top, b.second_dn);
  }
  if (!out.linearity.empty()) {
    if (counted > 0) out.linearity_error = sum / counted;
    r.validity = {{"signal_dn", out.pairs.front().first_dn, top}};
    for (const PairBin& b : out.pairs) r.validity[0].from = std::min(r.validity[0].from, b.first_dn);
  } else {
    r.not_identifiable.emplace_back("linearity", "no pixels lie between black and white in two exposures");
  }
  for (const PairBin& b : out.pairs)
    out.whitened.push_back((b.variance_dn2 / b.expected_dn2 - 1) / std::sqrt(2 / (b.pixels - 2)));
  r.warnings.insert(r.warnings.end(), out.statistics.warnings.begin(), out.statistics.warnings.end());
  if (r.residuals.unit.empty()) r.residuals.unit = "standard deviations";
  if (!gain && out.linearity.empty()) {
    std::string all;
    for (const auto& [name, reason] : r.not_identifiable)
      all += (all.empty() ? "" : "; ") + name + ": " + reason;
    return fail(ErrorCode::bad_input, "",
                "expected pictures that say something about the sensor, got none (" + all + ")");
  }
  return {};
}

}  // namespace rigor::calibration
