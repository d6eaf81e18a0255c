// `rigor world render`: one picture of a world.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Geometry>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <numbers>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "bench/files/picture.h"
#include "bench/files/picture_file.h"
#include "bench/world/world_assembly.h"
#include "cli/commands.h"
#include "sim/gis/import.h"
#include "sim/nature/trees/allometry.h"
#include "sim/render/engine/content_window.h"
#include "sim/render/rays/light_picture.h"
#include "sim/render/view/tone_map.h"
#include "sim/render/view/view_renderer.h"
#include "sim/sensors/camera_simulator.h"
#include "sim/world/semantic_types.h"

namespace rigor {
namespace {

using render::ViewPicture;
using render::ViewRequest;

Status set_time(world::Database& db, const std::string& text) {
  const auto utc = gis::parse_utc(text, "--time");
  if (!utc) return tl::unexpected(utc.error());
  const world::types::Atmosphere a(db.schema());
  const auto nodes = db.snapshot().nodes(a.type);
  if (nodes.empty())
    return fail(ErrorCode::bad_input, "--time", "expected a world with an Atmosphere, found none");
  auto tx = db.begin("time");
  for (const auto node : nodes) {
    if (auto s = tx.set(node, a.utc_s, *utc); !s) return s;
    if (auto s = tx.set(node, a.fixed_sun, false); !s) return s;
  }
  return tx.commit();
}

/// What the world holds, as far as it has places.
Eigen::AlignedBox3d extent_of(const world::Snapshot& world, const render::GroundHeights& ground) {
  Eigen::AlignedBox3d box;
  const auto add = [&](double x, double y, double z) {
    if (std::isnan(z)) z = ground.height_at(x, y);
    if (std::isfinite(x) && std::isfinite(y)) box.extend(Eigen::Vector3d(x, y, std::isfinite(z) ? z : 0));
  };
  const world::types::Tree tree(world.schema());
  world.for_each(tree.type, [&](world::NodeId n) {
    const auto& p = *world.get(n, tree.position);
    const auto size = nature::size_of(*nature::find_species(*world.get(n, tree.species)).species,
                                      {.dbh_m = *world.get(n, tree.dbh_m),
                                       .height_m = *world.get(n, tree.height_m),
                                       .crown_radius_m = *world.get(n, tree.crown_radius_m)});
    const double z = std::isnan(p.z()) ? ground.height_at(p.x(), p.y()) : p.z();
    add(p.x() - size.crown_radius_m, p.y() - size.crown_radius_m, z);
    add(p.x() + size.crown_radius_m, p.y() + size.crown_radius_m, (std::isnan(z) ? 0 : z) + size.height_m);
  });
  const world::types::Building building(world.schema());
  world.for_each(building.type, [&](world::NodeId n) {
    const auto ring = world.get(n, building.footprint)->span();
    for (std::size_t i = 0; i + 1 < ring.size(); i += 2) add(ring[i], ring[i + 1], std::nan(""));
  });
  if (!box.isEmpty()) return box;
  const world::types::Frame frame(world.schema());
  world.for_each(frame.type, [&](world::NodeId n) {
    const Eigen::Vector3d p = world.T_world_node(n, BenchTime(0)).translation();
    add(p.x(), p.y(), p.z());
  });
  const world::types::Terrain terrain(world.schema());
  if (box.isEmpty())
    world.for_each(terrain.type, [&](world::NodeId n) {
      const double x = *world.get(n, terrain.x_m), y = *world.get(n, terrain.y_m),
                   d = *world.get(n, terrain.spacing_m);
      const auto columns = static_cast<double>(*world.get(n, terrain.columns) - 1);
      const auto rows = static_cast<double>(*world.get(n, terrain.rows) - 1);
      add(x, y, std::nan(""));
      add(x + columns * d, y - rows * d, std::nan(""));
      add(x + columns * d / 2, y - rows * d / 2, std::nan(""));
    });
  if (box.isEmpty()) box.extend(Eigen::Vector3d(0, 0, 0));
  return box;
}

Result<Eigen::Vector3d> point(const std::vector<double>& v, const char* where, bool above_ground,
                              const render::GroundHeights& ground) {
  Eigen::Vector3d p(v[0], v[1], v[2]);
  if (!p.allFinite()) return fail(ErrorCode::bad_input, where, "expected three finite numbers");
  if (above_ground) {
    const double z = ground.height_at(p.x(), p.y());
    if (!std::isfinite(z))
      return fail(ErrorCode::bad_input, where,
                  fmt::format("expected a place on the terrain for --above-ground, got {} {}: there is no "
                              "ground; `rigor world info` says how far it reaches",
                              p.x(), p.y()));
    p.z() += z;
  }
  return p;
}

Result<Eigen::Isometry3d> camera_pose(const WorldRenderOptions& o, const OpenedWorld& opened,
                                      const render::GroundHeights& ground) {
  const auto box = extent_of(opened.db->snapshot(), ground);
  Eigen::Vector3d target = box.center();
  if (!o.target.empty()) {
    const auto p = point(o.target, "--target", o.above_ground, ground);
    if (!p) return tl::unexpected(p.error());
    target = *p;
  }
  Eigen::Vector3d eye;
  if (!o.eye.empty()) {
    const auto p = point(o.eye, "--eye", o.above_ground, ground);
    if (!p) return tl::unexpected(p.error());
    eye = *p;
    if (o.target.empty()) target = Eigen::Vector3d(target.x(), target.y(), eye.z());
  } else {
    const double radius = std::max({3.0, box.sizes().head<2>().norm() / 2, box.sizes().z()});
    eye = target + radius * Eigen::Vector3d(-0.55, -1.1, 0.5);
    const double z = ground.height_at(eye.x(), eye.y());
    if (std::isfinite(z)) eye.z() = std::max(eye.z(), z + 2);
  }
  const Eigen::Vector3d forward = target - eye;
  if (forward.norm() < 1e-6)
    return fail(ErrorCode::bad_input, "--target", "expected a point that is not the eye");
  const bool steep = forward.normalized().head<2>().norm() < 1e-6;
  return look_at(
      eye, target,
      steep ? Eigen::Vector3d(Eigen::Vector3d::UnitY()) : Eigen::Vector3d(Eigen::Vector3d::UnitZ()));
}

Status apply_switches(const std::vector<std::string>& off, render::ViewSwitches& s) {
  for (const auto& name : off) {
    if (name == "frustum-culling")
      s.frustum_culling = false;
    else if (name == "occlusion-culling")
      s.occlusion_culling = false;
    else if (name == "levels-of-detail")
      s.levels_of_detail = false;
    else if (name == "impostors")
      s.impostors = false;
    else if (name == "instancing")
      s.instancing = false;
    else if (name == "shadows")
      s.shadows = false;
    else
      return fail(ErrorCode::bad_input, "--off",
                  "expected frustum-culling, occlusion-culling, levels-of-detail, impostors, instancing or "
                  "shadows, got \"" +
                      name + "\"");
  }
  return {};
}

/// What rays have no part of is refused.
Status check_engine(const WorldRenderOptions& o) {
  if (o.engine != "rays") return {};
  if (!o.device.empty())
    return fail(ErrorCode::bad_input, "--device",
                "expected no such option beside --renderer rays, which needs no device");
  for (const auto& name : o.off)
    if (name != "shadows" && name != "levels-of-detail")
      return fail(ErrorCode::bad_input, "--off",
                  "expected shadows or levels-of-detail beside --renderer rays, got \"" + name + "\"");
  return {};
}

Result<std::string> bytes_of(const WorldRenderOptions& o, const ViewPicture& picture) {
  const auto w = static_cast<std::uint32_t>(picture.width_px),
             h = static_cast<std::uint32_t>(picture.height_px);
  if (o.output.extension() == ".exr") {
    using Channels = std::array<int, 3>;  // as blue, green, red
    const Channels channels = o.bands == "nir"            ? Channels{3, 3, 3}
                              : o.bands == "false-colour" ? Channels{1, 0, 3}
                                                          : Channels{2, 1, 0};
    std::vector<ExrPlane> planes;
    for (std::size_t c = 0; c < 3; ++c)
      planes.push_back({std::string(1, "BGR"[c]), false, picture.radiance.data() + channels[c],
                        4 * sizeof picture.radiance[0]});
    return exr_bytes(w, h, planes);
  }
  using Tone = render::ToneMapOptions;
  Tone tone{.compensation_ev = o.brighter_ev};
  if (o.bands == "nir") tone.colours = Tone::Colours::near_infrared;
  if (o.bands == "false-colour") tone.colours = Tone::Colours::false_near_infrared;
  if (o.white_radiance) {
    tone.exposure = Tone::Exposure::fixed;
    tone.scale = 1 / *o.white_radiance;
  }
  const auto rgb = render::tone_map(picture, tone);
  const auto png = png_of(rgb, picture.width_px, picture.height_px, 3);
  if (png.empty()) return fail(ErrorCode::internal, o.output.string(), "the picture cannot be made a PNG");
  return std::string(png.begin(), png.end());
}

Status check(const WorldRenderOptions& o) {
  const auto extension = o.output.extension();
  if (extension != ".png" && extension != ".exr")
    return fail(ErrorCode::bad_input, "-o",
                "expected a file that ends in .png or .exr, got \"" + o.output.string() + "\"");
  if (!(o.fov_deg >= 1 && o.fov_deg <= 150))
    return fail(ErrorCode::bad_input, "--fov", fmt::format("expected 1 to 150 degrees, got {}", o.fov_deg));
  if (o.white_radiance && !(*o.white_radiance > 0 && std::isfinite(*o.white_radiance)))
    return fail(ErrorCode::bad_input, "--white",
                fmt::format("expected a radiance above 0 in W/(m2 sr), got {}", *o.white_radiance));
  InputFiles inputs;
  inputs.add("the world", o.world);
  return Outputs(std::move(inputs)).add(o.output, "-o", o.force ? Existing::replace : Existing::refuse);
}

struct Drawn {
  ViewPicture picture;
  render::ViewStatistics statistics;
  Eigen::Isometry3d T_world_camera;
  std::string device;
  std::vector<std::string> warnings;
};

double ms_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
}

Status draw_by_vulkan(const std::string& device_name, render::WorldView& view, ViewRequest request,
                      Drawn& drawn) {
  auto device = render::Device::create({.name_contains = device_name});
  if (!device) return tl::unexpected(device.error());
  auto renderer = render::ViewRenderer::create(*device);
  if (!renderer) return tl::unexpected(renderer.error());
  drawn.device = (*device)->name();
  const auto begin = std::chrono::steady_clock::now();
  std::optional<ProgressTask> progress(std::in_place, "collect what is in view");
  const auto frame = view.collect(render::ViewRenderer::query_for(request));
  const double collect_ms = ms_since(begin);
  progress.emplace("draw", 1);
  request.progress = [&](double share) { progress->set(share); };
  if (auto s = (*renderer)->draw(frame, request, drawn.picture, &drawn.statistics); !s) return s;
  progress->finish();
  drawn.statistics.collect_ms = collect_ms;
  return {};
}

Status draw_by_rays(const OpenedWorld& opened, render::WorldView& view, ViewRequest request, Drawn& drawn) {
  // All round: what stands behind hides the sky and is seen in mirrors.
  request.switches.frustum_culling = false;
  const render::ContentQuery query = render::ViewRenderer::query_for(request);
  auto cache = render::EmbreeCache::create();
  if (!cache) return tl::unexpected(cache.error());
  auto engine =
      render::EmbreeEngine::create(*cache, {.allowed_error_rad = query.allowed_error_rad, .eye = query.eye});
  if (!engine) return tl::unexpected(engine.error());
  drawn.device = "rays";
  auto begin = std::chrono::steady_clock::now();
  std::optional<ProgressTask> progress(std::in_place, "collect what is in view");
  render::ViewContent content(*opened.db, view);
  const auto window = content.collect(query, request.t, request.t, 1);
  drawn.statistics.collect_ms = ms_since(begin);
  begin = std::chrono::steady_clock::now();
  progress.emplace("build the ray tracer's trees");
  if (auto s = (*engine)->prepare(window); !s) return s;
  drawn.statistics.upload_ms = ms_since(begin);
  begin = std::chrono::steady_clock::now();
  render::LightTracer tracer(*engine);
  progress.emplace("draw", 1);
  if (auto s = render::trace_picture(tracer,
                                     {.T_world_camera = request.T_world_camera,
                                      .pinhole = request.pinhole,
                                      .bands = request.bands,
                                      .samples_a_side = 4,
                                      .shadows = request.switches.shadows,
                                      .sky_rays = 1,
                                      .soft_sun = true,
                                      .progress = [&](double share) { progress->set(share); }},
                                     drawn.picture);
      !s)
    return s;
  progress->finish();
  drawn.statistics.draw_ms = ms_since(begin);
  for (const auto& batch : window->first().batches) {
    ++drawn.statistics.batches;
    drawn.statistics.instances += batch->instances.size();
  }
  drawn.statistics.instances_drawn = drawn.statistics.instances;
  return {};
}

Result<Drawn> draw(const WorldRenderOptions& o) {
  ViewRequest request;
  if (auto s = apply_switches(o.off, request.switches); !s) return tl::unexpected(s.error());
  if (auto s = check_engine(o); !s) return tl::unexpected(s.error());
  auto opened = open_world(o.world);
  if (!opened) return tl::unexpected(opened.error());
  if (!o.time.empty())
    if (auto s = set_time(*opened->db, o.time); !s) return tl::unexpected(s.error());
  for (const auto& a : o.assignments)
    if (auto s = set_attribute(*opened->db, a); !s) return tl::unexpected(s.error());
  const auto content = make_world_picture(*opened, {.plain = o.plain});
  const auto pose = camera_pose(o, *opened, *content.ground);
  if (!pose) return tl::unexpected(pose.error());
  request.T_world_camera = *pose;
  const double focal_px = o.width_px / 2.0 / std::tan(o.fov_deg * std::numbers::pi / 360);
  request.pinhole = {.width_px = o.width_px,
                     .height_px = o.height_px,
                     .fx_px = focal_px,
                     .fy_px = focal_px,
                     .cx_px = (o.width_px - 1) / 2.0,
                     .cy_px = (o.height_px - 1) / 2.0};
  request.allowed_error_px = o.allowed_error_px;
  Drawn drawn;
  drawn.T_world_camera = *pose;
  const bool rays = o.engine == "rays";
  if (auto s = rays ? draw_by_rays(*opened, *content.view, request, drawn)
                    : draw_by_vulkan(o.device, *content.view, request, drawn);
      !s)
    return tl::unexpected(s.error());
  drawn.warnings = opened->warnings;
  for (auto& w : content.view->warnings()) drawn.warnings.push_back(std::move(w));
  return drawn;
}

}  // namespace

