#include "sim/nature/built/built_surfaces.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <vector>

#include "sensor-hal/models/philox.h"
#include "sim/render/content/surface_library.h"
#include "sim/render/content/texels.h"

namespace rigor::nature::built {
namespace {

using render::Spectrum;
using render::Surface;
using render::Texture;

// A pattern on a square that repeats: brightness about 1 and height in texels, at whole texels.
struct Texel {
  float red = 1, green = 1, blue = 1;
  float height = 0;
};
using Pattern = std::function<Texel(int x, int y)>;

float draw(std::uint32_t stream, int x, int y) {
  constexpr std::uint64_t kSeed = 0x6275696c74;  // "built"
  const auto key = models::channel_key(kSeed, stream);
  return static_cast<float>(
             models::philox({static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y), 0, 0}, key)[0] >>
             8) *
         0x1p-24F;
}

// Smooth noise that repeats after `period` cells, between -1 and 1.
float noise(std::uint32_t stream, float x, float y, int period) {
  const float fx = std::floor(x), fy = std::floor(y);
  const auto wrap = [period](float v) { return ((static_cast<int>(v) % period) + period) % period; };
  const auto at = [&](int dx, int dy) {
    return draw(stream, wrap(fx + static_cast<float>(dx)), wrap(fy + static_cast<float>(dy)));
  };
  float u = x - fx, v = y - fy;
  u = u * u * (3 - 2 * u);
  v = v * v * (3 - 2 * v);
  return 2 * std::lerp(std::lerp(at(0, 0), at(1, 0), u), std::lerp(at(0, 1), at(1, 1), u), v) - 1;
}

float rough_noise(std::uint32_t stream, float x, float y, int period, int octaves) {
  float sum = 0, weight = 0.5F;
  for (int o = 0; o < octaves; ++o, x *= 2, y *= 2, period *= 2, weight *= 0.5F)
    sum += weight * noise(stream + static_cast<std::uint32_t>(o), x, y, period);
  return sum;
}

// The material with a pattern on it, its mean reflectance kept in every band.
Cover patterned(std::string_view material, std::string_view name, int size, double repeats_per_m,
                float relief, const Pattern& pattern, const Spectrum& times = {1, 1, 1, 1, 1, 1}) {
  auto surface = std::make_shared<Surface>(*render::SurfaceLibrary::builtin().get(material));
  surface->serial = render::next_serial();
  surface->name = name;
  std::vector<Texel> texels;
  float greatest = 0;
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      texels.push_back(pattern(x, y));
      const Texel& t = texels.back();
      greatest = std::max({greatest, t.red, t.green, t.blue});
    }
  auto colour = std::make_shared<Texture>();
  colour->width = colour->height = static_cast<std::uint32_t>(size);
  std::array<double, 3> mean{};
  for (const Texel& t : texels) {
    const float rgb[] = {t.red, t.green, t.blue};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint8_t byte = render::srgb_bytes().of(rgb[k] / greatest);
      colour->rgba.push_back(byte);
      mean[k] += render::linear_of_bytes(true)[byte] / static_cast<double>(texels.size());
    }
    colour->rgba.push_back(255);
  }
  const double grey = (mean[0] + mean[1] + mean[2]) / 3;
  for (std::size_t b = 0; b < surface->reflectance.size(); ++b)
    surface->reflectance[b] =
        std::min(1.0F, surface->reflectance[b] * times[b] / static_cast<float>(b < 3 ? mean[b] : grey));
  surface->colour_map = std::move(colour);
  if (relief > 0) {
    auto normals = std::make_shared<Texture>();
    normals->width = normals->height = static_cast<std::uint32_t>(size);
    normals->srgb = false;
    const auto height = [&](int x, int y) {
      return texels[static_cast<std::size_t>((y + size) % size * size + (x + size) % size)].height * relief;
    };
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x) {
        // Tangent space: x to the right, y to the top of the picture.
        const float nx = (height(x - 1, y) - height(x + 1, y)) / 2,
                    ny = (height(x, y + 1) - height(x, y - 1)) / 2;
        const float length = std::sqrt(nx * nx + ny * ny + 1);
        for (const float v : {nx / length, ny / length, 1 / length})
          normals->rgba.push_back(static_cast<std::uint8_t>(std::lround(127.5F * (v + 1))));
        normals->rgba.push_back(255);
      }
    surface->normal_map = std::move(normals);
  }
  return {std::move(surface), repeats_per_m};
}

