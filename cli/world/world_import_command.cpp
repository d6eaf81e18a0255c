#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/world/world_assembly.h"
#include "cli/world/world_commands.h"
#include "sim/gis/import.h"
#include "sim/world/store/world_file.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
using gis::ImportSource;
using Kind = ImportSource::Kind;

// PATH=WORD, PATH:LAYER=WORD or PATH alone (OpenStreetMap).
ImportSource vector_source(const std::string& text) {
  ImportSource s;
  s.kind = Kind::vector;
  s.location = text;
  std::error_code ec;
  if (fs::exists(text, ec)) return s;
  if (const auto equals = text.rfind('='); equals != std::string::npos) {
    s.location = text.substr(0, equals);
    s.becomes = text.substr(equals + 1);
  }
  if (fs::exists(s.location, ec)) return s;
  if (const auto colon = s.location.rfind(':');
      colon != std::string::npos && s.location.find('/', colon) == std::string::npos && colon > 4) {
    s.layer = s.location.substr(colon + 1);
    s.location.resize(colon);
  }
  return s;
}

Result<gis::ImportPlan> plan_of(const WorldImportOptions& o) {
  const bool sources = !o.elevation.empty() || !o.imagery.empty() || !o.land_cover.empty() ||
                       !o.vectors.empty() || !o.trees.empty() || !o.weather.empty();
  gis::ImportPlan plan;
  if (!o.plan.empty()) {
    if (sources)
      return fail(ErrorCode::bad_input, o.plan.string(),
                  "expected a plan or sources (--elevation …), got both");
    if (!o.crs.empty() || o.heights_above_geoid)
      return fail(ErrorCode::bad_input, o.crs.empty() ? "--heights-above-geoid" : "--crs",
                  "expected it in the plan, of the source that it belongs to: --set "
                  "sources.0.crs=EPSG:25832");
    std::vector<ConfigOverride> overrides;
    for (const auto& text : o.overrides) {
      auto parsed = ConfigOverride::parse(text);
      if (!parsed) return tl::unexpected(parsed.error());
      overrides.push_back(std::move(*parsed));
    }
    auto loaded = gis::load_import_plan(o.plan, overrides);
    if (!loaded) return tl::unexpected(loaded.error());
    plan = std::move(*loaded);
  } else if (!o.overrides.empty()) {
    return fail(ErrorCode::bad_input, "--set", "expected a plan whose keys it sets, got none");
  }
  const auto add = [&](Kind kind, const std::vector<std::string>& locations) {
    for (const auto& location : locations) {
      ImportSource s;
      s.kind = kind;
      s.location = location;
      s.crs = o.crs;
      if (kind == Kind::elevation) s.heights_above_geoid = o.heights_above_geoid;
      plan.sources.push_back(std::move(s));
    }
  };
  add(Kind::elevation, o.elevation);
  add(Kind::imagery, o.imagery);
  add(Kind::land_cover, o.land_cover);
  for (const auto& text : o.vectors) {
    plan.sources.push_back(vector_source(text));
    plan.sources.back().crs = o.crs;
  }
  add(Kind::trees, o.trees);
  add(Kind::weather, o.weather);
  if (!o.classes.empty()) {
    auto set = gis::class_set(o.classes);
    if (!set) return tl::unexpected(set.error());
    for (auto& s : plan.sources)
      if (s.kind == Kind::land_cover) s.classes = *set;
  }
  if (!o.anchor.empty()) {
    auto anchor = gis::parse_anchor(o.anchor);
    if (!anchor) return tl::unexpected(anchor.error());
    plan.anchor = *anchor;
  }
  if (o.half_extent_m) plan.half_extent_m = o.half_extent_m;
  if (o.spacing_m) plan.spacing_m = *o.spacing_m;
  if (!o.cache_dir.empty()) plan.cache_dir = o.cache_dir;
  if (plan.sources.empty() && o.plan.empty() && o.plugin_files.empty())
    return fail(ErrorCode::bad_input, "",
                "expected a plan (*.import.yaml) or sources (--elevation, --vector, --trees …), got neither");
  return plan;
}

/// Of the plan, and of the command line: FILE or FILE=IMPORTER.
Result<WorldPlugins> plugins_of(const WorldImportOptions& o) {
  WorldPlugins out;
  if (!o.plan.empty()) {
    const auto document = ConfigDocument::load(o.plan);
    if (!document) return tl::unexpected(document.error());
    auto read = read_world_plugins(*document);
    if (!read) return read;
    out = std::move(*read);
  }
  for (const std::string& text : o.plugin_files) {
    std::error_code ec;
    const auto equals = fs::exists(text, ec) ? std::string::npos : text.rfind('=');
    out.data.push_back({{text.substr(0, equals), "--plugin-file"},
                        equals == std::string::npos ? "" : text.substr(equals + 1)});
  }
  return out;
}

Status write_world(world::Database& db, const fs::path& output) {
  std::error_code ec;
  const auto written = write_output(output, [&](const fs::path& part) -> Status {
    Status s;
    {
      auto file = world::WorldFile::create(part, db);
      s = file ? (*file)->persist() : Status(tl::unexpected<Error>(file.error()));
    }
    if (!s)
      for (const char* suffix : {"-journal", "-wal", "-shm"}) fs::remove(part.string() + suffix, ec);
    return s;
  });
  // What a crash has left beside an older world of this name is not this one's.
  if (written)
    for (const char* suffix : {"-journal", "-wal", "-shm"}) fs::remove(output.string() + suffix, ec);
  return written;
}

}  // namespace

int world_import_command(const WorldImportOptions& options) {
  std::error_code ec;
  auto plan = plan_of(options);
  if (!plan) return report_error(plan.error(), options.json);
  const auto plugins = plugins_of(options);
  if (!plugins) return report_error(plugins.error(), options.json);
  InputFiles inputs;
  inputs.add("the plan", options.plan);
  for (const auto& d : plugins->data) inputs.add("a file for a plugin", d.file.file);
  for (const ImportSource& source : plan->sources) inputs.add("a source of the world", source.location);
  if (auto s = check_output(options.output, ".rigor", std::move(inputs), options.force); !s)
    return report_error(s.error(), options.json);
  auto opened = new_world(plugins->plugins);
  if (!opened) return report_error(opened.error(), options.json);
  const auto report = import_world(*opened, std::move(*plan), plugins->data, "import");
  if (!report) return report_error(report.error(), options.json);
  {
    const ProgressTask writing("write " + options.output.filename().string());
    if (auto s = write_world(*opened->db, options.output); !s) return report_error(s.error(), options.json);
  }
  const auto bytes = fs::file_size(options.output, ec);
  if (options.json) {
    fmt::print("{}\n", nlohmann::json{{"world", options.output.string()},
                                      {"bytes", bytes},
                                      {"nodes", report->nodes},
                                      {"anchor",
                                       {{"latitude_deg", report->anchor.latitude_deg},
                                        {"longitude_deg", report->anchor.longitude_deg},
                                        {"height_m", report->anchor.height_m}}},
                                      {"lines", report->lines},
                                      {"warnings", report->warnings}}
                           .dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
    return 0;
  }
  for (const auto& l : report->lines) fmt::print("{}\n", l);
  for (const auto& w : report->warnings) fmt::print("warning: {}\n", w);
  fmt::print("{}: {} nodes around {:.6f}, {:.6f}, {:.2f} m; {:.1f} MB\n", options.output.string(),
             report->nodes, report->anchor.latitude_deg, report->anchor.longitude_deg,
             report->anchor.height_m, static_cast<double>(bytes) / 1e6);
  return 0;
}

}  // namespace rigor
