#include "sensor-hal/record/replay_source.h"

#include <algorithm>
#include <condition_variable>
#include <map>
#include <mutex>
#include <optional>

#include "sensor-hal/record/message_header.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {
namespace {

std::int64_t number_or(const std::map<std::string, std::string>& map, const std::string& key,
                       std::int64_t fallback) {
  const auto it = map.find(key);
  if (it == map.end()) return fallback;
  char* end = nullptr;
  const long long n = std::strtoll(it->second.c_str(), &end, 10);
  return end && *end == '\0' && !it->second.empty() ? n : fallback;
}

/// The sensor's frame as its headers name it; empty where they do not.
std::string recorded_frame(SampleKind kind, const record::MessageView& message) {
  if (kind == SampleKind::odometry) {
    record::msg::Odometry m;
    return record::CdrReader::read(message.data, m) ? m.child_frame_id : std::string();
  }
  if (kind != SampleKind::image && kind != SampleKind::range_image && kind != SampleKind::point_cloud &&
      kind != SampleKind::imu && kind != SampleKind::nav_fix)
    return {};
  const auto header = record::read_header(message.data);
  return header ? header->frame_id : std::string();
}

/// Recordings of loops with a whole number of nanoseconds say that alone.
Period recorded_loop_period(const std::map<std::string, std::string>& metadata) {
  if (const auto it = metadata.find("loop_rate_hz"); it != metadata.end())
    if (const auto rate = parse_rate(it->second)) return *rate;
  return nanoseconds(number_or(metadata, "loop_period_ns", 1'000'000));
}

}  // namespace

// ------------------------------------------------------------------ visibility

VisibilityScript::Visible VisibilityScript::at(std::uint64_t cycle) const noexcept {
  if (changes_.empty() || cycle < changes_.front().cycle) return {};
  if (at_ >= changes_.size() || changes_[at_].cycle > cycle) at_ = 0;
  if (at_ + 1 < changes_.size() && changes_[at_ + 1].cycle <= cycle) {
    // Usually the next one; after a jump, search.
    if (at_ + 2 < changes_.size() && changes_[at_ + 2].cycle <= cycle) {
      const auto it = std::upper_bound(changes_.begin(), changes_.end(), cycle,
                                       [](std::uint64_t c, const Change& x) { return c < x.cycle; });
      at_ = static_cast<std::size_t>(it - changes_.begin()) - 1;
    } else {
      ++at_;
    }
  }
  Visible v = changes_[at_].visible;
  if (v.status == PortStatus::fresh && changes_[at_].cycle != cycle) v.status = PortStatus::held;
  return v;
}

