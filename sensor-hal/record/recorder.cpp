#include "sensor-hal/record/recorder.h"

#include <semaphore.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <mutex>
#include <optional>
#include <queue>
#include <set>
#include <thread>

#include "rt-core/spsc_ring.h"
#include "rt-core/stage_time.h"
#include "sensor-hal/channel/event_text.h"
#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/record/pair_diagnostics.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {
namespace {

using record::MessageInfo;

}  // namespace

std::string_view event_kind(std::uint32_t code) noexcept {
  if (code == kEventWorldEdit) return "world_edit";
  if (code == kEventPairSwitch) return "pair_switch";
  if (code == kEventPairAlarm) return "pair_alarm";
  if (code == kEventPairWatching || code == kEventPairOrder) return "pair_watch";
  if (code == kEventFaultBegin || code == kEventLiveFaultBegin) return "fault_begin";
  return code == kEventFaultEnd || code == kEventLiveFaultEnd ? "fault_end" : "event";
}

namespace {

void nap(std::int64_t ns) {
  const timespec t{0, ns};
  nanosleep(&t, nullptr);
}

void wait_on(sem_t& s) {
  while (sem_wait(&s) != 0 && errno == EINTR) {
  }
}

/// One entry of the ring to the writer.
struct Item {
  enum class Kind : std::uint8_t {
    none,
    sample,
    copy,
    visibility,
    skipped,
    command,
    event,
    window,
    end_cycle
  } kind = Kind::none;
  PortStatus status = PortStatus::never;
  PairSide side = PairSide::real;
  bool has_sample = false;
  std::uint32_t channel = 0;
  std::uint64_t cycle = 0;  // visibility, skipped, end_cycle
  BenchTime t;
  SampleLease lease;  // sample, copy, event
  Stamp stamp;        // visibility: of the visible sample; skipped: sequence is the count
  Command command;
};

record::msg::Time to_time(std::int64_t utc_ns) {
  std::int64_t s = utc_ns / 1'000'000'000;
  if (utc_ns % 1'000'000'000 < 0) --s;
  return {static_cast<std::int32_t>(s), static_cast<std::uint32_t>(utc_ns - s * 1'000'000'000)};
}

}  // namespace

struct Recorder::Impl {
  /// One stream of samples: a channel, or one side of a pair.
  struct Stream {
    std::string name;  // "left", "left/real"
    std::unique_ptr<record::SampleEncoder> encoder;
    std::vector<std::uint16_t> ids;  // MCAP channels of the encoder's streams
    std::optional<record::msg::CameraInfo> camera;
    std::uint16_t camera_id = 0;
    std::size_t lease_budget = 0;
    std::atomic<std::uint32_t> leases{0};  // counted up by the loop, down by the writer
    std::atomic<std::uint64_t> dropped{0};
  };
  struct Waiting {
    BenchTime release;
    std::uint32_t stream = 0;
    std::uint64_t sequence = 0;
    bool copy = false;
    SampleLease lease;
    bool operator<(const Waiting& o) const {  // the earliest on top
      return std::tie(o.release, o.stream, o.sequence) < std::tie(release, stream, sequence);
    }
  };
  class SideObserver final : public PairObserver {
   public:
    void on_side_sample(PairSide side, const SampleLease& sample) noexcept override {
      recorder->record_side(channel, side, sample);
    }
    void on_window(const SampleLease& window) noexcept override { recorder->record_window(channel, window); }
    Recorder* recorder = nullptr;
    std::uint32_t channel = 0;
  };

  /// Of a pair: where the newest sample of each side lies, and from which side the visible one is. The sides
  /// have pools of their own, so an address belongs to one side for ever.
  struct Sides {
    std::array<const Sample*, 2> newest{};
    PairSide shown = PairSide::real;
  };

  RecorderOptions options;
  std::vector<RecordedChannel> channels;
  std::vector<RecordedSink> sinks;
  Duration to_utc;

  // Loop to writer.
  std::optional<SpscRing<Item>> ring;
  std::unique_ptr<SamplePool> copies;
  std::atomic<std::uint32_t> copies_held{0};
  std::atomic<std::uint64_t> bytes_held{0};
  std::vector<std::unique_ptr<Stream>> streams;  // channel·2 + side
  std::vector<SideObserver> observers;
  std::vector<Sides> sides;  // loop thread
  std::atomic<std::uint64_t> other_dropped{0};
  std::atomic<bool> failed{false};
  std::atomic<bool> stopping{false};
  bool stopped = false;
  sem_t wake{}, done{};

  // Writer.
  std::thread thread;
  std::map<std::string, std::string> closing_metadata;
  std::unique_ptr<record::McapWriter> writer;
  record::CdrWriter cdr;
  std::priority_queue<Waiting> waiting;
  std::vector<Item> of_cycle;
  std::uint16_t visibility_id = 0, events_id = 0, commands_id = 0, diagnostics_id = 0;
  std::uint64_t last_log_ns = 0;
  std::uint32_t visibility_count = 0, event_count = 0, window_count = 0;
  std::uint64_t noted_drops = 0;
  BenchTime noted_at{std::numeric_limits<std::int64_t>::min()};
  bool any_cycle = false;
  BenchTime last_t;
  std::uint64_t cycles = 0;  // one more than the last that was ended
  record::msg::PortVisibility visibility;

  mutable std::mutex error_mutex;
  std::optional<Error> error;
  std::atomic<std::uint64_t> samples_written{0}, messages{0}, bytes{0}, chunks{0}, after_end{0};
  std::atomic<std::int64_t> cpu_ns{0};

  Impl() {
    sem_init(&wake, 0, 0);
    sem_init(&done, 0, 0);
  }
  ~Impl() {
    sem_destroy(&wake);
    sem_destroy(&done);
  }

  // ---- setup ----
  Status open(std::unique_ptr<record::ByteSink> sink, const std::map<std::string, std::string>& metadata);
  Result<std::uint16_t> add_topic(const std::string& topic, std::string_view type);
  std::map<std::string, std::uint16_t, std::less<>> schemas;

  // ---- loop ----
  bool push(Item&& item) noexcept;
  void sample(std::uint32_t stream, const SampleLease& lease) noexcept;
  void drop(Stream& s) noexcept {
    s.dropped.fetch_add(1, std::memory_order_relaxed);
    if (options.fail_on_drop) {
      // The text is made by error(): this is the loop.
      failed.store(true, std::memory_order_release);
    }
  }

  // ---- writer ----
  void work();
  void take(Item&& item);
  void end_cycle(const Item& tick);
  void write_released(BenchTime t);
  void write_sample(Waiting&& w);
  void let_go(const Waiting& w);
  void write_visibility();
  void note_drops(BenchTime t);
  void finish();
  std::uint64_t log_time(BenchTime t) {
    const std::int64_t ns = t.ns() + to_utc.ns();
    return last_log_ns = std::max(last_log_ns, ns < 0 ? std::uint64_t{0} : static_cast<std::uint64_t>(ns));
  }
  template <class M>
  void write(std::uint16_t id, std::uint32_t sequence, BenchTime t, const M& message);
  bool check(const Status& status) {
    if (status) return true;
    set_error(status.error());
    return false;
  }
  void set_error(Error e) {
    {
      const std::lock_guard lock(error_mutex);
      if (!error) error = std::move(e);
    }
    failed.store(true, std::memory_order_release);
  }
  /// Whether the file can still take something: after an error it cannot.
  bool writable() const {
    const std::lock_guard lock(error_mutex);
    return !error;
  }
  std::uint64_t all_dropped() const {
    std::uint64_t n = other_dropped.load(std::memory_order_relaxed);
    for (const auto& s : streams)
      if (s) n += s->dropped.load(std::memory_order_relaxed);
    return n;
  }
  void publish_statistics() {
    const auto& s = writer->statistics();
    messages.store(s.messages, std::memory_order_relaxed);
    bytes.store(s.file_bytes, std::memory_order_relaxed);
    chunks.store(s.chunks, std::memory_order_relaxed);
    cpu_ns.store(StageTime::thread_cpu().ns(), std::memory_order_relaxed);
  }
};

// ------------------------------------------------------------------ setup

Result<std::uint16_t> Recorder::Impl::add_topic(const std::string& topic, std::string_view type) {
  auto it = schemas.find(type);
  if (it == schemas.end()) {
    auto id = writer->add_schema(std::string(type), "ros2msg", record::schema_text(type));
    if (!id) return id;
    it = schemas.emplace(std::string(type), *id).first;
  }
  record::ChannelOptions c;
  c.schema = it->second;
  c.topic = topic;
  c.metadata["offered_qos_profiles"] = "";
  return writer->add_channel(c);
}

Status Recorder::Impl::open(std::unique_ptr<record::ByteSink> sink,
                            const std::map<std::string, std::string>& metadata) {
  std::set<std::string> names;
  for (const auto& c : channels) {
    if (c.name.empty() || !names.insert(c.name).second)
      return fail(ErrorCode::bad_input, c.name, "expected each recorded channel to have a name of its own");
  }
  to_utc = options.epoch.utc - RealtimeTime(options.epoch.bench.ns());
  auto opened = record::McapWriter::open(std::move(sink), options.writer);
  if (!opened) return tl::unexpected<Error>(opened.error());
  writer = std::move(*opened);
  record::Metadata run{"rigor", metadata};
  run.values["t0_ns"] = std::to_string(options.t0.ns());
  run.values["loop_period_ns"] = std::to_string(options.loop_period.ns());
  run.values["utc_of_bench_0_ns"] = std::to_string(to_utc.ns());
  if (auto s = writer->add_metadata(run); !s) return s;

  streams.resize(channels.size() * 2);
  observers.resize(channels.size());
  sides.resize(channels.size());
  for (std::size_t i = 0; i < channels.size(); ++i) {
    const RecordedChannel& c = channels[i];
    for (std::size_t side = 0; side < (c.is_pair ? 2u : 1u); ++side) {
      auto stream = std::make_unique<Stream>();
      stream->name = c.name + (c.is_pair ? std::string("/") + name_of(static_cast<PairSide>(side)) : "");
      stream->lease_budget = c.lease_budget;
      record::SampleChannel sc;
      sc.name = stream->name;
      sc.topic = "/" + stream->name + "/" + std::string(record::topic_of(c.description.kind));
      sc.frame_id = c.description.frame_id;
      sc.kind = c.description.kind;
      sc.register_names = c.description.names;
      sc.register_units = c.description.units;
      sc.to_utc = to_utc;
      stream->encoder = std::make_unique<record::SampleEncoder>(sc);
      for (const auto& s : stream->encoder->streams()) {
        auto id = add_topic(s.topic, s.type);
        if (!id) return tl::unexpected<Error>(id.error());
        stream->ids.push_back(*id);
      }
      if (c.camera && c.description.kind == SampleKind::image) {
        stream->camera = c.camera;
        stream->camera->header.frame_id = c.description.frame_id;
        auto id = add_topic("/" + stream->name + "/camera_info", record::msg::CameraInfo::kType);
        if (!id) return tl::unexpected<Error>(id.error());
        stream->camera_id = *id;
      }
      streams[i * 2 + side] = std::move(stream);
    }
  }
  for (auto [topic, type, id] :
       {std::tuple("/rigor/visibility", record::msg::PortVisibility::kType, &visibility_id),
        std::tuple("/rigor/events", record::msg::Event::kType, &events_id),
        std::tuple("/rigor/commands", record::msg::Command::kType, &commands_id)}) {
    auto added = add_topic(topic, type);
    if (!added) return tl::unexpected<Error>(added.error());
    *id = *added;
  }

  if (std::any_of(channels.begin(), channels.end(), [](const auto& c) { return !c.watched.empty(); })) {
    auto added = add_topic("/diagnostics", record::msg::DiagnosticArray::kType);
    if (!added) return tl::unexpected<Error>(added.error());
    diagnostics_id = *added;
  }

  options.places = std::max<std::size_t>(options.places, 64);
  copies = make_sample_pool(options.places, kCopyBytes);
  ring.emplace(options.places);
  return {};
}

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
  auto impl = std::make_unique<Impl>();
  impl->options = std::move(options);
  impl->channels = std::move(channels);
  impl->sinks = std::move(sinks);
  if (auto s = impl->open(std::move(sink), metadata); !s) return tl::unexpected<Error>(s.error());
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
    item.lease = copies->try_acquire();
    if (!item.lease) return drop(s);
    copies_held.fetch_add(1, std::memory_order_relaxed);
    Sample& copy = item.lease.edit();
    copy.stamp = lease->stamp;
    copy.info = lease->info;
    copy.size_bytes = size;
    if (size > 0) std::memcpy(copy.memory().data(), lease->bytes().data(), size);
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

void Recorder::record(std::uint32_t channel, const SampleLease& sample) noexcept {
  impl_->sample(channel * 2, sample);
}

void Recorder::record_side(std::uint32_t channel, PairSide side, const SampleLease& sample) noexcept {
  impl_->sample(channel * 2 + static_cast<std::uint32_t>(side), sample);
}

void Recorder::record_visibility(std::uint32_t channel, std::uint64_t cycle, BenchTime t, PortStatus status,
                                 const SampleLease& sample) noexcept {
  Item item;
  item.kind = Item::Kind::visibility;
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
  Item item;
  item.kind = Item::Kind::skipped;
  item.cycle = first;
  item.stamp.sequence = count;
  item.t = t;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_command(std::uint32_t sink, const Command& command) noexcept {
  Item item;
  item.kind = Item::Kind::command;
  item.channel = sink;
  item.t = command.t_issue;
  item.command = command;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_event(std::uint32_t channel, const SampleLease& event) noexcept {
  if (!event) return;
  Item item;
  item.kind = Item::Kind::event;
  item.channel = channel;
  item.t = event->stamp.t_release;
  item.lease = event;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::record_window(std::uint32_t channel, const SampleLease& window) noexcept {
  if (!window || channel >= impl_->channels.size() || impl_->channels[channel].watched.empty()) return;
  Item item;
  item.kind = Item::Kind::window;
  item.channel = channel;
  item.t = window->stamp.t_release;
  item.lease = window;
  if (!impl_->push(std::move(item))) impl_->other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::end_cycle(std::uint64_t cycle, BenchTime t) noexcept {
  Item item;
  item.kind = Item::Kind::end_cycle;
  item.cycle = cycle;
  item.t = t;
  // A lost mark costs nothing: the next one stands for both.
  if (!impl_->push(std::move(item)) || !impl_->options.virtual_time) return;
  sem_post(&impl_->wake);
  wait_on(impl_->done);
}

// ------------------------------------------------------------------ writer

void Recorder::Impl::work() {
  constexpr std::int64_t kNap_ns = 2'000'000;
  while (true) {
    // Before the ring is looked at: what was pushed before `stop` is then seen in this round.
    const bool last = stopping.load(std::memory_order_acquire);
    bool any = false;
    for (Item item; ring->try_pop(item); any = true) {
      take(std::move(item));
      item = Item{};
    }
    if (any) publish_statistics();
    if (last) break;
    if (options.virtual_time) {
      wait_on(wake);
    } else {
      nap(kNap_ns);
    }
  }
  finish();
}

void Recorder::Impl::take(Item&& item) {
  switch (item.kind) {
    case Item::Kind::none:
      break;
    case Item::Kind::sample:
    case Item::Kind::copy: {
      const Stamp& stamp = item.lease->stamp;
      Waiting w{stamp.t_release, item.channel, stamp.sequence, item.kind == Item::Kind::copy, {}};
      w.lease = std::move(item.lease);
      waiting.push(std::move(w));
      break;
    }
    case Item::Kind::visibility:
    case Item::Kind::skipped:
    case Item::Kind::command:
    case Item::Kind::event:
    case Item::Kind::window:
      of_cycle.push_back(std::move(item));
      break;
    case Item::Kind::end_cycle:
      end_cycle(item);
      if (options.virtual_time) sem_post(&done);
      break;
  }
}

void Recorder::Impl::end_cycle(const Item& tick) {
  any_cycle = true;
  last_t = tick.t;
  cycles = std::max(cycles, tick.cycle + 1);
  write_released(tick.t);
  write_visibility();
  for (Item& item : of_cycle) {
    if (item.kind == Item::Kind::command) {
      record::msg::Command m;
      m.header.stamp = to_time(item.t.ns() + to_utc.ns());
      if (item.channel < sinks.size()) {
        m.channel = sinks[item.channel].name;
        m.names = sinks[item.channel].value_names;
      }
      m.sequence = item.command.sequence;
      m.t_effect_ns = item.command.t_effect.ns();
      const std::size_t n = std::min<std::size_t>(item.command.count, item.command.value.size());
      m.values.assign(item.command.value.begin(),
                      item.command.value.begin() + static_cast<std::ptrdiff_t>(n));
      write(commands_id, static_cast<std::uint32_t>(item.command.sequence), tick.t, m);
    } else if (item.kind == Item::Kind::window) {
      PairWindow window;
      if (item.lease->size_bytes != sizeof window) continue;
      std::memcpy(&window, item.lease->bytes().data(), sizeof window);
      record::msg::DiagnosticArray m;
      m.header.stamp = to_time(window.t_end.ns() + to_utc.ns());
      const RecordedChannel& c = channels[item.channel];
      m.status.push_back(record::pair_diagnostics(c.name, c.description.kind, c.watched, window));
      write(diagnostics_id, window_count++, tick.t, m);
    } else if (item.kind == Item::Kind::event) {
      const auto* info = item.lease->as<EventInfo>();
      if (!info) continue;
      record::msg::Event m;
      m.header.stamp = to_time(item.lease->stamp.t_capture.ns() + to_utc.ns());
      if (item.channel < channels.size()) m.channel = channels[item.channel].name;
      m.kind = event_kind(info->code);
      m.code = info->code;
      m.value = info->value;
      m.text.assign(info->text.begin(), std::find(info->text.begin(), info->text.end(), '\0'));
      write(events_id, event_count++, tick.t, m);
    }
  }
  of_cycle.clear();
  if (!options.virtual_time) {
    note_drops(tick.t);
    // So that a quiet rig's last chunk is not older than the span either.
    if (writable()) check(writer->advance(log_time(tick.t)));
  }
}

void Recorder::Impl::write_released(BenchTime t) {
  while (!waiting.empty() && waiting.top().release <= t) {
    Waiting w = std::move(
        const_cast<Waiting&>(waiting.top()));  // only the lease moves; it takes no part in the order
    waiting.pop();
    write_sample(std::move(w));
  }
}

void Recorder::Impl::let_go(const Waiting& w) {
  // After the lease itself is gone, so that the loop finds the slot free when it finds the count low.
  if (w.copy) {
    copies_held.fetch_sub(1, std::memory_order_release);
    return;
  }
  streams[w.stream]->leases.fetch_sub(1, std::memory_order_release);
}

void Recorder::Impl::write_sample(Waiting&& w) {
  Stream& s = *streams[w.stream];
  const std::size_t size = w.lease->size_bytes;
  bool written = false;
  if (writable()) {
    const auto messages_of = s.encoder->encode(*w.lease);
    if (!messages_of) {
      set_error(messages_of.error());
    } else {
      MessageInfo info;
      info.sequence = static_cast<std::uint32_t>(w.sequence);
      info.log_time_ns = log_time(w.release);
      const std::int64_t capture = w.lease->stamp.t_capture.ns() + to_utc.ns();
      info.publish_time_ns = capture < 0 ? 0 : static_cast<std::uint64_t>(capture);
      written = true;
      if (s.camera) {
        s.camera->header.stamp = to_time(capture);
        if (const auto* image = w.lease->as<ImageInfo>(); image && s.camera->roi.width == 0) {
          s.camera->roi.x_offset = image->offset_x_px;
          s.camera->roi.y_offset = image->offset_y_px;
        }
        info.channel = s.camera_id;
        const auto pieces = cdr.write(*s.camera);
        written = pieces ? check(writer->write(info, *pieces)) : (set_error(pieces.error()), false);
      }
      for (const auto& m : *messages_of) {
        if (!written) break;
        info.channel = s.ids[m.stream];
        written = check(writer->write(info, m.pieces));
      }
    }
  }
  if (written) {
    samples_written.fetch_add(1, std::memory_order_relaxed);
  } else {
    s.dropped.fetch_add(1, std::memory_order_relaxed);
  }
  w.lease.reset();
  if (!w.copy) bytes_held.fetch_sub(size, std::memory_order_release);
  let_go(w);
}

template <class M>
void Recorder::Impl::write(std::uint16_t id, std::uint32_t sequence, BenchTime t, const M& message) {
  bool written = false;
  if (writable()) {
    MessageInfo info;
    info.channel = id;
    info.sequence = sequence;
    info.log_time_ns = info.publish_time_ns = log_time(t);
    const auto pieces = cdr.write(message);
    written = pieces ? check(writer->write(info, *pieces)) : (set_error(pieces.error()), false);
  }
  if (!written) other_dropped.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::Impl::write_visibility() {
  const auto flush = [&] {
    if (!visibility.entries.empty())
      write(visibility_id, visibility_count++, BenchTime(visibility.t_bench_ns), visibility);
    visibility.entries.clear();
  };
  for (const Item& item : of_cycle) {
    if (item.kind != Item::Kind::visibility && item.kind != Item::Kind::skipped) continue;
    if (!visibility.entries.empty() && visibility.cycle != item.cycle) flush();
    visibility.cycle = item.cycle;
    visibility.t_bench_ns = item.t.ns();
    record::msg::PortEntry entry;
    if (item.kind == Item::Kind::skipped) {
      entry.status = kVisibilitySkipped;
      entry.sequence = item.stamp.sequence;
    } else {
      const std::size_t stream = item.channel * 2 + static_cast<std::size_t>(item.side);
      if (stream < streams.size() && streams[stream]) entry.channel = streams[stream]->name;
      entry.status = static_cast<std::uint8_t>(item.status);
      if (item.has_sample) {
        entry.sequence = item.stamp.sequence;
        entry.t_capture_ns = item.stamp.t_capture.ns();
        entry.t_arrival_ns = item.stamp.t_arrival.ns();
        entry.t_release_ns = item.stamp.t_release.ns();
      }
    }
    visibility.entries.push_back(std::move(entry));
  }
  flush();
}

void Recorder::Impl::note_drops(BenchTime t) {
  const std::uint64_t dropped = all_dropped();
  if (dropped == noted_drops || (noted_at <= t && t < noted_at + milliseconds(100)) || !writable()) return;
  record::msg::Event m;
  m.header.stamp = to_time(t.ns() + to_utc.ns());
  m.kind = "recorder_dropped";
  m.value = static_cast<double>(dropped - noted_drops);
  m.text = "the recorder could not keep up and skipped entries";
  noted_drops = dropped;
  noted_at = t;
  write(events_id, event_count++, t, m);
}

void Recorder::Impl::finish() {
  // A caller that never ended a cycle gets all it gave.
  if (!any_cycle) {
    Item tick;
    tick.t = BenchTime(std::numeric_limits<std::int64_t>::min());
    for (const Item& item : of_cycle) tick.t = std::max(tick.t, item.t);
    while (!waiting.empty()) {
      tick.t = std::max(tick.t, waiting.top().release);
      write_released(waiting.top().release);
    }
    for (const Item& item : of_cycle) tick.cycle = std::max(tick.cycle, item.cycle);
    if (!of_cycle.empty()) end_cycle(tick);
  } else if (!of_cycle.empty()) {
    Item tick;
    tick.t = last_t;
    tick.cycle = cycles - 1;
    for (const Item& item : of_cycle) tick.t = std::max(tick.t, item.t);
    end_cycle(tick);
  }
  for (; !waiting.empty(); waiting.pop()) {
    after_end.fetch_add(1, std::memory_order_relaxed);
    Waiting w = std::move(const_cast<Waiting&>(waiting.top()));
    if (!w.copy) bytes_held.fetch_sub(w.lease->size_bytes, std::memory_order_release);
    w.lease.reset();
    let_go(w);
  }
  if (writable()) {
    record::Metadata m{"rigor_recorder", closing_metadata};
    m.values["dropped"] = std::to_string(all_dropped());
    for (const auto& s : streams)
      if (s && s->dropped.load() > 0) m.values["dropped." + s->name] = std::to_string(s->dropped.load());
    m.values["cycles"] = std::to_string(cycles);
    check(writer->add_metadata(m));
  }
  if (writable()) check(writer->close());
  publish_statistics();
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
    std::uint64_t n = 0;
    for (std::size_t side = 0; side < 2; ++side)
      if (const auto& stream = i.streams[c * 2 + side]) n += stream->dropped.load(std::memory_order_relaxed);
    s.dropped_by_channel.push_back(n);
  }
  return s;
}

}  // namespace rigor
