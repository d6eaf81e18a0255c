#include "sensor-hal/channel/fault_sink.h"

#include <algorithm>

namespace rigor {
FaultySink::FaultySink(std::unique_ptr<Sink> inner) : inner_(std::move(inner)) {}

FaultySink::~FaultySink() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)do_stop();
}

Status FaultySink::do_configure(const ChannelConfig& config) {
  (void)config.params.list_or_empty("faults");
  if (auto s = inner_->configure(config); !s) return s;
  description_ = inner_->describe();
  faults_.configure({config.name, SampleKind::register_block, true, &description_, {}}, config.seed,
                    config.params);
  return {};
}

Status FaultySink::do_arm(const ArmContext& context) {
  loop_period_ = context.loop_period;
  if (auto s = inner_->arm(context); !s) return s;
  faults_.arm();
  return {};
}

Status FaultySink::do_start(BenchTime t0) {
  if (auto s = inner_->start(t0); !s) return s;
  any_ = false;
  lost_.store(0, std::memory_order_relaxed);
  faults_.start(t0, loop_period_);
  return {};
}

Status FaultySink::do_stop() {
  faults_.stop();
  if (inner_->state() == ChannelState::armed || inner_->state() == ChannelState::running)
    return inner_->stop();
  return {};
}

void FaultySink::complete_until(BenchTime now) { inner_->complete_until(now); }

bool FaultySink::command(const Command& given) noexcept {
  faults_.begin_cycle(given.t_issue);
  if (faults_.active().empty()) {
    Command c = given;
    if (any_) c.t_effect = std::max(c.t_effect, last_effect_);
    return inner_->command(c);
  }
  Command c = given;
  Duration delay;
  bool lost = false;
  for (Fault* f : faults_.active()) {
    count(f->count.seen);
    switch (f->spec.kind) {
      case FaultKind::drop:
      case FaultKind::burst_loss:
      case FaultKind::disconnect: {
        const bool hit = f->spec.kind == FaultKind::drop         ? fault_hits(*f, c.sequence)
                         : f->spec.kind == FaultKind::burst_loss ? burst_loses(*f, c.sequence)
                                                                 : true;
        if (hit && !lost) count(f->count.dropped);
        lost |= hit;
        break;
      }
      case FaultKind::delay:
      case FaultKind::jitter:
        if (lost || !fault_hits(*f, c.sequence)) break;
        delay += fault_delay(*f, c.sequence);
        count(f->count.delayed);
        break;
      case FaultKind::stuck:
        if (lost) break;
        if (f->has_kept_values) {
          c.value = f->kept_values;
          count(f->count.changed);
        } else {
          f->kept_values = given.value;
          f->has_kept_values = true;
        }
        break;
      case FaultKind::bias:
      case FaultKind::drift:
      case FaultKind::noise:
      case FaultKind::spike: {
        if (lost || !fault_hits(*f, c.sequence)) break;
        const auto i = static_cast<std::size_t>(f->component);
        if (i < c.count) c.value[i] += edit_amount(fault_edit(*f, c.sequence, c.t_issue));
        count(f->count.changed);
        break;
      }
      case FaultKind::corrupt:
      case FaultKind::timestamp:
      case FaultKind::clock_skew:
      case FaultKind::clock_step:
      case FaultKind::slow_consumer:
        break;  // refused by read_fault
    }
  }
  if (lost) {
    count(lost_);
    return true;
  }
  c.t_effect = c.t_effect + delay;
  if (any_) c.t_effect = std::max(c.t_effect, last_effect_);
  last_effect_ = c.t_effect;
  any_ = true;
  return inner_->command(c);
}

SinkSnapshot FaultySink::counters() const noexcept {
  SinkSnapshot n = inner_->counters();
  const std::uint64_t lost = lost_.load(std::memory_order_relaxed);
  n.accepted += lost;
  n.dropped += lost;
  return n;
}

}  // namespace rigor
