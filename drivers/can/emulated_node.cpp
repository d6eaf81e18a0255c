#include "drivers/can/emulated_node.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "drivers/can/signal_codec.h"
#include "rt-core/numbers.h"

namespace rigor::can {
namespace {

constexpr std::size_t kMostTurns = 256;

std::vector<std::uint64_t> values_in_turn(const Message& m, int multiplexor) {
  std::set<std::uint64_t> values;
  for (const auto& s : m.signals) {
    if (s.multiplexed_by != multiplexor) continue;
    for (const auto& r : s.shown)
      for (std::uint64_t v = r.first; values.size() < kMostTurns; ++v) {
        values.insert(v);
        if (v == r.last) break;
      }
  }
  return {values.begin(), values.end()};
}

}  // namespace

Result<std::unique_ptr<EmulatedNode>> EmulatedNode::make(const NodeSettings& settings,
                                                         std::shared_ptr<SignalModel> model) {
  std::unique_ptr<EmulatedNode> node(new EmulatedNode(settings, std::move(model)));
  if (auto s = node->bind(); !s) return tl::unexpected<Error>(s.error());
  if (!settings.replay.empty())
    if (auto s = node->open_log(); !s) return tl::unexpected<Error>(s.error());
  return node;
}

Status EmulatedNode::open_log() {
  auto log = LogReader::open(settings_.replay);
  if (!log) return tl::unexpected<Error>(log.error());
  log_.emplace(std::move(*log));
  bool any = false;
  while (true) {
    const auto entry = log_->next();
    if (!entry) return tl::unexpected<Error>(entry.error());
    if (!*entry) return {};
    const RealtimeTime t = (*entry)->t;
    if (!any) log_first_ = t;
    any = true;
    if (t + seconds(1) < log_first_ + log_length_)
      return fail(ErrorCode::bad_input, settings_.replay.string(),
                  "expected lines in the order of time, got one that goes back by more than a second: " +
                      format_log_line(**entry) + "; sort the file");
    log_length_ = std::max(log_length_, t - log_first_);
  }
}

/// What cannot be read any more, for the file is another by now, ends the log.
void EmulatedNode::next_of_log() {
  auto entry = log_->next();
  if (!entry) ++counters_.failed;
  log_next_ = entry ? *entry : std::nullopt;
  if (log_next_) log_due_ = std::max(log_due_, log_start_ + (log_next_->t - log_first_));
}

int EmulatedNode::model_index(const std::string& signal) const {
  if (!model_) return -1;
  std::string name = signal;
  for (const auto& [from, to] : settings_.bind)
    if (from == signal) name = to;
  const auto& signals = model_->signals();
  for (std::size_t i = 0; i < signals.size(); ++i)
    if (signals[i].name == name) return static_cast<int>(i);
  return -1;
}

Status EmulatedNode::bind() {
  if (!settings_.dbc) return {};
  std::set<std::size_t> used;
  for (const auto& [from, to] : settings_.bind)
    if (model_index(from) < 0)
      return fail(ErrorCode::bad_input, "bind." + from,
                  "expected a signal of the device's model, got \"" + to + "\"");
  for (const NodeMessage& m : settings_.messages) {
    Sent s;
    s.message = m.message;
    s.period = m.period;
    s.frame = blank_frame(*m.message);
    s.values.assign(m.message->signals.size(), kNaN);
    for (std::size_t i = 0; i < m.message->signals.size(); ++i) {
      const Signal& signal = m.message->signals[i];
      const int index = model_index(signal.name);
      s.model.push_back(index);
      if (index >= 0) used.insert(static_cast<std::size_t>(index));
      if (index < 0 && signal.multiplexor && signal.multiplexed_by < 0 && s.turning < 0) {
        s.turning = static_cast<int>(i);
        s.turns = values_in_turn(*m.message, s.turning);
        if (s.turns.empty()) s.turning = -1;
      }
    }
    s.last = s.frame;
    sent_.push_back(std::move(s));
  }
  for (const Message& m : settings_.dbc->messages) {
    const bool own = std::any_of(sent_.begin(), sent_.end(), [&](const Sent& s) { return s.message == &m; });
    if (own || !m.fits_a_frame()) continue;
    Received r;
    r.message = &m;
    for (std::size_t i = 0; i < m.signals.size(); ++i) {
      const int index = model_index(m.signals[i].name);
      if (index < 0 || !model_->signals()[static_cast<std::size_t>(index)].commanded) continue;
      used.insert(static_cast<std::size_t>(index));
      r.signals.emplace_back(i, static_cast<std::size_t>(index));
    }
    if (!r.signals.empty()) received_.push_back(std::move(r));
  }
  if (model_ && !model_->signals().empty() && used.empty())
    return fail(ErrorCode::bad_input, settings_.dbc->name,
                "expected a signal with the name of one of the model's (" + model_->signals().front().name +
                    ", …), found none; name them by `bind: { SIGNAL_OF_THE_DBC: SIGNAL_OF_THE_MODEL }`");
  return {};
}

void EmulatedNode::start(BenchTime t0) {
  counters_ = {};
  for (auto& s : sent_) {
    s.next = t0;
    s.was_sent = false;
    s.turn = 0;
    s.frame = blank_frame(*s.message);
  }
  if (!log_) return;
  log_->rewind();
  log_start_ = log_due_ = t0;
  next_of_log();
}

BenchTime EmulatedNode::next_event() const noexcept {
  BenchTime t = BenchTime::never();
  for (const auto& s : sent_) t = std::min(t, s.next);
  if (log_next_) t = std::min(t, log_due_);
  return t;
}

bool EmulatedNode::compose(Sent& s, BenchTime now) {
  for (std::size_t i = 0; i < s.values.size(); ++i) {
    s.values[i] = kNaN;
    if (s.model[i] >= 0) {
      s.values[i] = model_->read(static_cast<std::size_t>(s.model[i]), now);
      if (!std::isfinite(s.values[i])) return false;
    } else if (static_cast<int>(i) == s.turning) {
      s.values[i] = value_of(s.message->signals[i], s.turns[s.turn]);
    }
  }
  std::size_t bad = 0;
  if (s.turning >= 0) {
    s.frame = blank_frame(*s.message);  // bits of the turn before are another signal's
    s.turn = (s.turn + 1) % s.turns.size();
  }
  return encode(*s.message, s.values, s.frame, bad) == EncodeStatus::good;
}

void EmulatedNode::send_one(Sent& s, BenchTime now, const std::function<bool(const CanFrame&)>& send) {
  if (!compose(s, now)) {
    ++counters_.unknown;
    return;
  }
  if (s.period.ns() == 0 && s.was_sent && s.frame.data == s.last.data) return;
  if (!send(s.frame)) {
    ++counters_.failed;  // an event message is tried again at the next look
    return;
  }
  ++counters_.sent;
  s.last = s.frame;
  s.was_sent = true;
}

void EmulatedNode::act(BenchTime now, const std::function<bool(const CanFrame&)>& send) {
  for (auto& s : sent_) {
    if (s.next > now) continue;
    const Duration period = s.period.ns() > 0 ? s.period : settings_.change_check;
    send_one(s, now, send);
    s.next = s.next + period;
    if (now - s.next > period) {
      const std::int64_t missed = (now - s.next) / period;
      if (s.period.ns() > 0) counters_.skipped += static_cast<std::uint64_t>(missed);
      s.next = s.next + period * missed;
    }
  }
  while (log_next_ && log_due_ <= now) {
    ++(send(log_next_->frame) ? counters_.sent : counters_.failed);
    next_of_log();
    if (log_next_ || !settings_.repeat) continue;
    // Again from the start, one millisecond behind the end: a log of one instant is not to spin.
    log_->rewind();
    log_start_ = log_due_ = log_start_ + log_length_ + milliseconds(1);
    next_of_log();
  }
}

void EmulatedNode::receive(const CanFrame& f, BenchTime now) {
  if (f.error || f.remote) return;
  for (const auto& r : received_) {
    if (r.message->id != f.id || r.message->extended != f.extended) continue;
    ++counters_.received;
    const std::span<const std::uint8_t> data(f.data.data(), std::min<std::size_t>(f.length, f.data.size()));
    for (const auto& [signal, index] : r.signals) {
      if (!is_shown(*r.message, signal, data)) continue;
      if (!model_->write(index, decode(*r.message, signal, data), now)) ++counters_.refused;
    }
    return;
  }
}

}  // namespace rigor::can
