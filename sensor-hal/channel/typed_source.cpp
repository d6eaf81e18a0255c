#include "sensor-hal/channel/typed_source.h"

namespace rigor {

TypedSource::~TypedSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)do_stop();
}

Status TypedSource::do_configure(const ChannelConfig& config) {
  const WheelGeometry wheels{config.params.number_or("wheel_radius_m", 0, {.min = 0, .max = 100}),
                             config.params.number_or("track_m", 0, {.min = 0, .max = 100})};
  ChannelConfig as_registers = config;
  as_registers.kind = SampleKind::register_block;
  if (auto s = inner_->configure(as_registers); !s) return s;
  const ChannelDescription& d = inner_->describe();
  if (d.kind != SampleKind::register_block)
    return tl::unexpected<Error>(
        config.params
            .error("kind",
                   "expected a backend that gives registers or signals of a bus for a channel of "
                   "this kind, got one that does not")
            .error());
  auto values = TypedValues::make(config.kind, d.names, wheels);
  if (!values) return tl::unexpected<Error>(config.params.error("kind", values.error().message).error());
  values_ = *values;
  description_ = {};
  description_.kind = config.kind;
  description_.frame_id = d.frame_id;
  return {};
}

Status TypedSource::do_start(BenchTime t0) {
  values_->reset();
  unknown_ = 0;
  return inner_->start(t0);
}

Status TypedSource::do_stop() {
  Status stopped;
  if (inner_->state() == ChannelState::armed || inner_->state() == ChannelState::running)
    stopped = inner_->stop();
  mirror_health();
  return stopped;
}

void TypedSource::begin_cycle(BenchTime now) noexcept {
  inner_->begin_cycle(now);
  mirror_health();
}

SampleLease TypedSource::poll(BenchTime now) noexcept {
  SampleLease sample = inner_->poll(now);
  if (sample) {
    // The source has handed it on, and nobody else has it yet: it is written in its own slot.
    Sample& s = sample.edit();
    if (const auto* block = s.as<RegisterBlock>()) {
      const RegisterBlock values = *block;
      if (!values_->convert(values, s.stamp.t_capture, s) && !(s.stamp.validity & kIncomplete)) {
        s.stamp.validity |= kIncomplete;
        ++unknown_;
      }
    }
  }
  mirror_health();
  return sample;
}

void TypedSource::mirror_health() noexcept {
  const Health& from = inner_->health();
  const auto copy = [](const auto& a, auto& b) {
    b.store(a.load(std::memory_order_relaxed), std::memory_order_relaxed);
  };
  copy(from.connected, health_.connected);
  copy(from.received, health_.received);
  copy(from.lost, health_.lost);
  copy(from.no_slot, health_.no_slot);
  copy(from.ring_full, health_.ring_full);
  copy(from.protocol_errors, health_.protocol_errors);
  copy(from.retries, health_.retries);
  copy(from.reconnects, health_.reconnects);
  health_.incomplete.store(from.incomplete.load(std::memory_order_relaxed) + unknown_,
                           std::memory_order_relaxed);
}

}  // namespace rigor
