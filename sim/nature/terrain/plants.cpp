#include "sim/nature/terrain/plants.h"

#include <cmath>
#include <map>
#include <mutex>
#include <numbers>

#include "sim/nature/terrain/noise.h"
#include "sim/render/content/surface_library.h"

namespace rigor::nature {
namespace {

using Eigen::Vector3d;
using render::Mesh;
using render::Surface;

using std::numbers::pi;

/// A surface of the library that shows through a card: its reflectance holds on the card's average.
std::shared_ptr<const Surface> card_surface(std::string_view material, Card card,
                                            const std::function<void(Surface&)>& change = {}) {
  auto s = std::make_shared<Surface>(*render::SurfaceLibrary::builtin().get(material));
  s->serial = render::next_serial();
  if (change) change(*s);
  const auto& picture = card_picture(card);
  const float infrared_mean = (picture.mean[0] + picture.mean[1] + picture.mean[2]) / 3;
  for (std::size_t b = 0; b < s->reflectance.size(); ++b) {
    s->reflectance[b] = std::min(1.0F, s->reflectance[b] / (b < 3 ? picture.mean[b] : infrared_mean));
  }
  s->colour_map = picture.texture;
  s->two_sided = true;
  // A card stands for leaves that face all ways: together they do not shine.
  s->roughness = std::max(s->roughness, 0.9F);
  if (card != Card::blade) s->alpha_cutoff = 0.5F;
  return s;
}

struct Surfaces {
  std::shared_ptr<const Surface> blade, tuft, frond, fern_side, leaves, wood, leaf, head;
};
const Surfaces& surfaces() {
  static const Surfaces all = {
      card_surface("grass", Card::blade),
      card_surface("grass", Card::tuft),
      card_surface("fern", Card::frond),
      card_surface("fern", Card::fern_side),
      card_surface("broad_leaves", Card::leaves),
      render::SurfaceLibrary::builtin().get("bark"),
      card_surface("leaf_litter", Card::leaf),
      card_surface("broad_leaves", Card::head,
                   [](Surface& s) {  // white petals: scattering without pigment
                     s.name = "petals";
                     s.reflectance = {0.62F, 0.60F, 0.56F, 0.66F, 0.66F, 0.38F};
                     s.transmittance = {0.2F, 0.2F, 0.18F, 0.25F, 0.25F, 0.2F};
                   }),
  };
  return all;
}

double draw(int variant, int stream, int i) {
  return unit_from_word(place_words(0x67726F77ULL, static_cast<std::uint32_t>(stream), i, variant)[0]);
}

/// Triangles of one surface after another.
class Shaper {
 public:
  void use(std::shared_ptr<const Surface> surface) {
    close();
    mesh_->parts.push_back({static_cast<std::uint32_t>(mesh_->indices.size()), 0, std::move(surface)});
  }
  std::uint32_t add(const Vector3d& p, const Vector3d& n, double u, double v, double sway) {
    render::Vertex out{};
    for (int k = 0; k < 3; ++k) {
      out.position[k] = static_cast<float>(p[k]);
      out.normal[k] = static_cast<float>(n[k]);
    }
    out.uv[0] = static_cast<float>(u);
    out.uv[1] = static_cast<float>(1 - v);  // v from the bottom of a picture
    out.sway = static_cast<float>(sway);
    mesh_->vertices.push_back(out);
    mesh_->bounds.extend(Eigen::Vector3f(out.position[0], out.position[1], out.position[2]));
    return static_cast<std::uint32_t>(mesh_->vertices.size() - 1);
  }
  void triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    mesh_->indices.insert(mesh_->indices.end(), {a, b, c});
  }

