#include "sim/render/rays/light_picture.h"

#include <cmath>
#include <vector>

namespace rigor::render {
namespace {

/// Rays of a tile follow each other, so that those of a packet stay together.
constexpr int kTile_px = 8;

Status check(const LightPictureRequest& q) {
  const auto bad = [](const char* where, const std::string& message) {
    return fail(ErrorCode::bad_input, where, message);
  };
  const Pinhole& p = q.pinhole;
  if (p.width_px < 1 || p.height_px < 1 || p.width_px > 16384 || p.height_px > 16384)
    return bad("picture", "expected 1 to 16384 px a side, got " + std::to_string(p.width_px) + "x" +
                              std::to_string(p.height_px));
  if (!(p.fx_px > 0 && p.fy_px > 0) || !std::isfinite(p.fx_px + p.fy_px + p.cx_px + p.cy_px))
    return bad("pinhole", "expected finite fx, fy above 0 and a finite centre");
  if (!(p.near_m > 0) || !std::isfinite(p.near_m))
    return bad("pinhole", "near_m: expected a length above 0, got " + std::to_string(p.near_m));
  const Eigen::Matrix3d r = q.T_world_camera.linear();
  if (!q.T_world_camera.matrix().allFinite() || !(r.transpose() * r).isIdentity(1e-6) || r.determinant() < 0)
    return bad("T_world_camera", "expected a finite place and a rotation");
  if (q.samples_a_side < 1 || q.samples_a_side > 64)
    return bad("samples_a_side", "expected 1 to 64, got " + std::to_string(q.samples_a_side));
  return {};
}

/// Through a place on the picture's plane, in pixels.
Ray ray_through(const LightPictureRequest& q, double u, double v) {
  const Pinhole& p = q.pinhole;
  const Eigen::Vector3d d = q.T_world_camera.linear() *
                            Eigen::Vector3d((u - p.cx_px) / p.fx_px, (v - p.cy_px) / p.fy_px, 1).normalized();
  Ray ray;
  for (int c = 0; c < 3; ++c) ray.direction[c] = static_cast<float>(d[c]);
  ray.time = q.time;
  return ray;
}

Status gather(LightTracer& tracer, const LightPictureRequest& request, LightQuery q) {
  std::vector<Ray> rays;
  const Pinhole& p = request.pinhole;
  for (int row = 0; row * kGatherHeight_px < p.height_px; ++row)
    for (int column = 0; column * kGatherWidth_px < p.width_px; ++column) {
      const GatheringPixel at = gathering_pixel(column, row);
      rays.push_back(ray_through(request, std::min(at.u, p.width_px - 1), std::min(at.v, p.height_px - 1)));
    }
  q.rays = rays;
  q.spread_rad = static_cast<float>(1.0 / std::max(p.fx_px, p.fy_px));
  return tracer.gather(q);
}

}  // namespace

Status trace_picture(LightTracer& tracer, const LightPictureRequest& request, ViewPicture& out) {
  if (auto s = check(request); !s) return s;
  const Pinhole& p = request.pinhole;
  const int a_side = request.samples_a_side;
  const auto each = static_cast<std::size_t>(a_side * a_side);
  const Eigen::Matrix3d r = request.T_world_camera.linear();
  const std::size_t pixels = static_cast<std::size_t>(p.width_px) * static_cast<std::size_t>(p.height_px);
  out.width_px = p.width_px;
  out.height_px = p.height_px;
  out.radiance.assign(4 * pixels, 0.0F);
  out.depth_m.assign(pixels, std::numeric_limits<float>::infinity());
  out.nodes.assign(pixels, 0);
  // Row of tiles by row of tiles, so that large pictures with many samples need little memory.
  std::vector<Ray> rays;
  std::vector<std::size_t> pixel_of;
  std::vector<LightSample> samples;
  // Of a pixel's samples, which one is nearest to its centre.
  const std::size_t middle = static_cast<std::size_t>((a_side - 1) / 2 * (a_side + 1));
  LightQuery q;
  q.origin = request.T_world_camera.translation();
  q.bands = request.bands;
  q.shadows = request.shadows;
  q.sky_rays = request.sky_rays;
  q.bounces = request.bounces;
  if (request.soft_sun) q.sun_rays = SunRays::to_points;
  q.spread_rad = static_cast<float>(1.0 / (std::max(p.fx_px, p.fy_px) * a_side));
  q.near_m = static_cast<float>(p.near_m);
  if (request.gather && q.shadows && q.sky_rays == 0) {
    if (auto s = gather(tracer, request, q); !s) return s;
    q.gathered = true;
  }
  const int rows_at_once =
      std::max(kTile_px, static_cast<int>(1'000'000 / (each * static_cast<std::size_t>(p.width_px))) /
                             kTile_px * kTile_px);
  for (int top = 0; top < p.height_px; top += rows_at_once) {
    rays.clear();
    pixel_of.clear();
    const int end = std::min(top + rows_at_once, p.height_px);
    for (int y0 = top; y0 < end; y0 += kTile_px)
      for (int x0 = 0; x0 < p.width_px; x0 += kTile_px)
        // By fours across and twos down: a packet of eight is nearly a square.
        for (int k = 0; k < kTile_px * kTile_px; ++k) {
          const int x = x0 + (k & 3) + (k >> 3 & 1) * 4, y = y0 + (k >> 2 & 1) + (k >> 4) * 2;
          if (x >= p.width_px || y >= end) continue;
          pixel_of.push_back(static_cast<std::size_t>(y) * static_cast<std::size_t>(p.width_px) +
                             static_cast<std::size_t>(x));
          for (int j = 0; j < a_side; ++j)
            for (int i = 0; i < a_side; ++i) {
              const double u = x + (i + 0.5) / a_side - 0.5, v = y + (j + 0.5) / a_side - 0.5;
              rays.push_back(ray_through(request, u, v));
            }
        }
    samples.resize(rays.size());
    q.rays = rays;
    // Another part of the picture, other draws.
    q.seed = request.seed + 0x9E3779B97F4A7C15ULL * static_cast<std::uint64_t>(top);
    if (auto s = tracer.trace(q, samples); !s) return s;
    for (std::size_t k = 0; k < pixel_of.size(); ++k) {
      const std::size_t pixel = pixel_of[k];
      double sum[4] = {};
      for (std::size_t i = 0; i < each; ++i)
        for (int b = 0; b < 4; ++b) sum[b] += static_cast<double>(samples[k * each + i].radiance[b]);
      for (std::size_t b = 0; b < 4; ++b)
        out.radiance[4 * pixel + b] = static_cast<float>(sum[b] / static_cast<double>(each));
      const LightSample& s = samples[k * each + middle];
      const float* d = rays[k * each + middle].direction;
      const Eigen::Vector3d direction(static_cast<double>(d[0]), static_cast<double>(d[1]),
                                      static_cast<double>(d[2]));
      out.depth_m[pixel] = s.range_m * static_cast<float>(r.col(2).dot(direction));
      out.nodes[pixel] = s.node.value;
    }
    if (request.progress) request.progress(static_cast<double>(end) / p.height_px);
  }
  return {};
}

}  // namespace rigor::render
