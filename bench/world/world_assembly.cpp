#include "bench/world/world_assembly.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <charconv>
#include <cmath>
#include <utility>

#include "bench/console/progress.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/config/yaml.h"
#include "sim/gis/import.h"
#include "sim/nature/sky/weather.h"
#include "sim/render/models/providers.h"
#include "sim/world/scene_graph.h"
#include "sim/world/semantic_types.h"
#include "sim/world/store/world_file.h"
#include "sim/world/world_yaml.h"

namespace rigor {
namespace {

/// Reads `text` as the kind that the attribute has.
Result<world::Value> read_value(const world::AttributeInfo& attribute, const std::string& text,
                                const std::string& where) {
  const auto wrong = [&](std::string_view what) {
    return fail(ErrorCode::bad_input, where, fmt::format("expected {}, got \"{}\"", what, text));
  };
  switch (attribute.kind()) {
    case world::ValueKind::flag:
      if (text == "true") return world::Value(true);
      if (text == "false") return world::Value(false);
      return wrong("true or false");
    case world::ValueKind::number: {
      if (text == "inf") return world::Value(std::numeric_limits<double>::infinity());
      double x = 0;
      const auto [end, ec] = std::from_chars(text.data(), text.data() + text.size(), x);
      if (ec != std::errc{} || end != text.data() + text.size()) return wrong("a number");
      return world::Value(x);
    }
    case world::ValueKind::integer: {
      std::int64_t x = 0;
      const auto [end, ec] = std::from_chars(text.data(), text.data() + text.size(), x);
      if (ec != std::errc{} || end != text.data() + text.size()) return wrong("a whole number");
      return world::Value(x);
    }
    case world::ValueKind::text:
      return world::Value(text);
    default:
      return fail(ErrorCode::bad_input, where,
                  fmt::format("expected an attribute that is a flag, a number or text; this one holds {}",
                              world::name_of(attribute.kind())));
  }
}

std::vector<std::string> type_names(const world::Schema& schema) {
  std::vector<std::string> names;
  for (std::uint32_t t = 0; t < schema.type_count(); ++t) names.push_back(schema.type(world::TypeId{t}).name);
  return names;
}

std::vector<std::string> attribute_names(const world::Schema& schema, world::TypeId type) {
  std::vector<std::string> names;
  for (const auto a : schema.attributes(type)) names.push_back(schema.attribute(a).spec.name);
  return names;
}

}  // namespace

Status check_output(const std::filesystem::path& output, std::string_view ending, InputFiles inputs,
                    bool force) {
  const std::string name = output.filename().string();
  if (!name.ends_with(ending) || (ending == ".yaml" && name.ends_with(".import.yaml")))
    return fail(ErrorCode::bad_input, "-o",
                fmt::format("expected a file that ends in {}, got \"{}\"", ending, output.string()));
  return Outputs(std::move(inputs)).add(output, "-o", force ? Existing::replace : Existing::refuse);
}

Result<OpenedWorld> new_world(const std::vector<NamedFile>& plugins) {
  OpenedWorld opened;
  opened.db = world::Database::create();
  if (auto s = world::define_semantic_types(*opened.db); !s) return tl::unexpected(s.error());
  if (auto s = nature::add_weather_rule(*opened.db); !s) return tl::unexpected(s.error());
  opened.plugins = std::make_unique<world::Plugins>(*opened.db);
  for (const auto* files : {&command_plugins(), &plugins})
    if (auto s = load_plugins(*opened.plugins, *files); !s) return tl::unexpected(s.error());
  return opened;
}

Result<gis::ImportReport> import_world(OpenedWorld& opened, gis::ImportPlan plan,
                                       const std::vector<WorldPlugins::Data>& data, const std::string& what) {
  ProgressTask progress(what, 1);
  plan.progress = [&](std::string_view part, double done) {
    progress.set(done);
    progress.note(std::string(part));
  };
  gis::ImportReport report;
  if (!plan.sources.empty() || data.empty()) {
    auto imported = gis::import_into(*opened.db, plan);
    if (!imported) return imported;
    report = std::move(*imported);
  }
  progress.finish();
  const std::size_t before = opened.db->snapshot().node_count();
  if (auto s = import_plugin_data(*opened.plugins, data); !s) return tl::unexpected(s.error());
  if (const std::size_t more = opened.db->snapshot().node_count() - before; more > 0)
    report.lines.push_back(fmt::format("plugins: {} node{}", more, more == 1 ? "" : "s"));
  report.nodes += opened.db->snapshot().node_count() - before;
  return report;
}

Result<OpenedWorld> open_world(const std::filesystem::path& file, const std::vector<NamedFile>& plugins) {
  std::error_code ec;
  if (!std::filesystem::is_regular_file(file, ec))
    return fail(ErrorCode::not_found, file.string(),
                "expected a world (*.rigor, *.yaml) or an import plan (*.import.yaml), found no such file");
  const std::string name = file.filename().string();
  const bool plan = name.ends_with(".import.yaml"), yaml = name.ends_with(".yaml") || name.ends_with(".yml");
  std::vector<NamedFile> all = plugins;
  WorldPlugins own;
  bool scene = false;
  if (yaml) {
    const auto document = ConfigDocument::load(file);
    if (!document) return tl::unexpected(document.error());
    auto read = read_world_plugins(*document);
    if (!read) return tl::unexpected(read.error());
    own = std::move(*read);
    all.insert(all.end(), own.plugins.begin(), own.plugins.end());
    // A world of nodes says so in its first key; else it is a scene of boxes and cylinders.
    scene = !plan && (document->has("materials") || document->has("bodies"));
  }
  auto opened = new_world(all);
  if (!opened) return opened;
  opened->base_dir = std::filesystem::absolute(file).parent_path();
  if (plan) {
    auto sources = gis::load_import_plan(file);
    if (!sources) return tl::unexpected(sources.error());
    auto report = import_world(*opened, std::move(*sources), own.data, "import " + name);
    if (!report) return tl::unexpected(report.error());
    opened->warnings = std::move(report->warnings);
    return opened;
  }
  const ProgressTask reading("read " + name);
  if (scene) {
    const auto drawn = world::load_world(file);
    if (!drawn) return tl::unexpected(drawn.error());
    if (auto s = world::put_scene(*opened->db, *drawn); !s) return tl::unexpected(s.error());
    opened->scene = true;
  } else if (yaml) {
    if (auto s = world::import_world_yaml(file, *opened->db); !s) return tl::unexpected(s.error());
  } else if (auto f = world::WorldFile::open(file, *opened->db); !f) {
    return tl::unexpected(f.error());
  }
  if (auto s = import_plugin_data(*opened->plugins, own.data); !s) return tl::unexpected(s.error());
  return opened;
}

WorldPicture make_world_picture(const OpenedWorld& opened, const PictureContent& content) {
  WorldPicture picture;
  picture.ground = nature::make_terrain_provider({.plain_imagery = content.plain});
  std::vector<std::shared_ptr<render::ContentProvider>> providers = {picture.ground};
  if (!content.plain) {
    providers.push_back(nature::make_ground_vegetation_provider(picture.ground));
    providers.push_back(nature::make_tree_provider(picture.ground));
    providers.push_back(nature::make_built_provider(picture.ground, opened.base_dir));
    providers.push_back(render::make_model_provider(opened.base_dir));
    providers.push_back(render::make_body_provider(opened.base_dir));
  }
  providers.push_back(nature::make_atmosphere_provider());
  picture.view = std::make_unique<render::WorldView>(*opened.db, std::move(providers));
  return picture;
}

Status set_attribute(world::Database& db, const std::string& assignment) {
  const auto eq = assignment.find('=');
  const auto dot = assignment.find('.');
  if (eq == std::string::npos || dot == std::string::npos || dot > eq)
    return fail(
        ErrorCode::bad_input, "--set",
        "expected Type.attribute=value, e.g. Atmosphere.fog_visibility_m=200, got \"" + assignment + "\"");
  const std::string type_name = assignment.substr(0, dot), name = assignment.substr(dot + 1, eq - dot - 1);
  const std::string where = "--set " + type_name + "." + name;
  const auto& schema = db.schema();
  const auto type = schema.find_type(type_name);
  if (!type)
    return fail(ErrorCode::bad_input, where,
                "expected a type of the world" + did_you_mean(type_name, type_names(schema)) +
                    "; `rigor world info` lists those with nodes");
  const auto attribute = schema.find_attribute(*type, name);
  if (!attribute) {
    const auto names = attribute_names(schema, *type);
    return fail(ErrorCode::bad_input, where,
                fmt::format("expected an attribute of {}: {}{}", type_name, fmt::join(names, ", "),
                            did_you_mean(name, names)));
  }
  auto value = read_value(schema.attribute(*attribute), assignment.substr(eq + 1), where);
  if (!value) return tl::unexpected(value.error());
  const auto nodes = db.snapshot().nodes(*type);
  if (nodes.empty())
    return fail(ErrorCode::bad_input, where, "expected a node of this type in the world, found none");
  auto tx = db.begin("set " + assignment);
  for (const auto node : nodes)
    if (auto s = tx.set(node, *attribute, *value); !s) return s;
  return tx.commit();
}

}  // namespace rigor
