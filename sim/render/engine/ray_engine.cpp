#include "sim/render/engine/ray_engine.h"

#include <algorithm>

namespace rigor::render {

Status RayEngine::occluded(const RayQuery& query, std::span<std::uint8_t> occluded) {
  met_.resize(occluded.size());
  if (auto s = cast(query, met_); !s) return s;
  std::transform(met_.begin(), met_.end(), occluded.begin(),
                 [](const Hit& h) { return static_cast<std::uint8_t>(h.nothing() ? 0 : 1); });
  return {};
}

Status RayEngine::cast_layers(const RayQuery& query, LayeredHits& hits) {
  met_.resize(hits.rays());
  if (auto s = cast(query, met_); !s) return s;
  for (std::size_t i = 0; i < met_.size(); ++i) {
    hits.clear(i);
    if (!met_[i].nothing()) hits.add(i) = {met_[i], 1};
  }
  return {};
}

}  // namespace rigor::render