Result<std::shared_ptr<const Recording>> Recording::open(const std::string& path) {
  auto reader = record::McapReader::open(path);
  if (!reader) return tl::unexpected<Error>(reader.error());
  auto recording = std::make_shared<Recording>();
  Recording& r = *recording;
  r.path_ = path;
  const auto metadata = (*reader)->metadata();
  if (!metadata) return tl::unexpected<Error>(metadata.error());
  for (const auto& m : *metadata)
    if (m.name == "rigor" || m.name == "rigor_recorder") r.metadata_.insert(m.values.begin(), m.values.end());
  for (const auto& [id, channel] : (*reader)->channels()) {
    const auto schema = (*reader)->schemas().find(channel.schema);
    r.topics_[channel.topic] = schema == (*reader)->schemas().end() ? "" : schema->second.name;
  }

  std::map<std::string, std::vector<VisibilityScript::Change>> changes;
  auto cursor = (*reader)->messages({.topics = {"/rigor/visibility"}, .order = record::MessageOrder::file});
  record::MessageView view;
  record::msg::PortVisibility message;
  bool any = false;
  std::int64_t first_t = 0;
  std::uint64_t first_cycle = 0;
  while (true) {
    const auto more = cursor.next(view);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) break;
    if (auto s = record::CdrReader::read(view.data, message); !s) return tl::unexpected<Error>(s.error());
    if (!any) first_t = message.t_bench_ns, first_cycle = message.cycle, any = true;
    for (const auto& entry : message.entries) {
      if (entry.status == kVisibilitySkipped && entry.channel.empty()) {
        if (entry.sequence > 0) r.skipped_.push_back({message.cycle, entry.sequence});
        r.cycles_ = std::max(r.cycles_, message.cycle + entry.sequence);
        continue;
      }
      if (entry.status > static_cast<std::uint8_t>(PortStatus::disconnected))
        return fail(ErrorCode::protocol, path,
                    "a port's status is unknown; the recording is of a newer version");
      const std::size_t slash = entry.channel.find('/');
      VisibilityScript::Change c;
      c.cycle = message.cycle;
      c.visible.status = static_cast<PortStatus>(entry.status);
      c.visible.sequence = entry.sequence;
      c.visible.simulated = slash != std::string::npos && entry.channel.substr(slash + 1) == "simulated";
      auto& list = changes[entry.channel.substr(0, slash)];
      if (!list.empty() && list.back().cycle >= c.cycle)
        return fail(ErrorCode::protocol, path, "the cycles of /rigor/visibility do not increase");
      list.push_back(c);
    }
    r.cycles_ = std::max(r.cycles_, message.cycle + 1);
  }
  for (auto& [name, list] : changes) r.scripts_.emplace(name, VisibilityScript(std::move(list)));
  // A recorded channel of which nothing became visible: the run ended before its first release. (A file that
  // says nothing of visibility is from elsewhere.)
  if (any)
    for (const auto& [topic, type] : r.topics_) {
      const std::size_t slash = topic.find('/', 1);
      if (topic[0] != '/' || slash == std::string::npos) continue;
      if (const std::string name = topic.substr(1, slash - 1); name != "rigor")
        r.scripts_.try_emplace(name, VisibilityScript({}));
    }
  std::sort(r.skipped_.begin(), r.skipped_.end(),
            [](const Skipped& a, const Skipped& b) { return a.first < b.first; });
  const Period period = recorded_loop_period(r.metadata_);
  const std::int64_t guess = any ? first_t - (period * static_cast<std::int64_t>(first_cycle)).ns() : 0;
  r.t0_ = BenchTime(number_or(r.metadata_, "t0_ns", guess));
  r.cycles_ = static_cast<std::uint64_t>(
      std::max<std::int64_t>(number_or(r.metadata_, "cycles", 0), static_cast<std::int64_t>(r.cycles_)));
  return std::shared_ptr<const Recording>(std::move(recording));
}

const VisibilityScript* Recording::visibility(const std::string& channel) const {
  const auto it = scripts_.find(channel);
  return it == scripts_.end() ? nullptr : &it->second;
}

bool Recording::ran(std::uint64_t cycle) const noexcept {
  auto it = std::upper_bound(skipped_.begin(), skipped_.end(), cycle,
                             [](std::uint64_t c, const Skipped& s) { return c < s.first; });
  if (it == skipped_.begin()) return true;
  --it;
  return cycle - it->first >= it->count;
}

std::vector<std::string> Recording::topics() const {
  std::vector<std::string> names;
  for (const auto& [topic, type] : topics_) names.push_back(topic);
  return names;
}

// ------------------------------------------------------------------ source

/// The thread that reads ahead, and what it shares with the loop.
struct ReplaySource::Reader {
  Reader(std::size_t slots, std::size_t bytes) : pool(slots), ring(slots + 1), slot_bytes(bytes) {
    pool.for_each([&](Sample& s) { s.reserve(bytes); });
  }

  /// One topic to read; a pair has two.
  struct Stream {
    Stream(std::string topic_in, bool simulated_in)
        : topic(std::move(topic_in)), simulated(simulated_in), decoder(topic) {}
    std::string topic;
    bool simulated;
    record::SampleDecoder decoder;
    std::vector<std::size_t> seen;  ///< places in `shown` of what was seen of this side
    std::size_t next = 0;           ///< of them: what lies before was met, or is not in the file
  };
  /// What the script says was seen, in this order.
  struct Shown {
    std::uint64_t sequence = 0;
    bool settled = false;  ///< handed over, or not in the file
  };

