#include "sensor-hal/models/gnss/gnss_model.h"

#include <algorithm>
#include <cmath>

namespace rigor::models {
namespace {

constexpr double kBlock_s = 60;
constexpr std::uint32_t kMostInBlock = 64;
/// Of lengths: −ln of the least draw there is, 2⁻²⁴.
constexpr double kLongestOverMean = 16.7;

}  // namespace

Status check(const GnssModel& m) {
  const auto bad = [](const std::string& field, const char* expected, double got) {
    return fail(ErrorCode::bad_input, field,
                std::string("expected ") + expected + ", got " + std::to_string(got));
  };
  for (const auto& [field, value] : {std::pair{"drift.time", m.best.drift_time_s},
                                     {"rtk_float.drift.time", m.rtk_float.drift_time_s},
                                     {"multipath.time", m.multipath_time_s},
                                     {"satellites.time", m.satellites_time_s},
                                     {"losses.mean", m.losses.mean_s},
                                     {"outages.mean", m.outages.mean_s}})
    if (!(value > 0) || !std::isfinite(value)) return bad(field, "a time above zero", value);
  for (const auto& [field, value] : {std::pair{"losses.per_h", m.losses.per_h * m.canopy_events},
                                     {"outages.per_h", m.outages.per_h * m.canopy_events}})
    if (!(value >= 0 && value <= 540))
      return bad(field, "0 to 540 events an hour, also under a canopy", value);
  if (!(m.canopy_events >= 1) || !(m.canopy_multipath >= 1))
    return bad("canopy", "factors of 1 and more", std::min(m.canopy_events, m.canopy_multipath));
  if (m.status == FixStatus::none || m.status == FixStatus::rtk_float)
    return fail(ErrorCode::bad_input, "status", "expected fix, sbas or rtk_fixed");
  return {};
}

bool event_under_way(PhiloxKey key, NoiseEffect effect, const GnssEvents& events, double share,
                     double t_s) noexcept {
  using Draws = NoiseMath<double>;
  if (!(events.per_h > 0) || !(t_s >= 0)) return false;
  const auto block = static_cast<std::int64_t>(t_s / kBlock_s);
  const auto back = static_cast<std::int64_t>(std::ceil(kLongestOverMean * events.mean_s / kBlock_s));
  for (std::int64_t b = std::max<std::int64_t>(0, block - back); b <= block; ++b) {
    const auto index = static_cast<std::uint64_t>(b);
    const double how_many =
        Draws::poisson_quantile(events.per_h * kBlock_s / 3600,
                                Draws::unit_from_bits(draw_words(key, effect, index, kMostInBlock)[0]));
    const auto count = static_cast<std::uint32_t>(std::min<double>(how_many, kMostInBlock));
    for (std::uint32_t k = 0; k < count; ++k) {
      const auto words = draw_words(key, effect, index, k);
      const double start_s = (static_cast<double>(b) + Draws::unit_from_bits(words[0])) * kBlock_s;
      const double length_s = -events.mean_s * std::log(Draws::unit_from_bits(words[1]));
      if (t_s >= start_s && t_s < start_s + length_s && Draws::unit_from_bits(words[2]) < share) return true;
    }
  }
  return false;
}

GnssErrors::GnssErrors(const GnssModel& model, PhiloxKey key, Duration period) : model_(model), key_(key) {
  const double period_s = period.seconds();
  drift_ = MarkovPath::stationary(key, NoiseEffect::gnss_drift, 0, model.best.drift_time_s / period_s);
  float_drift_ =
      MarkovPath::stationary(key, NoiseEffect::gnss_drift, 1, model.rtk_float.drift_time_s / period_s);
  multipath_ = MarkovPath::stationary(key, NoiseEffect::gnss_multipath, 0, model.multipath_time_s / period_s);
  satellites_ =
      MarkovPath::stationary(key, NoiseEffect::gnss_satellites, 0, model.satellites_time_s / period_s);
}

GnssError GnssErrors::at(std::uint64_t index, double since_start_s, double canopy) noexcept {
  GnssError e;
  const double cover = std::clamp(canopy, 0.0, 1.0);
  const double satellites = model_.satellites - model_.canopy_satellites * cover +
                            model_.satellites_sigma * satellites_.at(index)[0];
  // Events are drawn as often as they are under a closed canopy; fewer of them count under the open sky.
  const double factor = model_.canopy_events, share = (1 + (factor - 1) * cover) / factor;
  const auto under_way = [&](NoiseEffect effect, const GnssEvents& events) {
    return event_under_way(key_, effect, {events.per_h * factor, events.mean_s}, share, since_start_s);
  };
  constexpr double kFewest = 4;
  if (since_start_s < model_.first_fix_s || under_way(NoiseEffect::gnss_outage, model_.outages)) {
    e.satellites = static_cast<std::uint16_t>(std::clamp(std::round(satellites), 0.0, kFewest - 1));
    return e;
  }
  e.satellites = static_cast<std::uint16_t>(std::clamp(std::round(satellites), kFewest, 60.0));
  const bool lost = model_.status == FixStatus::rtk_fixed && under_way(NoiseEffect::gnss_loss, model_.losses);
  e.status = lost ? FixStatus::rtk_float : model_.status;
  const GnssNoise& n = lost ? model_.rtk_float : model_.best;
  const double more = 1 + (model_.canopy_multipath - 1) * cover;
  const auto white = normal_draws(key_, NoiseEffect::gnss_white, index, 0);
  const auto drift = lost ? float_drift_.at(index) : drift_.at(index);
  const auto multipath = multipath_.at(index);
  for (std::size_t i = 0; i < 3; ++i) {
    const bool up = i == 2;
    const double w = up ? n.white_vertical_m : n.white_horizontal_m;
    const double d = up ? n.drift_vertical_m : n.drift_horizontal_m;
    const double m = more * (up ? model_.multipath_vertical_m : model_.multipath_horizontal_m);
    e.enu_m[i] = w * white[i] + d * drift[i] + m * multipath[i];
    e.claimed_sigma_enu_m[i] = model_.claimed_scale * std::sqrt(w * w + d * d + m * m);
  }
  return e;
}

}  // namespace rigor::models
