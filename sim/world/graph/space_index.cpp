#include "sim/world/graph/space_index.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <queue>

namespace rigor::world {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr int kCellBits = 44;  // of a coordinate: 2^39 m to each side, in 1/16 m
constexpr double kCellsPerMetre = 16;
constexpr std::uint64_t kMiddle = std::uint64_t{1} << (kCellBits - 1);
constexpr std::uint32_t kLeafMax = 32, kMergeAt = 12;

// A key has 44 digits of the cell, then 22 of the id (64 bits and two zeros above), three bits each.
constexpr int kDigits = kCellBits + 22;

struct Key {
  std::uint64_t q[3];
  std::uint64_t id;
};

std::uint64_t cell(double v) {
  constexpr double kLimit = static_cast<double>(kMiddle) / kCellsPerMetre;
  const double c = std::floor(std::clamp(v, -kLimit, kLimit) * kCellsPerMetre) + static_cast<double>(kMiddle);
  return std::min(static_cast<std::uint64_t>(c), 2 * kMiddle - 1);
}

Key key_of(const SpaceEntry& e) { return {{cell(e.x), cell(e.y), cell(e.z)}, e.node.value}; }

unsigned digit(const Key& k, int depth) {
  if (depth < kCellBits) {
    const int bit = kCellBits - 1 - depth;
    return static_cast<unsigned>((k.q[0] >> bit & 1) | (k.q[1] >> bit & 1) << 1 | (k.q[2] >> bit & 1) << 2);
  }
  return static_cast<unsigned>(k.id >> (3 * (kDigits - 1 - depth)) & 7);
}

/// The first digit in which the keys differ; kDigits: none.
int first_difference(const Key& a, const Key& b) {
  const std::uint64_t cells = (a.q[0] ^ b.q[0]) | (a.q[1] ^ b.q[1]) | (a.q[2] ^ b.q[2]);
  if (cells) return kCellBits - (64 - std::countl_zero(cells));
  const std::uint64_t ids = a.id ^ b.id;
  if (ids) return kDigits - 1 - (63 - std::countl_zero(ids)) / 3;
  return kDigits;
}

struct SpaceNode : Stored {
  bool is_leaf = true;
};
struct SpaceLeaf : SpaceNode {
  std::uint32_t count = 0, capacity = 0;
  SpaceEntry entry[1];
};
struct SpaceInner : SpaceNode {
  int depth = 0;  ///< of the digit that tells its children apart
  std::uint32_t count = 0;
  Key key{};  ///< of any entry: the digits before `depth` count
  Stored* child[8] = {};
};

bool is_leaf(const Stored* n) { return static_cast<const SpaceNode*>(n)->is_leaf; }
SpaceLeaf* leaf(Stored* n) { return static_cast<SpaceLeaf*>(n); }
SpaceInner* inner(Stored* n) { return static_cast<SpaceInner*>(n); }
const SpaceLeaf* leaf(const Stored* n) { return static_cast<const SpaceLeaf*>(n); }
const SpaceInner* inner(const Stored* n) { return static_cast<const SpaceInner*>(n); }

SpaceLeaf* make_leaf(Memory& m, std::uint32_t count) {
  const std::uint32_t capacity = count <= 4 ? 4 : count <= 8 ? 8 : count <= 16 ? 16 : kLeafMax;
  auto* n = static_cast<SpaceLeaf*>(m.allocate(sizeof(SpaceLeaf) + capacity * sizeof(SpaceEntry)));
  n->stamp = m.stamp(StoredKind::space);
  n->is_leaf = true;
  n->count = 0;
  n->capacity = capacity;
  return n;
}

SpaceLeaf* my_leaf(Memory& m, Stored* old, std::uint32_t count) {
  if (m.is_mine(old) && leaf(old)->capacity >= count) return leaf(old);
  SpaceLeaf* n = make_leaf(m, std::max(count, leaf(old)->count));
  n->count = leaf(old)->count;
  std::copy_n(leaf(old)->entry, n->count, n->entry);
  m.retire(old);
  return n;
}

SpaceInner* make_inner(Memory& m) {
  auto* n = new (m.allocate(sizeof(SpaceInner))) SpaceInner;
  n->stamp = m.stamp(StoredKind::space);
  n->is_leaf = false;
  return n;
}

SpaceInner* my_inner(Memory& m, Stored* old) {
  if (m.is_mine(old)) return inner(old);
  auto* n = new (m.allocate(sizeof(SpaceInner))) SpaceInner(*inner(old));
  n->stamp = m.stamp(StoredKind::space);
  m.retire(old);
  return n;
}

struct Keyed {
  Key key;
  SpaceEntry entry;
};

/// `spare` is as long as `entries`; both are written over.
Stored* build(Memory& m, std::span<Keyed> entries, std::span<Keyed> spare) {
  if (entries.size() <= kLeafMax) {
    SpaceLeaf* n = make_leaf(m, static_cast<std::uint32_t>(entries.size()));
    for (const Keyed& e : entries) n->entry[n->count++] = e.entry;
    return n;
  }
  int depth = kDigits;
  for (const Keyed& e : entries) depth = std::min(depth, first_difference(entries[0].key, e.key));
  SpaceInner* n = make_inner(m);
  n->depth = depth;
  n->count = static_cast<std::uint32_t>(entries.size());
  n->key = entries[0].key;
  std::size_t start[9] = {};
  for (const Keyed& e : entries) ++start[digit(e.key, depth) + 1];
  for (int d = 0; d < 8; ++d) start[d + 1] += start[d];
  std::size_t at[8];
  std::copy_n(start, 8, at);
  for (const Keyed& e : entries) spare[at[digit(e.key, depth)]++] = e;
  for (int d = 0; d < 8; ++d)
    if (const std::size_t count = start[d + 1] - start[d])
      n->child[d] = build(m, spare.subspan(start[d], count), entries.subspan(start[d], count));
  return n;
}

Stored* build(Memory& m, std::span<const SpaceEntry> entries) {
  std::vector<Keyed> keyed(entries.size()), spare(entries.size());
  for (std::size_t i = 0; i < entries.size(); ++i) keyed[i] = {key_of(entries[i]), entries[i]};
  return build(m, keyed, spare);
}

Stored* insert(Memory& m, Stored* n, const SpaceEntry& e, const Key& k) {
  if (!n) {
    SpaceLeaf* l = make_leaf(m, 1);
    l->count = 1;
    l->entry[0] = e;
    return l;
  }
  if (is_leaf(n)) {
    if (leaf(n)->count < kLeafMax) {
      SpaceLeaf* l = my_leaf(m, n, leaf(n)->count + 1);
      l->entry[l->count++] = e;
      return l;
    }
    SpaceEntry all[kLeafMax + 1];
    std::copy_n(leaf(n)->entry, kLeafMax, all);
    all[kLeafMax] = e;
    m.retire(n);
    return build(m, all);
  }
  const int differs = first_difference(inner(n)->key, k);
  if (differs < inner(n)->depth) {
    SpaceInner* above = make_inner(m);
    above->depth = differs;
    above->count = inner(n)->count + 1;
    above->key = k;
    above->child[digit(inner(n)->key, differs)] = n;
    above->child[digit(k, differs)] = insert(m, nullptr, e, k);
    return above;
  }
  SpaceInner* in = my_inner(m, n);
  ++in->count;
  Stored*& child = in->child[digit(k, in->depth)];
  child = insert(m, child, e, k);
  return in;
}

void gather(Memory& m, Stored* n, SpaceLeaf* into) {
  if (is_leaf(n)) {
    std::copy_n(leaf(n)->entry, leaf(n)->count, into->entry + into->count);
    into->count += leaf(n)->count;
  } else {
    for (Stored* c : inner(n)->child)
      if (c) gather(m, c, into);
  }
  m.retire(n);
}

Stored* remove(Memory& m, Stored* n, const SpaceEntry& e, const Key& k) {
  if (is_leaf(n)) {
    if (leaf(n)->count == 1) {
      m.retire(n);
      return nullptr;
    }
    SpaceLeaf* l = my_leaf(m, n, 0);
    for (std::uint32_t i = 0; i < l->count; ++i)
      if (l->entry[i].node == e.node) {
        l->entry[i] = l->entry[--l->count];
        break;
      }
    return l;
  }
  SpaceInner* in = my_inner(m, n);
  --in->count;
  Stored*& child = in->child[digit(k, in->depth)];
  child = remove(m, child, e, k);
  if (in->count <= kMergeAt) {
    SpaceLeaf* l = make_leaf(m, in->count);
    gather(m, in, l);
    return l;
  }
  if (!child) {
    Stored* only = nullptr;
    int children = 0;
    for (Stored* c : in->child)
      if (c) {
        only = c;
        ++children;
      }
    if (children == 1) {
      m.retire(in);
      return only;
    }
  }
  return in;
}

/// Changes an entry whose key stays.
Stored* replace(Memory& m, Stored* n, const SpaceEntry& e, const Key& k) {
  if (is_leaf(n)) {
    SpaceLeaf* l = my_leaf(m, n, 0);
    for (std::uint32_t i = 0; i < l->count; ++i)
      if (l->entry[i].node == e.node) l->entry[i] = e;
    return l;
  }
  SpaceInner* in = my_inner(m, n);
  Stored*& child = in->child[digit(k, in->depth)];
  child = replace(m, child, e, k);
  return in;
}

// ---------------------------------------------------------------- queries

struct Cell {
  double min[3], max[3];
};

/// What the first `depth` digits of a key leave open. The outermost cells reach to infinity.
Cell cell_of(const Key& key, int depth) {
  const int open = std::max(0, kCellBits - depth);
  Cell c;
  for (int i = 0; i < 3; ++i) {
    const std::uint64_t low = key.q[i] >> open << open, high = low + (std::uint64_t{1} << open);
    c.min[i] = low == 0 ? -kInf : (static_cast<double>(low) - static_cast<double>(kMiddle)) / kCellsPerMetre;
    c.max[i] = high == 2 * kMiddle
                   ? kInf
                   : (static_cast<double>(high) - static_cast<double>(kMiddle)) / kCellsPerMetre;
  }
  return c;
}

Cell child_cell(const SpaceInner& n, unsigned d) {
  if (n.depth >= kCellBits) return cell_of(n.key, kCellBits);
  Key k = n.key;
  const int bit = kCellBits - 1 - n.depth;
  for (int i = 0; i < 3; ++i)
    k.q[i] = (k.q[i] & ~(std::uint64_t{1} << bit)) | std::uint64_t{d >> i & 1} << bit;
  return cell_of(k, n.depth + 1);
}

double distance(const Cell& c, const Vector3& p) {
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    const double d = p[i] < c.min[i] ? c.min[i] - p[i] : p[i] > c.max[i] ? p[i] - c.max[i] : 0;
    sum += d * d;
  }
  return std::sqrt(sum);
}

