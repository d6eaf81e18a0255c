// A small software rasteriser, to look at meshes and to compare levels of detail by their silhouettes.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <limits>
#include <vector>

#include "sim/render/content/content.h"

namespace rigor::test {

struct Picture {
  int width = 0, height = 0;
  std::vector<float> rgb;    ///< linear, 3 a pixel; negative: nothing drawn
  std::vector<float> depth;  ///< infinity: nothing
};

struct Eye {
  Eigen::Vector3f position{0, -10, 2}, target{0, 0, 2};
  float focal_px = 600;
  bool parallel = false;  ///< orthographic: focal_px pixels a metre
  [[nodiscard]] Eigen::Matrix3f axes() const {
    const Eigen::Vector3f z = (target - position).normalized(),
                          up = std::abs(z.z()) > 0.99F ? Eigen::Vector3f(0, 1, 0) : Eigen::Vector3f(0, 0, 1);
    const Eigen::Vector3f x = z.cross(up).normalized();
    Eigen::Matrix3f m;
    m << x.transpose(), z.cross(x).transpose(), z.transpose();  // y down
    return m;
  }
};

struct Placed {
  const render::Mesh* mesh;
  render::Instance at;
};

class Raster {
 public:
  Raster(int width, int height, const Eye& eye) : eye_(eye), axes_(eye.axes()) {
    out.width = width, out.height = height;
    out.rgb.assign(static_cast<std::size_t>(width) * height * 3, -1);
    out.depth.assign(static_cast<std::size_t>(width) * height, std::numeric_limits<float>::infinity());
  }
  /// Colour of a point: surface, texel (linear, with alpha), shading normal, position, tint, seen from
  /// behind.
  using Shade = std::function<Eigen::Vector3f(const render::Surface&, const Eigen::Vector4f&,
                                              const Eigen::Vector3f&, const Eigen::Vector3f&, const float*)>;
  void draw(const Placed& p, const Shade& shade) {
    const Eigen::Quaternionf q(p.at.rotation[3], p.at.rotation[0], p.at.rotation[1], p.at.rotation[2]);
    const Eigen::Vector3f scale(p.at.scale[0], p.at.scale[1], p.at.scale[2]),
        move(p.at.position[0], p.at.position[1], p.at.position[2]);
    std::vector<Eigen::Vector3f> world, normal, view;
    for (const auto& v : p.mesh->vertices) {
      world.push_back(q * scale.cwiseProduct(Eigen::Vector3f(v.position[0], v.position[1], v.position[2])) +
                      move);
      normal.push_back(
          (q * Eigen::Vector3f(v.normal[0], v.normal[1], v.normal[2]).cwiseQuotient(scale)).normalized());
      view.push_back(axes_ * (world.back() - eye_.position));
    }
    for (const auto& part : p.mesh->parts)
      for (std::uint32_t k = part.first_index; k < part.first_index + part.index_count; k += 3) {
        const std::uint32_t* i = &p.mesh->indices[k];
        triangle(*p.mesh, *part.surface, i, world, normal, view, shade, p.at.tint);
      }
  }
  [[nodiscard]] float depth_at(const Eigen::Vector3f& p, float* distance) const {
    const Eigen::Vector3f v = axes_ * (p - eye_.position);
    *distance = v.z();
    const int x = static_cast<int>(std::floor(sx(v))), y = static_cast<int>(std::floor(sy(v)));
    if (x < 0 || y < 0 || x >= out.width || y >= out.height) return std::numeric_limits<float>::infinity();
    return out.depth[static_cast<std::size_t>(y) * out.width + x];
  }
  [[nodiscard]] std::size_t covered() const {
    std::size_t n = 0;
    for (const float d : out.depth) n += d < 1e30F;
    return n;
  }
  Picture out;

