// Where the nodes of one type are: a radix tree over the digits of their cells, eight ways at each step, with
// the places in its leaves. It needs no bounds that hold the world: cells are 1/16 m wide up to 2^39 m from
// the origin, what is farther counts to the outermost cells; nodes that share a cell are told apart by their
// ids, so that no place is ever too crowded. Chains of single children are skipped.
//
// Stored like the rest of the world (storage.h): a change costs the path to one leaf.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "sim/world/graph/snapshot.h"
#include "sim/world/graph/storage.h"

namespace rigor::world {

struct SpaceEntry {
  double x, y, z;
  NodeId node;
  [[nodiscard]] Vector3 p() const { return {x, y, z}; }
};

/// Precondition of all: the place is finite.
void space_insert(Memory& m, Stored*& root, const SpaceEntry& entry);
/// Of many at once.
void space_insert(Memory& m, Stored*& root, std::span<const SpaceEntry> entries);
/// Precondition: it is there.
void space_remove(Memory& m, Stored*& root, const SpaceEntry& entry);
/// Precondition: `before` is there; the node is the same.
void space_move(Memory& m, Stored*& root, const SpaceEntry& before, const SpaceEntry& after);

void space_in_box(const Stored* root, const Box3& box, std::vector<NodeId>& found);
/// With their distances, in any order. Preconditions: a finite centre, a radius ≥ 0.
void space_in_radius(const Stored* root, const Vector3& centre, double radius_m,
                     std::vector<std::pair<double, NodeId>>& found);
/// The k nearest of all trees together, nearest first, of equal ones the lower id.
[[nodiscard]] std::vector<std::pair<double, NodeId>> space_nearest(std::span<const Stored* const> roots,
                                                                   const Vector3& centre, std::size_t k);

[[nodiscard]] std::size_t space_bytes(const Stored* n);
/// Calls `visit` for the children of an inner node of the tree.
void space_children(Stored* n, const std::function<void(Stored*)>& visit);

}  // namespace rigor::world
