#include "sim/nature/trees/tree_mesh.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <set>
#include <thread>

#include "sim/nature/trees/canvas.h"
#include "sim/nature/trees/crown_levels.h"
#include "sim/render/content/surface_library.h"
#include "sim/render/content/texels.h"
#include "tests/sim/nature/trees/raster.h"

namespace rigor::nature {
namespace {

using render::Mesh;

std::vector<CrownKey> some_crowns() {
  std::vector<CrownKey> out;
  for (int form = 0; form < kTreeFormCount; ++form)
    for (int age = 0; age < kAgeClasses; age += 2)
      out.push_back({static_cast<TreeForm>(form), BarkStyle::scaly, age, 0});
  return out;
}
std::vector<TrunkKey> all_trunks() {
  std::vector<TrunkKey> out;
  for (int kind = 0; kind < 3; ++kind)
    for (int bark = 0; bark < kBarkStyleCount; ++bark)
      for (int age = 0; age < kAgeClasses; ++age)
        out.push_back(
            {static_cast<TrunkKind>(kind), static_cast<BarkStyle>(bark), age, age % kTrunkVariants});
  return out;
}
Vec3 at(const Mesh& m, std::uint32_t i) {
  return {m.vertices[i].position[0], m.vertices[i].position[1], m.vertices[i].position[2]};
}

void expect_sound(const Mesh& m, const std::string& name) {
  ASSERT_FALSE(m.indices.empty()) << name;
  std::size_t covered = 0, degenerate = 0;
  for (const auto& v : m.vertices) {
    const Vec3 n(v.normal[0], v.normal[1], v.normal[2]);
    ASSERT_NEAR(n.norm(), 1, 1e-3) << name;
    ASSERT_TRUE(std::isfinite(v.position[0]) && std::isfinite(v.position[1]) && std::isfinite(v.position[2]))
        << name;
    ASSERT_TRUE(std::isfinite(v.uv[0]) && std::isfinite(v.uv[1])) << name;
    ASSERT_TRUE(v.sway >= 0 && v.sway <= 1) << name << " " << v.sway;
    ASSERT_TRUE(m.bounds.contains(Vec3(v.position[0], v.position[1], v.position[2]))) << name;
  }
  for (const auto& part : m.parts) {
    ASSERT_TRUE(part.surface) << name;
    ASSERT_EQ(part.first_index, covered) << name;
    covered += part.index_count;
  }
  EXPECT_EQ(covered, m.indices.size()) << name;
  for (std::size_t k = 0; k < m.indices.size(); k += 3) {
    const Vec3 a = at(m, m.indices[k]), b = at(m, m.indices[k + 1]), c = at(m, m.indices[k + 2]);
    degenerate += (b - a).cross(c - a).norm() < 1e-9F;
  }
  EXPECT_LE(degenerate * 100, m.indices.size() / 3) << name;
}

TEST(TreeMesh, CrownsAreSoundAtEveryLevel) {
  for (const CrownKey& key : some_crowns()) {
    const CrownPrototype& crown = crown_prototype(key);
    EXPECT_TRUE(crown.prototype->impostor);
    ASSERT_EQ(crown.prototype->levels.size(), 5u);
    std::size_t last = 1u << 30;
    float error = -1;
    for (const auto& level : crown.prototype->levels) {
      expect_sound(*level.mesh, crown.prototype->name);
      EXPECT_LT(level.mesh->indices.size(), last) << crown.prototype->name;
      EXPECT_GT(level.error_m, error) << crown.prototype->name;
      last = level.mesh->indices.size(), error = level.error_m;
    }
    EXPECT_EQ(crown.prototype->levels.front().error_m, 0);
    constexpr std::size_t kMost[] = {13500, 6500, 2900, 800, 160};
    for (std::size_t k = 0; k < 5; ++k)
      EXPECT_LE(crown.prototype->levels[k].mesh->indices.size() / 3, kMost[k])
          << crown.prototype->name << " " << k;
  }
}

TEST(TreeMesh, TrunksAreClosedAndSound) {
  for (const TrunkKey& key : all_trunks()) {
    const TrunkPrototype& trunk = trunk_prototype(key);
    std::size_t last = 1u << 30;
    for (const auto& level : trunk.prototype->levels) {
      expect_sound(*level.mesh, trunk.prototype->name);
      EXPECT_LT(level.mesh->indices.size(), last) << trunk.prototype->name;
      last = level.mesh->indices.size();
      if (key.kind == TrunkKind::snag) continue;  // its stubs are open inside the trunk
      // Vertices at one place are one corner; every edge then has a triangle on either side.
      std::map<std::array<float, 3>, int> corner;
      const auto id = [&](std::uint32_t i) {
        const auto& v = level.mesh->vertices[i];
        return corner
            .emplace(std::array<float, 3>{v.position[0], v.position[1], v.position[2]},
                     static_cast<int>(corner.size()))
            .first->second;
      };
      std::map<std::pair<int, int>, int> edges;
      double volume = 0;
      for (std::size_t k = 0; k < level.mesh->indices.size(); k += 3) {
        const std::uint32_t* i = &level.mesh->indices[k];
        for (int e = 0; e < 3; ++e) ++edges[{id(i[e]), id(i[(e + 1) % 3])}];
        volume += static_cast<double>(
                      at(*level.mesh, i[0]).dot(at(*level.mesh, i[1]).cross(at(*level.mesh, i[2])))) /
                  6;
      }
      for (const auto& [edge, count] : edges) {
        ASSERT_EQ(count, 1) << trunk.prototype->name;
        ASSERT_EQ(edges.count({edge.second, edge.first}), 1u) << trunk.prototype->name;
      }
      EXPECT_GT(volume, 0) << "inside out: " << trunk.prototype->name;
    }
  }
}

// What is deep in the crown or low wears the darker surface at every fine level, and what is outside does
// not.
TEST(TreeMesh, InsideOfCrownsIsDarker) {
  for (const CrownKey& key : some_crowns()) {
    if (key.age_class == 0) continue;
    const CrownPrototype& crown = crown_prototype(key);
    const FoliageSurface& foliage = foliage_surface(key.form);
    const Mesh& m = *crown.prototype->levels.front().mesh;
    double reach[2] = {};
    std::size_t count[2] = {};
    for (const auto& part : m.parts) {
      if (part.surface != foliage.surface && part.surface != foliage.inner) continue;
      const int outer = part.surface == foliage.surface;
      for (std::uint32_t k = part.first_index; k < part.first_index + part.index_count; ++k) {
        const auto& p = m.vertices[m.indices[k]].position;
        reach[outer] += std::hypot(p[0], p[1]), ++count[outer];
      }
    }
    ASSERT_GT(count[0] * count[1], 0u) << crown.prototype->name;
    EXPECT_LT(reach[0] / static_cast<double>(count[0]), reach[1] / static_cast<double>(count[1]) * 1.05)
        << crown.prototype->name;
    const double share = static_cast<double>(count[0]) / static_cast<double>(count[0] + count[1]);
    EXPECT_TRUE(share > 0.15 && share < 0.8) << crown.prototype->name << " " << share;
  }
}

TEST(TreeMesh, FoliageFacesOutOfTheCrown) {
  for (const CrownKey& key : some_crowns()) {
    const CrownPrototype& crown = crown_prototype(key);
    const Mesh& m = *crown.prototype->levels.front().mesh;
    std::size_t outer = 0, outward = 0;
    const auto& leaves = m.parts.back();
    for (std::uint32_t k = leaves.first_index; k < leaves.first_index + leaves.index_count; ++k) {
      const auto& v = m.vertices[m.indices[k]];
      const float r = std::hypot(v.position[0], v.position[1]);
      if (r < 0.5F * crown.radius_m) continue;
      ++outer;
      outward +=
          v.position[0] * v.normal[0] + v.position[1] * v.normal[1] + std::max(0.0F, v.normal[2]) * r > 0;
    }
    EXPECT_GT(static_cast<double>(outward), 0.95 * static_cast<double>(outer)) << crown.prototype->name;
  }
}

TEST(TreeMesh, SwayGrowsOutwards) {
  for (const CrownKey& key : some_crowns()) {
    const CrownPrototype& crown = crown_prototype(key);
    double in = 0, out = 0;
    std::size_t n_in = 0, n_out = 0;
    for (const auto& v : crown.prototype->levels.front().mesh->vertices) {
      const float r = std::hypot(v.position[0], v.position[1]) / crown.radius_m;
      if (r < 0.3F) in += static_cast<double>(v.sway), ++n_in;
      if (r > 0.7F) out += static_cast<double>(v.sway), ++n_out;
    }
    ASSERT_GT(n_in * n_out, 0u);
    EXPECT_GT(out / static_cast<double>(n_out), 1.3 * in / static_cast<double>(n_in))
        << crown.prototype->name;
  }
}

// The silhouette is what a level is for. Seen from three sides, drawn so that a crown is 300 pixels high.
TEST(TreeMesh, LevelsKeepTheSilhouette) {
  for (const CrownKey& key : some_crowns()) {
    const CrownPrototype& crown = crown_prototype(key);
    std::vector<double> covered;
    for (const auto& level : crown.prototype->levels) {
      double sum = 0;
      for (int side = 0; side < 3; ++side) {
        const float a = 2.1F * static_cast<float>(side);
        const Vec3 middle(0, 0, 0.5F * crown.length_m);
        test::Raster raster(
            420, 420, {middle + 50 * Vec3(std::cos(a), std::sin(a), 0), middle, 300 / crown.length_m, true});
        raster.draw({level.mesh.get(), {}}, nullptr);
        sum += static_cast<double>(raster.covered());
      }
      covered.push_back(sum);
    }
    constexpr double kAllowed[] = {0, 0.25, 0.30, 0.40, 0.50};
    for (std::size_t i = 1; i < covered.size(); ++i)
      EXPECT_NEAR(covered[i] / covered[0], 1, kAllowed[i]) << crown.prototype->name << " level " << i;
  }
}

TEST(TreeMesh, SameKeySameBytesOnAnyThread) {
  const auto bytes = [](const CrownMeshes& c) {
    std::vector<float> out;
    for (const auto& m : c.levels)
      for (const auto& v : m->vertices)
        out.insert(out.end(), {v.position[0], v.position[1], v.position[2], v.normal[0], v.uv[0], v.sway});
    return out;
  };
  for (const CrownKey& key : {CrownKey{TreeForm::hemlock, BarkStyle::scaly, 2, 1},
                              CrownKey{TreeForm::beech, BarkStyle::smooth, 2, 1}}) {
    const auto make = is_conifer(key.form) ? make_conifer_crown : make_broadleaf_crown;
    const auto here = bytes(make(key));
    std::vector<float> there;
    std::thread([&] { there = bytes(make(key)); }).join();
    EXPECT_EQ(here, there);
    CrownKey other = key;
    other.variant = 2;
    EXPECT_NE(here, bytes(make(other)));
  }
  EXPECT_EQ(&crown_prototype({TreeForm::fir, BarkStyle::scaly, 1, 0}),
            &crown_prototype({TreeForm::fir, BarkStyle::scaly, 1, 0}));
}

TEST(TreeMesh, CrownsAreAsLongAndWideAsTheySay) {
  for (const CrownKey& key : some_crowns()) {
    const CrownPrototype& crown = crown_prototype(key);
    const auto& box = crown.prototype->levels.front().mesh->bounds;
    EXPECT_NEAR(box.max().z() / crown.length_m, 1, 0.1) << crown.prototype->name;
    EXPECT_GT(box.min().z(), -0.3F * crown.length_m) << crown.prototype->name;
    EXPECT_NEAR(crown.radius_m / class_size(key.form, key.age_class).radius_m, 1.1, 0.35)
        << crown.prototype->name;
  }
}

// A surface's mean over its covered texels is the library's reflectance, so that radiometry does not depend
// on the drawing.
TEST(TreeMesh, FoliageReflectsAsTheLibrarySays) {
  for (int form = 0; form < kTreeFormCount; ++form) {
    const auto& s = *foliage_surface(static_cast<TreeForm>(form)).surface;
    const auto library = render::SurfaceLibrary::builtin().get(
        is_conifer(static_cast<TreeForm>(form)) ? "needles" : "broad_leaves");
    ASSERT_NE(library->name, "unknown");
    double sum[3] = {}, weight = 0;
    for (std::size_t i = 0; i < s.colour_map->rgba.size(); i += 4) {
      const double a = s.colour_map->rgba[i + 3];
      if (a < 255 * static_cast<double>(s.alpha_cutoff)) continue;  // not drawn
      for (int k = 0; k < 3; ++k)
        sum[k] += static_cast<double>(render::linear_of_bytes(true)[s.colour_map->rgba[i + k]]);
      weight += 1;
    }
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(s.reflectance[k] * sum[k] / weight / static_cast<double>(library->reflectance[k]), 1, 0.05)
          << form;
    for (int b = 3; b < render::kBandCount; ++b) EXPECT_EQ(s.reflectance[b], library->reflectance[b]);
    for (int b = 0; b < render::kBandCount; ++b) EXPECT_LE(s.reflectance[b] + s.transmittance[b], 1.0F);
    EXPECT_TRUE(s.two_sided);
    // Inside a crown the same leaves, under less visible light; the near infrared gets through.
    const auto& inner = *foliage_surface(static_cast<TreeForm>(form)).inner;
    EXPECT_EQ(inner.colour_map, s.colour_map);
    for (int b = 0; b < render::kBandCount; ++b)
      EXPECT_FLOAT_EQ(inner.reflectance[b], s.reflectance[b] * (b < 3 ? kInnerLight : 1.0F));
    EXPECT_GT(s.alpha_cutoff, 0);
  }
}

TEST(TreeMesh, BarkReflectsAsTheLibrarySays) {
  for (int style = 0; style < kBarkStyleCount; ++style) {
    const auto s = bark_surface(static_cast<BarkStyle>(style));
    double sum = 0;
    for (std::size_t i = 0; i < s->colour_map->rgba.size(); i += 4)
      sum += static_cast<double>(render::linear_of_bytes(true)[s->colour_map->rgba[i]]);
    const double mean = sum / (static_cast<double>(s->colour_map->rgba.size()) / 4);
    const double red =
        style == static_cast<int>(BarkStyle::birch)
            ? 0.46
            : static_cast<double>(render::SurfaceLibrary::builtin().get("bark")->reflectance[0]);
    EXPECT_NEAR(s->reflectance[0] * mean / red, 1, 0.03) << style;
    EXPECT_TRUE(s->normal_map);
  }
}

TEST(TreeMesh, SnagsHaveNoLeaves) {
  const TrunkPrototype& snag = trunk_prototype({TrunkKind::snag, BarkStyle::scaly, 3, 0});
  for (const auto& level : snag.prototype->levels)
    for (const auto& part : level.mesh->parts) EXPECT_EQ(part.surface->name, "bark");
}

}  // namespace
}  // namespace rigor::nature
