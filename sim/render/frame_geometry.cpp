#include "sim/render/frame_geometry.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>

namespace rigor::render {
namespace {

constexpr double kNear_m = 0.01;
constexpr int kInnerStrips = 24;
constexpr int kLines =
    kInnerStrips + 3;  // the shaded rectangle in strips, and one line at each end of the ground
constexpr int kNoiseCellsPerCell = 4;

gpu::vec4 to_vec4(const Eigen::Vector3d& v, double w = 0.0) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z()),
          static_cast<float>(w)};
}
gpu::vec4 row_of(const Eigen::Affine3d& T, int r) {
  return to_vec4(T.linear().row(r).transpose(), T.translation()[r]);
}
double away_from_zero(double v) { return std::abs(v) < 1e-7 ? (v < 0 ? -1e-7 : 1e-7) : v; }

}  // namespace

FrameGeometry::FrameGeometry(const world::Scene& scene, const ChannelResponse& response) : scene_(scene) {
  // Light is linear, so a material's answer to sun and sky is worked out once per channel: see MaterialData.
  const world::Sun& sun = scene.sun;
  const double sun_height = sun.direction_to_sun.z();
  sun_up_ = sun_height > 0.0 &&
            *std::max_element(sun.irradiance_w_per_m2.begin(), sun.irradiance_w_per_m2.end()) > 0.0;
  world::Bands sky_irradiance{};     // of a surface that faces up
  world::Bands ground_irradiance{};  // of one that faces down, reflected by the ground
  for (std::size_t b = 0; b < sky_irradiance.size(); ++b) {
    const double horizon = scene.sky.horizon_radiance_w_per_m2_sr[b];
    const double zenith = scene.sky.zenith_radiance_w_per_m2_sr[b];
    // Integral over the upper hemisphere of (h + (z - h) sin e) sin e.
    sky_irradiance[b] = std::numbers::pi * (horizon + 2.0 / 3.0 * (zenith - horizon));
    if (scene.ground) {
      const double down = sky_irradiance[b] + (sun_up_ ? sun.irradiance_w_per_m2[b] * sun_height : 0.0);
      const double mean_reflectance = 0.5 * (scene.materials[scene.ground->material].reflectance[b] +
                                             scene.materials[scene.ground->other_material].reflectance[b]);
      ground_irradiance[b] = down * mean_reflectance * (1.0 - 0.5 * scene.ground->noise_contrast);
    }
  }
  const auto channels = [&](auto per_band) {
    gpu::vec4 out;
    float* const value[3] = {&out.x, &out.y, &out.z};
    for (std::size_t c = 0; c < 3; ++c) {
      double sum = 0.0;
      for (std::size_t b = 0; b < 4; ++b) sum += response[c][b] * per_band(b);
      *value[c] = static_cast<float>(sum);
    }
    return out;
  };
  for (const world::Material& m : scene.materials) {
    const auto radiance = [&m](std::size_t b, double irradiance) {
      return m.reflectance[b] / std::numbers::pi * irradiance;
    };
    gpu::MaterialData d;
    d.sun = channels([&](std::size_t b) { return sun_up_ ? radiance(b, sun.irradiance_w_per_m2[b]) : 0.0; });
    d.sun.w = static_cast<float>(m.roughness);
    d.ambient_0 = channels(
        [&](std::size_t b) { return radiance(b, 0.5 * (sky_irradiance[b] + ground_irradiance[b])); });
    d.ambient_1 = channels(
        [&](std::size_t b) { return radiance(b, 0.5 * (sky_irradiance[b] - ground_irradiance[b])); });
    materials_.push_back(d);
  }
  uniforms.sky_horizon = channels([&](std::size_t b) { return scene.sky.horizon_radiance_w_per_m2_sr[b]; });
  uniforms.sky_gradient = channels([&](std::size_t b) {
    return scene.sky.zenith_radiance_w_per_m2_sr[b] - scene.sky.horizon_radiance_w_per_m2_sr[b];
  });
  uniforms.below_horizon = channels([&](std::size_t b) {
    return scene.ground ? ground_irradiance[b] / std::numbers::pi : scene.sky.horizon_radiance_w_per_m2_sr[b];
  });
  uniforms.sun_specular = channels([&](std::size_t b) { return sun_up_ ? sun.irradiance_w_per_m2[b] : 0.0; });
  const std::size_t n = scene.bodies.size();
  surfaces.reserve(max_surfaces());
  draws.reserve(max_surfaces());
  casters.reserve(n);
  placed_.reserve(n);
  footprints_.reserve(n);
  caster_list.reserve(max_caster_list());
  tiles_.reserve(max_tiles());
  tile_order_.reserve(max_tiles());
  ground_vertices.reserve(6 * max_tiles());
}

