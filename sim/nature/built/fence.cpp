#include "sim/nature/built/fence.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/nature/built/built_surfaces.h"
#include "sim/render/models/mesh_builder.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using render::Batch;
using render::Instance;
using render::MeshBuilder;
using render::Prototype;

constexpr double kBuried_m = 0.3;  // of posts and poles
constexpr double kPost_m = 0.1, kWire_m = 0.003, kWireAt[] = {0.25, 0.5, 0.75, 0.96};
constexpr double kRailHeight_m = 0.1, kRailDepth_m = 0.04, kRailAt[] = {0.25, 0.6, 0.93};
constexpr double kBoardAt[] = {0.2, 0.85}, kBoard_m = 0.14, kGap_m = 0.02, kBoardDepth_m = 0.02;
constexpr std::size_t kMostInstances = 2'000'000;

using PrototypePtr = std::shared_ptr<const Prototype>;

PrototypePtr prototype(const char* name, const MeshBuilder& mesh) {
  auto p = std::make_shared<Prototype>();
  p->name = name;
  p->levels.push_back({mesh.finish(), 0.0F});
  return p;
}

// Parts of size 1, which instances stretch: a box about its middle along x; a rod from z = 0 to 1.
struct Parts {
  PrototypePtr box, post, wire, pole;
};
Parts make_parts(const std::shared_ptr<const render::Surface>& all) {
  const auto wood = all ? all : cover(Finish::wood).surface, metal = all ? all : cover(Finish::wire).surface;
  MeshBuilder box, post, wire, pole;
  box.box(wood, Vector3d::Constant(-0.5), Vector3d::Constant(0.5));
  post.cylinder(wood, {.segments = 12});
  wire.cylinder(metal, {.segments = 6});
  pole.cylinder(wood, {.radius0_m = 0.5, .radius1_m = 0.36, .segments = 24});
  return {prototype("fence_board", box), prototype("fence_post", post), prototype("fence_wire", wire),
          prototype("pole", pole)};
}
const Parts& shared_parts() {
  static const Parts parts = make_parts(nullptr);
  return parts;
}

class Fence {
 public:
  Fence(const FenceSpec& spec, const Parts& parts) : spec_(spec), parts_(parts) {}

  std::vector<std::shared_ptr<const Batch>> make() {
    set_posts();
    for (std::size_t i = 0; i + 1 < posts_.size(); ++i) span(posts_[i], posts_[i + 1]);
    std::vector<std::shared_ptr<const Batch>> out;
    const auto put = [&](const PrototypePtr& p, std::vector<Instance> instances) {
      if (instances.empty()) return;
      auto b = std::make_shared<Batch>();
      b->prototype = p;
      b->origin = spec_.origin;
      b->node = spec_.node;
      b->instances = std::move(instances);
      b->bounds = render::bounds_of(*b);
      out.push_back(std::move(b));
    };
    put(spec_.style == FenceStyle::wire ? parts_.post : parts_.box, std::move(upright_));
    put(parts_.wire, std::move(wires_));
    put(parts_.box, std::move(boards_));
    return out;
  }

 private:
  [[nodiscard]] double ground_at(const Vector2d& p) {
    const double z = spec_.ground ? spec_.ground(p) : std::numeric_limits<double>::quiet_NaN();
    if (std::isfinite(z)) last_ = z;
    return last_;
  }
  static Instance part(const Vector3d& at, const Eigen::Quaterniond& q, const Vector3d& scale) {
    Instance i;
    const double xyzw[] = {q.x(), q.y(), q.z(), q.w()};
    for (int k = 0; k < 3; ++k) {
      i.position[k] = static_cast<float>(at[k]);
      i.scale[k] = static_cast<float>(scale[k]);
    }
    for (int k = 0; k < 4; ++k) i.rotation[k] = static_cast<float>(xyzw[k]);
    return i;
  }

