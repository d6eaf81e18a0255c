#include "cli/world/world_cli.h"

#include <CLI/CLI.hpp>

#include "cli/commands.h"

namespace rigor {

struct WorldCommandLine::Impl {
  CLI::App* world = nullptr;
  CLI::App* render = nullptr;
  WorldRenderOptions render_options;
};

namespace {

void add_render(CLI::App* app, WorldRenderOptions& o) {
  app->add_option("WORLD", o.world, "World (*.rigor, *.yaml) or import plan (*.import.yaml)")->required();
  app->add_option("-o,--output", o.output, "out.png, or out.exr with radiance in W/(m2 sr)")->required();
  app->add_option("--eye", o.eye, "Where the camera stands: EAST,NORTH,UP in metres")
      ->expected(3)
      ->delimiter(',');
  app->add_option("--target", o.target, "What it looks at: EAST,NORTH,UP")->expected(3)->delimiter(',');
  app->add_flag("--above-ground", o.above_ground, "UP of both counts from the ground");
  app->add_option("--width", o.width_px, "Pixels")->check(CLI::Range(1, 8192));
  app->add_option("--height", o.height_px, "Pixels")->check(CLI::Range(1, 8192));
  app->add_option("--fov", o.fov_deg, "Horizontal field of view in degrees");
  app->add_option("--time", o.time, "UTC, e.g. 2024-06-21T12:00:00Z");
  app->add_option("--set", o.assignments, "Type.attribute=value on every node of the type (may be repeated)")
      ->allow_extra_args(false);
  app->add_option("--bands", o.bands, "rgb, nir (850 nm in grey) or false-colour (850 nm as red)")
      ->check(CLI::IsMember({"rgb", "nir", "false-colour"}));
  app->add_option("--white", o.white_radiance, "Radiance that becomes white (default: by the picture)")
      ->check(CLI::PositiveNumber);
  app->add_option("--brighter", o.brighter_ev, "Stops");
  app->add_option("--allowed-error-px", o.allowed_error_px,
                  "Detail that subtends less is left out; 0: all is drawn")
      ->check(CLI::NonNegativeNumber);
  app->add_option(
         "--off", o.off,
         "Draw without frustum-culling, occlusion-culling, levels-of-detail, impostors, instancing, shadows")
      ->delimiter(',');
  app->add_flag("--plain", o.plain, "The ground alone, with imagery draped on it");
  app->add_option("--device", o.device, "Part of the Vulkan device's name");
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
  impl_->render = impl_->world->add_subcommand("render", "Make one picture of a world");
  add_render(impl_->render, impl_->render_options);
}

WorldCommandLine::~WorldCommandLine() = default;

bool WorldCommandLine::chosen() const { return impl_->world->parsed(); }

int WorldCommandLine::run() const { return world_render_command(impl_->render_options); }

}  // namespace rigor
