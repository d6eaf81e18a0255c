#include "drivers/usb/bulk_source.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

namespace rigor::usb {
namespace {

std::uint64_t mask_of(const BulkField& field) {
  const std::size_t bits = raw_bytes(field.type) * 8;
  return bits >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1;
}

void describe_frames(const BulkSettings& s, const ChannelConfig& config, ChannelDescription& d) {
  d.kind = config.kind;
  d.frame_id = config.name;
  d.width_px = s.format.width_px;
  d.height_px = s.format.height_px;
  d.max_bytes = bulk_sample_bytes(s.format);
  if (s.format.image())
    d.format = s.format.planes.front().type == RawType::u8 ? PixelFormat::mono8 : PixelFormat::mono16;
}

}  // namespace

BulkSettings read_bulk_settings(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  BulkSettings s;
  (void)n.choice_or("protocol", {"bulk"}, "bulk");
  s.link = read_link_settings(n, true);
  s.format = read_bulk_format(n.map("frame"));
  const SampleKind gives = s.format.image() ? SampleKind::image : SampleKind::range_image;
  if (config.kind != gives)
    throw n.error("frame", s.format.image() ? "expected `kind: image` for frames with a plane `image`"
                                            : "expected `kind: range_image` for frames with a plane `range`");
  s.delay = seconds_from(n.number_or("delay_ms", 0, {.min = 0, .max = 10000}) * 1e-3);
  s.delay_sigma = seconds_from(n.number_or("delay_sigma_ms", 0, {.min = 0, .max = 10000}) * 1e-3);
  s.slots = static_cast<std::size_t>(n.integer_or("slots", 16, {.min = 2, .max = 1024}));
  return s;
}

// ------------------------------------------------------------------ place and time

void FrameKeeper::begin(const ChannelConfig& config, const BulkSettings& settings) {
  settings_ = &settings;
  period_ = config.period;
  latency_ = config.latency;
  any_ = counted_ = false;
  ClockMapOptions options;
  options.min_delay = settings.delay;
  options.min_delay_sigma = settings.delay_sigma;
  options.resolution = Duration(settings.format.tick_ns);
  map_ = std::make_unique<ClockMap>(options);
}

void FrameKeeper::forget_device() noexcept {
  if (map_) map_->reset();
  counted_ = false;
}

FrameKeeper::Kept FrameKeeper::place(const BulkReader::Frame& frame, const RunOrigin& origin) noexcept {
  const BulkFormat& f = settings_->format;
  Stamp stamp;
  stamp.t_arrival = BenchTime(frame.last_ns);
  stamp.t_capture = BenchTime(frame.first_ns) - settings_->delay;
  stamp.sigma_capture = settings_->delay_sigma;
  if (f.stamp && !trusted_) {
    // The counter may be narrow: what it has gone on by since the last frame counts.
    const std::uint64_t mask = mask_of(*f.stamp), now = *bulk_field(f, *f.stamp, frame.bytes);
    const std::uint64_t ahead = (now - device_ticks_) & mask;
    extended_ticks_ += ahead <= mask / 2 ? static_cast<std::int64_t>(ahead)
                                         : -static_cast<std::int64_t>((device_ticks_ - now) & mask);
    device_ticks_ = now;
    const std::int64_t most = INT64_MAX / 4 / f.tick_ns;
    if (extended_ticks_ > most || extended_ticks_ < -most) extended_ticks_ = 0;
    const DeviceTime x(extended_ticks_ * f.tick_ns);
    (void)map_->add_arrival(x, BenchTime(frame.first_ns));
    if (const Mapped m = map_->map(x); m.known) {
      // A frame that is here before the map says that it was measured knows better: those before it were
      // late.
      if (m.t > stamp.t_capture + m.sigma * 3) stamp.validity |= kClockUnsure;
      stamp.t_capture = std::min(stamp.t_capture, m.t);
      stamp.sigma_capture = m.sigma;
    } else {
      stamp.validity |= kClockUnsure;
    }
  }
  stamp.t_release = stamp.t_capture + latency_;
  if (!any_ && !origin.covers(stamp.t_capture, period_)) return {.in_run = false};
  std::int64_t step = 1;
  if (any_) {
    if (stamp.t_capture <= stamp_.t_capture) return {.in_order = false};
    if (period_.ns() > 0)
      step = std::max<std::int64_t>(
          1, std::llround(static_cast<double>((stamp.t_capture - stamp_.t_capture).ns()) /
                          static_cast<double>(period_.ns())));
  } else if (period_.ns() > 0) {
    stamp.sequence = static_cast<std::uint64_t>(
        std::max<std::int64_t>(0, std::llround(static_cast<double>((stamp.t_capture - *origin.get()).ns()) /
                                               static_cast<double>(period_.ns()))));
  }
  if (f.sequence) {
    const std::uint64_t mask = mask_of(*f.sequence);
    const std::uint64_t now = *bulk_field(f, *f.sequence, frame.bytes);
    const std::uint64_t ahead = (now - device_sequence_) & mask;
    if (counted_ && ahead != 0 && ahead <= mask / 2) step = static_cast<std::int64_t>(ahead);
    device_sequence_ = now;
    counted_ = true;
  }
  if (any_) stamp.sequence = stamp_.sequence + static_cast<std::uint64_t>(step);
  const bool first = !std::exchange(any_, true);
  stamp_ = stamp;
  return {.lost = first ? 0 : static_cast<std::uint64_t>(step - 1)};
}

void FrameKeeper::fill(const BulkReader::Frame& frame, Sample& sample) const noexcept {
  const BulkFormat& f = settings_->format;
  sample.stamp = stamp_;
  sample.size_bytes = bulk_sample_bytes(f);
  if (f.image()) {
    ImageInfo info;
    info.format = f.planes.front().type == RawType::u8 ? PixelFormat::mono8 : PixelFormat::mono16;
    info.width_px = f.width_px;
    info.height_px = f.height_px;
    sample.info = info;
  } else {
    sample.info = RangeImageInfo{f.width_px, f.height_px};
  }
  if (!decode_bulk(f, frame.bytes, sample.memory())) sample.stamp.validity |= kCorrupt;
}

std::uint64_t FrameKeeper::missing_by(BenchTime now) noexcept {
  if (!any_ || period_.ns() <= 0) return 0;
  const Duration since = now - stamp_.t_capture - latency_;
  any_ = false;
  return since > period_ ? static_cast<std::uint64_t>(since / period_) : 0;
}

// ------------------------------------------------------------------ the device

BulkSource::~BulkSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status BulkSource::do_configure(const ChannelConfig& config) {
  settings_ = read_bulk_settings(config);
  describe_frames(settings_, config, description_);
  return {};
}

Status BulkSource::do_arm(const ArmContext&) {
  link_ = links_(settings_.link);
  if (!link_)
    return fail(ErrorCode::unavailable, config().name, "this build has no libusb; use `transport: tcp`");
  if (auto s = link_->open(); !s) {
    auto error = fail(s.error().code, config().name, s.error().text());
    link_.reset();
    return error;
  }
  reader_ = std::make_unique<BulkReader>(settings_.format);
  open_stream(settings_.slots, description_.max_bytes, false);
  health_.connected.store(true, std::memory_order_release);
  keeper_.begin(config(), settings_);
  backoff_.reset();
  link_->uncut();
  thread_ = std::thread([this] { run(); });
  return {};
}

Status BulkSource::do_stop() {
  link_->cut();
  if (thread_.joinable()) thread_.join();
  link_counters_ = link_->counters();
  link_.reset();
  close_stream();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

void BulkSource::run() {
  std::vector<char> buffer(64 * 1024);
  std::uint64_t refused = 0, stalls = link_->counters().stalls;
  bool fresh = true;  // from a new connection nothing is expected to be where the old one ended
  while (true) {
    if (!link_->is_open()) {
      if (!backoff_.due(monotonic_now())) {
        if (!link_->wait(backoff_.next())) break;
        if (!backoff_.due(monotonic_now())) backoff_.reset();
      }
      backoff_.failed(monotonic_now());
      if (!link_->open()) continue;
      reader_->interrupt();
      keeper_.forget_device();
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
      health_.connected.store(true, std::memory_order_release);
      fresh = true;
    }
    const ByteLink::Received r = link_->receive(buffer, monotonic_now() + seconds(1));
    if (r.state == ByteLink::State::cut) break;
    if (r.state == ByteLink::State::gone) {
      link_->close();
      health_.connected.store(false, std::memory_order_release);
      continue;
    }
    if (const std::uint64_t now = link_->counters().stalls; now != stalls) {
      stalls = now;
      health_.retries.fetch_add(1, std::memory_order_relaxed);
      reader_->interrupt();
      fresh = true;
    }
    if (r.state == ByteLink::State::timeout) continue;
    const std::uint64_t skipped = reader_->skipped_bytes();
    reader_->push({buffer.data(), r.bytes}, r.arrival.ns());
    BulkReader::Frame frame;
    while (reader_->next(frame)) {
      backoff_.reset();
      fresh = false;
      const FrameKeeper::Kept kept = keeper_.place(frame, origin());
      if (!kept.in_run) continue;
      if (!kept.in_order) {
        health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
        continue;
      }
      if (kept.lost > 0) count_lost(kept.lost);
      SampleSlot slot = take_slot();
      if (slot) keeper_.fill(frame, *slot);
      hand_over(std::move(slot));
    }
    const std::uint64_t now =
        reader_->refused_headers() + (reader_->skipped_bytes() != skipped && !fresh ? 1 : 0);
    if (now > refused) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    refused = reader_->refused_headers();
  }
  if (!link_->is_open()) count_lost(keeper_.missing_by(bench_now()));
}

// ------------------------------------------------------------------ the world

WorldFrames::WorldFrames(DeviceParts parts, BulkFormat format)
    : parts_(std::move(parts)), format_(std::move(format)) {
  const std::size_t measured = parts_.samples ? parts_.samples->geometry().max_bytes : 0;
  sample_.reserve(std::max<std::size_t>({measured, bulk_sample_bytes(format_), std::size_t{1}}));
}

Result<std::unique_ptr<WorldFrames>> WorldFrames::create(DeviceParts parts, BulkFormat format,
                                                         const std::string& name) {
  const auto wrong = [&](const std::string& got) {
    return fail(ErrorCode::bad_input, name,
                "expected something that gives frames of " + std::to_string(format.width_px) + "x" +
                    std::to_string(format.height_px) +
                    " px, as `frame` says: give the emulator a sensor model of a " +
                    (format.image() ? "camera" : "time-of-flight camera") + " as `sensor`; got " + got);
  };
  const auto size = [](std::uint32_t w, std::uint32_t h) {
    return std::to_string(w) + "x" + std::to_string(h) + " px";
  };
  if (format.image()) {
    if (!parts.image) return wrong("none");
    const auto g = parts.image->geometry();
    if (g.width_px != format.width_px || g.height_px != format.height_px)
      return wrong(size(g.width_px, g.height_px));
  } else {
    if (!parts.samples || parts.samples->geometry().kind != SampleKind::range_image) return wrong("none");
    const auto g = parts.samples->geometry();
    if (g.width_px != format.width_px || g.height_px != format.height_px)
      return wrong(size(g.width_px, g.height_px));
  }
  return std::unique_ptr<WorldFrames>(new WorldFrames(std::move(parts), std::move(format)));
}

bool WorldFrames::frame(std::uint64_t index, BenchTime t, std::int64_t stamp_ns, std::string& out) {
  WorldMotion motion;
  if (parts_.motion) motion = parts_.motion->motion_at(t);
  if (format_.image()) {
    ImageRequest r;
    r.index = index;
    r.t_capture = t;
    r.format = format_.planes.front().type == RawType::u8 ? PixelFormat::mono8 : PixelFormat::mono16;
    r.motion = motion;
    const std::size_t bytes = bulk_sample_bytes(format_);
    if (!parts_.image->capture(r, sample_.memory().first(bytes))) return false;
    sample_.size_bytes = bytes;
  } else {
    SampleProvider::Request r;
    r.index = index;
    r.t_capture = t;
    r.motion = motion;
    if (!parts_.samples->capture(r, sample_)) return false;
  }
  encode_bulk(format_, sample_.bytes(), index, stamp_ns, out);
  return true;
}

BulkVirtualSource::BulkVirtualSource(DeviceParts parts, ConfigNode emulator_params)
    : parts_(std::move(parts)), emulator_params_(std::move(emulator_params)) {}
BulkVirtualSource::~BulkVirtualSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status BulkVirtualSource::do_configure(const ChannelConfig& config) {
  settings_ = read_bulk_settings(config);
  describe_frames(settings_, config, description_);
  if (config.period.ns() <= 0)
    return fail(ErrorCode::bad_input, config.name,
                "expected a rate: a device in virtual time measures on the bench's grid");
  return {};
}

Status BulkVirtualSource::do_arm(const ArmContext& context) {
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time only");
  BulkFormat format = settings_.format;
  if (emulator_params_.has("frame")) {
    auto read = catch_config([&] { return read_bulk_format(emulator_params_.map("frame")); });
    if (!read) return tl::unexpected<Error>(read.error());
    format = std::move(*read);
  }
  auto world = WorldFrames::create(parts_, std::move(format), config().name);
  if (!world) return tl::unexpected<Error>(world.error());
  world_ = std::move(*world);
  reader_ = std::make_unique<BulkReader>(settings_.format);
  open_stream(settings_.slots, description_.max_bytes, true);
  health_.connected.store(true, std::memory_order_release);
  return {};
}

Status BulkVirtualSource::do_start(BenchTime t0) {
  keeper_.begin(config(), settings_);
  keeper_.trust_arrivals();
  t0_ = t0;
  index_ = 0;
  return {};
}

Status BulkVirtualSource::do_stop() {
  close_stream();
  reader_.reset();
  world_.reset();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

void BulkVirtualSource::complete_until(BenchTime now) {
  if (state() != ChannelState::running) return;
  while (true) {
    const BenchTime t = t0_ + config().period * static_cast<std::int64_t>(index_);
    if (t > now) return;
    const std::uint64_t index = index_++;
    bytes_.clear();
    if (!world_->frame(index, t, t.ns(), bytes_)) continue;  // the gap shows in what comes next
    // It arrives as late as the configured delay says, so that its instant is the bench's own.
    reader_->push(bytes_, (t + settings_.delay).ns());
    BulkReader::Frame frame;
    while (reader_->next(frame)) {
      const FrameKeeper::Kept kept = keeper_.place(frame, origin());
      if (!kept.in_run || !kept.in_order) continue;
      if (kept.lost > 0) count_lost(kept.lost);
      SampleSlot slot = take_slot();
      if (slot) {
        keeper_.fill(frame, *slot);
        slot->stamp.t_arrival = slot->stamp.t_release;
      }
      hand_over(std::move(slot));
    }
  }
}

}  // namespace rigor::usb
