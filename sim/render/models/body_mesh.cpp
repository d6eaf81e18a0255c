#include "sim/render/models/body_mesh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "sim/render/content/texels.h"
#include "sim/render/models/mesh_builder.h"

namespace rigor::render {
namespace {

using Eigen::Vector3d;
constexpr int kSegments = 64;
constexpr int kNoiseCellsPerCell = 4;

const PictureFrame kFromAbove{.right = Vector3d::UnitX(), .down = -Vector3d::UnitY()};

// The +z face as a grid of squares. Its outer edges have no points of their own, so that the sides fit.
void add_board(MeshBuilder& mesh, const Vector3d& half, const SurfacePtr& light,
               const ChessboardSpec& board) {
  const auto lines = [&](int squares, double limit) {
    std::vector<double> at;
    for (int i = 0; i <= squares; ++i)
      at.push_back(std::clamp((i - squares / 2.0) * board.square_m, -limit, limit));
    return at;
  };
  const auto xs = lines(board.columns + 1, half.x()), ys = lines(board.rows + 1, half.y());
  const auto at = [&](double x, double y) { return Vector3d(x, y, half.z()); };
  for (std::size_t i = 0; i + 1 < xs.size(); ++i)
    for (std::size_t j = 0; j + 1 < ys.size(); ++j) {
      const Vector3d p[] = {at(xs[i], ys[j]), at(xs[i + 1], ys[j]), at(xs[i + 1], ys[j + 1]),
                            at(xs[i], ys[j + 1])};
      mesh.polygon((i + j) % 2 ? board.dark : light, p, kFromAbove);
    }
  std::array<std::vector<Vector3d>, 4> inner;
  for (const double x : xs) {
    inner[0].push_back(at(x, ys.front()));
    inner[2].insert(inner[2].begin(), at(x, ys.back()));
  }
  for (const double y : ys) {
    inner[1].push_back(at(xs.back(), y));
    inner[3].insert(inner[3].begin(), at(xs.front(), y));
  }
  const Vector3d corner[] = {at(-half.x(), -half.y()), at(half.x(), -half.y()), at(half.x(), half.y()),
                             at(-half.x(), half.y())};
  for (std::size_t k = 0; k < 4; ++k) {
    const auto& in = inner[k];
    mesh.triangle(light, corner[k], corner[(k + 1) % 4], in.back(), kFromAbove);
    for (std::size_t i = in.size() - 1; i > 0; --i)
      mesh.triangle(light, corner[k], in[i], in[i - 1], kFromAbove);
  }
}

// The lattice of sim/render/scene/scene_light.cpp.
float lattice(std::int32_t x, std::int32_t y) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x9E3779B1U ^ static_cast<std::uint32_t>(y) * 0x85EBCA77U;
  h = (h ^ (h >> 15)) * 0x2C1B3C6DU;
  h = (h ^ (h >> 12)) * 0x297A2D39U;
  return static_cast<float>((h ^ (h >> 15)) >> 8) * (1.0F / 16777216.0F);
}
// Smooth noise in [0, 1] that repeats after `period`.
float smooth_noise(float x, float y, int period) {
  const float cx = std::floor(x), cy = std::floor(y);
  const auto wrapped = [period](float v) { return ((static_cast<int>(v) % period) + period) % period; };
  const auto node = [&](int dx, int dy) {
    return lattice(wrapped(cx + static_cast<float>(dx)), wrapped(cy + static_cast<float>(dy)));
  };
  float u = x - cx, v = y - cy;
  u = u * u * (3 - 2 * u);
  v = v * v * (3 - 2 * v);
  return std::lerp(std::lerp(node(0, 0), node(1, 0), u), std::lerp(node(0, 1), node(1, 1), u), v);
}

}  // namespace

std::shared_ptr<const Mesh> box_mesh(const Vector3d& size_m, const SurfacePtr& surface) {
  MeshBuilder mesh;
  mesh.box(surface, -size_m / 2, size_m / 2);
  return mesh.finish();
}

std::shared_ptr<const Mesh> chessboard_mesh(const Vector3d& size_m, const SurfacePtr& surface,
                                            const ChessboardSpec& board) {
  MeshBuilder mesh;
  const Vector3d half = size_m / 2;
  mesh.box(surface, -half, half, 1U << MeshBuilder::kTop);
  add_board(mesh, half, surface, board);
  return mesh.finish();
}