/// So much more than rounding can hide that a cell beyond it holds nothing within `d`.
double with_margin(double d) { return d * (1 + 1e-12); }

void in_box(const Stored* n, const Box3& box, std::vector<NodeId>& found) {
  if (is_leaf(n)) {
    for (std::uint32_t i = 0; i < leaf(n)->count; ++i) {
      const SpaceEntry& e = leaf(n)->entry[i];
      if (e.x >= box.min.x() && e.x <= box.max.x() && e.y >= box.min.y() && e.y <= box.max.y() &&
          e.z >= box.min.z() && e.z <= box.max.z())
        found.push_back(e.node);
    }
    return;
  }
  for (unsigned d = 0; d < 8; ++d) {
    const Stored* c = inner(n)->child[d];
    if (!c) continue;
    const Cell cell = child_cell(*inner(n), d);
    bool apart = false;
    for (int i = 0; i < 3; ++i) apart |= cell.max[i] < box.min[i] || cell.min[i] > box.max[i];
    if (!apart) in_box(c, box, found);
  }
}

void in_radius(const Stored* n, const Vector3& centre, double radius_m,
               std::vector<std::pair<double, NodeId>>& found) {
  if (is_leaf(n)) {
    for (std::uint32_t i = 0; i < leaf(n)->count; ++i) {
      const SpaceEntry& e = leaf(n)->entry[i];
      const double d = (e.p() - centre).norm();
      if (d <= radius_m) found.emplace_back(d, e.node);
    }
    return;
  }
  for (unsigned d = 0; d < 8; ++d)
    if (const Stored* c = inner(n)->child[d];
        c && !(distance(child_cell(*inner(n), d), centre) > with_margin(radius_m)))
      in_radius(c, centre, radius_m, found);
}

}  // namespace

