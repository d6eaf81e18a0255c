#include "sim/render/scene/scene_frame.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::render {
namespace {

double not_zero(double v) { return std::abs(v) < 1e-7 ? (v < 0 ? -1e-7 : 1e-7) : v; }

/// The camera's rays in a frame that T (camera to that frame, scales included) leads to.
FrameRays rays_in(const Eigen::Affine3d& T) {
  FrameRays r;
  for (int k = 0; k < 3; ++k) {
    r.origin[k] = static_cast<float>(T.translation()[k]);
    r.axis[k] = static_cast<float>(T.linear()(k, 2));
    r.right[k] = static_cast<float>(T.linear()(k, 0));
    r.down[k] = static_cast<float>(T.linear()(k, 1));
  }
  return r;
}

Eigen::Vector3d corner_of(const Eigen::Vector3d& half, int corner) {
  return {(corner & 1) ? half.x() : -half.x(), (corner & 2) ? half.y() : -half.y(),
          (corner & 4) ? half.z() : -half.z()};
}

/// The rays that may meet the body, and a little more for rounding.
Eigen::AlignedBox2f rays_to(const Eigen::Isometry3d& T_camera_body, const Eigen::Vector3d& half) {
  constexpr float kMargin = 1e-5F, kAll = 1e9F;
  Eigen::AlignedBox2f seen;
  bool before = false, behind = false;
  for (int k = 0; k < 8; ++k) {
    const Eigen::Vector3d c = T_camera_body * corner_of(half, k);
    if (c.z() < kSceneNear_m) {
      behind = true;
      continue;
    }
    before = true;
    seen.extend(Eigen::Vector2d(c.head<2>() / c.z()).cast<float>());
  }
  if (!before) return {};
  if (behind) return {Eigen::Vector2f::Constant(-kAll), Eigen::Vector2f::Constant(kAll)};
  const Eigen::Vector2f margin =
      kMargin * (Eigen::Vector2f::Ones() + seen.min().cwiseAbs().cwiseMax(seen.max().cwiseAbs()));
  return {seen.min() - margin, seen.max() + margin};
}

}  // namespace

SceneFrame::SceneFrame(const world::Scene& scene, const ChannelResponse& response) : scene_(scene) {
  // Light is linear, so a material's answer to sun and sky is worked out once per channel.
  const world::Sun& sun = scene.sun;
  const double sun_height = sun.direction_to_sun.z();
  sun_up = sun_height > 0.0 &&
           *std::max_element(sun.irradiance_w_per_m2.begin(), sun.irradiance_w_per_m2.end()) > 0.0;
  world::Bands sky_irradiance{};     // of a surface that faces up
  world::Bands ground_irradiance{};  // of one that faces down, reflected by the ground
  for (std::size_t b = 0; b < sky_irradiance.size(); ++b) {
    const double horizon = scene.sky.horizon_radiance_w_per_m2_sr[b];
    const double zenith = scene.sky.zenith_radiance_w_per_m2_sr[b];
    // Integral over the upper hemisphere of (h + (z - h) sin e) sin e.
    sky_irradiance[b] = std::numbers::pi * (horizon + 2.0 / 3.0 * (zenith - horizon));
    if (scene.ground) {
      const double down = sky_irradiance[b] + (sun_up ? sun.irradiance_w_per_m2[b] * sun_height : 0.0);
      const double mean_reflectance = 0.5 * (scene.materials[scene.ground->material].reflectance[b] +
                                             scene.materials[scene.ground->other_material].reflectance[b]);
      ground_irradiance[b] = down * mean_reflectance * (1.0 - 0.5 * scene.ground->noise_contrast);
    }
  }
  const auto channels = [&](auto per_band) {
    Channels out{};
    for (std::size_t c = 0; c < 3; ++c) {
      double sum = 0.0;
      for (std::size_t b = 0; b < 4; ++b) sum += response[c][b] * per_band(b);
      out[c] = static_cast<float>(sum);
    }
    return out;
  };
  for (const world::Material& m : scene.materials) {
    const auto radiance = [&m](std::size_t b, double irradiance) {
      return m.reflectance[b] / std::numbers::pi * irradiance;
    };
    SurfaceLight d;
    d.sun = channels([&](std::size_t b) { return sun_up ? radiance(b, sun.irradiance_w_per_m2[b]) : 0.0; });
    d.roughness = static_cast<float>(m.roughness);
    d.ambient_0 = channels(
        [&](std::size_t b) { return radiance(b, 0.5 * (sky_irradiance[b] + ground_irradiance[b])); });
    d.ambient_1 = channels(
        [&](std::size_t b) { return radiance(b, 0.5 * (sky_irradiance[b] - ground_irradiance[b])); });
    materials_.push_back(d);
  }
  sky_horizon = channels([&](std::size_t b) { return scene.sky.horizon_radiance_w_per_m2_sr[b]; });
  sky_gradient = channels([&](std::size_t b) {
    return scene.sky.zenith_radiance_w_per_m2_sr[b] - scene.sky.horizon_radiance_w_per_m2_sr[b];
  });
  below_horizon = channels([&](std::size_t b) {
    return scene.ground ? ground_irradiance[b] / std::numbers::pi : scene.sky.horizon_radiance_w_per_m2_sr[b];
  });
  sun_specular = channels([&](std::size_t b) { return sun_up ? sun.irradiance_w_per_m2[b] : 0.0; });
}