  SamplePool pool;
  SpscRing<SampleLease> ring;
  std::size_t slot_bytes;
  std::unique_ptr<record::McapReader> file;
  std::vector<Stream> streams;
  /// The samples to give, in this order; null: all.
  const VisibilityScript* script = nullptr;
  std::vector<Shown> shown;
  std::size_t due = 0;                       ///< of `shown`: all before are settled
  std::map<std::size_t, SampleLease> early;  ///< by place in `shown`: read, while one before may yet come
  std::size_t most_early = 0;                ///< of them: who waits takes a slot
  Duration shift;                            ///< known when the run begins
  HealthCounters* health = nullptr;

  std::thread thread;
  std::atomic<bool> stopping{false};
  // How far the reader is: every sample released up to here is in the ring.
  std::mutex mutex;
  std::condition_variable progress;
  BenchTime complete{std::numeric_limits<std::int64_t>::min()};
  BenchTime awaited{std::numeric_limits<std::int64_t>::min()};  // what the loop waits for, in virtual time
  bool ended = false;

  void reached(BenchTime t, bool end) {
    {
      const std::lock_guard lock(mutex);
      complete = std::max(complete, t);
      ended = ended || end;
    }
    progress.notify_all();
  }

  void follow(const VisibilityScript& visibility) {
    script = &visibility;
    for (const auto& change : visibility.changes()) {
      if (change.visible.status != PortStatus::fresh) continue;
      for (Stream& stream : streams)
        if (stream.simulated == change.visible.simulated) stream.seen.push_back(shown.size());
      shown.push_back({change.visible.sequence, false});
    }
  }

  /// Which of `shown` this sample is; none: nobody saw it. Samples of one side come in the order in which
  /// they were seen.
  std::optional<std::size_t> place_of(Stream& stream, std::uint64_t sequence) {
    for (std::size_t i = stream.next; i < stream.seen.size(); ++i) {
      const std::uint64_t shown_sequence = shown[stream.seen[i]].sequence;
      if (shown_sequence > sequence) return std::nullopt;
      if (shown_sequence < sequence) continue;
      for (; stream.next < i; ++stream.next)
        shown[stream.seen[stream.next]].settled = true;  // not in the file
      return stream.seen[stream.next++];
    }
    return std::nullopt;
  }

  /// Samples of the two sides of a pair may have been seen in another order than they are in the file. False:
  /// stopping.
  bool hand_over_in_order(bool all) {
    while (!early.empty()) {
      const auto first = early.begin();
      while (due < first->first && shown[due].settled) ++due;
      if (due < first->first && !all && early.size() <= most_early) return true;
      if (!push(std::move(first->second))) return false;
      shown[first->first].settled = true;
      early.erase(first);
    }
    return true;
  }

  void run(const RunOrigin& origin, BenchTime recorded_t0) {
    auto t0 = origin.get();
    for (; !t0; t0 = origin.get()) {
      if (stopping.load(std::memory_order_acquire)) return;
      std::this_thread::sleep_for(kNap);
    }
    shift = *t0 - recorded_t0;
    record::MessageFilter filter;
    for (const Stream& s : streams) {
      filter.topics.insert(s.topic);
      for (const std::string_view companion : record::kCompanionTopics)
        filter.topics.insert(s.topic + std::string(companion));
    }
    filter.order = record::MessageOrder::file;
    auto cursor = file->messages(filter);
    record::MessageView view;
    while (!stopping.load(std::memory_order_acquire)) {
      const auto more = cursor.next(view);
      if (!more) {
        health->protocol_errors.fetch_add(1, std::memory_order_relaxed);
        break;
      }
      if (!*more) break;
      for (Stream& stream : streams) {
        if (!stream.decoder.wants(view.channel->topic)) continue;
        const auto whole = stream.decoder.take(view);
        if (!whole) {
          health->protocol_errors.fetch_add(1, std::memory_order_relaxed);
          continue;
        }
        if (!*whole) continue;
        if (!script) {
          SampleSlot sample;
          if (!read(stream.decoder, sample) || (sample && !push(std::move(sample)))) return;
          continue;
        }
        if (const auto place = place_of(stream, stream.decoder.stamp().sequence)) {
          SampleSlot sample;
          if (!read(stream.decoder, sample)) return;
          if (sample)
            early.emplace(*place, std::move(sample));
          else
            shown[*place].settled = true;
        }
        if (!hand_over_in_order(false)) return;
      }
    }
    if (!hand_over_in_order(true)) return;
    reached(BenchTime::never(), true);
  }

