// The loop's side of the recorder, and what any thread may ask.
#include "sensor-hal/record/recorder.h"

#include <cstring>

#include "sensor-hal/record/recorder_impl.h"

namespace rigor {
Recorder::Recorder(std::unique_ptr<Impl> impl) : impl_(std::move(impl)), failed_(impl_->failed) {}

Result<std::unique_ptr<Recorder>> Recorder::create(const std::string& path, RecorderOptions options,
                                                   std::vector<RecordedChannel> channels,
                                                   std::vector<RecordedSink> sinks,
                                                   std::map<std::string, std::string> metadata) {
  auto sink = record::open_file_sink(path, options.file);
  if (!sink) return tl::unexpected<Error>(sink.error());
  return create(std::move(*sink), std::move(options), std::move(channels), std::move(sinks),
                std::move(metadata));
}

Result<std::unique_ptr<Recorder>> Recorder::create(std::unique_ptr<record::ByteSink> sink,
                                                   RecorderOptions options,
                                                   std::vector<RecordedChannel> channels,
                                                   std::vector<RecordedSink> sinks,
                                                   std::map<std::string, std::string> metadata) {
  auto writer = record::McapWriter::open(std::move(sink), options.writer);
  if (!writer) return tl::unexpected<Error>(writer.error());
  return create(std::unique_ptr<record::MessageWriter>(std::move(*writer)), std::move(options),
                std::move(channels), std::move(sinks), std::move(metadata));
}

Result<std::unique_ptr<Recorder>> Recorder::create(std::unique_ptr<record::MessageWriter> writer,
                                                   RecorderOptions options,
                                                   std::vector<RecordedChannel> channels,
                                                   std::vector<RecordedSink> sinks,
                                                   std::map<std::string, std::string> metadata) {
  auto impl = std::make_unique<Impl>();
  impl->options = std::move(options);
  impl->channels = std::move(channels);
  impl->sinks = std::move(sinks);
  impl->metadata = std::move(metadata);
  if (auto s = impl->open(std::move(writer)); !s) return tl::unexpected<Error>(s.error());
  std::unique_ptr<Recorder> recorder(new Recorder(std::move(impl)));
  Impl& i = *recorder->impl_;
  for (std::size_t c = 0; c < i.channels.size(); ++c) {
    i.observers[c].recorder = recorder.get();
    i.observers[c].channel = static_cast<std::uint32_t>(c);
  }
  i.thread = std::thread([&i] { i.work(); });
  return recorder;
}

Recorder::~Recorder() {
  if (impl_) (void)stop();
}

PairObserver* Recorder::observer(std::uint32_t channel) noexcept { return &impl_->observers[channel]; }

// ------------------------------------------------------------------ loop

bool Recorder::Impl::push(Item&& item) noexcept {
  while (!ring->try_push(std::move(item))) {
    if (!options.virtual_time) return false;
    sem_post(&wake);
    nap(50'000);
  }
  return true;
}

void Recorder::Impl::sample(std::uint32_t index, const SampleLease& lease) noexcept {
  if (!lease || index >= streams.size() || !streams[index]) return;
  Stream& s = *streams[index];
  sides[index / 2].newest[index % 2] = &*lease;
  Item item;
  item.channel = index;
  const std::size_t size = lease->size_bytes;
  if (size <= kCopyBytes) {
    item.kind = Item::Kind::copy;
    while (copies_held.load(std::memory_order_acquire) >= copies->size()) {
      if (!options.virtual_time) return drop(s);
      sem_post(&wake);
      nap(50'000);
    }
    SampleSlot copy = copies->try_acquire();
    if (!copy) return drop(s);
    copies_held.fetch_add(1, std::memory_order_relaxed);
    copy->stamp = lease->stamp;
    copy->info = lease->info;
    copy->size_bytes = size;
    if (size > 0) std::memcpy(copy->memory().data(), lease->bytes().data(), size);
    item.lease = std::move(copy);
  } else {
    // In virtual time the loop ends each cycle with nothing under way, so what is held here are samples that
    // wait for their release: a budget would make it depend on arrival.
    if (!options.virtual_time && (s.leases.load(std::memory_order_acquire) >= s.lease_budget ||
                                  bytes_held.load(std::memory_order_acquire) + size > options.budget_bytes))
      return drop(s);
    item.kind = Item::Kind::sample;
    item.lease = lease;
    s.leases.fetch_add(1, std::memory_order_relaxed);
    bytes_held.fetch_add(size, std::memory_order_relaxed);
  }
  const bool copied = item.kind == Item::Kind::copy;
  if (!push(std::move(item))) {
    if (copied) {
      copies_held.fetch_sub(1, std::memory_order_relaxed);
    } else {
      s.leases.fetch_sub(1, std::memory_order_relaxed);
      bytes_held.fetch_sub(size, std::memory_order_relaxed);
    }
    drop(s);
  }
}

void Recorder::begin(BenchTime t0) noexcept {
  Impl::Item item;
  item.kind = Impl::Item::Kind::begin;
  item.t = t0;
  impl_->first_motion = impl_->next_motion = t0;
  (void)impl_->push(std::move(item));  // it is the first: there is a place
}

void Recorder::record(std::uint32_t channel, const SampleLease& sample) noexcept {
  impl_->sample(channel * 2, sample);
}

void Recorder::record_side(std::uint32_t channel, PairSide side, const SampleLease& sample) noexcept {
  impl_->sample(channel * 2 + static_cast<std::uint32_t>(side), sample);
}

void Recorder::record_visibility(std::uint32_t channel, std::uint64_t cycle, BenchTime t, PortStatus status,
                                 const SampleLease& sample) noexcept {
  if (!impl_->channels[channel].wanted) return;
  Impl::Item item;
  item.kind = Impl::Item::Kind::visibility;
  item.channel = channel;
  item.cycle = cycle;
  item.t = t;
  item.status = status;
  auto& sides = impl_->sides[channel];
  if (sample)
    for (std::size_t i = 0; i < 2; ++i)
      if (sides.newest[i] == &*sample) sides.shown = static_cast<PairSide>(i);
  item.side = sides.shown;
  if (sample) {
    item.has_sample = true;
    item.stamp = sample->stamp;
  }
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_skipped(std::uint64_t first, std::uint64_t count, BenchTime t) noexcept {
  Impl::Item item;
  item.kind = Impl::Item::Kind::skipped;
  item.cycle = first;
  item.stamp.sequence = count;
  item.t = t;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_command(std::uint32_t sink, const Command& command) noexcept {
  Impl::Item item;
  item.kind = Impl::Item::Kind::command;
  item.channel = sink;
  item.t = command.t_issue;
  item.command = command;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_event(std::uint32_t channel, const SampleLease& event) noexcept {
  if (!event) return;
  Impl::Item item;
  item.kind = Impl::Item::Kind::event;
  item.channel = channel;
  item.t = event->stamp.t_release;
  item.lease = event;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_fault(const FaultChange& change) noexcept {
  if (!change) return;
  Impl::Item item;
  item.kind = Impl::Item::Kind::fault;
  item.t = change.t;
  item.change = change;
  item.change.event.reset();
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_window(std::uint32_t channel, const SampleLease& window) noexcept {
  if (!window || channel >= impl_->channels.size() || impl_->channels[channel].watched.empty()) return;
  Impl::Item item;
  item.kind = Impl::Item::Kind::window;
  item.channel = channel;
  item.t = window->stamp.t_release;
  item.lease = window;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

bool Recorder::motion_due(BenchTime t) const noexcept {
  return impl_->want_motion && t >= impl_->next_motion;
}

void Recorder::record_motion(const WorldMotion& motion, BenchTime t) noexcept {
  Impl& i = *impl_;
  const Period& period = i.options.frames_period;
  i.next_motion = i.first_motion + period * ((t - i.first_motion) / period + 1);
  while (!i.motions.try_push({t, motion})) {
    if (!i.options.virtual_time) {
      i.other_dropped.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    sem_post(&i.wake);
    Impl::nap(50'000);
  }
}

void Recorder::end_cycle(std::uint64_t cycle, BenchTime t) noexcept {
  Impl::Item item;
  item.kind = Impl::Item::Kind::end_cycle;
  item.cycle = cycle;
  item.t = t;
  // A lost mark costs nothing: the next one stands for both.
  if (!impl_->push(std::move(item))) return;
  if (impl_->options.live || impl_->options.virtual_time) sem_post(&impl_->wake);
  if (!impl_->options.virtual_time) return;
  Impl::wait_on(impl_->done);
}

// ------------------------------------------------------------------ any thread

Error Recorder::error() const {
  {
    const std::lock_guard lock(impl_->error_mutex);
    if (impl_->error) return *impl_->error;
  }
  return {
      ErrorCode::io, "recorder",
      "the recording lacks " + std::to_string(impl_->all_dropped()) +
          " entries, because the disk could not keep up, and `fail_on_drop` says that this fails the run"};
}

void Recorder::add_closing_metadata(std::map<std::string, std::string> values) {
  impl_->closing_metadata.merge(values);  // read by the writer thread after it saw `stopping`
}

Status Recorder::stop() {
  Impl& i = *impl_;
  if (!i.stopped) {
    i.stopped = true;
    i.stopping.store(true, std::memory_order_release);
    sem_post(&i.wake);
    if (i.thread.joinable()) i.thread.join();
  }
  if (failed()) return tl::unexpected<Error>(error());
  return {};
}

Recorder::Statistics Recorder::statistics() const {
  const Impl& i = *impl_;
  Statistics s;
  s.messages = i.messages.load(std::memory_order_relaxed);
  s.bytes = i.bytes.load(std::memory_order_relaxed);
  s.chunks = i.chunks.load(std::memory_order_relaxed);
  s.samples = i.samples_written.load(std::memory_order_relaxed);
  s.after_end = i.after_end.load(std::memory_order_relaxed);
  s.dropped = i.all_dropped();
  s.cpu_s = static_cast<double>(i.cpu_ns.load(std::memory_order_relaxed)) * 1e-9;
  for (std::size_t c = 0; c < i.channels.size(); ++c) {
    std::uint64_t dropped = 0, written = 0;
    for (std::size_t side = 0; side < 2; ++side)
      if (const auto& stream = i.streams[c * 2 + side]) {
        dropped += stream->dropped.load(std::memory_order_relaxed);
        written += stream->written.load(std::memory_order_relaxed);
      }
    s.dropped_by_channel.push_back(dropped);
    s.samples_by_channel.push_back(written);
  }
  return s;
}

}  // namespace rigor