void SceneFrame::build(const Eigen::Isometry3d& T_world_sensor, const Eigen::AlignedBox2f& field,
                       const world::WorldSnapshot& snapshot, BenchTime t) {
  const Eigen::Isometry3d T_camera_world = T_world_sensor.inverse();
  sun_camera = T_camera_world.linear() * scene_.sun.direction_to_sun;
  // "Up" is the ground's normal; without a ground it is the world's z axis.
  up_camera = T_camera_world.linear() * (scene_.ground ? scene_.ground->T_world_ground.linear().col(2).eval()
                                                       : Eigen::Vector3d::UnitZ().eval());
  place_bodies(T_camera_world, field, snapshot, t);
  footprints.clear();
  footprint_bodies.clear();
  has_ground = scene_.ground.has_value();
  if (has_ground) place_ground(T_camera_world);
}

void SceneFrame::place_bodies(const Eigen::Isometry3d& T_camera_world, const Eigen::AlignedBox2f& field,
                              const world::WorldSnapshot& snapshot, BenchTime t) {
  in_the_dark = false;
  bodies.clear();
  casters.clear();
  T_world_body_.clear();
  const std::size_t n = scene_.bodies.size();
  for (std::size_t i = 0; i < n; ++i) {
    const world::Body& body = scene_.bodies[i];
    T_world_body_.push_back(world::T_world_body(scene_, snapshot, i, t));
    // Differences of far-away positions are taken in double, before anything is rounded to float.
    const Eigen::Isometry3d T_camera_body = T_camera_world * T_world_body_.back();
    const Eigen::Isometry3d T_body_camera = T_camera_body.inverse();
    const Eigen::Vector3d half = 0.5 * body.size_m;
    FrameBody b;
    b.cylinder = body.shape == world::Shape::cylinder;
    const Eigen::Affine3d T_unit_camera =
        Eigen::Scaling(half.cwiseInverse()) * Eigen::Affine3d(T_body_camera);
    b.rays = rays_in(T_unit_camera);
    const Eigen::Vector3d d = T_unit_camera.linear() * sun_camera;
    b.sun_unit = Eigen::Vector3d(not_zero(d.x()), not_zero(d.y()), not_zero(d.z())).cast<float>();
    b.half_size_m = half.cast<float>();
    b.sun = (T_body_camera.linear() * sun_camera).cast<float>();
    b.up = (T_body_camera.linear() * up_camera).cast<float>();
    b.material = &materials_[body.material];
    if (body.chessboard) {
      b.dark = &materials_[body.chessboard->dark_material];
      b.squares = Eigen::Vector2i(body.chessboard->columns + 1, body.chessboard->rows + 1).cast<float>();
      b.squares_per_m = static_cast<float>(1.0 / body.chessboard->square_m);
    }
    b.seen = rays_to(T_camera_body, half).intersection(field);
    const Eigen::Vector3d eye = T_unit_camera.translation();  // in units of half the size
    in_the_dark = in_the_dark || (b.cylinder ? eye.head<2>().norm() < 1 && std::abs(eye.z()) < 1
                                             : eye.cwiseAbs().maxCoeff() < 1);
    bodies.push_back(b);
  }
  for (std::size_t i = 0; i < n; ++i) {
    FrameBody& b = bodies[i];
    b.first_caster = static_cast<std::uint32_t>(casters.size());
    if (sun_up && !b.seen.isEmpty())
      for (std::size_t k = 0; k < n; ++k) {
        if (k == i) continue;  // convex: its lit faces see the sun past itself
        const Eigen::Vector3d between = T_world_body_[k].translation() - T_world_body_[i].translation();
        const double along = between.dot(scene_.sun.direction_to_sun);
        const double reach = 0.5 * (scene_.bodies[i].size_m.norm() + scene_.bodies[k].size_m.norm());
        if (along > -reach && (between - along * scene_.sun.direction_to_sun).norm() < reach)
          casters.push_back(static_cast<std::uint32_t>(k));
      }
    b.casters = static_cast<std::uint32_t>(casters.size()) - b.first_caster;
  }
}