  /// A strip that rises from its foot and bends outwards: `reach` across the ground for a rise of `height`;
  /// `droop` of the height is lost again at the tip. Pointed: the last segment is one triangle.
  struct Strip {
    Vector3d foot = Vector3d::Zero();
    double heading = 0, height = 1, reach = 0.3, droop = 0, width = 0.1;
    int segments = 2;
    bool pointed = true;
  };
  void strip(const Strip& s) {
    const Vector3d out(std::cos(s.heading), std::sin(s.heading), 0), across(-out.y(), out.x(), 0);
    const auto at = [&](double t) -> Vector3d {
      return s.foot + out * (s.reach * (0.35 * t + 0.65 * t * t)) +
             Vector3d(0, 0, s.height * (t * (1 + s.droop) - s.droop * t * t * t * 1.6));
    };
    std::uint32_t left = 0, right = 0;
    for (int k = 0; k <= s.segments; ++k) {
      const double t = static_cast<double>(k) / s.segments;
      const Vector3d p = at(t),
                     along = (at(std::min(1.0, t + 0.01)) - at(std::max(0.0, t - 0.01))).normalized();
      // Between the blade's own normal and the sky's: a blade is not flat, and its neighbours scatter too.
      const Vector3d normal = (along.cross(across).normalized() * -0.6 + Vector3d(0, 0, 0.7)).normalized();
      const double half = s.width / 2 * (s.pointed ? 1 - 0.55 * t : 1);
      if (k == s.segments && s.pointed) {
        const auto tip = add(p, normal, 0.5, 1, 1);
        triangle(left, right, tip);
        break;
      }
      const auto l = add(p - across * half, normal, 0, t, t * t),
                 r = add(p + across * half, normal, 1, t, t * t);
      if (k > 0) {
        triangle(left, right, r);
        triangle(left, r, l);
      }
      left = l;
      right = r;
    }
  }

  /// A rectangle: `right` and `up` are its full sides, `foot` the middle of its lower one.
  void card(const Vector3d& foot, const Vector3d& right, const Vector3d& up, const Vector3d& normal,
            double sway_low, double sway_high) {
    const Vector3d h = right / 2;
    const auto a = add(foot - h, normal, 0, 0, sway_low), b = add(foot + h, normal, 1, 0, sway_low),
               c = add(foot + h + up, normal, 1, 1, sway_high),
               d = add(foot - h + up, normal, 0, 1, sway_high);
    triangle(a, b, c);
    triangle(a, c, d);
  }

  /// Stretched upwards so that its highest point is at `height`; 0: as it is.
  std::shared_ptr<const Mesh> take(double height = 0) {
    close();
    if (height > 0) {
      const auto stretch = static_cast<float>(height) / mesh_->bounds.max().z();
      for (auto& v : mesh_->vertices) v.position[2] *= stretch;
      mesh_->bounds.min().z() *= stretch;
      mesh_->bounds.max().z() *= stretch;
    }
    return std::move(mesh_);
  }