std::shared_ptr<const Mesh> cylinder_mesh(const Vector3d& size_m, const SurfacePtr& surface) {
  MeshBuilder mesh;
  mesh.cylinder(surface, {.z0_m = -size_m.z() / 2,
                          .z1_m = size_m.z() / 2,
                          .radius0_m = size_m.x() / 2,
                          .radius1_m = size_m.x() / 2,
                          .segments = kSegments});
  return mesh.finish();
}

GroundSurface ground_surface(const GroundPlaneSpec& spec) {
  const Surface &a = *spec.even, &b = *spec.odd;
  if (&a == &b && !(spec.noise_contrast > 0)) return {spec.even, spec.cell_m};
  const int cells = spec.noise_contrast > 0 ? 8 : 2, size = spec.noise_contrast > 0 ? 1024 : 512;
  auto out = std::make_shared<Surface>(a);
  out->serial = next_serial();
  const auto picture = [size](bool srgb) {
    auto t = std::make_shared<Texture>();
    t->width = t->height = static_cast<std::uint32_t>(size);
    t->srgb = srgb;
    t->rgba.resize(static_cast<std::size_t>(size) * static_cast<std::size_t>(size) * 4, 255);
    return t;
  };
  const auto colour = picture(true), infrared = picture(true), gloss = picture(false);
  // The surface is the brighter and glossier of the two in each respect; pictures take away.
  std::array<Spectrum, 2> share{};
  for (std::size_t k = 0; k < out->reflectance.size(); ++k) {
    const float most = std::max({a.reflectance[k], b.reflectance[k], 1e-6F});
    out->reflectance[k] = most;
    share[0][k] = a.reflectance[k] / most;
    share[1][k] = b.reflectance[k] / most;
  }
  out->roughness = std::min(a.roughness, b.roughness);
  const float most_gloss = std::max(1 - out->roughness, 1e-6F);
  const float gloss_share[] = {(1 - a.roughness) / most_gloss, (1 - b.roughness) / most_gloss};
  for (int row = 0; row < size; ++row)
    for (int column = 0; column < size; ++column) {
      const float x =
          (static_cast<float>(column) + 0.5F) / static_cast<float>(size) * static_cast<float>(cells);
      const float y =
          -(static_cast<float>(row) + 0.5F) / static_cast<float>(size) * static_cast<float>(cells);
      const auto odd =
          static_cast<std::size_t>((static_cast<int>(std::floor(x)) + static_cast<int>(std::floor(y))) & 1);
      const float n = spec.noise_contrast > 0 ? smooth_noise(x * kNoiseCellsPerCell, y * kNoiseCellsPerCell,
                                                             cells * kNoiseCellsPerCell)
                                              : 0.0F;
      const float light = 1 - static_cast<float>(spec.noise_contrast) * n;
      const std::size_t texel = 4 * (static_cast<std::size_t>(row) * static_cast<std::size_t>(size) +
                                     static_cast<std::size_t>(column));
      for (std::size_t k = 0; k < 3; ++k) {
        colour->rgba[texel + k] = srgb_bytes().of(share[odd][k] * light);
        infrared->rgba[texel + k] = srgb_bytes().of(share[odd][k + 3] * light);
        gloss->rgba[texel + k] = static_cast<std::uint8_t>(std::lround(255 * gloss_share[odd]));
      }
    }
  out->colour_map = colour;
  out->near_infrared_map = infrared;
  out->normal_map = nullptr;
  out->gloss_map = a.roughness != b.roughness ? gloss : nullptr;
  return {std::move(out), cells * spec.cell_m};
}

std::shared_ptr<const Mesh> ground_mesh(const GroundPlaneSpec& spec) {
  constexpr int kTiles = 16;
  const GroundSurface ground = ground_surface(spec);
  const PictureFrame picture{.right = Vector3d::UnitX() / ground.repeat_m,
                             .down = -Vector3d::UnitY() / ground.repeat_m};
  MeshBuilder mesh;
  const auto at = [&](int i) { return spec.half_extent_m * (2.0 * i / kTiles - 1); };
  for (int i = 0; i < kTiles; ++i)
    for (int j = 0; j < kTiles; ++j) {
      const Vector3d p[] = {
          {at(i), at(j), 0}, {at(i + 1), at(j), 0}, {at(i + 1), at(j + 1), 0}, {at(i), at(j + 1), 0}};
      mesh.polygon(ground.surface, p, picture);
    }
  return mesh.finish();
}

}  // namespace rigor::render
