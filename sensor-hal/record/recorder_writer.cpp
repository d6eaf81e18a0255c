// The writer's side of the recorder: its thread, what it writes and in which order, how a recording ends.
#include <algorithm>
#include <cstring>

#include "rt-core/time_slice.h"
#include "sensor-hal/channel/event_text.h"
#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/record/fault_message.h"
#include "sensor-hal/record/pair_diagnostics.h"
#include "sensor-hal/record/recorder_impl.h"
#include "sensor-hal/record/ros2_time.h"

namespace rigor {

std::string_view event_kind(std::uint32_t code) noexcept {
  if (code == kEventWorldEdit) return "world_edit";
  if (code == kEventMadeSafe) return "made_safe";
  if (code == kEventPairSwitch) return "pair_switch";
  if (code == kEventPairAlarm) return "pair_alarm";
  if (code == kEventPairWatching || code == kEventPairOrder) return "pair_watch";
  if (code == kEventFaultBegin || code == kEventLiveFaultBegin) return "fault_begin";
  return code == kEventFaultEnd || code == kEventLiveFaultEnd ? "fault_end" : "event";
}

namespace {

using record::MessageInfo;
using record::to_time;

}  // namespace

void Recorder::Impl::work() {
  ask_for_time_slice(kLongTimeSlice);
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
    } else if (options.live) {
      wait_on(wake, kNap_ns);
    } else {
      nap(kNap_ns);
    }
  }
  finish();
}

void Recorder::Impl::take(Item&& item) {
  if (!begun && item.kind != Item::Kind::begin)
    set_error({ErrorCode::wrong_state, "recorder",
               "something was recorded before begin() said when the run began"});
  switch (item.kind) {
    case Item::Kind::none:
      break;
    case Item::Kind::begin:
      begun = true;
      check(write_beginning(item.t));
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
    case Item::Kind::fault:
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
  write_motions(tick.t);
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
    } else if (item.kind == Item::Kind::fault) {
      record::msg::Fault m = fault_message(item.change);
      m.header.stamp = to_time(item.change.t.ns() + to_utc.ns());
      write(faults_id, fault_count++, tick.t, m);
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
        written = check(writer->write_sample(info, m.pieces, w.lease));
      }
    }
  }
  if (written) {
    samples_written.fetch_add(1, std::memory_order_relaxed);
    s.written.fetch_add(1, std::memory_order_relaxed);
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

void Recorder::Impl::write_motions(BenchTime until) {
  for (const MotionAt* next = motions.peek(); next && next->t <= until; next = motions.peek()) {
    MotionAt at;
    (void)motions.try_pop(at);
    const record::msg::Time stamp = to_time(at.t.ns() + to_utc.ns());
    const std::uint32_t sequence = motion_count++;
    if (clock_id != 0) write(clock_id, sequence, at.t, record::msg::Clock{stamp});
    if (tf_id != 0 && options.frames->moving(at.motion, at.t, t0, stamp, transforms))
      write(tf_id, sequence, at.t, transforms);
  }
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

}  // namespace rigor