  static constexpr auto kNap = std::chrono::microseconds(200);
  // Others than the loop (the recorder, a digest) let go of their slots some time, on a busy machine late.
  // Once they did not, it is the loop itself that holds them, and no wait is worth much.
  static constexpr std::chrono::milliseconds kTimeout{1500}, kTimeoutOnceStarved{200};
  bool starved = false;

  /// No sample where it cannot be had. False: stopping.
  bool read(const record::SampleDecoder& decoder, SampleSlot& slot) {
    const BenchTime release = decoder.stamp().t_release + shift;
    for (int naps = 0; !(slot = pool.try_acquire());) {
      // All slots are ahead of the loop or held by somebody.
      if (!hand_over_in_order(true)) return false;
      reached(release - Duration(1), false);
      if (stopping.load(std::memory_order_acquire)) return false;
      std::this_thread::sleep_for(kNap);
      // The loop itself waits for this sample, so it is not the one who could let go of a slot; other threads
      // may.
      const std::lock_guard lock(mutex);
      if (awaited >= release && ++naps * kNap > (starved ? kTimeoutOnceStarved : kTimeout)) {
        starved = true;
        health->no_slot.fetch_add(1, std::memory_order_relaxed);
        return true;
      }
    }
    Sample& sample = *slot;
    if (!decoder.fill(sample)) {
      health->protocol_errors.fetch_add(1, std::memory_order_relaxed);
      slot.reset();
      return true;
    }
    sample.stamp.t_capture = sample.stamp.t_capture + shift;
    sample.stamp.t_release = release;
    sample.stamp.t_arrival = sample.stamp.t_arrival + shift;
    health->received.fetch_add(1, std::memory_order_relaxed);
    if (sample.stamp.validity & kIncomplete) health->incomplete.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  /// False: stopping.
  bool push(SampleLease sample) {
    const BenchTime release = sample->stamp.t_release;
    while (!ring.try_push(std::move(sample))) {
      if (stopping.load(std::memory_order_acquire)) return false;
      std::this_thread::sleep_for(kNap);
    }
    reached(release, false);
    return true;
  }
};

ReplaySource::ReplaySource(std::shared_ptr<const Recording> recording, std::string channel)
    : from_keys_(false), recording_(std::move(recording)), channel_(std::move(channel)) {}

ReplaySource::ReplaySource() = default;
ReplaySource::~ReplaySource() { (void)do_stop(); }

Status ReplaySource::do_configure(const ChannelConfig& config) {
  if (from_keys_) {
    auto opened = Recording::open((config.params.base_dir() / config.params.text("file")).string());
    if (!opened) return tl::unexpected<Error>(opened.error());
    recording_ = std::move(*opened);
    channel_ = config.params.text_or("channel", config.name);
  }
  if (channel_.empty()) channel_ = config.name;
  slots_ = static_cast<std::size_t>(config.params.integer_or("slots", 32, {.min = 2, .max = 4096}));
  const std::string_view kind_topic = record::topic_of(config.kind);
  const std::string plain = "/" + channel_ + "/" + std::string(kind_topic);
  const std::string real = "/" + channel_ + "/real/" + std::string(kind_topic);
  if (config.kind == SampleKind::none ||
      (!recording_->topics_.contains(plain) && !recording_->topics_.contains(real)))
    return fail(ErrorCode::not_found, recording_->path(),
                "expected a topic " + plain + " (or of a pair " + real + ") to replay channel " + channel_ +
                    " from, found none; `rigor inspect` lists the topics that there are");

  // What the samples are like is learnt from the first of them.
  auto file = record::McapReader::open(recording_->path());
  if (!file) return tl::unexpected<Error>(file.error());
  description_.kind = config.kind;
  const bool optical = config.kind == SampleKind::image || config.kind == SampleKind::range_image;
  description_.frame_id = optical ? config.name + "_optical" : config.name;
  bool known = false;
  for (const auto& topic : {plain, real, "/" + channel_ + "/simulated/" + std::string(kind_topic)}) {
    if (!recording_->topics_.contains(topic)) continue;
    record::SampleDecoder decoder(topic);
    record::MessageFilter filter;
    filter.topics.insert(topic);
    for (const std::string_view companion : record::kCompanionTopics)
      filter.topics.insert(topic + std::string(companion));
    filter.order = record::MessageOrder::file;
    auto cursor = (*file)->messages(filter);
    record::MessageView view;
    // Images of one channel have one size; point clouds have not, so all are looked at (without their
    // content).
    while (true) {
      const auto more = cursor.next(view);
      if (!more) return tl::unexpected<Error>(more.error());
      if (!*more) break;
      const auto whole = decoder.take(view);
      if (!whole) return tl::unexpected<Error>(whole.error());
      if (!*whole) continue;
      description_.max_bytes = std::max(description_.max_bytes, decoder.size_bytes());
      if (known) {
        if (config.kind != SampleKind::point_cloud) break;
        continue;
      }
      known = true;
      if (std::string frame = recorded_frame(config.kind, view); !frame.empty())
        description_.frame_id = std::move(frame);
      Sample sample;
      sample.reserve(decoder.size_bytes());
      if (auto s = decoder.fill(sample); !s) return s;
      if (const auto* image = sample.as<ImageInfo>()) {
        description_.width_px = image->width_px;
        description_.height_px = image->height_px;
        description_.format = image->format;
      } else if (const auto* range = sample.as<RangeImageInfo>()) {
        description_.width_px = range->width_px;
        description_.height_px = range->height_px;
      } else if (view.schema && view.schema->name == record::msg::RegisterBlock::kType) {
        record::msg::RegisterBlock m;
        if (record::CdrReader::read(view.data, m)) {
          description_.names = m.names;
          description_.units = m.units;
        }
      }
      if (config.kind != SampleKind::point_cloud) break;
    }
  }
  return {};
}

Status ReplaySource::do_arm(const ArmContext&) {
  reader_ = std::make_unique<Reader>(slots_, description_.max_bytes);
  auto file = record::McapReader::open(recording_->path());
  if (!file) {
    reader_.reset();
    return tl::unexpected<Error>(file.error());
  }
  reader_->file = std::move(*file);
  const std::string_view kind_topic = record::topic_of(description_.kind);
  for (const char* side : {"", "real/", "simulated/"}) {
    std::string topic = "/" + channel_ + "/" + side + std::string(kind_topic);
    if (recording_->topics_.contains(topic)) reader_->streams.emplace_back(topic, side[0] == 's');
  }
  if (const VisibilityScript* script = recording_->visibility(channel_)) reader_->follow(*script);
  reader_->most_early = slots_ / 4;
  reader_->health = &health_;
  health_.connected.store(true, std::memory_order_relaxed);
  reader_->thread = std::thread([r = reader_.get(), this] { r->run(origin(), recording_->t0()); });
  return {};
}

Status ReplaySource::do_stop() {
  health_.connected.store(false, std::memory_order_relaxed);
  if (reader_) {
    reader_->stopping.store(true, std::memory_order_release);
    if (reader_->thread.joinable()) reader_->thread.join();
    reader_.reset();
  }
  return {};
}

SampleLease ReplaySource::poll(BenchTime now) noexcept {
  if (!reader_) return {};
  // Ahead of its release a sample stays in the ring: the port has fewer places than this source has slots.
  const SampleLease* next = reader_->ring.peek();
  if (!next || (*next)->stamp.t_release > now) return {};
  SampleLease sample;
  (void)reader_->ring.try_pop(sample);
  return sample;
}

void ReplaySource::complete_until(BenchTime now) {
  if (!reader_ || !reader_->thread.joinable()) return;
  std::unique_lock lock(reader_->mutex);
  reader_->awaited = now;
  reader_->progress.wait(lock, [&] { return reader_->ended || reader_->complete >= now; });
}

Backend replay_backend() {
  Backend b;
  b.name = "replay";
  b.summary = "a channel of an earlier recording";
  b.make_source = [] { return std::make_unique<ReplaySource>(); };
  b.same_in_virtual_time = true;
  b.gives_typed_samples = true;
  return b;
}

}  // namespace rigor