void space_insert(Memory& m, Stored*& root, const SpaceEntry& entry) {
  root = insert(m, root, entry, key_of(entry));
}

void space_insert(Memory& m, Stored*& root, std::span<const SpaceEntry> entries) {
  if (entries.empty()) return;
  if (!root) {
    root = build(m, entries);
    return;
  }
  for (const SpaceEntry& e : entries) space_insert(m, root, e);
}

void space_remove(Memory& m, Stored*& root, const SpaceEntry& entry) {
  root = remove(m, root, entry, key_of(entry));
}

void space_move(Memory& m, Stored*& root, const SpaceEntry& before, const SpaceEntry& after) {
  const Key from = key_of(before), to = key_of(after);
  if (first_difference(from, to) == kDigits) {
    root = replace(m, root, after, to);
  } else {
    root = remove(m, root, before, from);
    root = insert(m, root, after, to);
  }
}

void space_in_box(const Stored* root, const Box3& box, std::vector<NodeId>& found) {
  if (root) in_box(root, box, found);
}

void space_in_radius(const Stored* root, const Vector3& centre, double radius_m,
                     std::vector<std::pair<double, NodeId>>& found) {
  if (root) in_radius(root, centre, radius_m, found);
}

std::vector<std::pair<double, NodeId>> space_nearest(std::span<const Stored* const> roots,
                                                     const Vector3& centre, std::size_t k) {
  using Found = std::pair<double, NodeId>;
  using Waiting = std::pair<double, const Stored*>;
  const auto farther = [](const Waiting& a, const Waiting& b) { return a.first > b.first; };
  std::priority_queue<Waiting, std::vector<Waiting>, decltype(farther)> waiting(farther);
  std::priority_queue<Found> best;  // the worst on top
  if (k == 0) return {};
  for (const Stored* r : roots)
    if (r) waiting.emplace(0.0, r);
  while (!waiting.empty()) {
    const auto [at, n] = waiting.top();
    waiting.pop();
    if (best.size() == k && at > with_margin(best.top().first)) break;
    if (is_leaf(n)) {
      for (std::uint32_t i = 0; i < leaf(n)->count; ++i) {
        const SpaceEntry& e = leaf(n)->entry[i];
        const Found f{(e.p() - centre).norm(), e.node};
        if (best.size() < k) {
          best.push(f);
        } else if (f < best.top()) {
          best.pop();
          best.push(f);
        }
      }
      continue;
    }
    for (unsigned d = 0; d < 8; ++d)
      if (const Stored* c = inner(n)->child[d]) {
        const double far = distance(child_cell(*inner(n), d), centre);
        if (best.size() < k || !(far > with_margin(best.top().first))) waiting.emplace(far, c);
      }
  }
  std::vector<Found> all(best.size());
  for (std::size_t i = all.size(); i > 0; --i) {
    all[i - 1] = best.top();
    best.pop();
  }
  return all;
}

std::size_t space_bytes(const Stored* n) {
  return is_leaf(n) ? sizeof(SpaceLeaf) + leaf(n)->capacity * sizeof(SpaceEntry) : sizeof(SpaceInner);
}

void space_children(Stored* n, const std::function<void(Stored*)>& visit) {
  if (is_leaf(n)) return;
  for (Stored* c : inner(n)->child)
    if (c) visit(c);
}

}  // namespace rigor::world
