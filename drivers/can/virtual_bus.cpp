#include "drivers/can/virtual_bus.h"

#include <algorithm>
#include <limits>
#include <tuple>

namespace rigor::can {

void VirtualBus::join(Participant* p, Rank rank) {
  if (members_.empty()) {  // a new run begins
    waiting_.clear();
    is_busy_ = false;
    t_ = BenchTime(std::numeric_limits<std::int64_t>::min());
    order_ = frames_ = 0;
    busy_ = {};
  }
  const auto place =
      std::find_if(members_.begin(), members_.end(), [&](const Member& m) { return m.rank > rank; });
  members_.insert(place, {p, rank});
}

void VirtualBus::leave(const Participant* p) {
  std::erase_if(members_, [&](const Member& m) { return m.participant == p; });
  std::erase_if(waiting_, [&](const Waiting& w) { return w.from == p; });
}

bool VirtualBus::send(const Participant* from, const CanFrame& frame) {
  if (waiting_.size() >= 4096) return false;
  waiting_.push_back({from, frame, order_++});
  return true;
}

void VirtualBus::start_next() {
  if (waiting_.empty()) return;
  const auto winner =
      std::min_element(waiting_.begin(), waiting_.end(), [](const Waiting& a, const Waiting& b) {
        return std::tuple(arbitration(a.frame), a.order) < std::tuple(arbitration(b.frame), b.order);
      });
  on_bus_ = *winner;
  waiting_.erase(winner);
  const Duration takes = frame_duration(on_bus_.frame, rates_);
  busy_ += takes;
  end_ = t_ + takes;
  is_busy_ = true;
}

void VirtualBus::deliver() {
  is_busy_ = false;
  ++frames_;
  const Waiting done = on_bus_;
  for (std::size_t i = 0; i < members_.size(); ++i)
    if (members_[i].participant != done.from) members_[i].participant->receive(done.frame, t_);
}

void VirtualBus::advance(BenchTime now) {
  while (true) {
    Member first{nullptr, Rank::command};
    BenchTime when = BenchTime::never();
    for (const auto& m : members_)  // the first of equal ones: they stand by rank
      if (const auto t = m.participant->next_action(now); t < when) when = t, first = m;
    // The bus goes on at the instant itself, after all that acts there.
    if (is_busy_ && end_ <= when && end_ <= now) {
      t_ = std::max(t_, end_);
      deliver();
      continue;
    }
    if (!is_busy_ && !waiting_.empty() && (when > t_ || !first.participant)) {
      start_next();
      continue;
    }
    if (!first.participant || when > now) return;
    t_ = std::max(t_, when);
    first.participant->act(when);
  }
}

}  // namespace rigor::can
