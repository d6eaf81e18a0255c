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
  unknown_.store(0, std::memory_order_relaxed);
  return inner_->start(t0);
}

Status TypedSource::do_stop() {
  if (inner_->state() == ChannelState::armed || inner_->state() == ChannelState::running)
    return inner_->stop();
  return {};
}

void TypedSource::begin_cycle(BenchTime now) noexcept { inner_->begin_cycle(now); }

SampleLease TypedSource::poll(BenchTime now) noexcept {
  SampleLease sample = inner_->poll(now);
  // Converted in its own slot, which nobody else reads yet.
  if (SampleSlot s = sample.take_back()) {
    if (const auto* block = s->as<RegisterBlock>()) {
      const RegisterBlock values = *block;
      if (!values_->convert(values, s->stamp.t_capture, *s) && !(s->stamp.validity & kIncomplete)) {
        s->stamp.validity |= kIncomplete;
        unknown_.fetch_add(1, std::memory_order_relaxed);
      }
    }
    sample = std::move(s);
  } else {
    sample.reset();  // shared by its source, which must not be; its sequence is missing then
  }
  return sample;
}

HealthSnapshot TypedSource::health() const noexcept {
  HealthSnapshot h = inner_->health();
  h.incomplete += unknown_.load(std::memory_order_relaxed);
  return h;
}

}  // namespace rigor