std::size_t FrameGeometry::max_tiles() const {
  return static_cast<std::size_t>(scene_.ground ? (kLines - 1) * (kLines - 1) : 0);
}
std::size_t FrameGeometry::max_caster_list() const {
  return scene_.bodies.size() * (scene_.bodies.size() + max_tiles());
}
bool FrameGeometry::bodies_have_highlights() const {
  return sun_up_ && std::any_of(scene_.bodies.begin(), scene_.bodies.end(), [this](const world::Body& b) {
           return scene_.materials[b.material].roughness < 1.0;
         });
}
bool FrameGeometry::ground_has_highlights() const {
  return sun_up_ && scene_.ground &&
         std::min(scene_.materials[scene_.ground->material].roughness,
                  scene_.materials[scene_.ground->other_material].roughness) < 1.0;
}

bool FrameGeometry::sphere_visible(const Eigen::Vector3d& centre_camera, double radius_m) const {
  if (centre_camera.z() < kNear_m - radius_m) return false;
  return std::all_of(planes_.begin(), planes_.end(),
                     [&](const Eigen::Vector3d& n) { return n.dot(centre_camera) >= -radius_m; });
}

void FrameGeometry::build(const PictureGeometry& picture, const Eigen::Isometry3d& T_world_sensor,
                          const world::WorldSnapshot& snapshot, BenchTime t) {
  const Eigen::Isometry3d T_camera_world = T_world_sensor.inverse();
  sun_camera_ = T_camera_world.linear() * scene_.sun.direction_to_sun;
  const double w = picture.width_px, h = picture.height_px;
  uniforms.projection = {static_cast<float>(2.0 * picture.focal_x_px / w),
                         static_cast<float>(2.0 * (picture.centre_u_px + 0.5) / w - 1.0),
                         static_cast<float>(2.0 * picture.focal_y_px / h),
                         static_cast<float>(2.0 * (picture.centre_v_px + 0.5) / h - 1.0)};
  uniforms.sun_camera = to_vec4(sun_camera_, kNear_m);
  // "Up" is the ground's normal; without a ground it is the world's z axis.
  uniforms.up_camera =
      to_vec4(T_camera_world.linear() * (scene_.ground ? scene_.ground->T_world_ground.linear().col(2).eval()
                                                       : Eigen::Vector3d::UnitZ().eval()));
  const double x0 = (-0.5 - picture.centre_u_px) / picture.focal_x_px;
  const double x1 = (w - 0.5 - picture.centre_u_px) / picture.focal_x_px;
  const double y0 = (-0.5 - picture.centre_v_px) / picture.focal_y_px;
  const double y1 = (h - 0.5 - picture.centre_v_px) / picture.focal_y_px;
  planes_ = {Eigen::Vector3d(1, 0, -x0).normalized(), Eigen::Vector3d(-1, 0, x1).normalized(),
             Eigen::Vector3d(0, 1, -y0).normalized(), Eigen::Vector3d(0, -1, y1).normalized()};
  place_bodies(T_world_sensor, snapshot, t);
  tiles_.clear();
  tile_order_.clear();
  ground_vertices.clear();
  if (scene_.ground) tile_ground(T_camera_world);
}

