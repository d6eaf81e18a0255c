#include "sim/nature/built/facade.h"

#include <algorithm>
#include <array>

namespace rigor::nature::built {
namespace {

using Eigen::Vector3d;
constexpr double kFrame_m = 0.07, kMullion_m = 0.05;

class Wall {
 public:
  Wall(render::MeshBuilder& mesh, const WallSpec& spec) : mesh_(mesh), spec_(spec) {
    const Eigen::Vector2d d = spec.to - spec.from;
    length_m_ = d.norm();
    along_ = Vector3d(d.x(), d.y(), 0) / length_m_;
    out_ = Vector3d(along_.y(), -along_.x(), 0);
  }

  void add() {
    if (spec_.openings.empty()) {
      rectangle(spec_.cover, 0, spec_.z0_m, length_m_, spec_.z1_m, 0);
      return;
    }
    collect_breaks();
    frame();
    for (std::size_t i = 0; i + 1 < xs_.size(); ++i)
      for (std::size_t j = 0; j + 1 < zs_.size(); ++j)
        if (opening_at(i, j) < 0) rectangle(spec_.cover, xs_[i], zs_[j], xs_[i + 1], zs_[j + 1], 0);
    for (std::size_t k = 0; k < spec_.openings.size(); ++k) open(k);
  }

 private:
  // x along the wall, z up, `depth` behind its face. The wall's ends keep the corners' own coordinates.
  [[nodiscard]] Vector3d at(double x, double z, double depth) const {
    const Eigen::Vector2d base = x == length_m_ ? spec_.to : spec_.from;
    Vector3d p(base.x(), base.y(), z);
    if (x != length_m_) p += along_ * x;
    return p - out_ * depth;
  }
  [[nodiscard]] render::PictureFrame picture(const Cover& c, const Vector3d& right,
                                             const Vector3d& down) const {
    return {.origin = at(0, 0, 0), .right = right * c.repeats_per_m, .down = down * c.repeats_per_m};
  }
  void face(const Cover& c, std::initializer_list<Vector3d> corners) {
    mesh_.polygon(c.surface, std::span(corners.begin(), corners.size()),
                  picture(c, along_, -Vector3d::UnitZ()));
  }
  void rectangle(const Cover& c, double x0, double z0, double x1, double z1, double depth) {
    face(c, {at(x0, z0, depth), at(x1, z0, depth), at(x1, z1, depth), at(x0, z1, depth)});
  }

  void collect_breaks() {
    for (const Opening& o : spec_.openings) {
      for (const double x : {o.x0_m, o.x1_m}) xs_.push_back(x);
      for (const double z : {o.z0_m, o.z1_m}) zs_.push_back(z);
    }
    for (auto* v : {&xs_, &zs_}) {
      std::sort(v->begin(), v->end());
      v->erase(std::unique(v->begin(), v->end()), v->end());
    }
  }

  // Between the wall's plain edges and the grid of openings: on each side a trapezoid, as a fan from a plain
  // corner.
  void frame() {
    const double x0 = xs_.front(), x1 = xs_.back(), z0 = zs_.front(), z1 = zs_.back();
    std::vector<Vector3d> bottom, right, top, left;
    for (const double x : xs_) {
      bottom.push_back(at(x, z0, 0));
      top.push_back(at(x, z1, 0));
    }
    for (const double z : zs_) {
      right.push_back(at(x1, z, 0));
      left.push_back(at(x0, z, 0));
    }
    std::reverse(top.begin(), top.end());
    std::reverse(left.begin(), left.end());
    const Vector3d corner[] = {at(0, spec_.z0_m, 0), at(length_m_, spec_.z0_m, 0),
                               at(length_m_, spec_.z1_m, 0), at(0, spec_.z1_m, 0)};
    const std::vector<Vector3d>* inner[] = {&bottom, &right, &top, &left};
    for (std::size_t k = 0; k < 4; ++k) {
      const auto& in = *inner[k];
      face(spec_.cover, {corner[k], corner[(k + 1) % 4], in.back()});
      for (std::size_t i = in.size() - 1; i > 0; --i) face(spec_.cover, {corner[k], in[i], in[i - 1]});
    }
  }

  [[nodiscard]] int opening_at(std::size_t i, std::size_t j) const {
    const double x = (xs_[i] + xs_[i + 1]) / 2, z = (zs_[j] + zs_[j + 1]) / 2;
    for (std::size_t k = 0; k < spec_.openings.size(); ++k) {
      const Opening& o = spec_.openings[k];
      if (x > o.x0_m && x < o.x1_m && z > o.z0_m && z < o.z1_m) return static_cast<int>(k);
    }
    return -1;
  }

  [[nodiscard]] static std::vector<double> between(const std::vector<double>& all, double a, double b) {
    std::vector<double> in;
    for (const double v : all)
      if (v >= a && v <= b) in.push_back(v);
    return in;
  }

