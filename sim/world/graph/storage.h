// What the world is stored in: nodes of trees that a snapshot shares with the world that goes on.
//
// Every stored node bears the epoch in which it was made. Taking a snapshot ends the epoch. The writer
// changes a node in place when it was made in the present epoch, for then no snapshot can reach it; an older
// node is copied, and the old copy is retired: it is freed once no living snapshot is of an epoch between its
// birth and its retirement. Nothing is counted on the way, so copying a node touches that node alone.
//
// World thread, but for Memory::release. Readers read what the writer no longer touches.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "sim/world/graph/value.h"

namespace rigor::world {

enum class StoredKind : std::uint8_t {
  flag,  // the leaves of columns come first, in the order of ValueKind
  integer,
  number,
  text,
  vector3,
  pose,
  motion,
  numbers,
  blob,
  locations,
  ids,
  lists,
  dynamics,
  inner,
  table,
  tables,
  edges,
  block,
  dynamic_map,
  space,
  count
};
inline constexpr std::size_t kLeafKinds = static_cast<std::size_t>(StoredKind::inner);

[[nodiscard]] constexpr StoredKind leaf_of(ValueKind k) { return static_cast<StoredKind>(k); }

struct Stored {
  std::uint64_t stamp = 0;  // epoch of birth · 256 + kind
  [[nodiscard]] std::uint64_t birth() const { return stamp >> 8; }
  [[nodiscard]] StoredKind kind() const { return static_cast<StoredKind>(stamp & 0xFF); }
};

/// Allocates, retires and frees stored nodes.
class Memory {
 public:
  Memory() = default;
  ~Memory();
  Memory(const Memory&) = delete;
  Memory& operator=(const Memory&) = delete;

  [[nodiscard]] bool is_mine(const Stored* n) const { return n->birth() == epoch_; }
  [[nodiscard]] std::uint64_t stamp(StoredKind kind) const {
    return epoch_ << 8 | static_cast<std::uint64_t>(kind);
  }
  [[nodiscard]] void* allocate(std::size_t bytes);
  /// The writer no longer reaches it.
  void retire(Stored* n);
  /// Ends the epoch. What is reachable now stays until release(the number returned).
  [[nodiscard]] std::uint64_t seal();
  /// Any thread.
  void release(std::uint64_t version);
  /// Frees what no snapshot reaches any more.
  void collect();
  /// The roots that are left at the end; freed with the memory.
  void adopt(Stored* root) {
    if (root) adopted_.push_back(root);
  }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  struct Live {
    std::uint64_t version;
    std::vector<Stored*> retired;  // this is the newest living snapshot that reaches them
  };
  void give_back(void* p, std::size_t bytes);
  void free_now(Stored* n);
  void free_tree(Stored* n);
  void drop(std::uint64_t version);

  // Freed room is kept by size for the next of that size: a world that changes at a steady pace asks the
  // system for nothing.
  static constexpr std::size_t kGrain = 64, kPooled = 2048, kSlab = 1 << 16;
  struct Free {
    Free* next;
  };
  std::array<Free*, kPooled / kGrain + 1> free_{};
  std::vector<void*> slabs_;
  std::byte* slab_at_ = nullptr;
  std::size_t slab_left_ = 0;