 private:
  void close() {
    if (mesh_->parts.empty()) return;
    auto& last = mesh_->parts.back();
    last.index_count = static_cast<std::uint32_t>(mesh_->indices.size()) - last.first_index;
  }
  std::shared_ptr<Mesh> mesh_ = std::make_shared<Mesh>();
};

Vector3d up(double z) { return {0, 0, z}; }

std::shared_ptr<const Mesh> crossed_cards(const std::shared_ptr<const Surface>& surface, double width,
                                          double height, int cards) {
  Shaper s;
  s.use(surface);
  for (int k = 0; k < cards; ++k) {
    const double a = pi * k / cards;
    s.card(Vector3d::Zero(), Vector3d(std::cos(a), std::sin(a), 0) * width, up(height), Vector3d(0, 0, 1), 0,
           1);
  }
  return s.take();
}

std::shared_ptr<const Mesh> grass(double h, int variant, int blades, double width) {
  Shaper s;
  s.use(surfaces().blade);
  for (int i = 0; i < blades; ++i) {
    const double a = 2 * pi * (i + 0.7 * draw(variant, 1, i)) / blades,
                 r = 0.22 * h * std::sqrt(draw(variant, 2, i));
    const double tall = i == 0 ? 1 : 0.5 + 0.48 * draw(variant, 3, i);
    s.strip({.foot = {r * std::cos(a), r * std::sin(a), 0},
             .heading = a + 1.2 * (draw(variant, 4, i) - 0.5),
             .height = h * tall,
             .reach = h * tall * (0.15 + 0.5 * draw(variant, 5, i)),
             .droop = 0.25 * draw(variant, 6, i),
             .width = width,
             .segments = 2});
  }
  return s.take(h);
}

std::shared_ptr<const Mesh> fern(double h, int variant, int fronds, int segments, double width) {
  Shaper s;
  s.use(surfaces().frond);
  for (int i = 0; i < fronds; ++i) {
    const double a = 2 * pi * (i + 0.6 * draw(variant, 11, i)) / fronds,
                 tall = 0.72 + 0.28 * draw(variant, 12, i);
    s.strip({.foot = {0.03 * h * std::cos(a), 0.03 * h * std::sin(a), 0},
             .heading = a,
             .height = h * tall,
             .reach = h * (0.75 + 0.45 * draw(variant, 13, i)),
             .droop = 0.55 + 0.2 * draw(variant, 14, i),
             .width = width,
             .segments = segments,
             .pointed = false});
  }
  return s.take(h);
}

std::shared_ptr<const Mesh> shrub(double h, int variant, int cards, double size, bool stems) {
  Shaper s;
  if (stems) {
    s.use(surfaces().wood);
    for (int i = 0; i < 7; ++i) {
      const double a = 2 * pi * (i + draw(variant, 21, i)) / 7, lean = 0.15 + 0.3 * draw(variant, 22, i);
      const Vector3d top(h * lean * std::cos(a), h * lean * std::sin(a),
                         h * (0.6 + 0.25 * draw(variant, 23, i)));
      std::uint32_t ring[3];
      for (int k = 0; k < 3; ++k) {
        const double b = 2 * pi * k / 3;
        const Vector3d n(std::cos(b), std::sin(b), 0);
        ring[k] = s.add(n * (0.012 * h), n, k / 3.0, 0, 0);
      }
      const auto tip = s.add(top, top.normalized(), 0.5, 1, 0.5);
      for (int k = 0; k < 3; ++k) s.triangle(ring[k], ring[(k + 1) % 3], tip);
    }
  }
  s.use(surfaces().leaves);
  const Vector3d middle = up(0.55 * h);
  for (int i = 0; i < cards; ++i) {
    const double z = -0.75 + 1.65 * (i + 0.5) / cards, a = i * 2.39996 + draw(variant, 24, i);
    const double r = std::sqrt(std::max(0.0, 1 - z * z)), depth = 0.55 + 0.4 * draw(variant, 25, i);
    const Vector3d outward(r * std::cos(a), r * std::sin(a), z);
    const Vector3d foot =
        middle + Vector3d(outward.x() * 0.46, outward.y() * 0.46, outward.z() * 0.42) * (h * depth) * 0.8;
    Vector3d along =
        (outward + up(0.5) + Vector3d(std::sin(i * 3.1), std::cos(i * 1.7), 0) * 0.35).normalized();
    const Vector3d right = along.cross(Vector3d(std::cos(i * 2.1), std::sin(i * 2.1), 0.6)).normalized();
    // Nothing of the shrub rises above its height.
    const double length = std::min(size, along.z() > 0 ? (h - foot.z()) / along.z() : size);
    s.card(foot, right * size, along * std::max(0.3 * size, length), (outward + up(0.4)).normalized(), 0.5,
           1);
  }
  return s.take(h);
}

std::shared_ptr<const Mesh> flower(double h, int variant, int leaves_count, bool stem) {
  Shaper s;
  const double diameter = 0.16 * h, lean = 0.1 * h;
  if (stem) {
    s.use(surfaces().blade);
    s.strip({.heading = 0,
             .height = 0.97 * h,
             .reach = lean,
             .width = 0.025 * h,
             .segments = 1,
             .pointed = false});
    for (int i = 0; i < leaves_count; ++i) {
      s.strip({.heading = 2 * pi * (i + draw(variant, 31, i)) / leaves_count,
               .height = h * (0.2 + 0.25 * draw(variant, 32, i)),
               .reach = 0.22 * h,
               .droop = 0.3,
               .width = 0.05 * h,
               .segments = 2});
    }
  }
  s.use(surfaces().head);
  const Vector3d tilt = Vector3d(0.35, 0.1 * variant, 1).normalized();
  const Vector3d right = Vector3d(0, 1, 0).cross(tilt).normalized() * diameter, upward = tilt.cross(right);
  s.card(Vector3d(lean, 0, 0.97 * h) - upward / 2, right, upward, tilt, 1, 1);
  return s.take(h);
}

std::shared_ptr<const Mesh> litter(double length, int variant, int count, double size) {
  Shaper s;
  s.use(surfaces().leaf);
  for (int i = 0; i < count; ++i) {
    const double a = 2 * pi * draw(variant, 41, i),
                 r = count == 1 ? 0 : 2.2 * length * std::sqrt(draw(variant, 42, i));
    const double b = 2 * pi * draw(variant, 43, i);
    const Vector3d along = Vector3d(std::cos(b), std::sin(b), 0.35 * (draw(variant, 44, i) - 0.35));
    const Vector3d right = Vector3d(-std::sin(b), std::cos(b), 0.3 * (draw(variant, 45, i) - 0.5));
    const Vector3d normal = along.cross(right).normalized() * (along.cross(right).z() < 0 ? -1 : 1);
    const double lift = length * (0.12 + 0.1 * draw(variant, 46, i));
    s.card(Vector3d(r * std::cos(a), r * std::sin(a), lift), right * (-0.55 * size), along * size, normal, 0,
           0);
  }
  return s.take();
}

}  // namespace