  void open(std::size_t k) {
    const Opening& o = spec_.openings[k];
    const auto xs = between(xs_, o.x0_m, o.x1_m), zs = between(zs_, o.z0_m, o.z1_m);
    const double d = spec_.inset_m;
    if (d > 0) {
      const auto side = [&](const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& e,
                            bool level) {
        const Vector3d corners[] = {a, b, c, e};
        mesh_.polygon(
            spec_.cover.surface, corners,
            level ? picture(spec_.cover, along_, -out_) : picture(spec_.cover, out_, -Vector3d::UnitZ()));
      };
      for (std::size_t i = 0; i + 1 < xs.size(); ++i) {
        side(at(xs[i], o.z0_m, 0), at(xs[i + 1], o.z0_m, 0), at(xs[i + 1], o.z0_m, d), at(xs[i], o.z0_m, d),
             true);
        side(at(xs[i], o.z1_m, d), at(xs[i + 1], o.z1_m, d), at(xs[i + 1], o.z1_m, 0), at(xs[i], o.z1_m, 0),
             true);
      }
      for (std::size_t j = 0; j + 1 < zs.size(); ++j) {
        side(at(o.x0_m, zs[j], 0), at(o.x0_m, zs[j], d), at(o.x0_m, zs[j + 1], d), at(o.x0_m, zs[j + 1], 0),
             false);
        side(at(o.x1_m, zs[j], d), at(o.x1_m, zs[j], 0), at(o.x1_m, zs[j + 1], 0), at(o.x1_m, zs[j + 1], d),
             false);
      }
    }
    if (o.door) {
      for (std::size_t i = 0; i + 1 < xs.size(); ++i)
        for (std::size_t j = 0; j + 1 < zs.size(); ++j)
          rectangle(cover(Finish::door), xs[i], zs[j], xs[i + 1], zs[j + 1], d);
      return;
    }
    pane(o, xs, zs, d);
  }

  // A pane within its frame; the frame's outer edge has the points of the grid.
  void pane(const Opening& o, const std::vector<double>& xs, const std::vector<double>& zs, double d) {
    const double w = std::min(kFrame_m, 0.2 * std::min(o.x1_m - o.x0_m, o.z1_m - o.z0_m));
    const double x0 = o.x0_m + w, x1 = o.x1_m - w, z0 = o.z0_m + w, z1 = o.z1_m - w;
    const Vector3d inner[] = {at(x0, z0, d), at(x1, z0, d), at(x1, z1, d), at(x0, z1, d)};
    std::array<std::vector<Vector3d>, 4> outer;
    for (const double x : xs) {
      outer[0].push_back(at(x, o.z0_m, d));
      outer[2].insert(outer[2].begin(), at(x, o.z1_m, d));
    }
    for (const double z : zs) {
      outer[1].push_back(at(o.x1_m, z, d));
      outer[3].insert(outer[3].begin(), at(o.x0_m, z, d));
    }
    const Cover& frame = cover(Finish::window_frame);
    for (std::size_t k = 0; k < 4; ++k) {
      const auto& side = outer[k];
      for (std::size_t i = 0; i + 1 < side.size(); ++i) face(frame, {side[i], side[i + 1], inner[k]});
      face(frame, {side.back(), inner[(k + 1) % 4], inner[k]});
    }
    face(cover(Finish::glass), {inner[0], inner[1], inner[2], inner[3]});
    // Bars in front of wide panes, each a closed body of its own.
    if (!(d > 0.05) || x1 - x0 < 0.7) return;
    bar((x0 + x1) / 2 - kMullion_m / 2, z0, (x0 + x1) / 2 + kMullion_m / 2, z1, d);
  }

  void bar(double x0, double z0, double x1, double z1, double d) {
    const double front = d - 0.02;
    const Cover& c = cover(Finish::window_frame);
    const Vector3d f[] = {at(x0, z0, front), at(x1, z0, front), at(x1, z1, front), at(x0, z1, front)};
    const Vector3d b[] = {at(x0, z0, d), at(x1, z0, d), at(x1, z1, d), at(x0, z1, d)};
    face(c, {f[0], f[1], f[2], f[3]});
    face(c, {b[1], b[0], b[3], b[2]});
    for (std::size_t k = 0; k < 4; ++k) face(c, {f[k], b[k], b[(k + 1) % 4], f[(k + 1) % 4]});
  }

  render::MeshBuilder& mesh_;
  const WallSpec& spec_;
  double length_m_ = 0;
  Vector3d along_, out_;
  std::vector<double> xs_, zs_;
};

}  // namespace

void add_wall(render::MeshBuilder& mesh, const WallSpec& wall) { Wall(mesh, wall).add(); }

}  // namespace rigor::nature::built