  void set_posts() {
    for (std::size_t k = 0; k + 1 < spec_.line.size(); ++k) {
      const Vector2d a = spec_.line[k], d = spec_.line[k + 1] - a;
      const int n = std::max(1, static_cast<int>(std::ceil(d.norm() / spec_.post_spacing_m - 1e-6)));
      const Eigen::Quaterniond q(Eigen::AngleAxisd(std::atan2(d.y(), d.x()), Vector3d::UnitZ()));
      for (int i = k == 0 ? 0 : 1; i <= n; ++i) {
        const Vector2d p = a + d * i / n;
        const Vector3d foot(p.x(), p.y(), ground_at(p));
        posts_.push_back(foot);
        const double tall = spec_.height_m + kBuried_m;
        if (spec_.style == FenceStyle::wire)
          upright_.push_back(part(foot - Vector3d(0, 0, kBuried_m), q, {kPost_m, kPost_m, tall}));
        else
          upright_.push_back(
              part(foot + Vector3d(0, 0, spec_.height_m - tall / 2), q, {kPost_m, kPost_m, tall}));
        if (upright_.size() + boards_.size() > kMostInstances) return;
      }
    }
  }

  void span(const Vector3d& a, const Vector3d& b) {
    const Vector3d d = b - a;
    const double length = d.norm(), level = d.head<2>().norm(), heading = std::atan2(d.y(), d.x());
    const Eigen::Quaterniond turned(Eigen::AngleAxisd(heading, Vector3d::UnitZ()));
    const Eigen::Quaterniond along =
        turned * Eigen::Quaterniond(Eigen::AngleAxisd(-std::atan2(d.z(), level), Vector3d::UnitY()));
    if (spec_.style == FenceStyle::wire) {
      const Eigen::Quaterniond lying =
          along * Eigen::Quaterniond(Eigen::AngleAxisd(M_PI / 2, Vector3d::UnitY()));
      for (const double f : kWireAt)
        wires_.push_back(part(a + Vector3d(0, 0, f * spec_.height_m), lying, {kWire_m, kWire_m, length}));
      return;
    }
    const auto rail = [&](double f) {
      const Vector3d aside = turned * Vector3d(0, (kPost_m + kRailDepth_m) / 2, 0);
      boards_.push_back(part((a + b) / 2 + Vector3d(0, 0, f * spec_.height_m) + aside, along,
                             {length, kRailDepth_m, kRailHeight_m}));
    };
    if (spec_.style == FenceStyle::rails) {
      for (const double f : kRailAt) rail(f);
      return;
    }
    for (const double f : kBoardAt) rail(f);
    const int n = std::max(1, static_cast<int>(std::floor(level / (kBoard_m + kGap_m))));
    const Vector3d aside = turned * Vector3d(0, kPost_m / 2 + kRailDepth_m + kBoardDepth_m / 2, 0);
    constexpr double kClear_m = 0.05;
    const double tall = std::max(spec_.height_m - kClear_m, 0.02);
    for (int i = 0; i < n; ++i) {
      const Vector2d p = (a + (b - a) * (i + 0.5) / n).head<2>();
      const double z = ground_at(p) + spec_.height_m - tall / 2;
      boards_.push_back(
          part(Vector3d(p.x(), p.y(), z) + aside, turned, {level / n - kGap_m, kBoardDepth_m, tall}));
    }
  }

  const FenceSpec& spec_;
  const Parts& parts_;
  std::vector<Vector3d> posts_;  // feet
  std::vector<Instance> upright_, wires_, boards_;
  double last_ = 0;
};

}  // namespace

std::vector<std::shared_ptr<const Batch>> make_fence(const FenceSpec& spec) {
  if (!spec.surface) return Fence(spec, shared_parts()).make();
  const Parts own = make_parts(spec.surface);
  return Fence(spec, own).make();
}

std::shared_ptr<const Batch> make_pole(const PoleSpec& spec) {
  auto b = std::make_shared<Batch>();
  b->prototype = spec.surface ? make_parts(spec.surface).pole : shared_parts().pole;
  b->origin = spec.foot;
  b->node = spec.node;
  Instance i;
  i.position[2] = static_cast<float>(-kBuried_m);
  i.scale[0] = i.scale[1] = static_cast<float>(spec.diameter_m);
  i.scale[2] = static_cast<float>(spec.height_m + kBuried_m);
  b->instances.push_back(i);
  b->bounds = render::bounds_of(*b);
  return b;
}

}  // namespace rigor::nature::built