Cover plain(std::string_view material, std::string_view name, const Spectrum& times = {1, 1, 1, 1, 1, 1}) {
  auto surface = std::make_shared<Surface>(*render::SurfaceLibrary::builtin().get(material));
  surface->serial = render::next_serial();
  surface->name = name;
  for (std::size_t b = 0; b < times.size(); ++b)
    surface->reflectance[b] = std::min(1.0F, surface->reflectance[b] * times[b]);
  return {std::move(surface), 1.0};
}

Texel grey(float v, float height = 0) { return {v, v, v, height}; }

Texel render_coat(int x, int y) {
  const float u = static_cast<float>(x) / 256, v = static_cast<float>(y) / 256;
  const float stain = rough_noise(10, 4 * u, 4 * v, 4, 3), grain = draw(20, x, y) - 0.5F;
  return grey(1 + 0.07F * stain + 0.06F * grain, grain);
}

// A metre of wall: 4 bricks to a course, 12 courses, every second one moved by half a brick.
Texel brick_wall(int x, int y) {
  constexpr int kSize = 384, kCourses = 12, kAcross = 4;
  const float v = static_cast<float>(y) * kCourses / kSize;
  const int course = static_cast<int>(v);
  const float u = static_cast<float>(x) * kAcross / kSize + (course % 2 ? 0.5F : 0.0F);
  const int brick = static_cast<int>(u) % kAcross;
  const float in_u = (u - std::floor(u)) * 250, in_v = (v - std::floor(v)) * 83;  // mm
  const float edge = std::min(std::min(in_u, 250 - in_u), std::min(in_v, 83 - in_v));
  const float grain = 0.06F * (draw(32, x, y) - 0.5F);
  if (edge < 5) return {1.15F + grain, 1.9F + grain, 2.3F + grain, 0};  // mortar
  const float own = draw(30, brick, course) - 0.5F, hue = draw(31, brick, course) - 0.5F;
  return {1 + 0.35F * own + grain, 1 + 0.35F * own + 0.2F * hue + grain,
          1 + 0.35F * own + 0.15F * hue + grain, std::min(1.0F, (edge - 5) / 4)};
}

// 1.2 m of roof: 5 pantiles across, 4 rows, each row over the one below it.
Texel pantiles(int x, int y) {
  constexpr int kSize = 320, kRows = 4, kAcross = 5;
  const float u = static_cast<float>(x) * kAcross / kSize, v = static_cast<float>(y) * kRows / kSize;
  const int column = static_cast<int>(u), row = static_cast<int>(v);
  const float in_u = u - std::floor(u), in_v = v - std::floor(v);
  const float wave = 0.5F - 0.5F * std::cos(6.2831853F * in_u);
  const float own = draw(40, column, row) - 0.5F;
  const float shade = in_v > 0.93F ? 0.55F : 1.0F;  // the gap below a tile's lower edge
  const float grain = 0.08F * (draw(41, x, y) - 0.5F);
  return grey((1 + 0.22F * own + 0.12F * (wave - 0.5F) + grain) * shade, 14 * wave + 8 * in_v);
}

Texel slates(int x, int y) {
  constexpr int kSize = 256, kRows = 6, kAcross = 5;
  const float v = static_cast<float>(y) * kRows / kSize;
  const int row = static_cast<int>(v);
  const float u = static_cast<float>(x) * kAcross / kSize + (row % 2 ? 0.5F : 0.0F);
  const float in_u = u - std::floor(u), in_v = v - std::floor(v);
  const bool joint = in_u < 0.03F || in_v > 0.94F;
  const float own = draw(50, static_cast<int>(u) % kAcross, row) - 0.5F;
  return grey((1 + 0.3F * own + 0.08F * (draw(51, x, y) - 0.5F)) * (joint ? 0.6F : 1.0F),
              joint ? 0.0F : 3 + in_v);
}

Texel grains(std::uint32_t stream, int x, int y, float fine, float coarse) {
  const float u = static_cast<float>(x) / 256, v = static_cast<float>(y) / 256;
  const float g = noise(stream, 64 * u, 64 * v, 64) * 0.6F + (2 * draw(stream + 1, x, y) - 1) * 0.4F;
  return grey(std::max(0.1F, 1 + fine * g + coarse * rough_noise(stream + 2, 3 * u, 3 * v, 3, 3)), 2 * g);
}

// Sawn along x.
Texel timber(int x, int y) {
  const float u = static_cast<float>(x) / 256, v = static_cast<float>(y) / 256;
  const float ring = rough_noise(60, 4 * u, 48 * v, 4, 1) + 0.5F * noise(65, 2 * u, 8 * v, 2);
  return {1 + 0.2F * ring, 1 + 0.24F * ring, 1 + 0.28F * ring, ring};
}