void SceneFrame::place_ground(const Eigen::Isometry3d& T_camera_world) {
  const world::Ground& g = *scene_.ground;
  const Eigen::Isometry3d T_ground_camera = (T_camera_world * g.T_world_ground).inverse();
  const Eigen::Vector3d sun = g.T_world_ground.linear().transpose() * scene_.sun.direction_to_sun;
  const Eigen::Vector2d base =
      (0.5 * T_ground_camera.translation().head<2>() / g.cell_m).array().floor().max(-1e8).min(1e8) * 2.0;
  Eigen::Affine3d T_cells_ground = Eigen::Affine3d::Identity();
  T_cells_ground.linear().diagonal() << 1 / g.cell_m, 1 / g.cell_m, 1;
  T_cells_ground.translation() << -base.x(), -base.y(), 0;
  ground.rays = rays_in(T_cells_ground * T_ground_camera);
  const double extent = g.half_extent_m / g.cell_m;
  const Eigen::AlignedBox2d all(Eigen::Vector2d::Constant(-extent) - base,
                                Eigen::Vector2d::Constant(extent) - base);
  ground.least = all.min().cast<float>();
  ground.most = all.max().cast<float>();
  ground.base_cell = {static_cast<std::int32_t>(base.x()), static_cast<std::int32_t>(base.y())};
  ground.noise_contrast = static_cast<float>(g.noise_contrast);
  ground.material = &materials_[g.material];
  ground.other = &materials_[g.other_material];
  ground.across = Eigen::Vector2d(-sun.y(), sun.x());
  ground.cos_sun = static_cast<float>(sun.z());
  if (!sun_up || sun.z() <= 1e-6) return;
  // The eight corners of each body, as they are and slid along the sun's rays onto the plane; a little more
  // for rounding.
  constexpr double kMargin_cells = 1e-3;
  const Eigen::Isometry3d T_ground_world = g.T_world_ground.inverse();
  for (std::size_t i = 0; i < scene_.bodies.size(); ++i) {
    const Eigen::Isometry3d T_ground_body = T_ground_world * T_world_body_[i];
    Footprint print;
    for (int corner = 0; corner < 8; ++corner) {
      const Eigen::Vector3d c = T_ground_body * corner_of(0.5 * scene_.bodies[i].size_m, corner);
      const Eigen::Vector2d slid = c.head<2>() - sun.head<2>() / sun.z() * std::max(c.z(), 0.0);
      print.box.extend(slid / g.cell_m - base);
      // An edge that pierces the plane does so between its corners.
      print.box.extend(c.head<2>() / g.cell_m - base);
      print.across.extend(
          Eigen::Matrix<double, 1, 1>(ground.across.dot((c.head<2>() / g.cell_m - base).eval())));
    }
    const double margin = kMargin_cells + 1e-6 * (print.box.min().norm() + print.box.max().norm());
    print.box.min().array() -= margin;
    print.box.max().array() += margin;
    print.across.min().array() -= margin;
    print.across.max().array() += margin;
    if (!print.box.intersects(all)) continue;
    footprints.push_back(print);
    footprint_bodies.push_back(static_cast<std::uint32_t>(i));
  }
}

}  // namespace rigor::render
