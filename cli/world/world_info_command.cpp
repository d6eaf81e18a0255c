#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/world/world_assembly.h"
#include "cli/world/world_commands.h"
#include "sim/world/semantic_types.h"

namespace rigor {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

// East and north of everything that has a place or an outline.
struct Extent {
  double west = std::numeric_limits<double>::infinity(), east = -west, south = west, north = -west;
  void add(double x, double y) {
    if (!std::isfinite(x) || !std::isfinite(y)) return;
    west = std::min(west, x), east = std::max(east, x);
    south = std::min(south, y), north = std::max(north, y);
  }
  [[nodiscard]] bool empty() const { return !(west <= east); }
};

template <class Types>
void add_grids(const world::Snapshot& w, const Types& t, Extent& extent) {
  w.for_each(t.type, [&](world::NodeId n) {
    const double x = *w.get(n, t.x_m), y = *w.get(n, t.y_m), s = *w.get(n, t.spacing_m);
    extent.add(x, y);
    extent.add(x + static_cast<double>(*w.get(n, t.columns) - 1) * s,
               y - static_cast<double>(*w.get(n, t.rows) - 1) * s);
  });
}

Extent extent_of(const world::Snapshot& w) {
  const auto& schema = w.schema();
  Extent extent;
  add_grids(w, world::types::Terrain(schema), extent);
  add_grids(w, world::types::LandCover(schema), extent);
  add_grids(w, world::types::Imagery(schema), extent);
  for (const auto& [type, attribute] :
       {std::pair{"Building", "footprint"}, {"Road", "line"}, {"Fence", "line"}, {"Water", "outline"}})
    w.scan<world::Numbers>(schema.require_type(type), schema.require<world::Numbers>(type, attribute),
                           [&](auto, auto lists) {
                             for (const world::Numbers& l : lists)
                               for (std::size_t i = 0; i + 1 < l.size(); i += 2) extent.add(l[i], l[i + 1]);
                           });
  for (const char* type : {"Tree", "Pole"})
    w.scan<world::Vector3>(schema.require_type(type), schema.require<world::Vector3>(type, "position"),
                           [&](auto, auto places) {
                             for (const world::Vector3& p : places) extent.add(p.x(), p.y());
                           });
  w.for_each(schema.require_type("Frame"), [&](world::NodeId n) {
    const world::Vector3 p = w.T_world_node(n, BenchTime{}).translation();
    extent.add(p.x(), p.y());
  });
  return extent;
}

json info_of(const world::Snapshot& w, const fs::path& file) {
  std::error_code ec;
  json info{{"world", file.string()}, {"bytes", fs::file_size(file, ec)}, {"nodes", w.node_count()}};
  json types = json::object();
  const auto& schema = w.schema();
  for (std::uint32_t t = 0; t < schema.type_count(); ++t) {
    std::size_t own = w.count(world::TypeId{t});
    for (std::uint32_t sub = t + 1; sub < schema.type_count(); ++sub)
      if (schema.base(world::TypeId{sub}) == world::TypeId{t}) own -= w.count(world::TypeId{sub});
    if (own > 0) types[schema.type(world::TypeId{t}).name] = own;
  }
  info["types"] = types;
  const Extent e = extent_of(w);
  if (!e.empty())
    info["extent_m"] = {{"west", e.west}, {"east", e.east}, {"south", e.south}, {"north", e.north}};
  const world::types::Place place(schema);
  if (const auto n = w.nodes(place.type); !n.empty())
    info["anchor"] = {{"latitude_deg", *w.get(n[0], place.latitude_deg)},
                      {"longitude_deg", *w.get(n[0], place.longitude_deg)},
                      {"height_m", *w.get(n[0], place.height_m)}};
  if (const auto n = w.nodes(schema.require_type("Atmosphere")); !n.empty()) {
    json air = json::object();
    for (const auto a : schema.attributes(schema.require_type("Atmosphere"))) {
      const auto& spec = schema.attribute(a).spec;
      const auto v = *w.get(n[0], a);
      if (const auto* d = std::get_if<double>(&v))
        air[spec.name] = std::isfinite(*d) ? json(*d) : json("infinity");
      else if (const auto* f = std::get_if<bool>(&v))
        air[spec.name] = *f;
    }
    info["atmosphere"] = air;
  }
  return info;
}

std::string utc_text(double utc_s) {
  const std::chrono::sys_seconds t(std::chrono::seconds(std::llround(utc_s)));
  const auto day = std::chrono::floor<std::chrono::days>(t);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss time(t - day);
  return fmt::format("{:.0f} ({:04}-{:02}-{:02}T{:02}:{:02}:{:02}Z)", utc_s, static_cast<int>(date.year()),
                     static_cast<unsigned>(date.month()), static_cast<unsigned>(date.day()),
                     time.hours().count(), time.minutes().count(), time.seconds().count());
}

// Without the sign that a rounded −0.04 would carry.
double tenth(double x_m) { return std::round(x_m * 10) / 10 + 0.0; }

}  // namespace

int world_info_command(const WorldInfoOptions& options) {
  const auto opened = open_world(options.world);
  if (!opened) return report_error(opened.error(), options.json);
  json info = info_of(opened->db->snapshot(), options.world);
  for (const world::PluginInfo& p : opened->plugins->list())
    info["plugins"].push_back({{"name", p.name},
                               {"version", p.version},
                               {"file", p.file.string()},
                               {"types", p.types},
                               {"rules", p.rules},
                               {"importers", p.importers}});
  if (options.json) {
    fmt::print("{}\n", info.dump(2, ' ', false, json::error_handler_t::replace));
    return 0;
  }
  fmt::print("{}: {} nodes, {:.1f} MB\n", options.world.string(), info["nodes"].get<std::size_t>(),
             info["bytes"].get<double>() / 1e6);
  if (info.contains("anchor"))
    fmt::print("anchor  {:.6f}, {:.6f}, {:.2f} m above the ellipsoid\n",
               info["anchor"]["latitude_deg"].get<double>(), info["anchor"]["longitude_deg"].get<double>(),
               info["anchor"]["height_m"].get<double>());
  if (info.contains("extent_m"))
    fmt::print("extent  {:.1f} … {:.1f} m east, {:.1f} … {:.1f} m north\n",
               tenth(info["extent_m"]["west"].get<double>()), tenth(info["extent_m"]["east"].get<double>()),
               tenth(info["extent_m"]["south"].get<double>()),
               tenth(info["extent_m"]["north"].get<double>()));
  for (const auto& [type, count] : info["types"].items())
    fmt::print("{:>8}  {}\n", count.get<std::size_t>(), type);
  for (const world::PluginInfo& p : opened->plugins->list())
    fmt::print("plugin  {} {}: {}\n", p.name, p.version, p.meaning);
  if (info.contains("atmosphere")) {
    fmt::print("atmosphere\n");
    for (const auto& [name, value] : info["atmosphere"].items())
      fmt::print("          {} {}\n", name,
                 name == "utc_s"      ? utc_text(value.get<double>())
                 : value.is_string()  ? value.get<std::string>()
                 : value.is_boolean() ? value.dump()
                                      : fmt::format("{}", value.get<double>()));
  }
  return 0;
}

}  // namespace rigor
