#include "drivers/aravis/aravis_source.h"

#include <fmt/format.h>
#include <pthread.h>
#include <semaphore.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "drivers/aravis/camera_session.h"
#include "drivers/aravis/frame_sequence.h"
#include "rt-core/clock_map.h"

namespace rigor {
namespace {

constexpr Duration kLatchEvery = seconds(1);
constexpr int kFirstLatches = 4;
constexpr int kLatchTries = 4;
constexpr Duration kAskWait = milliseconds(300);
constexpr Duration kAskEvery = seconds(1);
constexpr Duration kMaxReconnectPause = milliseconds(250);  // a question is one datagram
constexpr Duration kPtpEvery = milliseconds(100);
constexpr Duration kSameClock = milliseconds(1);  // of cameras that follow one PTP master
constexpr Duration kFrozenAfter = seconds(2);     // a camera that answers and sends nothing is opened anew

void raise(std::atomic<std::uint64_t>& counter, std::uint64_t by = 1) {
  counter.fetch_add(by, std::memory_order_relaxed);
}

ClockMapOptions clock_options(const AravisSettings& s, Duration exposure, std::size_t payload_bytes) {
  ClockMapOptions o;
  // From the start of exposure to the last packet at best: the exposure, and the frame's bytes on a gigabit
  // link.
  const Duration transfer = nanoseconds(static_cast<std::int64_t>(payload_bytes) * 8);
  o.min_delay = s.arrival_delay.value_or(exposure + transfer / 2);
  o.min_delay_sigma = s.arrival_delay ? microseconds(100) : transfer / 2 + microseconds(500);
  return o;
}

}  // namespace

struct AravisSource::Impl {
  explicit Impl(AravisSource& s) : self(s), health(s.health_), origin(s.origin()) { sem_init(&wake, 0, 0); }
  ~Impl() { sem_destroy(&wake); }

  // Setup.
  AravisSource& self;
  HealthCounters& health;
  const RunOrigin& origin;
  AravisSettings settings;
  ChannelConfig config;
  std::vector<std::byte*> slot_base;  ///< of the samples
  std::vector<std::byte*>
      slot_memory;  ///< where the camera's bytes go: behind the sample's, where it is made of parts
  std::size_t raw_at = 0, payload_bytes = 0;

  // Control thread, while it runs; setup thread otherwise.
  std::unique_ptr<CameraSession> session;
  std::thread control_thread, frame_thread;
  std::atomic<bool> stop{false}, frame_stop{false};
  sem_t wake{};
  StreamCounters seen;
  std::uint64_t triggers_handled = 0;
  BenchTime t_connected, t_last_latch, t_last_asked;
  BenchTime t_last_trigger, t_owed;  ///< newest exposure that was asked for, and since when one is owed
  std::shared_ptr<ActionGroup> group;
  bool follows_master = false;  ///< as of the last latch
  ActionSender actions;

  // Frame thread.
  std::vector<SampleSlot> queued;  // by slot: what the camera may write to
  std::size_t queued_count = 0;
  FrameSequence sequence;  ///< of the camera, from arm on
  RunSequence in_run;

  // Shared.
  std::unique_ptr<ClockMap> clock;
  std::atomic<std::int64_t> t_last_frame_ns{0};
  std::atomic<std::int64_t> ptp_offset_ns{0};  ///< magnitude
  mutable std::mutex ptp_mutex;
  std::string ptp_status;  ///< under ptp_mutex
  std::string strange;     ///< under ptp_mutex: what the first frame that could not be used was like
  std::atomic<std::uint64_t> triggers_wanted{0};
  std::atomic<std::uint64_t> resent_packets{0}, resend_requests{0}, underruns{0}, latches{0},
      triggers_sent{0}, triggers_missed{0};

  // Loop thread.
  std::int64_t next_trigger = 0;  ///< index on the grid of t0

