#include "cli/world/world_cli.h"

#include "bench/files/installed_configs.h"
#include "cli/commands.h"
#include "cli/option_checks.h"
#include "cli/world/world_commands.h"

namespace rigor {

struct WorldCommandLine::Impl {
  CLI::App* world = nullptr;
  CLI::App *import_app = nullptr, *info = nullptr, *export_app = nullptr, *render = nullptr;
  WorldImportOptions import_options;
  WorldInfoOptions info_options;
  WorldExportOptions export_options;
  WorldRenderOptions render_options;
};

namespace {

void add_import(CLI::App* app, WorldImportOptions& o) {
  app->add_option("PLAN", o.plan, "Import plan (*.import.yaml); or name the sources below");
  app->add_option("-o,--output", o.output, "World file to write, *.rigor")->required();
  const auto source = [&](const char* name, std::vector<std::string>& list, const char* help) {
    app->add_option(name, list, help)->allow_extra_args(false);
  };
  source("--elevation", o.elevation,
         "Elevation raster, or WCS:http://… (may be repeated; the first that has data wins)");
  source("--imagery", o.imagery, "Picture from above, or WMS:http://…");
  source("--land-cover", o.land_cover, "Raster of classes");
  source("--vector", o.vectors,
         "FILE[:LAYER][=WORD], or WFS:http://…; WORD: building, road, fence, pole, water, tree");
  source("--trees", o.trees, "Tree list in CSV");
  source("--weather", o.weather, "Weather series in CSV");
  source("--plugin-file", o.plugin_files, "FILE[=IMPORTER], read by an importer of a plugin (--plugin)");
  app->add_option("--anchor", o.anchor, "Where the world frame stands: LAT,LON[,HEIGHT]");
  app->add_option("--half-extent", o.half_extent_m, "Metres around the anchor; what lies outside is left out")
      ->check(number_within({.min = 0, .max = 1e6, .exclusive_min = true}));
  app->add_option("--spacing", o.spacing_m, "Metres between grid points (default: as the source)")
      ->check(number_within({.min = 0, .max = 1e5}));
  app->add_option("--crs", o.crs, "Reference system of sources that do not say it, e.g. EPSG:25832");
  app->add_option("--classes", o.classes, "What the land cover's values mean: worldcover, corine or words");
  app->add_flag("--heights-above-geoid", o.heights_above_geoid,
                "Elevations count from EGM96 (sea level), not from the ellipsoid");
  app->add_option("--cache", o.cache_dir, "Folder for what servers answered");
  app->add_option("--set", o.overrides, "Replace one value of the plan: path.to.key=value (may be repeated)")
      ->allow_extra_args(false);
  app->add_flag("--force", o.force, "Write over a file that is there");
  app->add_flag("--json", o.json, "Print the report as JSON");
  app->footer("Example: rigor world import configs/worlds/hills.import.yaml -o hills.rigor");
}

void add_render(CLI::App* app, WorldRenderOptions& o) {
  app->add_option("WORLD", o.world, "World (*.rigor, *.yaml) or import plan (*.import.yaml)")->required();
  app->add_option("-o,--output", o.output, "out.png, or out.exr with radiance in W/(m2 sr)")->required();
  const auto coordinate = number_within({.min = -1e8, .max = 1e8});
  app->add_option("--eye", o.eye, "Where the camera stands: EAST,NORTH,UP in metres")
      ->check(coordinate)
      ->expected(3)
      ->delimiter(',');
  app->add_option("--target", o.target, "What it looks at: EAST,NORTH,UP")
      ->check(coordinate)
      ->expected(3)
      ->delimiter(',');
  app->add_flag("--above-ground", o.above_ground, "UP of eye and target counts from the ground below them");
  app->add_option("--width", o.width_px, "Pixels")->check(number_within({.min = 1, .max = 8192}));
  app->add_option("--height", o.height_px, "Pixels")->check(number_within({.min = 1, .max = 8192}));
  app->add_option("--fov", o.fov_deg, "Horizontal field of view in degrees");
  app->add_option("--time", o.time, "E.g. 2024-06-21T12:00:00Z or 2024-06-21T14:00:00+02:00");
  app->add_option("--set", o.assignments, "Type.attribute=value on every node of the type (may be repeated)")
      ->allow_extra_args(false);
  app->add_option("--bands", o.bands, "rgb, nir (850 nm in grey) or false-colour (850 nm as red)")
      ->check(CLI::IsMember({"rgb", "nir", "false-colour"}));
  app->add_option("--white", o.white_radiance,
                  "Radiance in W/(m2 sr) that becomes white (default: by the picture)");
  app->add_option("--brighter", o.brighter_ev, "Stops by which the picture is made brighter")
      ->check(number_within({.min = -60, .max = 60}));
  app->add_option("--allowed-error-px", o.allowed_error_px,
                  "Detail that subtends less is left out; 0: all is drawn")
      ->check(number_within({.min = 0, .max = 1e4}));
  app->add_option(
         "--off", o.off,
         "Draw without frustum-culling, occlusion-culling, levels-of-detail, impostors, instancing, shadows")
      ->delimiter(',');
  app->add_flag("--plain", o.plain, "The ground alone, with imagery draped on it");
  app->add_option("--renderer", o.engine,
                  "raster, or rays: 16 samples a pixel, each with a ray for what hides the sky")
      ->check(CLI::IsMember({"raster", "rays"}));
  app->add_option("--device", o.device, "Part of the Vulkan device's name");
  app->add_flag("--force", o.force, "Write over a file that is there");
  app->add_flag("--json", o.json, "Print what was drawn as JSON");
  app->footer(
      "Example: rigor world render configs/worlds/forest.import.yaml --eye 0,-60,2 --target 0,0,6 "
      "--above-ground "
      "-o forest.png");
}

}  // namespace

WorldCommandLine::WorldCommandLine(CLI::App& app) : impl_(std::make_unique<Impl>()) {
  impl_->world = app.add_subcommand("world", "Worlds from GIS data, and pictures of them");
  impl_->world->require_subcommand(1);
  impl_->import_app = impl_->world->add_subcommand("import", "Make a world of GIS data");
  add_import(impl_->import_app, impl_->import_options);
  impl_->info = impl_->world->add_subcommand("info", "Say what is in a world");
  impl_->info
      ->add_option("WORLD", impl_->info_options.world,
                   "World (*.rigor, *.yaml) or import plan (*.import.yaml)")
      ->required();
  impl_->info->add_flag("--json", impl_->info_options.json, "Print as JSON");
  impl_->info->footer("Example: rigor world info hills.rigor");
  impl_->export_app = impl_->world->add_subcommand("export", "Write a world as YAML, or a map of its stems");
  impl_->export_app
      ->add_option("WORLD", impl_->export_options.world,
                   "World (*.rigor, *.yaml) or import plan (*.import.yaml)")
      ->required();
  impl_->export_app
      ->add_option("-o,--output", impl_->export_options.output,
                   "What to write: the world, *.yaml; a map of its stems, *.csv")
      ->required();
  impl_->export_app
      ->add_option(
          "--at-height", impl_->export_options.at_height_m,
          "Metres above its foot at which a stem's place and diameter are measured for the map (default: "
          "feet and diameters of the inventory)")
      ->check(number_within({.min = 0, .max = 100}));
  impl_->export_app->add_flag("--force", impl_->export_options.force, "Write over a file that is there");
  impl_->export_app->add_flag("--json", impl_->export_options.json, "Print as JSON");
  impl_->export_app->footer("Example: rigor world export hills.rigor -o hills.yaml");
  impl_->render = impl_->world->add_subcommand("render", "Make one picture of a world");
  add_render(impl_->render, impl_->render_options);
  for (CLI::App* sub : {impl_->import_app, impl_->info, impl_->export_app, impl_->render}) add_plugins(sub);
}

WorldCommandLine::~WorldCommandLine() = default;

bool WorldCommandLine::chosen() const { return impl_->world->parsed(); }

int WorldCommandLine::run() const {
  for (std::filesystem::path* file : {&impl_->import_options.plan, &impl_->info_options.world,
                                      &impl_->export_options.world, &impl_->render_options.world})
    *file = find_config(*file);
  // Words after `=` and addresses of servers are no files, and come back as they are.
  WorldImportOptions& sources = impl_->import_options;
  for (auto* list :
       {&sources.elevation, &sources.imagery, &sources.land_cover, &sources.trees, &sources.weather})
    for (std::string& file : *list) file = find_config(file).string();
  if (*impl_->import_app) return world_import_command(impl_->import_options);
  if (*impl_->info) return world_info_command(impl_->info_options);
  if (*impl_->export_app) return world_export_command(impl_->export_options);
  return world_render_command(impl_->render_options);
}

}  // namespace rigor