  std::uint64_t epoch_ = 1;
  std::size_t bytes_ = 0;
  std::vector<Live> live_;  // oldest first
  std::vector<std::vector<Stored*>> spare_;
  std::vector<Stored*> adopted_;
  std::atomic<bool> has_released_{false};
  std::mutex mutex_;
  std::vector<std::uint64_t> released_;
  std::vector<std::uint64_t> collecting_;
};

// ---------------------------------------------------------------- leaves

/// Where a node stands. type: 0 no node ever, kGone: was removed, else the type's number + 1.
struct Location {
  std::uint32_t type = 0;
  std::uint32_t row = 0;
  static constexpr std::uint32_t kGone = 0xFFFFFFFF;
  [[nodiscard]] bool is_there() const { return type != 0 && type != kGone; }
};

/// Grows at its end in place even where snapshots share it: each reader knows how many it may see.
struct Block : Stored {
  std::uint32_t used = 0;  // the writer's
  std::uint32_t capacity = 0;
  NodeId ids[1];
};

/// Neighbours along one edge type: one lies here, more in a block.
struct NodeList {
  std::uint64_t size = 0;
  union {
    NodeId one;
    Block* block;
  };
  NodeList() : block(nullptr) {}
  [[nodiscard]] std::span<const NodeId> span() const {
    return {size <= 1 ? &one : block->ids, static_cast<std::size_t>(size)};
  }
};

struct DynamicMap : Stored {
  std::map<std::string, Value, std::less<>> values;
};

template <class T>
inline constexpr unsigned kShift = 7;
template <>
inline constexpr unsigned kShift<bool> = 8;
template <>
inline constexpr unsigned kShift<std::string> = 5;
template <>
inline constexpr unsigned kShift<Vector3> = 6;
template <>
inline constexpr unsigned kShift<Pose> = 3;
template <>
inline constexpr unsigned kShift<Motion> = 3;
template <>
inline constexpr unsigned kShift<Numbers> = 6;
template <>
inline constexpr unsigned kShift<Blob> = 6;
template <>
inline constexpr unsigned kShift<NodeList> = 6;

template <class T>
struct Leaf : Stored {
  T v[std::size_t{1} << kShift<T>];
};

/// What the writer needs to know of the kinds of leaf.
struct LeafOps {
  unsigned shift;
  std::size_t value_bytes, offset, leaf_bytes;
  void (*fill)(void* leaf, const void* value);  ///< constructs a leaf of equal values
  void (*copy)(void* leaf, const void* from);   ///< constructs a leaf as another
  void (*destroy)(void* leaf);
  void (*assign)(void* to, const void* from);
  bool (*same)(const void* a, const void* b);
};
[[nodiscard]] const LeafOps& leaf_ops(StoredKind kind);

/// Rows and bytes of leaves, for readers.
struct LeafShape {
  unsigned shift;
  std::uint32_t value_bytes, offset;
};
extern const std::array<LeafShape, kLeafKinds> kLeafShapes;

// ---------------------------------------------------------------- arrays

inline constexpr unsigned kFanBits = 5;
inline constexpr std::size_t kFan = std::size_t{1} << kFanBits;

struct Inner : Stored {
  Stored* child[kFan];
};

/// A sparse array of values: a radix tree of leaves. What is not there is the default.
struct Array {
  Stored* root = nullptr;
  std::uint32_t levels = 0;  // of inner nodes above the leaves
};

/// The leaf that holds `row`, or null.
[[nodiscard]] inline const Stored* find_leaf(const Array& a, std::size_t row, unsigned shift) {
  const std::size_t index = row >> shift;
  if (index >> (kFanBits * a.levels)) return nullptr;
  const Stored* n = a.root;
  for (unsigned l = a.levels; l > 0 && n; --l)
    n = static_cast<const Inner*>(n)->child[(index >> (kFanBits * (l - 1))) & (kFan - 1)];
  return n;
}

template <class T>
[[nodiscard]] inline const T* find(const Array& a, std::size_t row) {
  const Stored* n = find_leaf(a, row, kShift<T>);
  return n ? &static_cast<const Leaf<T>*>(n)->v[row & ((std::size_t{1} << kShift<T>)-1)] : nullptr;
}

[[nodiscard]] inline const void* find(const Array& a, StoredKind kind, std::size_t row) {
  const LeafShape& s = kLeafShapes[static_cast<std::size_t>(kind)];
  const Stored* n = find_leaf(a, row, s.shift);
  return n ? reinterpret_cast<const std::byte*>(n) + s.offset +
                 (row & ((std::size_t{1} << s.shift) - 1)) * s.value_bytes
           : nullptr;
}

/// The value at `row`, to be written; its leaf is made of `fill` where there is none.
[[nodiscard]] void* edit(Memory& m, Array& a, StoredKind kind, std::size_t row, const void* fill);
template <class T>
[[nodiscard]] inline T& edit(Memory& m, Array& a, StoredKind kind, std::size_t row) {
  static const T empty{};
  return *static_cast<T*>(edit(m, a, kind, row, &empty));
}
/// Forgets the leaf that holds `row`: its values are defaults again.
void drop_leaf(Memory& m, Array& a, StoredKind kind, std::size_t row);

// ---------------------------------------------------------------- the world

/// The nodes of one type, row by row. Rows beyond `size` hold defaults.
struct Table : Stored {
  std::size_t size = 0;
  Array ids;
  Stored* space = nullptr;  // where they are: space_index.h
  std::uint32_t column_count = 0;
  Array column[1];
};

struct Tables : Stored {
  std::uint32_t count = 0;
  Table* of[1];  // by type; null: no node yet
};

struct EdgeTable {
  Array out, in;  // of NodeList, by node
  std::size_t count = 0;
};
struct Edges : Stored {
  std::uint32_t count = 0;
  EdgeTable of[1];  // by edge type
};

struct World {
  std::uint64_t revision = 0;
  std::uint64_t next_id = 1;
  std::size_t node_count = 0;
  Array locations;
  Tables* tables = nullptr;
  Edges* edges = nullptr;
  Array dynamics;  // of DynamicMap*, by node
  [[nodiscard]] Location location(NodeId n) const {
    const Location* l = find<Location>(locations, n.value);
    return l ? *l : Location{};
  }
  [[nodiscard]] const Table* table(std::uint32_t type) const {
    return tables && type < tables->count ? tables->of[type] : nullptr;
  }
  [[nodiscard]] std::span<const NodeId> neighbours(NodeId n, std::uint32_t edge, bool backwards) const {
    if (!edges || edge >= edges->count) return {};
    const EdgeTable& t = edges->of[edge];
    const NodeList* l = find<NodeList>(backwards ? t.in : t.out, n.value);
    return l ? l->span() : std::span<const NodeId>{};
  }
  [[nodiscard]] const DynamicMap* dynamic_map(NodeId n) const {
    DynamicMap* const* p = find<DynamicMap*>(dynamics, n.value);
    return p ? *p : nullptr;
  }
};

}  // namespace rigor::world