  void begin_session();
  void end_session(bool dead);
  void latch_now();
  void run_control();
  void run_frames();
  void handle(const ReceivedFrame& f);
  void refill();
  void fill(Sample& sample, const ReceivedFrame& f, Duration exposure) const;
  void hand_on(SampleSlot slot, const ReceivedFrame& f, BenchTime arrival);
  void read_counters();
  void look_at_ptp();
  void send_trigger();
  /// Commands for exposures that are due soon; until when the next one has time.
  Duration send_actions(BenchTime now);
  [[nodiscard]] Status join_group();
  void owe_from(BenchTime now, BenchTime t_exposure);
  [[nodiscard]] bool lost_camera(BenchTime now);
  [[nodiscard]] Duration silence_allowed() const;
  void reconnect();
  void pause(Duration d);
  [[nodiscard]] std::size_t at_camera() const {
    return std::max<std::size_t>(3, std::min<std::size_t>(8, settings.buffers / 2));
  }
};

AravisSource::AravisSource() : impl_(std::make_unique<Impl>(*this)) {}

AravisSource::~AravisSource() { (void)do_stop(); }

AravisSource::Counters AravisSource::counters() const {
  const auto get = [](const std::atomic<std::uint64_t>& a) { return a.load(std::memory_order_relaxed); };
  return {get(impl_->resent_packets), get(impl_->resend_requests), get(impl_->underruns),
          get(impl_->latches),        get(impl_->triggers_sent),   get(impl_->triggers_missed),
          impl_->actions.statistics()};
}

std::vector<std::string> AravisSource::warnings() const {
  Impl& i = *impl_;
  std::vector<std::string> all;
  i.actions.receive();
  if (const ActionStatistics a = i.actions.statistics(); !a.good())
    all.push_back(i.config.name + ": " + a.text());
  const std::lock_guard lock(i.ptp_mutex);
  if (!i.strange.empty()) all.push_back(i.config.name + ": frames that could not be used: " + i.strange);
  if (!i.settings.ptp || i.ptp_status == "Slave") return all;
  if (i.ptp_status.empty()) {
    all.push_back(i.config.name + ": the camera's PTP clock was not asked yet; it is once a second");
    return all;
  }
  all.push_back(fmt::format(
      "{}: the camera's PTP clock is {}, {:g} µs from its master; is there a master (ptp4l) on its "
      "network?",
      i.config.name, i.ptp_status,
      static_cast<double>(i.ptp_offset_ns.load(std::memory_order_relaxed)) * 1e-3));
  return all;
}

// --- Loop thread
// -----------------------------------------------------------------------------------------------

void AravisSource::begin_cycle(BenchTime now) noexcept {
  Impl& i = *impl_;
  const auto t0 = i.origin.get();
  if (!i.settings.software_trigger || !t0) return;
  const std::int64_t after = (now - *t0) / i.config.period + 1;
  if (after <= i.next_trigger) return;
  // Where the loop skipped instants, only the newest is exposed: the others are past.
  const std::int64_t due = after - std::exchange(i.next_trigger, after);
  i.triggers_wanted.fetch_add(static_cast<std::uint64_t>(due), std::memory_order_release);
  sem_post(&i.wake);
}

// --- Setup thread
// ----------------------------------------------------------------------------------------------

Status AravisSource::do_configure(const ChannelConfig& config) {
  impl_->settings = read_aravis_settings(config);
  impl_->config = config;
  const AravisSettings& s = impl_->settings;
  description_.kind = config.kind;
  description_.frame_id = s.frame_id;
  description_.format = s.format;
  if (s.region) {
    description_.width_px = s.region->width_px, description_.height_px = s.region->height_px;
    description_.max_bytes = s.range
                                 ? std::size_t{s.region->width_px} * s.region->height_px * 2 * sizeof(float)
                                 : image_bytes(s.format, s.region->width_px, s.region->height_px);
  }
  return {};
}

Status AravisSource::do_arm(const ArmContext&) {
  Impl& i = *impl_;
  auto session = CameraSession::open(i.settings, i.config, [] { return false; });
  if (!session) return tl::unexpected<Error>(session.error());
  i.session = std::move(*session);
  const CameraFacts& f = i.session->facts();
  description_.width_px = f.width_px, description_.height_px = f.height_px;
  description_.max_bytes = f.picture_bytes;

  i.raw_at = i.settings.parts() ? (f.picture_bytes + 63) / 64 * 64 : 0;
  open_stream(i.settings.buffers, i.raw_at + f.payload_bytes, false);
  i.payload_bytes = f.payload_bytes;
  i.slot_base.clear();
  i.slot_memory.clear();
  for_each_slot([&](Sample& s) {
    i.slot_base.push_back(s.memory().data());
    i.slot_memory.push_back(s.memory().data() + i.raw_at);
  });
  i.strange.clear();
  i.queued = std::vector<SampleSlot>(i.settings.buffers);
  i.clock = std::make_unique<ClockMap>(clock_options(i.settings, f.exposure, f.payload_bytes));
  i.sequence = FrameSequence(i.config.period);
  i.in_run.reset();
  i.actions.restart();
  i.triggers_wanted = i.triggers_handled = 0;
  i.next_trigger = 0;
  i.stop = false;
  i.begin_session();
  Status status = i.settings.action ? i.join_group() : Status();
  if (status) status = i.session->start();
  if (!status) {
    i.end_session(true);
    return status;
  }
  health_.connected = true;
  i.control_thread = std::thread([&i] { i.run_control(); });
  return {};
}

Status AravisSource::do_stop() {
  Impl& i = *impl_;
  i.stop = true;
  sem_post(&i.wake);
  if (i.control_thread.joinable()) i.control_thread.join();
  i.actions.receive();
  if (i.session) i.end_session(!i.session->alive(kAskWait));
  close_stream();
  i.group.reset();
  health_.connected = false;
  return {};
}

// --- Control thread
// --------------------------------------------------------------------------------------------

/// Slots to the camera, its clock tied to ours, the frame thread up. Acquisition starts after that.
void AravisSource::Impl::begin_session() {
  session->set_slots(slot_memory);
  queued_count = 0;
  seen = {};
  refill();
  sequence.restart();
  clock->reset();
  if (session->can_latch())
    for (int n = 0; n < kFirstLatches; ++n) latch_now();
  const BenchTime now = bench_now();
  t_connected = now;
  t_last_frame_ns.store(0, std::memory_order_relaxed);
  frame_stop = false;
  frame_thread = std::thread([this] { run_frames(); });
}

void AravisSource::Impl::end_session(bool dead) {
  frame_stop = true;
  if (frame_thread.joinable()) frame_thread.join();
  if (session) session->close_stream();
  for (SampleSlot& s : queued) s.reset();
  queued_count = 0;
  retire(std::move(session), dead);
}

void AravisSource::Impl::latch_now() {
  t_last_latch = bench_now();
  // A latch that a busy machine or network delayed was delayed on one side of its window: only the best of a
  // few tells.
  std::optional<LatchPair> best;
  for (int n = 0; n < kLatchTries; ++n) {
    const auto pair = session->latch();
    if (!pair) return;
    if (!best || pair->after - pair->before < best->after - best->before) best = *pair;
  }
  (void)clock->add_latch(best->device, best->before, best->after);
  raise(latches);
  if (settings.ptp) look_at_ptp();
  // A camera that came back has a clock of its own until it follows the master again.
  if (group && follows_master) group->add_latch(this, best->device, best->before, best->after);
}

/// How far the camera is from its master: a clock that is being pulled is no better than that.
void AravisSource::Impl::look_at_ptp() {
  const auto p = session->ptp();
  if (!p) return;
  // What the camera says may be anything; -2^63 has no magnitude.
  constexpr std::int64_t kMost_ns = std::int64_t{1} << 62;
  ptp_offset_ns.store(std::abs(std::clamp(p->offset.ns(), -kMost_ns, kMost_ns)), std::memory_order_relaxed);
  follows_master = p->status == "Slave" || p->status == "Master";
  const std::lock_guard lock(ptp_mutex);
  ptp_status = p->status;
}

/// Action commands need a clock that follows a master, which takes a camera some seconds, and the same master
/// for all cameras of a group.
Status AravisSource::Impl::join_group() {
  if (!session->can_latch())
    return fail(ErrorCode::unavailable, config.name,
                "expected a camera whose timestamp can be latched, as `trigger: action` needs its clock");
  const MonotonicTime end = monotonic_now() + settings.action->settle;
  while (true) {
    const auto p = session->ptp();
    if (!p) return tl::unexpected<Error>(p.error());
    if (p->status == "Slave" || p->status == "Master") break;
    if (monotonic_now() > end)
      return fail(
          ErrorCode::timeout, config.name,
          fmt::format("expected a PTP clock that is Slave or Master, got {} for {:g} s (`settle_s` of "
                      "`action`); is there a master (ptp4l) on the camera's network?",
                      p->status, settings.action->settle.seconds()));
    pause(kPtpEvery);
  }
  // A clock that was pulled to its master stepped: the pairs of before are of another clock.
  clock->reset();
  group = ActionGroup::join(settings.action->device_key, settings.action->group_key);
  const auto pair = session->latch();
  if (!pair) return tl::unexpected<Error>(pair.error());
  if (const Duration d = group->distance(pair->device, pair->before, pair->after); d > kSameClock)
    return fail(
        ErrorCode::unavailable, config.name,
        fmt::format("expected a clock that agrees with those of the other cameras of this action group, got "
                    "one that is {:g} s away: do they follow the same PTP master?",
                    d.seconds()));
  for (int n = 0; n < kFirstLatches; ++n) latch_now();
  return actions.aim(session->address());
}

void AravisSource::Impl::run_control() {
  pthread_setname_np(pthread_self(), "camera-control");
  Duration next = milliseconds(50);
  while (!stop.load(std::memory_order_acquire)) {
    pause(std::min(next, milliseconds(50)));
    if (stop.load(std::memory_order_acquire)) break;
    if (triggers_wanted.load(std::memory_order_acquire) != triggers_handled) send_trigger();
    const BenchTime now = bench_now();
    if (settings.action) next = send_actions(now);
    if (lost_camera(now)) {
      health.connected = false;
      end_session(true);
      reconnect();
      continue;
    }
    read_counters();
    // Right after a trigger there is time until the next; and only while frames come: a dead camera would
    // keep us.
    const bool quiet =
        now - BenchTime(t_last_frame_ns.load(std::memory_order_relaxed)) > silence_allowed() / 2;
    if (session->can_latch() && !quiet && now - t_last_latch > kLatchEvery) latch_now();
  }
}

/// Until woken, or `d` at most.
void AravisSource::Impl::pause(Duration d) {
  const MonotonicTime until = monotonic_now() + d;
  timespec ts{};
  ts.tv_sec = until.ns() / 1'000'000'000;
  ts.tv_nsec = until.ns() % 1'000'000'000;
  (void)sem_clockwait(&wake, CLOCK_MONOTONIC, &ts);
}

/// Silence counts from the first exposure that was asked for and not seen.
void AravisSource::Impl::owe_from(BenchTime now, BenchTime t_exposure) {
  const BenchTime last_frame(t_last_frame_ns.load(std::memory_order_relaxed));
  if (t_last_trigger <= std::max(t_connected, last_frame)) t_owed = now;
  t_last_trigger = t_exposure;
}

Duration AravisSource::Impl::send_actions(BenchTime now) {
  const auto t0 = origin.get();
  if (!t0) return RunOrigin::kLook;
  const AravisSettings::Action& a = *settings.action;
  const auto due = actions.send_due(now,
                                    {*t0,
                                     config.period,
                                     a.lead,
                                     {a.device_key, a.group_key, a.group_mask, {}},
                                     [this](DeviceTime t) { return session->ticks(t); }},
                                    *group);
  if (due.asked) owe_from(now, *due.asked);
  return due.wait;
}

void AravisSource::Impl::send_trigger() {
  const std::uint64_t wanted = triggers_wanted.load(std::memory_order_acquire);
  const std::uint64_t missed = wanted - triggers_handled - 1;
  triggers_handled = wanted;
  raise(triggers_missed, missed);
  const BenchTime now = bench_now();
  owe_from(now, now);
  if (session->trigger())
    raise(triggers_sent);
  else
    raise(triggers_missed);
}

void AravisSource::Impl::read_counters() {
  const StreamCounters c = session->stream_counters();
  if (origin.get()) {  // frames of before the run are discarded, whether there was a slot or not
    raise(health.no_slot, c.underruns - seen.underruns);
    raise(underruns, c.underruns - seen.underruns);
  }
  raise(health.retries, c.resend_requests - seen.resend_requests);
  raise(resend_requests, c.resend_requests - seen.resend_requests);
  raise(resent_packets, c.resent_packets - seen.resent_packets);
  seen = c;
}

Duration AravisSource::Impl::silence_allowed() const {
  return std::max(milliseconds(200), config.period * 5) + session->facts().exposure;
}

bool AravisSource::Impl::lost_camera(BenchTime now) {
  if (session->control_lost()) return true;
  const BenchTime last_frame(t_last_frame_ns.load(std::memory_order_relaxed));
  const BenchTime last_sign = std::max(t_connected, last_frame);
  // A camera without a rate, or one that the loop does not trigger, owes no frame; it only has to be there.
  if (config.period.ns() <= 0 || settings.hardware_trigger ||
      (settings.triggered_by_bench() && t_last_trigger <= last_sign)) {
    if (now - std::max(last_sign, t_last_asked) <= kAskEvery) return false;
    t_last_asked = now;
    return !session->alive(kAskWait) || !session->in_control();
  }
  const Duration silence = now - (settings.triggered_by_bench() ? std::max(last_sign, t_owed) : last_sign);
  if (silence <= silence_allowed()) return false;
  if (!session->alive(kAskWait) || !session->in_control()) return true;
  return silence > std::max(kFrozenAfter, silence_allowed() * 2);
}

void AravisSource::Impl::reconnect() {
  Duration wait = settings.reconnect_after;
  const auto cancelled = [this] { return stop.load(std::memory_order_acquire); };
  while (!cancelled()) {
    // Asked before the long way, which would list all cameras each time.
    const bool there = settings.address.empty() || gige::ask_gige_camera(settings.address, milliseconds(150));
    if (there && !cancelled()) {
      auto opened = CameraSession::open(settings, config, cancelled);
      const bool same = opened && (*opened)->facts().payload_bytes == payload_bytes;
      if (same) {
        session = std::move(*opened);
        begin_session();
        if (session->start()) {
          raise(health.reconnects);
          health.connected = true;
          triggers_handled = triggers_wanted.load(std::memory_order_acquire);
          if (settings.action) (void)actions.aim(session->address());
          return;
        }
        end_session(true);
      }
    }
    const BenchTime until = bench_now() + wait;
    while (!cancelled() && bench_now() < until) pause(until - bench_now());
    wait = std::min(wait * 2, std::max(kMaxReconnectPause, settings.reconnect_after));
  }
}

// --- Frame thread
// ----------------------------------------------------------------------------------------------

void AravisSource::Impl::run_frames() {
  pthread_setname_np(pthread_self(), "camera-frames");
  while (!frame_stop.load(std::memory_order_acquire)) {
    const bool short_of_slots = queued_count < at_camera();
    if (const auto f = session->wait_frame(short_of_slots ? milliseconds(2) : milliseconds(50))) handle(*f);
    refill();
  }
}

void AravisSource::Impl::refill() {
  while (queued_count < at_camera()) {
    SampleSlot next = self.lend_slot();
    if (!next) return;  // Aravis counts the frames that find no buffer
    Sample& s = *next;
    const auto slot = static_cast<std::size_t>(
        std::find(slot_base.begin(), slot_base.end(), s.memory().data()) - slot_base.begin());
    // What never comes must read as zero, not as the picture that was here before. Aravis does not say what
    // came.
    if (!settings.drop_incomplete) std::memset(slot_memory[slot], 0, s.memory().size() - raw_at);
    queued[slot] = std::move(next);
    ++queued_count;
    session->queue(slot);
  }
}

void AravisSource::Impl::handle(const ReceivedFrame& f) {
  const BenchTime arrival = bench_now();
  SampleSlot slot = std::move(queued[f.slot]);
  --queued_count;
  using State = ReceivedFrame::State;
  if (f.state == State::aborted) return;
  t_last_frame_ns.store(arrival.ns(), std::memory_order_relaxed);
  if (f.state == State::unusable || !f.as_expected) {
    raise(health.protocol_errors);
    const std::lock_guard lock(ptp_mutex);
    if (strange.empty()) strange = f.strange;
    return;  // the next frame's id tells that one is missing
  }
  if (f.state == State::complete && f.timestamp && !session->can_latch())
    (void)clock->add_arrival(*f.timestamp, arrival);
  hand_on(std::move(slot), f, arrival);
}

void AravisSource::Impl::hand_on(SampleSlot slot, const ReceivedFrame& f, BenchTime arrival) {
  Sample& sample = *slot;
  const Duration exposure = f.exposure.value_or(session->facts().exposure);
  Stamp stamp;
  bool clock_known = false;
  if (f.timestamp) {
    const Mapped m = clock->map(*f.timestamp);
    clock_known = m.known;
    stamp.t_capture = m.t + exposure / 2;
    const auto ptp = static_cast<double>(ptp_offset_ns.load(std::memory_order_relaxed));
    stamp.sigma_capture =
        Duration(static_cast<std::int64_t>(std::hypot(static_cast<double>(m.sigma.ns()), ptp)));
  }
  if (!clock_known) {
    // By the ids where they hold, otherwise by what the channel's latency promises.
    const std::uint64_t gap = sequence.gap(f.block_id);
    stamp.t_capture = gap != 0 && config.period.ns() > 0
                          ? sequence.last_capture() + config.period * static_cast<std::int64_t>(gap)
                          : arrival - config.latency;
    stamp.sigma_capture = std::max(config.latency, milliseconds(1));
    stamp.validity |= kClockUnsure;
  }
  const FrameSequence::Step step = sequence.step(f.block_id, stamp.t_capture);
  const auto place = in_run.place(origin, stamp.t_capture, config.period, step.sequence, step.lost_before);
  if (!place) return;
  if (f.timestamp && settings.action) actions.exposed(*f.timestamp);
  self.count_lost(place->lost);
  const bool whole = f.state == ReceivedFrame::State::complete;
  if (!whole && settings.drop_incomplete) return self.count_lost(1);
  if (!whole) raise(health.incomplete);
  stamp.sequence = place->sequence;
  stamp.t_release = stamp.t_capture + config.latency;
  stamp.t_arrival = arrival;
  if (!whole) stamp.validity |= kIncomplete;
  sample.stamp = stamp;
  fill(sample, f, exposure);
  self.hand_over(std::move(slot));
}

/// What the sample is, and its bytes where they are not the camera's own.
void AravisSource::Impl::fill(Sample& sample, const ReceivedFrame& f, Duration exposure) const {
  const CameraFacts& facts = session->facts();
  sample.size_bytes = facts.picture_bytes;
  const auto memory = sample.memory();
  const auto raw = memory.subspan(raw_at);
  if (settings.range) {
    const std::size_t pixels = std::size_t{facts.width_px} * facts.height_px;
    const std::span<float> planes(reinterpret_cast<float*>(memory.data()), 2 * pixels);
    const bool gaps = f.state != ReceivedFrame::State::complete;
    const FramePart range = f.picture.value_or(FramePart{});  // a frame that is all range begins with it
    counts_to_range(facts.scale, raw.subspan(range.offset), gaps, planes.first(pixels));
    if (f.amplitude)
      counts_to_amplitude(facts.scale, raw.subspan(f.amplitude->offset),
                          ((f.amplitude->pfnc >> 16) & 0xFF) / 8, planes.subspan(pixels));
    else
      std::fill(planes.begin() + static_cast<std::ptrdiff_t>(pixels), planes.end(),
                std::numeric_limits<float>::quiet_NaN());
    sample.info = RangeImageInfo{facts.width_px, facts.height_px};
    return;
  }
  if (f.picture) std::memcpy(memory.data(), raw.data() + f.picture->offset, facts.picture_bytes);
  sample.info = ImageInfo{.format = settings.format,
                          .width_px = facts.width_px,
                          .height_px = facts.height_px,
                          .offset_x_px = facts.offset_x_px,
                          .offset_y_px = facts.offset_y_px,
                          .exposure = exposure,
                          .gain_db = f.gain_db.value_or(facts.gain_db)};
}

}  // namespace rigor
