// The inside of the rays engine, for the tracer of light. Internal to sim/render/rays.
#pragma once

#include <tbb/task_arena.h>

#include "sim/render/rays/embree_placement.h"

namespace rigor::render {

struct EmbreeEngine::Impl {
  virtual ~Impl() = default;
  /// The prepared content round this place; what it points to holds until the next call of this or of
  /// prepare. Builds where the cell is a new one. Errors: bad_input (nothing prepared, a place that is not
  /// finite), unavailable (memory).
  [[nodiscard]] virtual Result<const RayScene*> scene_at(const Eigen::Vector3d& p_world) = 0;
  /// What was prepared; its window is null before the first prepare.
  [[nodiscard]] virtual const WantedContent& content() const noexcept = 0;
  /// With the threads that the options allow.
  [[nodiscard]] virtual tbb::task_arena& arena() noexcept = 0;
};

}  // namespace rigor::render
