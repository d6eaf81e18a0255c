#include "bench/expect/safe_state.h"

#include <algorithm>

namespace rigor::expect {
namespace {

Duration took(const SafeState::Seen& s) { return std::max(Duration(0), s.t_safe - s.t_began); }

void count(Reactions& r, Duration d) {
  r.minimum = r.judged == 0 ? d : std::min(r.minimum, d);
  r.maximum = r.judged == 0 ? d : std::max(r.maximum, d);
  ++r.judged;
}

/// A stretch fails once, at its first instant that is wrong.
void fail_at(SafeState::Seen& s, BenchTime t, Reactions::How how) {
  if (s.failed) return;
  s.failed = true;
  s.first_failed = s.reactions.failed++ == 0;
  if (!s.first_failed) return;
  s.reactions.how = how;
  s.reactions.t_began = s.t_began;
  s.reactions.t_failed = t;
  s.reactions.took = took(s);
}

}  // namespace

void SafeState::begin(BenchTime t0) noexcept {
  seen_ = {};
  seen_.t_safe = t0;
}

void SafeState::command(const Command& c) noexcept {
  const bool safe = std::ranges::all_of(safe_, [&](const auto& value) {
    return value.first < c.count && c.value[value.first] == value.second;
  });
  if (safe && !seen_.safe) seen_.t_safe = c.t_effect;
  if (!safe && seen_.safe) seen_.t_unsafe = c.t_effect;
  seen_.safe = safe;
}

void SafeState::made_safe(BenchTime t) noexcept {
  if (!seen_.safe) seen_.t_safe = t;
  seen_.safe = true;
}

void SafeState::cycle(BenchTime t, bool wrong, bool counts) noexcept {
  Seen& s = seen_;
  const bool begins = wrong && !s.was_wrong;
  s.was_wrong = wrong;
  if (begins && counts && !s.open) {
    ++s.reactions.begun;
    s.t_began = t;
    s.open = true;
    s.decided = s.failed = s.first_failed = s.waiting = false;
  }
  if (!s.open) return;
  // It may have ended in a cycle that the loop skipped.
  if (!s.decided && t >= s.t_began + within_ && (wrong || t > s.t_began + within_)) decide(s);
  if (s.decided && wrong && !s.safe) fail_at(s, s.t_unsafe, Reactions::How::left);
  if (s.waiting && s.safe) {
    s.waiting = false;
    count(s.reactions, took(s));
    if (s.first_failed) s.reactions.how = Reactions::How::late, s.reactions.took = took(s);
  }
  if (!wrong) close(s, t);
}

/// At the end of `within`.
void SafeState::decide(Seen& s) const noexcept {
  const BenchTime deadline = s.t_began + within_;
  s.decided = true;
  if (s.t_safe <= deadline && (s.safe || s.t_unsafe > deadline)) {
    count(s.reactions, took(s));
  } else {
    fail_at(s, deadline, Reactions::How::never);  // so far
    s.waiting = true;
  }
}

void SafeState::close(Seen& s, BenchTime t) const noexcept {
  s.open = false;
  if (s.waiting) {
    s.waiting = false;
    count(s.reactions, t - s.t_began);
  } else if (!s.decided && s.safe && s.t_safe <= s.t_began + within_) {
    count(s.reactions, took(s));
  }
}

Reactions SafeState::reactions(Seen s, BenchTime now, bool ended) const noexcept {
  if (s.open && ended) {
    close(s, now);
  } else if (s.waiting) {
    count(s.reactions, now - s.t_began);
  }
  return s.reactions;
}

}  // namespace rigor::expect