void FrameGeometry::place_bodies(const Eigen::Isometry3d& T_world_sensor,
                                 const world::WorldSnapshot& snapshot, BenchTime t) {
  in_the_dark = false;
  surfaces.clear();
  draws.clear();
  casters.clear();
  caster_list.clear();
  placed_.clear();
  footprints_.clear();
  const Eigen::Isometry3d T_camera_world = T_world_sensor.inverse();
  for (std::size_t i = 0; i < scene_.bodies.size(); ++i) {
    const world::Body& body = scene_.bodies[i];
    const Eigen::Isometry3d T_world_body = world::T_world_body(scene_, snapshot, i, t);
    // Differences of far-away positions are taken in double, before anything is rounded to float.
    const Eigen::Isometry3d T_camera_body = T_camera_world * T_world_body;
    const Eigen::Vector3d half = 0.5 * body.size_m;
    placed_.push_back({i, T_camera_body, Eigen::Isometry3d::Identity(), T_camera_body.translation(),
                       half.norm(), T_camera_body.translation().norm()});
    if (scene_.ground) placed_.back().T_ground_body = scene_.ground->T_world_ground.inverse() * T_world_body;
    const Eigen::Affine3d T_unit_camera =
        Eigen::Scaling(half.cwiseInverse()) * Eigen::Affine3d(T_camera_body.inverse());
    const Eigen::Vector3d d = T_unit_camera.linear() * sun_camera_;
    gpu::CasterData caster;
    caster.row0 = row_of(T_unit_camera, 0);
    caster.row1 = row_of(T_unit_camera, 1);
    caster.row2 = row_of(T_unit_camera, 2);
    caster.sun_unit = to_vec4({away_from_zero(d.x()), away_from_zero(d.y()), away_from_zero(d.z())},
                              body.shape == world::Shape::cylinder ? 1.0 : 0.0);
    casters.push_back(caster);
  }
  for (const Placed& p : placed_) {
    if (!sphere_visible(p.centre_camera, p.radius_m)) continue;
    const world::Body& body = scene_.bodies[p.body];
    const Eigen::Vector3d half = 0.5 * body.size_m;
    gpu::SurfaceData d;
    const Eigen::Affine3d T(p.T_camera_body);
    d.row0 = row_of(T, 0);
    d.row1 = row_of(T, 1);
    d.row2 = row_of(T, 2);
    const Eigen::Vector3d eye_body = p.T_camera_body.inverse().translation();
    const bool within = body.shape == world::Shape::box
                            ? (eye_body.cwiseAbs() - half).maxCoeff() < 0.0
                            : eye_body.head<2>().norm() < half.x() && std::abs(eye_body.z()) < half.z();
    in_the_dark = in_the_dark || within;
    d.half_size = to_vec4(half);
    d.material = materials_[body.material];
    SurfaceDraw draw;
    draw.mesh = body.shape == world::Shape::box ? Mesh::box : Mesh::cylinder;
    if (body.chessboard) {
      draw.pattern = true;
      d.other = materials_[body.chessboard->dark_material];
      d.pattern = {static_cast<float>(body.chessboard->columns + 1),
                   static_cast<float>(body.chessboard->rows + 1),
                   static_cast<float>(1.0 / body.chessboard->square_m), 0.0f};
    }
    const auto first = static_cast<std::uint32_t>(caster_list.size());
    if (sun_up_)
      for (const Placed& other : placed_) {
        if (other.body == p.body) continue;  // convex: its lit faces see the sun past itself
        const Eigen::Vector3d between = other.centre_camera - p.centre_camera;
        const double along = between.dot(sun_camera_);
        const double reach = p.radius_m + other.radius_m;
        if (along > -reach && (between - along * sun_camera_).norm() < reach)
          caster_list.push_back(static_cast<std::uint32_t>(other.body));
      }
    give_casters(d, draw, first, static_cast<std::uint32_t>(caster_list.size()) - first);
    draw.data = static_cast<std::uint32_t>(surfaces.size());
    draw.nearest_m = p.centre_camera.norm() - p.radius_m;
    surfaces.push_back(d);
    draws.push_back(draw);
  }
  // Nearest first, so that depth rejects what lies behind; ties by index keep the order fixed.
  std::sort(draws.begin(), draws.end(), [](const SurfaceDraw& a, const SurfaceDraw& b) {
    return a.nearest_m != b.nearest_m ? a.nearest_m < b.nearest_m : a.data < b.data;
  });
}

