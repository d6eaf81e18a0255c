#include "sim/world/graph/signals.h"

#include <algorithm>

namespace rigor::world {

bool passes(const Schema& schema, const Filter& filter, const Change& change) {
  if (filter.node && filter.node != change.node) return false;
  if (filter.attribute && (change.kind != ChangeKind::changed || change.attribute != *filter.attribute))
    return false;
  if (filter.edge && ((change.kind != ChangeKind::connected && change.kind != ChangeKind::disconnected) ||
                      change.edge != *filter.edge))
    return false;
  return !filter.type || schema.is_a(change.type, *filter.type);
}

Signals::List& Signals::list_of(const Filter& filter) {
  const auto at = [](std::vector<List>& lists, std::size_t i) -> List& {
    if (lists.size() <= i) lists.resize(i + 1);
    return lists[i];
  };
  if (filter.node) return by_node_[filter.node];
  if (filter.attribute) return at(by_attribute_, filter.attribute->value);
  if (filter.edge) return at(by_edge_, filter.edge->value);
  if (filter.type) return at(by_type_, filter.type->value);
  return any_;
}

std::uint64_t Signals::add(const Filter& filter, Subscriber subscriber) {
  auto w = std::make_shared<Watch>(Watch{next_id_++, filter, std::move(subscriber), false, {}});
  list_of(filter).push_back(w);
  watches_.emplace(w->id, w);
  return w->id;
}

void Signals::end(std::uint64_t id) {
  const auto it = watches_.find(id);
  if (it == watches_.end()) return;
  const auto w = it->second;  // lives on while it is told
  w->ended = true;
  watches_.erase(it);
  List& list = list_of(w->filter);
  list.erase(std::find(list.begin(), list.end(), w));
  if (w->filter.node && list.empty()) by_node_.erase(w->filter.node);
}

std::size_t Signals::deliver(const Schema& schema, const ChangeSet& set) {
  const auto offer = [&](const List& list, std::uint32_t i) {
    for (const auto& w : list)
      if (passes(schema, w->filter, set.changes[i])) {
        if (w->hits.empty()) called_.push_back(w);
        w->hits.push_back(i);
      }
  };
  for (std::uint32_t i = 0; i < set.changes.size(); ++i) {
    const Change& c = set.changes[i];
    offer(any_, i);
    if (!by_type_.empty())
      for (TypeId t = c.type;; t = schema.base(t)) {
        if (t.value < by_type_.size()) offer(by_type_[t.value], i);
        if (t.value == 0) break;
      }
    if (c.attribute.value < by_attribute_.size()) offer(by_attribute_[c.attribute.value], i);
    if (c.edge.value < by_edge_.size()) offer(by_edge_[c.edge.value], i);
    if (!by_node_.empty())
      if (const auto it = by_node_.find(c.node); it != by_node_.end()) offer(it->second, i);
  }
  if (called_.size() > 1)
    std::sort(called_.begin(), called_.end(), [](const auto& a, const auto& b) { return a->id < b->id; });
  std::size_t told = 0;
  List called;
  called.swap(called_);
  std::vector<Change> mine;
  for (const auto& w : called) {
    if (!w->ended) {
      ++told;
      if (w->hits.size() == set.changes.size()) {
        w->subscriber(set, set.changes);
      } else {
        mine.clear();
        for (const std::uint32_t i : w->hits) mine.push_back(set.changes[i]);
        w->subscriber(set, mine);
      }
    }
    w->hits.clear();
  }
  called.clear();
  called_.swap(called);
  return told;
}

}  // namespace rigor::world