int world_render_command(const WorldRenderOptions& o) {
  if (auto s = check(o); !s) return report_error(s.error(), o.json);
  const auto drawn = draw(o);
  if (!drawn) return report_error(drawn.error(), o.json);
  const auto bytes = bytes_of(o, drawn->picture);
  if (!bytes) return report_error(bytes.error(), o.json);
  if (auto s = write_output(o.output, *bytes); !s) return report_error(s.error(), o.json);
  const auto& st = drawn->statistics;
  const Eigen::Vector3d eye = drawn->T_world_camera.translation();
  if (o.json) {
    fmt::print("{}\n", nlohmann::json{{"file", o.output.string()},
                                      {"width_px", drawn->picture.width_px},
                                      {"height_px", drawn->picture.height_px},
                                      {"device", drawn->device},
                                      {"eye_m", {eye.x(), eye.y(), eye.z()}},
                                      {"batches", st.batches},
                                      {"instances", st.instances},
                                      {"instances_drawn", st.instances_drawn},
                                      {"triangles_drawn", st.triangles_drawn},
                                      {"impostors_drawn", st.impostors_drawn},
                                      {"draw_calls", st.draw_calls},
                                      {"collect_ms", st.collect_ms},
                                      {"cull_ms", st.cull_ms},
                                      {"upload_ms", st.upload_ms},
                                      {"draw_ms", st.draw_ms},
                                      {"warnings", drawn->warnings}}
                           .dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    return 0;
  }
  constexpr std::size_t kShown = 10;
  for (std::size_t i = 0; i < std::min(kShown, drawn->warnings.size()); ++i)
    write_stderr(fmt::format("warning: {}\n", drawn->warnings[i]));
  if (drawn->warnings.size() > kShown)
    write_stderr(fmt::format("warning: {} more; --json lists them all\n", drawn->warnings.size() - kShown));
  fmt::print(
      "{}: {}x{}, eye at {:.1f} {:.1f} {:.1f} m, {} of {} instances, {} triangles, {:.0f} ms to draw, {}\n",
      o.output.string(), drawn->picture.width_px, drawn->picture.height_px, eye.x(), eye.y(), eye.z(),
      st.instances_drawn, st.instances, st.triangles_drawn, st.draw_ms, drawn->device);
  return 0;
}

}  // namespace rigor
