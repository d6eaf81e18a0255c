#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>

#include "cli/commands.h"
#include "cli/overrides.h"
#include "cli/report.h"
#include "cli/simulation.h"
#include "cli/terminal.h"
#include "sensor-hal/config/rig.h"

namespace rigor {
namespace {

struct Target {
  RigConfig rig;
  const ChannelEntry* entry = nullptr;
  const BackendChoice* choice = nullptr;
  std::string noise_name;  ///< the name that keys the channel's noise in a run
};

Result<std::unique_ptr<Target>> find_target(const SenseOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  auto rig = load_rig(options.rig, *overrides);
  if (!rig) return tl::unexpected<Error>(rig.error());
  auto target = std::make_unique<Target>();
  target->rig = std::move(*rig);
  std::vector<std::string> names;
  for (const ChannelEntry& c : target->rig.channels) {
    const BackendChoice& choice = c.is_pair ? c.twin : c.source;
    if (choice.backend != "simulated") continue;
    names.push_back(c.name);
    if (c.name != options.channel) continue;
    target->entry = &c;
    target->choice = &choice;
    target->noise_name = c.is_pair ? c.name + ".simulated" : c.name;
  }
  if (!target->entry)
    return fail(ErrorCode::bad_input, "--channel",
                fmt::format("expected a simulated channel of the rig, got \"{}\"; there {}: {}",
                            options.channel, names.size() == 1 ? "is" : "are",
                            names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "))));
  if (target->rig.simulation.world.empty())
    return fail(ErrorCode::bad_input, options.rig.string(), "expected `simulation.world`, found none");
  return target;
}

Status set_joint(WorldMotion& motion, const Simulation& simulation, const std::string& text) {
  const auto eq = text.find('=');
  char* end = nullptr;
  const double degrees = eq == std::string::npos ? 0 : std::strtod(text.c_str() + eq + 1, &end);
  if (eq == std::string::npos || end == text.c_str() + eq + 1 || *end != '\0' || !std::isfinite(degrees))
    return fail(ErrorCode::bad_input, "--joint", "expected NAME=DEGREES, got \"" + text + "\"");
  auto index = simulation.joint(text.substr(0, eq));
  if (!index) return tl::unexpected<Error>(index.error());
  motion.joint[*index].position_rad = degrees * std::numbers::pi / 180;
  return {};
}

}  // namespace

int sense_command(const SenseOptions& options) {
  const std::string extension = options.output.extension().string();
  if (extension != ".png" && extension != ".exr")
    return report_error(
        {ErrorCode::bad_input, "-o",
         "expected a file that ends in .png or .exr, got \"" + options.output.string() + "\""},
        options.json);
  auto target = find_target(options);
  if (!target) return report_error(target.error(), options.json);
  const RigConfig& rig = (*target)->rig;
  auto simulation = Simulation::open(rig.simulation);
  if (!simulation) return report_error(simulation.error(), options.json);
  ImageRequest request;
  request.motion.count = static_cast<std::uint32_t>((*simulation)->joint_count());
  for (const std::string& joint : options.joints)
    if (auto s = set_joint(request.motion, **simulation, joint); !s)
      return report_error(s.error(), options.json);
  auto camera =
      (*simulation)->camera((*target)->choice->params, rig.seed, (*target)->noise_name, options.ideal);
  if (!camera) return report_error(camera.error(), options.json);

  // The sample that a virtual run takes at that instant: same index, same draws.
  const Duration period = (*target)->entry->period;
  request.index = static_cast<std::uint64_t>(seconds_from(options.at_s) / period);
  request.t_capture = BenchTime(0) + period * static_cast<std::int64_t>(request.index);
  const auto geometry = (*camera)->geometry();
  request.format = geometry.format;
  request.width_px = geometry.width_px;
  request.height_px = geometry.height_px;
  const ConfigNode& params = (*target)->choice->params;
  auto settings = catch_config([&] {
    request.exposure =
        seconds_from(params.number_or("exposure_us", geometry.exposure.seconds() * 1e6, {.min = 1}) * 1e-6);
    request.gain_db = params.number_or("gain_db", 0);
    return 0;
  });
  if (!settings) return report_error(settings.error(), options.json);
  std::vector<std::byte> pixels(image_bytes(request.format, request.width_px, request.height_px));
  if (auto s = (*camera)->capture(request, pixels); !s) return report_error(s.error(), options.json);
  const ImageInfo info{request.format,   request.width_px, request.height_px, 0, 0,
                       request.exposure, request.gain_db};
  if (auto s = write_picture(options.output, info, pixels); !s) return report_error(s.error(), options.json);

  if (options.json)
    fmt::print("{}\n", nlohmann::json{{"file", options.output.string()},
                                      {"channel", options.channel},
                                      {"width_px", info.width_px},
                                      {"height_px", info.height_px},
                                      {"format", pfnc_name(info.format)},
                                      {"t_capture_s", static_cast<double>(request.t_capture.ns()) * 1e-9},
                                      {"index", request.index},
                                      {"engine", (*simulation)->engine()}}
                           .dump());
  else
    fmt::print("{}: {}x{} {}, capture {} at {:.3f} s, {}\n", options.output.string(), info.width_px,
               info.height_px, pfnc_name(info.format), request.index,
               static_cast<double>(request.t_capture.ns()) * 1e-9, (*simulation)->engine());
  return 0;
}

}  // namespace rigor