void FrameGeometry::give_casters(gpu::SurfaceData& surface, SurfaceDraw& draw, std::uint32_t first,
                                 std::uint32_t count) const {
  draw.casters = count;
  for (std::uint32_t i = first; i < first + count; ++i)
    draw.cylinders = draw.cylinders || scene_.bodies[caster_list[i]].shape == world::Shape::cylinder;
  surface.caster_range = {first, count, 0, 0};
  gpu::CasterData nowhere;  // o = (2, 2, 2) in its unit coordinates, and the ray leads away
  nowhere.row0.w = nowhere.row1.w = nowhere.row2.w = 2.0f;
  nowhere.sun_unit = {1.0f, 1.0f, 1.0f, 0.0f};
  for (std::size_t i = 0; i < gpu::kInlineCasters; ++i)
    surface.casters[i] = i < count ? casters[caster_list[first + i]] : nowhere;
}

void FrameGeometry::tile_ground(const Eigen::Isometry3d& T_camera_world) {
  const world::Ground& ground = *scene_.ground;
  const Eigen::Isometry3d T_camera_ground = T_camera_world * ground.T_world_ground;
  const Eigen::Vector3d sun_ground = ground.T_world_ground.linear().transpose() * scene_.sun.direction_to_sun;
  const double extent = ground.half_extent_m;

  // Where each body's shadow can fall: its eight corners, slid along the sun's rays onto the plane.
  const Eigen::Vector2d across = Eigen::Vector2d(-sun_ground.y(), sun_ground.x());
  Eigen::AlignedBox2d shaded;
  for (const Placed& p : placed_) {
    Footprint print;
    Eigen::AlignedBox2d& footprint = print.box;
    if (sun_up_ && sun_ground.z() > 1e-6) {
      const Eigen::Vector3d half = 0.5 * scene_.bodies[p.body].size_m;
      for (int corner = 0; corner < 8; ++corner) {
        const Eigen::Vector3d c = p.T_ground_body * Eigen::Vector3d((corner & 1) ? half.x() : -half.x(),
                                                                    (corner & 2) ? half.y() : -half.y(),
                                                                    (corner & 4) ? half.z() : -half.z());
        footprint.extend(
            Eigen::Vector2d(c.head<2>() - sun_ground.head<2>() / sun_ground.z() * std::max(c.z(), 0.0)));
        print.across.extend(Eigen::Matrix<double, 1, 1>(across.dot(c.head<2>())));
      }
    }
    if (!footprint.isEmpty())
      footprint = footprint.intersection(
          Eigen::AlignedBox2d(Eigen::Vector2d(-extent, -extent), Eigen::Vector2d(extent, extent)));
    footprints_.push_back(print);
    if (!footprint.isEmpty()) shaded.extend(footprint);
  }
  if (shaded.isEmpty())
    shaded =
        Eigen::AlignedBox2d(Eigen::Vector2d(-1, -1) * 0.5 * extent, Eigen::Vector2d(1, 1) * 0.5 * extent);

  std::array<std::array<double, kLines>, 2> lines{};
  for (int axis = 0; axis < 2; ++axis) {
    const auto a = static_cast<std::size_t>(axis);
    lines[a].front() = -extent;
    lines[a].back() = extent;
    for (int k = 0; k <= kInnerStrips; ++k)
      lines[a][static_cast<std::size_t>(k) + 1] =
          shaded.min()[axis] + (shaded.max()[axis] - shaded.min()[axis]) * k / kInnerStrips;
  }
  for (std::size_t j = 0; j + 1 < kLines; ++j) {
    for (std::size_t i = 0; i + 1 < kLines; ++i) {
      const Eigen::AlignedBox2d tile(Eigen::Vector2d(lines[0][i], lines[1][j]),
                                     Eigen::Vector2d(lines[0][i + 1], lines[1][j + 1]));
      if (!(tile.sizes().minCoeff() > 0.0)) continue;
      std::array<Eigen::Vector3d, 4> corner;
      const Eigen::Vector2d at[4] = {{tile.min().x(), tile.min().y()},
                                     {tile.max().x(), tile.min().y()},
                                     {tile.max().x(), tile.max().y()},
                                     {tile.min().x(), tile.max().y()}};
      for (std::size_t k = 0; k < 4; ++k)
        corner[k] = T_camera_ground * Eigen::Vector3d(at[k].x(), at[k].y(), 0.0);
      const auto all_outside = [&corner](const Eigen::Vector3d& n, double offset) {
        return std::all_of(corner.begin(), corner.end(),
                           [&](const Eigen::Vector3d& c) { return n.dot(c) < offset; });
      };
      if (all_outside(Eigen::Vector3d::UnitZ(), kNear_m) ||
          std::any_of(planes_.begin(), planes_.end(),
                      [&](const Eigen::Vector3d& n) { return all_outside(n, 0.0); }))
        continue;
      // Texture coordinates relative to an even cell near the tile: small numbers for float, the same pattern
      // anywhere.
      const Eigen::Vector2d base = (0.5 * tile.min() / ground.cell_m).array().floor() * 2.0;
      Tile out;
      Eigen::AlignedBox1d tile_across;
      for (const Eigen::Vector2d& corner_ground : at)
        tile_across.extend(Eigen::Matrix<double, 1, 1>(across.dot(corner_ground)));
      out.first_caster = static_cast<std::uint32_t>(caster_list.size());
      for (std::size_t b = 0; b < footprints_.size(); ++b)
        if (!footprints_[b].box.isEmpty() && footprints_[b].box.intersects(tile) &&
            footprints_[b].across.intersects(tile_across))
          caster_list.push_back(static_cast<std::uint32_t>(placed_[b].body));
      out.casters = static_cast<std::uint32_t>(caster_list.size()) - out.first_caster;
      std::size_t n = 0;
      for (const std::size_t k : {0, 1, 2, 0, 2, 3}) {
        gpu::GroundVertex& v = out.vertices[n++];
        for (int axis = 0; axis < 3; ++axis) v.position_camera[axis] = static_cast<float>(corner[k][axis]);
        for (int axis = 0; axis < 2; ++axis) {
          v.cell_position[axis] = static_cast<float>(at[k][axis] / ground.cell_m - base[axis]);
          v.base_cell[axis] = static_cast<std::int32_t>(base[axis]);
        }
      }
      tile_order_.push_back(static_cast<std::uint32_t>(tiles_.size()));
      tiles_.push_back(out);
    }
  }

  // Tiles that the same bodies may shade are drawn together.
  const auto list_of = [this](std::uint32_t t) {
    return std::span(caster_list).subspan(tiles_[t].first_caster, tiles_[t].casters);
  };
  std::sort(tile_order_.begin(), tile_order_.end(), [&](std::uint32_t a, std::uint32_t b) {
    const auto la = list_of(a), lb = list_of(b);
    if (std::lexicographical_compare(la.begin(), la.end(), lb.begin(), lb.end())) return true;
    if (std::lexicographical_compare(lb.begin(), lb.end(), la.begin(), la.end())) return false;
    return a < b;
  });
  for (std::size_t i = 0; i < tile_order_.size(); ++i) {
    const Tile& tile = tiles_[tile_order_[i]];
    if (i == 0 || !std::ranges::equal(list_of(tile_order_[i]), list_of(tile_order_[i - 1]))) {
      gpu::SurfaceData d;
      d.material = materials_[ground.material];
      d.other = materials_[ground.other_material];
      d.pattern = {static_cast<float>(ground.noise_contrast), static_cast<float>(kNoiseCellsPerCell), 0.0f,
                   0.0f};
      SurfaceDraw draw;
      draw.mesh = Mesh::ground;
      draw.pattern = ground.noise_contrast > 0.0;
      draw.data = static_cast<std::uint32_t>(surfaces.size());
      draw.first_vertex = static_cast<std::uint32_t>(ground_vertices.size());
      give_casters(d, draw, tile.first_caster, tile.casters);
      surfaces.push_back(d);
      draws.push_back(draw);
    }
    ground_vertices.insert(ground_vertices.end(), tile.vertices.begin(), tile.vertices.end());
    draws.back().vertex_count += 6;
  }
}

}  // namespace rigor::render