bool plant_from_word(std::string_view word, Plant& plant) {
  constexpr std::string_view kWords[] = {"grass", "fern", "shrub", "flower", "litter"};
  for (std::size_t i = 0; i < std::size(kWords); ++i) {
    if (kWords[i] == word) {
      plant = static_cast<Plant>(i);
      return true;
    }
  }
  return false;
}

std::shared_ptr<const render::Prototype> plant_prototype(Plant plant, double h, int variant) {
  auto p = std::make_shared<render::Prototype>();
  const auto level = [&](std::shared_ptr<const Mesh> mesh, double error) {
    p->levels.push_back({std::move(mesh), static_cast<float>(error * h)});
  };
  // Wider blades and cards where there are fewer: the area that is seen stays. Errors: how far a silhouette
  // moves.
  switch (plant) {
    case Plant::grass:
      p->name = "grass";
      level(grass(h, variant, 12, 0.045 * h), 0);
      level(grass(h, variant, 5, 0.10 * h), 0.12);
      level(crossed_cards(surfaces().tuft, 1.1 * h, h, 2), 0.35);
      p->casts_shadow = false;
      p->sway_m = static_cast<float>(0.25 * h);
      break;
    case Plant::fern:
      p->name = "fern";
      level(fern(h, variant, 11, 5, 0.36 * h), 0);
      level(fern(h, variant, 7, 2, 0.48 * h), 0.10);
      level(crossed_cards(surfaces().fern_side, 2 * h, h, 2), 0.3);
      p->sway_m = static_cast<float>(0.12 * h);
      break;
    case Plant::shrub:
      p->name = "shrub";
      level(shrub(h, variant, 56, 0.34 * h, true), 0);
      level(shrub(h, variant, 22, 0.52 * h, false), 0.10);
      level(crossed_cards(surfaces().leaves, 0.95 * h, h, 3), 0.3);
      p->sway_m = static_cast<float>(0.05 * h);
      break;
    case Plant::flower:
      p->name = "flower";
      level(flower(h, variant, 4, true), 0);
      level(flower(h, variant, 1, true), 0.15);
      level(flower(h, variant, 0, false), 0.4);
      p->casts_shadow = false;
      p->sway_m = static_cast<float>(0.25 * h);
      break;
    case Plant::litter:
      p->name = "litter";
      level(litter(h, variant, 6, h), 0);
      level(litter(h, variant, 2, 1.7 * h), 1.0);
      level(litter(h, variant, 1, 2.4 * h), 2.0);
      p->casts_shadow = false;
      break;
  }
  return p;
}

}  // namespace rigor::nature
