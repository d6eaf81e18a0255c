// The small scene of boxes and cylinders that the bench's cameras draw is a view of the world database:
// written into it from a world file, read from its snapshot.
#pragma once

#include "rt-core/result.h"
#include "sim/world/graph/database.h"
#include "sim/world/scene.h"

namespace rigor::world {

/// Writes a scene as Material, Frame, Hinge, Body, GroundPlane and StudioLight nodes, in one transaction. The
/// database has the semantic types. Bands beyond near infrared at 850 nm take its value.
[[nodiscard]] Status put_scene(Database& db, const Scene& scene);

/// What of a world such a scene can show; nodes in the order of their ids. bad_input: two grounds or two
/// studio lights, a body without a material, a frame that moves.
[[nodiscard]] Result<Scene> scene_of(const Snapshot& world);

}  // namespace rigor::world
