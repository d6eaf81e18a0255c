#include "sensor-hal/record/frame_tree.h"

#include <algorithm>
#include <cmath>

namespace rigor::record {
namespace {

using Quaternion = std::array<double, 4>;
using Vector = std::array<double, 3>;

/// The body of a camera (x forward, y left, z up) in its optical frame (x right, y down, z forward): REP 103.
constexpr Quaternion kBodyInOptical{0.5, 0.5, -0.5, 0.5};
constexpr std::string_view kOptical = "_optical";

Quaternion product(const Quaternion& a, const Quaternion& b) {
  return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
          a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
          a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
}
Quaternion conjugate(const Quaternion& q) { return {q[0], -q[1], -q[2], -q[3]}; }
Vector rotated(const Quaternion& q, const Vector& v) {
  const Quaternion r = product(product(q, {0, v[0], v[1], v[2]}), conjugate(q));
  return {r[1], r[2], r[3]};
}

msg::TransformStamped message_of(const FrameLink& link, const Pose& T, const msg::Time& stamp) {
  const auto& p = T.position_m;
  const auto& q = T.orientation_wxyz;
  return {{stamp, link.parent}, link.child, {{p[0], p[1], p[2]}, {q[1], q[2], q[3], q[0]}}};
}

Pose T_at(const FrameLink& link, const WorldMotion& motion, BenchTime t, BenchTime t0) {
  switch (link.moves) {
    case FrameLink::Moves::fixed:
      break;
    case FrameLink::Moves::with_body:
      return link.index < motion.body_count ? motion.body[link.index].at(t) : link.T_parent_child;
    case FrameLink::Moves::turns: {
      const double half = link.index < motion.count ? motion.joint[link.index].at(t) / 2 : 0;
      const double s = std::sin(half);
      return composed(link.T_parent_child,
                      {{0, 0, 0}, {std::cos(half), s * link.axis[0], s * link.axis[1], s * link.axis[2]}});
    }
    case FrameLink::Moves::slides: {
      const double d = link.index < motion.count ? motion.joint[link.index].at(t) : 0;
      return composed(link.T_parent_child,
                      {{d * link.axis[0], d * link.axis[1], d * link.axis[2]}, {1, 0, 0, 0}});
    }
    case FrameLink::Moves::by_itself:
      return link.way(t - t0);
  }
  return link.T_parent_child;
}

class OfTree final : public FrameSource {
 public:
  explicit OfTree(std::shared_ptr<const FrameTree> tree) : tree_(std::move(tree)) {}
  [[nodiscard]] msg::TFMessage fixed(const msg::Time& stamp) const override { return tree_->fixed(stamp); }
  [[nodiscard]] bool moves() const override { return tree_->moves(); }
  [[nodiscard]] bool moving(const WorldMotion& motion, BenchTime t, BenchTime t0, const msg::Time& stamp,
                            msg::TFMessage& out) override {
    tree_->moving(motion, t, t0, stamp, out);
    return true;
  }

 private:
  std::shared_ptr<const FrameTree> tree_;
};

}  // namespace

Pose composed(const Pose& T_a_b, const Pose& T_b_c) {
  const Vector p = rotated(T_a_b.orientation_wxyz, T_b_c.position_m);
  Pose T;
  for (std::size_t i = 0; i < 3; ++i) T.position_m[i] = T_a_b.position_m[i] + p[i];
  T.orientation_wxyz = product(T_a_b.orientation_wxyz, T_b_c.orientation_wxyz);
  return T;
}

Pose inverse_of(const Pose& T_a_b) {
  Pose T;
  T.orientation_wxyz = conjugate(T_a_b.orientation_wxyz);
  const Vector p = rotated(T.orientation_wxyz, T_a_b.position_m);
  for (std::size_t i = 0; i < 3; ++i) T.position_m[i] = -p[i];
  return T;
}

const FrameLink* FrameTree::link_of(std::string_view frame) const {
  const auto at =
      std::find_if(links_.begin(), links_.end(), [&](const FrameLink& l) { return l.child == frame; });
  return at == links_.end() ? nullptr : &*at;
}

bool FrameTree::contains(std::string_view frame) const { return frame == root_ || link_of(frame); }

Status FrameTree::add(FrameLink link) {
  if (link.child.empty() || contains(link.child))
    return fail(ErrorCode::bad_input, link.child,
                "expected a frame with a name of its own, got one that has a place already");
  if (!contains(link.parent))
    return fail(ErrorCode::bad_input, link.child,
                "expected a parent with a place of its own, got \"" + link.parent + "\"");
  links_.push_back(std::move(link));
  return {};
}

Status FrameTree::add_sensor(FrameLink link) {
  const std::string optical = link.child;
  if (!optical.ends_with(kOptical)) return add(std::move(link));
  const std::string body = optical.substr(0, optical.size() - kOptical.size());
  if (body.empty() || contains(body) || contains(optical)) return add(std::move(link));
  const Pose T_optical_body{{0, 0, 0}, kBodyInOptical};
  link.child = body;
  link.T_parent_child = composed(link.T_parent_child, T_optical_body);
  if (link.way)
    link.way = [way = std::move(link.way), T_optical_body](Duration since_start) {
      return composed(way(since_start), T_optical_body);
    };
  if (auto s = add(std::move(link)); !s) return s;
  return add({.parent = body, .child = optical, .T_parent_child = inverse_of(T_optical_body)});
}

std::optional<Pose> FrameTree::T_fixed(std::string_view a, std::string_view b) const {
  // From b up, all ancestors by fixed links; then from a up to the first of them.
  std::vector<std::pair<std::string_view, Pose>> above_b{{b, Pose{}}};
  for (const FrameLink* l = link_of(b); l && l->moves == FrameLink::Moves::fixed; l = link_of(l->parent))
    above_b.emplace_back(l->parent, composed(l->T_parent_child, above_b.back().second));
  Pose T_ancestor_a;
  for (std::string_view at = a;;) {
    for (const auto& [frame, T_frame_b] : above_b)
      if (frame == at && contains(at)) return composed(inverse_of(T_ancestor_a), T_frame_b);
    const FrameLink* l = link_of(at);
    if (!l || l->moves != FrameLink::Moves::fixed) return std::nullopt;
    T_ancestor_a = composed(l->T_parent_child, T_ancestor_a);
    at = l->parent;
  }
}

bool FrameTree::moves() const {
  return std::any_of(links_.begin(), links_.end(),
                     [](const FrameLink& l) { return l.moves != FrameLink::Moves::fixed; });
}

msg::TFMessage FrameTree::fixed(const msg::Time& stamp) const {
  msg::TFMessage m;
  for (const FrameLink& l : links_)
    if (l.moves == FrameLink::Moves::fixed) m.transforms.push_back(message_of(l, l.T_parent_child, stamp));
  return m;
}

void FrameTree::moving(const WorldMotion& motion, BenchTime t, BenchTime t0, const msg::Time& stamp,
                       msg::TFMessage& out) const {
  out.transforms.clear();
  for (const FrameLink& l : links_)
    if (l.moves != FrameLink::Moves::fixed)
      out.transforms.push_back(message_of(l, T_at(l, motion, t, t0), stamp));
}

std::unique_ptr<FrameSource> source_of(std::shared_ptr<const FrameTree> tree) {
  return std::make_unique<OfTree>(std::move(tree));
}

}  // namespace rigor::record
