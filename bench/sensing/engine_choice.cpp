#include "bench/sensing/engine_choice.h"

#include <fmt/format.h>

namespace rigor {
namespace {

void read_quality(ConfigNode n, EngineChoice& c) {
  c.allowed_error_rad = n.number_or("allowed_error_rad", 0, {.min = 0, .max = 0.1});
  c.sub_rays = static_cast<int>(n.integer_or("sub_rays", 0, {.min = 1, .max = 4096}));
  c.samples_per_pixel = static_cast<int>(n.integer_or("samples_per_pixel", 0, {.min = 1, .max = 4096}));
  c.pixel_step = static_cast<int>(n.integer_or("pixel_step", 0, {.min = 1, .max = 8}));
  const auto more = [&](const char* key) -> std::optional<int> {
    if (!n.has(key)) return std::nullopt;
    return static_cast<int>(n.integer_or(key, 0, {.min = 0, .max = 4096}));
  };
  c.uneven_samples = more("uneven_samples");
  c.sky_samples = more("sky_samples");
  c.sky_rays = static_cast<int>(n.integer_or("sky_rays", 0, {.min = 0, .max = 4096}));
  c.pixels_per_rad = n.number_or("pixels_per_rad", 0, {.min = 10, .max = 100000});
  c.supersampling = n.number_or("supersampling", 0, {.min = 0.25, .max = 4});
  c.instants = static_cast<int>(n.integer_or("instants", 0, {.min = 1, .max = 64}));
}

/// What would be ignored is refused.
void refuse_foreign(const ConfigNode& n, const EngineChoice& c, SampleKind kind) {
  const bool raster = c.engine == "raster", rays = c.engine == "rays", image = kind == SampleKind::image;
  const auto only = [&](const char* key, bool allowed, const char* what) {
    if (n.has(key) && !allowed)
      throw n.error(key, fmt::format("expected no such key here: it is for {}", what));
  };
  only("allowed_error_rad", c.engine != kSceneRenderer, "rays and raster");
  only("sub_rays", kind == SampleKind::point_cloud, "LiDARs");
  only("samples_per_pixel", kind == SampleKind::range_image || (image && rays),
       "time-of-flight cameras, and for cameras by rays");
  only("pixel_step", image && rays, "cameras by rays");
  only("uneven_samples", image && rays, "cameras by rays");
  only("sky_samples", image && rays, "cameras by rays");
  only("sky_rays", image && rays, "cameras by rays");
  only("pixels_per_rad", raster && !image, "LiDARs and time-of-flight cameras by raster");
  only("supersampling", raster && image, "cameras by raster");
  only("instants", raster, "the renderer raster");
}

}  // namespace

EngineChoice read_engine_choice(ConfigNode params, SampleKind kind) {
  EngineChoice c;
  if (params.has("renderer"))
    c.engine = kind == SampleKind::image ? params.choice("renderer", {kSceneRenderer, "rays", "raster"})
                                         : params.choice("renderer", {"rays", "raster"});
  if (const ConfigNode quality = params.map_or_absent("quality"); quality.present()) {
    if (c.engine.empty() && params.has("tolerance"))
      throw params.error("quality",
                         "expected one of `quality` and `tolerance`, got both: `rigor tune` sets "
                         "the quality of a channel with a tolerance");
    if (c.engine.empty()) c.engine = "rays";
    read_quality(quality, c);
    refuse_foreign(quality, c, kind);
    quality.finish();
  }
  return c;
}

EngineChoice read_locked_choice(ConfigNode n) {
  EngineChoice c;
  c.engine = n.choice("renderer", {"rays", "raster"});
  read_quality(n, c);
  n.finish();
  return c;
}

std::string EngineChoice::text() const {
  std::string t = engine;
  if (sub_rays > 0) t += fmt::format(", {} sub-ray{}", sub_rays, sub_rays == 1 ? "" : "s");
  if (samples_per_pixel > 0)
    t += fmt::format(", {} sample{} per pixel", samples_per_pixel, samples_per_pixel == 1 ? "" : "s");
  if (pixel_step > 1) t += fmt::format(", every {} pixels", pixel_step);
  if (uneven_samples.value_or(0) > 0) t += fmt::format(", {} more where it is uneven", *uneven_samples);
  if (sky_samples.value_or(0) > 0) t += fmt::format(", {} at the sky's edges", *sky_samples);
  if (sky_rays > 0) t += fmt::format(", {} sky ray{}", sky_rays, sky_rays == 1 ? "" : "s");
  if (pixels_per_rad > 0) t += fmt::format(", {:g} pixels per rad", pixels_per_rad);
  if (supersampling > 0) t += fmt::format(", supersampling {:g}", supersampling);
  if (instants > 0) t += fmt::format(", {} instant{}", instants, instants == 1 ? "" : "s");
  t += allowed_error_rad > 0 ? fmt::format(", allowed error {:g} mrad", allowed_error_rad * 1e3)
                             : std::string(", in full");
  return t;
}

std::string EngineChoice::yaml() const {
  std::string t = "{ renderer: " + engine;
  if (allowed_error_rad > 0) t += fmt::format(", allowed_error_rad: {}", allowed_error_rad);
  if (sub_rays > 0) t += fmt::format(", sub_rays: {}", sub_rays);
  if (samples_per_pixel > 0) t += fmt::format(", samples_per_pixel: {}", samples_per_pixel);
  if (pixel_step > 0) t += fmt::format(", pixel_step: {}", pixel_step);
  if (uneven_samples) t += fmt::format(", uneven_samples: {}", *uneven_samples);
  if (sky_samples) t += fmt::format(", sky_samples: {}", *sky_samples);
  if (sky_rays > 0) t += fmt::format(", sky_rays: {}", sky_rays);
  if (pixels_per_rad > 0) t += fmt::format(", pixels_per_rad: {}", pixels_per_rad);
  if (supersampling > 0) t += fmt::format(", supersampling: {}", supersampling);
  if (instants > 0) t += fmt::format(", instants: {}", instants);
  return t + " }";
}

}  // namespace rigor
