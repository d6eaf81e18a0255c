#include "sim/world/graph/log.h"

namespace rigor::world {

template <class F>
auto Log::with_kind(ValueKind kind, const F& f) {
  switch (kind) {
    case ValueKind::flag:
      return f(std::integral_constant<std::size_t, 0>());
    case ValueKind::integer:
      return f(std::integral_constant<std::size_t, 1>());
    case ValueKind::number:
      return f(std::integral_constant<std::size_t, 2>());
    case ValueKind::text:
      return f(std::integral_constant<std::size_t, 3>());
    case ValueKind::vector3:
      return f(std::integral_constant<std::size_t, 4>());
    case ValueKind::pose:
      return f(std::integral_constant<std::size_t, 5>());
    case ValueKind::motion:
      return f(std::integral_constant<std::size_t, 6>());
    case ValueKind::numbers:
      return f(std::integral_constant<std::size_t, 7>());
    default:
      return f(std::integral_constant<std::size_t, 8>());
  }
}

std::uint64_t Log::keep(ValueKind kind, const void* value) {
  return with_kind(kind, [&](auto k) -> std::uint64_t {
    auto& list = std::get<k()>(values_);
    using T = decltype(list[0].v);
    list.push_back({*static_cast<const std::remove_reference_t<T>*>(value)});
    return list.size() - 1;
  });
}

const void* Log::kept(ValueKind kind, std::uint64_t at) const {
  return with_kind(kind, [&](auto k) -> const void* { return &std::get<k()>(values_)[at].v; });
}

void Log::clear() {
  // A transaction of a million writes must not keep its room for good.
  constexpr std::size_t kKeep = 1 << 12;
  const auto empty = [](auto& list) {
    if (list.capacity() > kKeep)
      std::decay_t<decltype(list)>().swap(list);
    else
      list.clear();
  };
  empty(ops);
  empty(dynamics);
  empty(nodes);
  std::apply([&](auto&... list) { (empty(list), ...); }, values_);
}

std::size_t Log::bytes() const {
  std::size_t n = ops.capacity() * sizeof(Op) + dynamics.capacity() * sizeof(OldDynamic) +
                  nodes.capacity() * sizeof(OldNode);
  std::apply([&](auto&... list) { ((n += list.capacity() * sizeof(list[0])), ...); }, values_);
  return n;
}

}  // namespace rigor::world