 private:
  [[nodiscard]] float sx(const Eigen::Vector3f& v) const {
    return 0.5F * static_cast<float>(out.width) + eye_.focal_px * v.x() / (eye_.parallel ? 1 : v.z());
  }
  [[nodiscard]] float sy(const Eigen::Vector3f& v) const {
    return 0.5F * static_cast<float>(out.height) + eye_.focal_px * v.y() / (eye_.parallel ? 1 : v.z());
  }
  static Eigen::Vector4f texel(const render::Texture& t, float u, float v) {
    const auto wrap = [&](float x) { return t.repeat ? x - std::floor(x) : std::clamp(x, 0.0F, 0.99999F); };
    const auto x = static_cast<std::size_t>(wrap(u) * static_cast<float>(t.width)) % t.width,
               y = static_cast<std::size_t>(wrap(v) * static_cast<float>(t.height)) % t.height;
    const std::uint8_t* p = &t.rgba[4 * (y * t.width + x)];
    const auto lin = [&](std::uint8_t b) {
      const float f = static_cast<float>(b) / 255;
      return t.srgb ? std::pow(f, 2.2F) : f;
    };
    return {lin(p[0]), lin(p[1]), lin(p[2]), static_cast<float>(p[3]) / 255};
  }
  void triangle(const render::Mesh& mesh, const render::Surface& surface, const std::uint32_t* i,
                const std::vector<Eigen::Vector3f>& world, const std::vector<Eigen::Vector3f>& normal,
                const std::vector<Eigen::Vector3f>& view, const Shade& shade, const float* tint) {
    const Eigen::Vector3f &a = view[i[0]], &b = view[i[1]], &c = view[i[2]];
    if (!eye_.parallel && (a.z() < 0.05F || b.z() < 0.05F || c.z() < 0.05F)) return;
    const float ax = sx(a), ay = sy(a), bx = sx(b), by = sy(b), cx = sx(c), cy = sy(c);
    const float area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    if (area == 0) return;
    const int x0 = std::max(0, static_cast<int>(std::floor(std::min({ax, bx, cx})))),
              x1 = std::min(out.width - 1, static_cast<int>(std::ceil(std::max({ax, bx, cx}))));
    const int y0 = std::max(0, static_cast<int>(std::floor(std::min({ay, by, cy})))),
              y1 = std::min(out.height - 1, static_cast<int>(std::ceil(std::max({ay, by, cy}))));
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        const float px = static_cast<float>(x) + 0.5F, py = static_cast<float>(y) + 0.5F;
        float wb = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area,
              wc = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area, wa = 1 - wb - wc;
        if (wa < 0 || wb < 0 || wc < 0) continue;
        if (!eye_.parallel) {
          wa /= a.z(), wb /= b.z(), wc /= c.z();
          const float sum = wa + wb + wc;
          wa /= sum, wb /= sum, wc /= sum;
        }
        const float z = wa * a.z() + wb * b.z() + wc * c.z();
        float& depth = out.depth[static_cast<std::size_t>(y) * out.width + x];
        if (z >= depth) continue;
        const auto &va = mesh.vertices[i[0]], &vb = mesh.vertices[i[1]], &vc = mesh.vertices[i[2]];
        Eigen::Vector4f t(1, 1, 1, 1);
        if (surface.colour_map) {
          const float u = wa * va.uv[0] + wb * vb.uv[0] + wc * vc.uv[0],
                      v = wa * va.uv[1] + wb * vb.uv[1] + wc * vc.uv[1];
          t = texel(*surface.colour_map, u, v);
          if (surface.alpha_cutoff > 0 && t.w() < surface.alpha_cutoff) continue;
        }
        depth = z;
        if (!shade) continue;
        Eigen::Vector3f n = (wa * normal[i[0]] + wb * normal[i[1]] + wc * normal[i[2]]).normalized();
        const Eigen::Vector3f p = wa * world[i[0]] + wb * world[i[1]] + wc * world[i[2]];
        const Eigen::Vector3f colour = shade(surface, t, n, p, tint);
        for (int k = 0; k < 3; ++k)
          out.rgb[3 * (static_cast<std::size_t>(y) * out.width + x) + k] = colour[k];
      }
  }
  Eye eye_;
  Eigen::Matrix3f axes_;
};

/// Sun with shadows, sky from above. Draws at twice the size and averages.
inline Picture lit_picture(const std::vector<Placed>& scene, const Eye& eye, int width, int height,
                           float radius_m, const Eigen::Vector3f& middle) {
  const Eigen::Vector3f sun = Eigen::Vector3f(-0.55F, -0.5F, 0.75F).normalized();
  constexpr int kShadow = 1600;
  Eye from_sun{middle + 3 * radius_m * sun, middle, static_cast<float>(kShadow) / (2 * radius_m), true};
  Raster shadow(kShadow, kShadow, from_sun);
  for (const Placed& p : scene) shadow.draw(p, nullptr);
  Eye twice = eye;
  twice.focal_px *= 2;
  Raster view(2 * width, 2 * height, twice);
  const auto shade = [&](const render::Surface& s, const Eigen::Vector4f& t, const Eigen::Vector3f& n,
                         const Eigen::Vector3f& p, const float* tint) {
    float depth = 0;
    const float first = shadow.depth_at(p + 0.02F * n, &depth);
    const float lit = first + 0.12F < depth ? 0.0F : 1.0F;
    const float cosine = n.dot(sun);
    Eigen::Vector3f c;
    for (int k = 0; k < 3; ++k) {
      const float f = t[k] * tint[k];
      const float direct = lit * (cosine > 0 ? cosine * s.reflectance[k] : -cosine * s.transmittance[k]);
      c[k] = f * (3.2F * direct + (0.55F + 0.45F * n.z()) * 0.65F * (k == 2 ? 1.25F : 1.0F) *
                                      (s.reflectance[k] + 0.4F * s.transmittance[k]));
    }
    return c;
  };
  for (const Placed& p : scene) view.draw(p, shade);
  Picture out;
  out.width = width, out.height = height;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int k = 0; k < 3; ++k) {
        float sum = 0;
        for (int d = 0; d < 4; ++d) {
          const float v =
              view.out.rgb[3 * (static_cast<std::size_t>(2 * y + d / 2) * 2 * width + 2 * x + d % 2) + k];
          sum += v < 0 ? (k == 2 ? 0.85F : k == 1 ? 0.72F : 0.62F) * 0.8F : v * 1.7F;
        }
        out.rgb.push_back(sum / 4);
      }
  return out;
}

}  // namespace rigor::test