std::vector<Cover> make_all() {
  std::vector<Cover> all(static_cast<std::size_t>(Finish::count));
  const auto put = [&](Finish f, Cover c) { all[static_cast<std::size_t>(f)] = std::move(c); };
  const Spectrum ochre{0.95F, 0.78F, 0.55F, 0.95F, 0.95F, 0.95F},
      dull{0.72F, 0.74F, 0.78F, 0.75F, 0.75F, 0.8F};
  put(Finish::plaster, patterned("plaster", "plaster", 256, 0.4, 0.3F, render_coat));
  put(Finish::plaster_ochre, patterned("plaster", "plaster", 256, 0.4, 0.3F, render_coat, ochre));
  put(Finish::plaster_grey, patterned("plaster", "plaster", 256, 0.4, 0.3F, render_coat, dull));
  put(Finish::brick, patterned("brick", "brick", 384, 1.0, 1.5F, brick_wall));
  put(Finish::roof_tiles, patterned("roof_tiles", "roof_tiles", 320, 1 / 1.2, 0.5F, pantiles));
  put(Finish::roof_slate,
      patterned("rock", "slate", 256, 1 / 1.5, 0.5F, slates, {0.4F, 0.42F, 0.48F, 0.4F, 0.4F, 0.4F}));
  put(Finish::roof_felt, patterned("asphalt", "roofing_felt", 256, 0.5, 0,
                                   [](int x, int y) { return grains(70, x, y, 0.2F, 0.2F); }));
  put(Finish::concrete, patterned("concrete", "concrete", 256, 0.4, 0.2F,
                                  [](int x, int y) { return grains(80, x, y, 0.08F, 0.2F); }));
  put(Finish::asphalt, patterned("asphalt", "asphalt", 256, 0.5, 0.4F,
                                 [](int x, int y) { return grains(90, x, y, 0.3F, 0.12F); }));
  put(Finish::gravel, patterned("gravel", "gravel", 256, 0.5, 0.8F,
                                [](int x, int y) { return grains(100, x, y, 0.45F, 0.15F); }));
  put(Finish::soil,
      patterned("soil", "soil", 256, 0.4, 0.8F, [](int x, int y) { return grains(110, x, y, 0.3F, 0.3F); }));
  put(Finish::road_marking, plain("road_marking", "road_marking"));
  // The room behind a pane is closed and dark: what passes the glass comes back as a few per cent.
  Cover pane = plain("glass", "glass", {2.0F, 2.0F, 2.0F, 2.0F, 2.0F, 2.0F});
  auto glass = std::make_shared<Surface>(*pane.surface);
  glass->transmittance = {};
  glass->two_sided = false;
  pane.surface = std::move(glass);
  put(Finish::glass, std::move(pane));
  put(Finish::window_frame, plain("painted_metal", "window_frame", {2.1F, 2.1F, 2.05F, 2.0F, 2.0F, 2.0F}));
  put(Finish::door,
      patterned("wood", "door", 256, 0.5, 0.5F, timber, {0.35F, 0.3F, 0.25F, 0.5F, 0.5F, 0.5F}));
  put(Finish::wood,
      patterned("wood", "wood", 256, 0.5, 0.5F, timber, {0.62F, 0.66F, 0.72F, 0.7F, 0.7F, 0.7F}));
  put(Finish::wire, plain("bare_metal", "wire"));
  return all;
}

}  // namespace

const Cover& cover(Finish finish) {
  static const std::vector<Cover> all = make_all();
  return all[static_cast<std::size_t>(finish)];
}

std::shared_ptr<const Surface> with_pattern(const std::shared_ptr<const Surface>& surface) {
  if (surface->colour_map || surface->normal_map) return surface;
  const auto plain = render::SurfaceLibrary::builtin().find(surface->name);
  for (std::size_t f = 0; plain && f < static_cast<std::size_t>(Finish::count); ++f) {
    const Surface& like = *cover(static_cast<Finish>(f)).surface;
    if (like.name != surface->name || !like.colour_map) continue;
    auto out = std::make_shared<Surface>(*surface);
    out->serial = render::next_serial();
    for (std::size_t b = 0; b < out->reflectance.size(); ++b)
      out->reflectance[b] = std::min(1.0F, out->reflectance[b] * like.reflectance[b] / plain->reflectance[b]);
    out->colour_map = like.colour_map;
    out->normal_map = like.normal_map;
    return out;
  }
  return surface;
}

double repeats_of(const Surface& surface) {
  for (std::size_t f = 0; surface.colour_map && f < static_cast<std::size_t>(Finish::count); ++f) {
    const Cover& c = cover(static_cast<Finish>(f));
    if (c.surface->colour_map == surface.colour_map) return c.repeats_per_m;
  }
  return 1.0;
}

}  // namespace rigor::nature::built
