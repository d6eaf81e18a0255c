#include "sensor-hal/models/gnss/gnss_yaml.h"

#include <algorithm>

namespace rigor {
namespace {

using namespace models;

constexpr Range kNotNegative{.min = 0};
constexpr Range kTime{.min = 0, .max = 1e7, .exclusive_min = true};

GnssNoise read_noise(ConfigNode n) {
  GnssNoise g;
  g.white_horizontal_m = n.number_or("white_horizontal_m", 0, kNotNegative);
  g.white_vertical_m = n.number_or("white_vertical_m", g.white_horizontal_m, kNotNegative);
  g.drift_horizontal_m = n.number_or("drift_horizontal_m", 0, kNotNegative);
  g.drift_vertical_m = n.number_or("drift_vertical_m", g.drift_horizontal_m, kNotNegative);
  g.drift_time_s = n.number_or("drift_time_s", g.drift_time_s, kTime);
  n.finish();
  return g;
}

GnssEvents read_events(ConfigNode n) {
  GnssEvents e;
  e.per_h = n.number_or("per_h", 0, {.min = 0, .max = 540});
  e.mean_s = n.number_or("mean_s", e.mean_s, {.min = 0, .max = 3600, .exclusive_min = true});
  n.finish();
  return e;
}

}  // namespace

Result<GnssModel> parse_gnss_model(ConfigNode root) {
  auto read = catch_config([&] {
    GnssModel m;
    m.name = root.text_or("name", "gnss");
    const std::string status = root.choice("status", {"fix", "sbas", "rtk_fixed"});
    m.status = status == "fix" ? FixStatus::fix : status == "sbas" ? FixStatus::sbas : FixStatus::rtk_fixed;
    m.best = read_noise(root.map("noise"));
    const bool rtk = m.status == FixStatus::rtk_fixed;
    for (const char* key : {"rtk_float", "losses"})
      if (root.has(key) && !rtk)
        throw root.error(key, "expected it with `status: rtk_fixed`, got `status: " + status + "`");
    if (rtk) {
      m.losses = read_events(root.map_or_absent("losses"));
      if (m.losses.per_h > 0 && !root.has("rtk_float"))
        throw root.error("losses", "expected `rtk_float` too: the noise while the fixed solution is lost");
      m.rtk_float = root.has("rtk_float") ? read_noise(root.map("rtk_float")) : m.best;
    }
    m.outages = read_events(root.map_or_absent("outages"));
    ConfigNode p = root.map_or_absent("multipath");
    m.multipath_horizontal_m = p.number_or("horizontal_m", 0, kNotNegative);
    m.multipath_vertical_m = p.number_or("vertical_m", m.multipath_horizontal_m, kNotNegative);
    m.multipath_time_s = p.number_or("time_s", m.multipath_time_s, kTime);
    p.finish();
    ConfigNode c = root.map_or_absent("canopy");
    m.canopy_multipath = c.number_or("multipath", 1, {.min = 1, .max = 1000});
    m.canopy_events = c.number_or("events", 1, {.min = 1, .max = 1000});
    m.canopy_satellites = c.number_or("satellites", 0, kNotNegative);
    c.finish();
    ConfigNode s = root.map_or_absent("satellites");
    m.satellites = s.number_or("mean", m.satellites, {.min = 4, .max = 60});
    m.satellites_sigma = s.number_or("sigma", 0, kNotNegative);
    m.satellites_time_s = s.number_or("time_s", m.satellites_time_s, kTime);
    s.finish();
    m.first_fix_s = root.number_or("first_fix_s", 0, kNotNegative);
    m.claimed_scale = root.number_or("claimed_scale", 1, {.min = 0, .max = 1000, .exclusive_min = true});
    const auto antenna = root.numbers_or("antenna_m", {0, 0, 0});
    std::copy(antenna.begin(), antenna.end(), m.antenna_m.begin());
    m.delay_s = root.number_or("delay_ms", 0, {.min = 0, .max = 1000}) * 1e-3;
    if (auto ok = check(m); !ok) throw root.error("", ok.error().text());
    root.finish();
    return m;
  });
  return read;
}

Result<GnssModel> load_gnss_model(const std::filesystem::path& file) {
  auto document = ConfigDocument::load(file);
  if (!document) return tl::unexpected<Error>(document.error());
  return parse_gnss_model(*document);
}

}  // namespace rigor
