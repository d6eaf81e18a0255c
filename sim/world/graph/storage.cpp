#include "sim/world/graph/storage.h"

#include <algorithm>
#include <cstdlib>
#include <new>
#include <type_traits>

#include "rt-core/sanitizers.h"
#include "sim/world/graph/same.h"
#include "sim/world/graph/space_index.h"

namespace rigor::world {
namespace {

template <class T>
bool same_bytes_or_value(const void* a, const void* b) {
  if constexpr (requires(const T& x) { same(x, x); })
    return same(*static_cast<const T*>(a), *static_cast<const T*>(b));
  else
    return std::memcmp(a, b, sizeof(T)) == 0;
}

template <class T>
constexpr LeafOps ops_for() {
  constexpr std::size_t rows = std::size_t{1} << kShift<T>;
  return {.shift = kShift<T>,
          .value_bytes = sizeof(T),
          .offset = (sizeof(Stored) + alignof(T) - 1) / alignof(T) * alignof(T),
          .leaf_bytes = sizeof(Leaf<T>),
          .fill =
              [](void* leaf, const void* value) {
                T* v = static_cast<Leaf<T>*>(leaf)->v;
                for (std::size_t i = 0; i < rows; ++i) new (v + i) T(*static_cast<const T*>(value));
              },
          .copy =
              [](void* leaf, const void* from) {
                T* v = static_cast<Leaf<T>*>(leaf)->v;
                const T* f = static_cast<const Leaf<T>*>(from)->v;
                if constexpr (std::is_trivially_copyable_v<T>)
                  std::memcpy(static_cast<void*>(v), f, rows * sizeof(T));
                else
                  for (std::size_t i = 0; i < rows; ++i) new (v + i) T(f[i]);
              },
          .destroy =
              [](void* leaf) {
                if constexpr (!std::is_trivially_destructible_v<T>) {
                  T* v = static_cast<Leaf<T>*>(leaf)->v;
                  for (std::size_t i = 0; i < rows; ++i) v[i].~T();
                }
              },
          .assign = [](void* to, const void* from) { *static_cast<T*>(to) = *static_cast<const T*>(from); },
          .same = same_bytes_or_value<T>};
}

const std::array<LeafOps, kLeafKinds> kOps = {
    ops_for<bool>(),       ops_for<std::int64_t>(), ops_for<double>(), ops_for<std::string>(),
    ops_for<Vector3>(),    ops_for<Pose>(),         ops_for<Motion>(), ops_for<Numbers>(),
    ops_for<Blob>(),       ops_for<Location>(),     ops_for<NodeId>(), ops_for<NodeList>(),
    ops_for<DynamicMap*>()};

template <class T>
constexpr LeafShape shape_for() {
  return {kShift<T>, sizeof(T),
          static_cast<std::uint32_t>((sizeof(Stored) + alignof(T) - 1) / alignof(T) * alignof(T))};
}

std::size_t bytes_of(const Stored* n) {
  switch (n->kind()) {
    case StoredKind::inner:
      return sizeof(Inner);
    case StoredKind::table:
      return sizeof(Table) + static_cast<const Table*>(n)->column_count * sizeof(Array);
    case StoredKind::tables:
      return sizeof(Tables) + static_cast<const Tables*>(n)->count * sizeof(Table*);
    case StoredKind::edges:
      return sizeof(Edges) + static_cast<const Edges*>(n)->count * sizeof(EdgeTable);
    case StoredKind::block:
      return sizeof(Block) + static_cast<const Block*>(n)->capacity * sizeof(NodeId);
    case StoredKind::dynamic_map:
      return sizeof(DynamicMap);
    case StoredKind::space:
      return space_bytes(n);
    default:
      return leaf_ops(n->kind()).leaf_bytes;
  }
}

}  // namespace

constinit const std::array<LeafShape, kLeafKinds> kLeafShapes = {
    shape_for<bool>(),       shape_for<std::int64_t>(), shape_for<double>(), shape_for<std::string>(),
    shape_for<Vector3>(),    shape_for<Pose>(),         shape_for<Motion>(), shape_for<Numbers>(),
    shape_for<Blob>(),       shape_for<Location>(),     shape_for<NodeId>(), shape_for<NodeList>(),
    shape_for<DynamicMap*>()};

const LeafOps& leaf_ops(StoredKind kind) { return kOps[static_cast<std::size_t>(kind)]; }

// ---------------------------------------------------------------- memory

Memory::~Memory() {
  for (auto& live : live_)
    for (Stored* n : live.retired) free_now(n);
  for (Stored* n : adopted_) free_tree(n);
  for (void* s : slabs_) ::operator delete(s);
}

namespace {
#if defined(RIGOR_ADDRESS_SANITIZER)
constexpr bool kPools = false;  // so that the sanitizer sees each stored node's end
#else
constexpr bool kPools = true;
#endif
}  // namespace

void* Memory::allocate(std::size_t bytes) {
  bytes_ += bytes;
  if (!kPools || bytes > kPooled) return ::operator new(bytes);
  const std::size_t grains = (bytes + kGrain - 1) / kGrain;
  if (Free*& list = free_[grains]; list) {
    void* p = list;
    list = list->next;
    return p;
  }
  const std::size_t room = grains * kGrain;
  if (slab_left_ < room) {
    slabs_.push_back(::operator new(kSlab));
    slab_at_ = static_cast<std::byte*>(slabs_.back());
    slab_left_ = kSlab;
  }
  void* p = slab_at_;
  slab_at_ += room;
  slab_left_ -= room;
  return p;
}

void Memory::give_back(void* p, std::size_t bytes) {
  bytes_ -= bytes;
  if (!kPools || bytes > kPooled) {
    ::operator delete(p);
    return;
  }
  Free*& list = free_[(bytes + kGrain - 1) / kGrain];
  list = new (p) Free{list};
}

void Memory::free_now(Stored* n) {
  const std::size_t bytes = bytes_of(n);
  if (n->kind() == StoredKind::dynamic_map)
    static_cast<DynamicMap*>(n)->~DynamicMap();
  else if (n->kind() < StoredKind::inner)
    leaf_ops(n->kind()).destroy(n);
  give_back(n, bytes);
}

void Memory::free_tree(Stored* n) {
  if (!n) return;
  switch (n->kind()) {
    case StoredKind::inner:
      for (Stored* c : static_cast<Inner*>(n)->child) free_tree(c);
      break;
    case StoredKind::lists:
      for (NodeList& l : static_cast<Leaf<NodeList>*>(n)->v)
        if (l.size > 1) free_now(l.block);
      break;
    case StoredKind::dynamics:
      for (DynamicMap* d : static_cast<Leaf<DynamicMap*>*>(n)->v)
        if (d) free_now(d);
      break;
    case StoredKind::table: {
      auto* t = static_cast<Table*>(n);
      free_tree(t->ids.root);
      free_tree(t->space);
      for (std::uint32_t i = 0; i < t->column_count; ++i) free_tree(t->column[i].root);
      break;
    }
    case StoredKind::tables: {
      auto* t = static_cast<Tables*>(n);
      for (std::uint32_t i = 0; i < t->count; ++i) free_tree(t->of[i]);
      break;
    }
    case StoredKind::edges: {
      auto* e = static_cast<Edges*>(n);
      for (std::uint32_t i = 0; i < e->count; ++i) {
        free_tree(e->of[i].out.root);
        free_tree(e->of[i].in.root);
      }
      break;
    }
    case StoredKind::space:
      space_children(n, [this](Stored* c) { free_tree(c); });
      break;
    default:
      break;
  }
  free_now(n);
}

void Memory::retire(Stored* n) {
  if (live_.empty() || live_.back().version < n->birth())
    free_now(n);
  else
    live_.back().retired.push_back(n);
}

std::uint64_t Memory::seal() {
  Live live{epoch_, {}};
  if (!spare_.empty()) {
    live.retired = std::move(spare_.back());
    spare_.pop_back();
  }
  live_.push_back(std::move(live));
  return epoch_++;
}

void Memory::release(std::uint64_t version) {
  const std::lock_guard lock(mutex_);
  released_.push_back(version);
  has_released_.store(true, std::memory_order_release);
}

void Memory::collect() {
  if (!has_released_.load(std::memory_order_acquire)) return;
  {
    const std::lock_guard lock(mutex_);
    collecting_.swap(released_);
    has_released_.store(false, std::memory_order_relaxed);
  }
  for (const std::uint64_t v : collecting_) drop(v);
  collecting_.clear();
}

void Memory::drop(std::uint64_t version) {
  const auto at = std::lower_bound(live_.begin(), live_.end(), version,
                                   [](const Live& l, std::uint64_t v) { return l.version < v; });
  std::vector<Stored*> retired = std::move(at->retired);
  Live* older = at == live_.begin() ? nullptr : &*(at - 1);
  for (Stored* n : retired)
    if (older && older->version >= n->birth())
      older->retired.push_back(n);
    else
      free_now(n);
  retired.clear();
  if (spare_.size() < 8 && retired.capacity() < 4096) spare_.push_back(std::move(retired));
  live_.erase(at);
}

// ---------------------------------------------------------------- arrays

namespace {

Inner* make_inner(Memory& m) {
  auto* n = static_cast<Inner*>(m.allocate(sizeof(Inner)));
  std::memset(static_cast<void*>(n), 0, sizeof(Inner));
  n->stamp = m.stamp(StoredKind::inner);
  return n;
}

Inner* my_inner(Memory& m, Stored* old) {
  if (m.is_mine(old)) return static_cast<Inner*>(old);
  auto* n = static_cast<Inner*>(m.allocate(sizeof(Inner)));
  std::memcpy(static_cast<void*>(n), static_cast<const void*>(old), sizeof(Inner));
  n->stamp = m.stamp(StoredKind::inner);
  m.retire(old);
  return n;
}

}  // namespace

void* edit(Memory& m, Array& a, StoredKind kind, std::size_t row, const void* fill) {
  const LeafOps& ops = leaf_ops(kind);
  const std::size_t index = row >> ops.shift;
  while (index >> (kFanBits * a.levels)) {
    if (a.root) {
      Inner* top = make_inner(m);
      top->child[0] = a.root;
      a.root = top;
    }
    ++a.levels;
  }
  Stored** slot = &a.root;
  for (unsigned l = a.levels; l > 0; --l) {
    *slot = *slot ? my_inner(m, *slot) : make_inner(m);
    slot = &static_cast<Inner*>(*slot)->child[(index >> (kFanBits * (l - 1))) & (kFan - 1)];
  }
  if (!*slot) {
    auto* leaf = static_cast<Stored*>(m.allocate(ops.leaf_bytes));
    leaf->stamp = m.stamp(kind);
    ops.fill(leaf, fill);
    *slot = leaf;
  } else if (!m.is_mine(*slot)) {
    auto* leaf = static_cast<Stored*>(m.allocate(ops.leaf_bytes));
    leaf->stamp = m.stamp(kind);
    ops.copy(leaf, *slot);
    m.retire(*slot);
    *slot = leaf;
  }
  return reinterpret_cast<std::byte*>(*slot) + ops.offset +
         (row & ((std::size_t{1} << ops.shift) - 1)) * ops.value_bytes;
}

void drop_leaf(Memory& m, Array& a, StoredKind kind, std::size_t row) {
  const LeafOps& ops = leaf_ops(kind);
  if (!find_leaf(a, row, ops.shift)) return;
  const std::size_t index = row >> ops.shift;
  Stored** slot = &a.root;
  for (unsigned l = a.levels; l > 0; --l) {
    *slot = my_inner(m, *slot);
    slot = &static_cast<Inner*>(*slot)->child[(index >> (kFanBits * (l - 1))) & (kFan - 1)];
  }
  m.retire(*slot);
  *slot = nullptr;
}

}  // namespace rigor::world
