#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "sim/gis/csv.h"
#include "sim/gis/frame.h"
#include "sim/gis/import.h"
#include "sim/gis/server.h"
#include "sim/gis/tree_list.h"

namespace rigor::gis {
namespace {

using Kind = ImportSource::Kind;
constexpr std::pair<const char*, Kind> kKinds[] = {
    {"elevation", Kind::elevation}, {"imagery", Kind::imagery}, {"land_cover", Kind::land_cover},
    {"vector", Kind::vector},       {"trees", Kind::trees},     {"weather", Kind::weather}};

std::string located(const ConfigNode& n, const std::string& text) {
  if (is_server(text) || std::filesystem::path(text).is_absolute()) return text;
  return (n.base_dir() / text).lexically_normal().string();
}

Plot read_plot(const ConfigNode& n) {
  Plot p{n.number("latitude_deg", {-90, 90}), n.number("longitude_deg", {-360, 360}),
         n.number("y_axis_azimuth_deg", {-360, 360})};
  n.finish();
  return p;
}

/// `plots: stands.csv`, or a map of the file and the columns whose names are others.
void read_plots(const ConfigNode& n, ImportSource& s) {
  if (const auto text = catch_config([&] { return n.text("plots"); })) {
    s.plots = located(n, *text);
    return;
  }
  const ConfigNode plots = n.map("plots");
  s.plots = located(plots, plots.text("file"));
  const ConfigNode columns = plots.map_or_absent("columns");
  for (const char* key : {"plot", "latitude_deg", "longitude_deg", "y_axis_azimuth_deg"})
    if (columns.has(key)) s.plot_columns.emplace_back(key, columns.text(key));
  columns.finish();
  plots.finish();
}

ImportSource read_source(const ConfigNode& n) {
  ImportSource s;
  const std::pair<const char*, Kind>* kind = nullptr;
  for (const auto& k : kKinds) {
    if (!n.has(k.first)) continue;
    if (kind)
      throw n.error(
          k.first,
          fmt::format("expected one of elevation, imagery, land_cover, vector, trees, weather, got {} too",
                      kind->first));
    kind = &k;
  }
  if (!kind)
    throw n.error("",
                  "expected one of elevation, imagery, land_cover, vector, trees, weather with a path or an "
                  "address, got none");
  s.kind = kind->second;
  s.location = n.text(kind->first);
  if (s.location.empty()) throw n.error(kind->first, "expected a path or an address, got nothing");
  s.location = located(n, s.location);
  s.crs = n.text_or("crs", "");
  if (s.kind == Kind::elevation) s.heights_above_geoid = n.flag_or("heights_above_geoid", false);
  if (s.kind == Kind::vector) s.becomes = n.text_or("becomes", "");
  if (s.kind != Kind::trees && s.kind != Kind::weather) s.layer = n.text_or("layer", "");
  if (s.kind == Kind::vector || s.kind == Kind::trees) s.where = n.text_or("where", "");
  if (auto w = parse_where(s.where); !w) throw n.error("where", w.error().message);
  if (s.kind == Kind::vector || s.kind == Kind::trees || s.kind == Kind::weather)
    if (const ConfigNode columns = n.map_or_absent("columns"); columns.present()) {
      for (const auto& key : columns.keys()) s.columns.emplace_back(key, columns.text(key));
      columns.finish();
    }
  if (s.kind == Kind::trees) {
    if (const ConfigNode plot = n.map_or_absent("plot"); plot.present()) s.plot = read_plot(plot);
    if (n.has("plots")) read_plots(n, s);
  }
  if (s.kind == Kind::land_cover && n.has("classes")) {
    bool is_map = true;
    std::string name;
    try {
      name = n.text("classes");
      is_map = false;
    } catch (const ConfigError&) {
      is_map = true;
    }
    if (is_map) {
      const ConfigNode classes = n.map("classes");
      for (const auto& key : classes.keys()) s.classes.emplace_back(key, classes.text(key));
      classes.finish();
    } else {
      auto set = class_set(name);
      if (!set) throw n.error("classes", set.error().message);
      s.classes = std::move(*set);
    }
  }
  n.finish();
  return s;
}

ImportPlan read_plan(const ConfigNode& n) {
  ImportPlan plan;
  if (const ConfigNode a = n.map_or_absent("anchor"); a.present()) {
    plan.anchor = Anchor{a.number("latitude_deg", {-90, 90}), a.number("longitude_deg", {-180, 180}),
                         a.number_or("height_m", std::numeric_limits<double>::quiet_NaN(), {-1e5, 1e5})};
    a.finish();
  }
  if (n.has("half_extent_m"))
    plan.half_extent_m = n.number("half_extent_m", {.min = 0, .max = 1e6, .exclusive_min = true});
  plan.spacing_m = n.number_or("spacing_m", 0, {.min = 0, .max = 1e5});
  plan.server_timeout_s = n.number_or("server_timeout_s", plan.server_timeout_s, {.min = 0.1, .max = 3600});
  if (n.has("cache_dir")) plan.cache_dir = located(n, n.text("cache_dir"));
  if (n.has("utc")) {
    auto utc = parse_utc(n.text("utc"), "utc");
    if (!utc) throw n.error("utc", utc.error().message);
    plan.utc_s = *utc;
  }
  // Read by whoever opens the world: plugins are loaded before it is read (docs/world-plugins.md).
  (void)n.list_or_empty("plugins");
  const bool more = !n.list_or_empty("plugin_files").empty();
  for (const ConfigNode& s : more ? n.list_or_empty("sources") : n.list("sources"))
    plan.sources.push_back(read_source(s));
  if (plan.sources.empty() && !more) throw n.error("sources", "expected at least one source, got none");
  n.finish();
  return plan;
}

}  // namespace

Result<ImportPlan> load_import_plan(const std::filesystem::path& file,
                                    const std::vector<ConfigOverride>& overrides) {
  auto document = ConfigDocument::load(file, overrides);
  if (!document) return tl::unexpected(document.error());
  return catch_config([&] { return read_plan(*document); });
}

Result<Anchor> parse_anchor(std::string_view text) {
  double v[3] = {0, 0, std::numeric_limits<double>::quiet_NaN()};
  int n = 0;
  std::string_view rest = text;
  bool more = true;
  while (more && n < 3) {
    const auto comma = rest.find(',');
    const auto number = number_of(rest.substr(0, comma));
    if (!number || std::isnan(*number)) break;
    v[n++] = *number;
    more = comma != std::string_view::npos;
    rest.remove_prefix(more ? comma + 1 : rest.size());
  }
  if (n < 2 || more)
    return fail(ErrorCode::bad_input, "anchor",
                fmt::format("expected latitude,longitude[,height] in degrees and metres, got '{}'", text));
  return checked({v[0], v[1], v[2]}, "anchor");
}

}  // namespace rigor::gis
