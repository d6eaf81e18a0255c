// Who wants to hear of what: tables by node, attribute, edge and type, so that a change finds its subscribers
// at the cost of those alone.
#pragma once

#include <memory>
#include <span>
#include <unordered_map>
#include <vector>

#include "sim/world/graph/database.h"

namespace rigor::world {

[[nodiscard]] bool passes(const Schema& schema, const Filter& filter, const Change& change);

class Signals {
 public:
  std::uint64_t add(const Filter& filter, Subscriber subscriber);
  /// May be called by a subscriber while it is told.
  void end(std::uint64_t id);
  [[nodiscard]] bool empty() const { return watches_.empty(); }
  /// Tells each subscriber once, in the order in which they subscribed. Returns how many were told.
  std::size_t deliver(const Schema& schema, const ChangeSet& set);

 private:
  struct Watch {
    std::uint64_t id;
    Filter filter;
    Subscriber subscriber;
    bool ended = false;
    std::vector<std::uint32_t> hits;
  };
  using List = std::vector<std::shared_ptr<Watch>>;
  List& list_of(const Filter& filter);

  std::uint64_t next_id_ = 1;
  std::unordered_map<std::uint64_t, std::shared_ptr<Watch>> watches_;
  std::unordered_map<NodeId, List> by_node_;
  std::vector<List> by_attribute_, by_edge_, by_type_;
  List any_;
  List called_;
};

}  // namespace rigor::world
