#include "sim/render/view/kept_shadow.h"

#include <algorithm>

namespace rigor::render {

bool KeptShadow::Content::has(std::uint64_t serial) const {
  const auto at = std::lower_bound(still.begin(), still.end(), serial,
                                   [](const Caster& c, std::uint64_t s) { return c.serial < s; });
  return at != still.end() && at->serial == serial;
}

bool KeptShadow::same(const ShadowCascade& cascade, const Content& kept, const Content& now) {
  if (!kept.any || kept.square != now.square) return false;
  // What lies beside what is looked at may come and go.
  const auto all_in = [&](const Content& a, const Content& b) {
    return std::all_of(a.still.begin(), a.still.end(), [&](const Content::Caster& c) {
      return b.has(c.serial) || !cascade.may_shade(c.centre, c.radius_m);
    });
  };
  return all_in(kept, now) && all_in(now, kept);
}

KeptShadow::Use KeptShadow::next(const ShadowCascade& c, std::span<const ResidentBatch* const> batches,
                                 const CullOptions& options) {
  Content now;
  now.square = {c.x.x(),
                c.x.y(),
                c.x.z(),
                c.z.x(),
                c.z.y(),
                c.z.z(),
                c.centre.x(),
                c.centre.y(),
                c.centre.z(),
                c.half_side_m,
                c.texel_m,
                c.near_m,
                c.far_m,
                c.receivers_far_m,
                options.allowed_error_px,
                options.levels ? 1.0 : 0.0};
  now.any = true;
  for (const ResidentBatch* b : batches) {
    if (!b->prototype->prototype->casts_shadow || shadow_moves(*b, options)) continue;
    const Eigen::Vector3d centre = b->bounds.center();
    const double radius_m = 0.5 * b->bounds.diagonal().norm();
    if (c.reaches(centre, radius_m)) now.still.push_back({b->batch->serial, centre, radius_m});
  }
  std::sort(now.still.begin(), now.still.end(),
            [](const Content::Caster& a, const Content::Caster& b) { return a.serial < b.serial; });
  const bool kept = same(c, kept_, now), stays = same(c, last_, now);
  last_ = std::move(now);
  if (kept) return Use::again;
  // A map of all of a square costs more than one of what is looked at: of use where the eye stays.
  if (!stays) return Use::none;
  kept_ = last_;
  return Use::fill;
}

}  // namespace rigor::render
