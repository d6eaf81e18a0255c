#include "drivers/usb/scip_device.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace rigor::usb {
namespace {

constexpr std::size_t kMostReplyBytes = 16 * 1024;  ///< of text replies that nobody reads

ScannerModel make_urg() {
  ScannerModel m;
  m.name = "urg-04lx";
  m.parameters = {"URG-04LX(Hokuyo Automatic Co.,Ltd.)", 20, 5600, 1024, 44, 725, 384, 600};
  m.identity = {"Hokuyo Automatic Co.,Ltd.", "SOKUIKI Sensor URG-04LX", "3.3.00(Rigor emulator)", "SCIP 2.0",
                "H0000000"};
  m.end_step = 768;
  m.motor_speed = true;
  m.no_return_code = 1;    // reflected light has low intensity
  m.unmeasured_code = 19;  // non-measurable step
  return m;
}

ScannerModel make_utm() {
  ScannerModel m;
  m.name = "utm-30lx";
  m.parameters = {"UTM-30LX(Hokuyo Automatic Co.,Ltd.)", 23, 60000, 1440, 0, 1080, 540, 2400};
  m.identity = {"Hokuyo Automatic Co.,Ltd.", "SOKUIKI Sensor UTM-30LX", "1.18.01(Rigor emulator)", "SCIP 2.0",
                "H0000000"};
  m.end_step = 1080;
  m.intensity = true;
  m.no_return_code = 1;  // no object in the range
  m.unmeasured_code = 1;
  return m;
}

}  // namespace

const ScannerModel& urg_04lx() {
  static const ScannerModel model = make_urg();
  return model;
}
const ScannerModel& utm_30lx() {
  static const ScannerModel model = make_utm();
  return model;
}
const ScannerModel* find_scanner_model(std::string_view name) {
  for (const ScannerModel* m : {&urg_04lx(), &utm_30lx()})
    if (m->name == name) return m;
  return nullptr;
}

ScipDevice::ScipDevice(ScannerModel model, Measure measure, const Options& options)
    : model_(std::move(model)), measure_(std::move(measure)), options_(options) {
  range_mm_.assign(model_.end_step + 1, 0);
  intensity_.assign(model_.end_step + 1, 0);
  anchor_ = DeviceTime(options_.phase.ns());
  turn_ns_ = model_.parameters.turn_s() * 1e9;
}

std::uint32_t ScipDevice::clock_ms(DeviceTime t) const noexcept {
  const auto ns = t.ns() - clock_zero_ns_;
  const auto ticks =
      ns + static_cast<std::int64_t>(std::llround(static_cast<double>(ns) * options_.clock_ppm * 1e-6));
  return static_cast<std::uint32_t>((ticks / 1'000'000 + options_.clock_start_ms) %
                                    static_cast<std::int64_t>(kScipClockModulus));
}

DeviceTime ScipDevice::step_zero(std::uint64_t scan) const noexcept {
  return anchor_ + Duration(std::llround(static_cast<double>(scan - anchor_scan_) * turn_ns_));
}

DeviceTime ScipDevice::scan_end(std::uint64_t scan) const noexcept {
  const double part = (model_.parameters.last_step + 1.0) / model_.parameters.steps_per_turn;
  return step_zero(scan) + Duration(std::llround(part * turn_ns_));
}

std::uint64_t ScipDevice::first_scan_from(DeviceTime t) const noexcept {
  const auto since = static_cast<double>((t - anchor_).ns());
  auto k = anchor_scan_ + (since > 0 ? static_cast<std::uint64_t>(since / turn_ns_) : 0);
  while (step_zero(k) < t) ++k;
  return k;
}

DeviceTime ScipDevice::next_event() const {
  DeviceTime t = DeviceTime::never();
  if (running_) t = std::min(t, scan_end(running_->next_scan));
  if (single_) t = std::min(t, scan_end(single_->next_scan));
  return t;
}

void ScipDevice::advance(DeviceTime t) {
  while (next_event() <= t) {
    if (single_ && (!running_ || scan_end(single_->next_scan) <= scan_end(running_->next_scan))) {
      const Asked asked = *single_;
      single_.reset();
      emit(asked, asked.next_scan);
      continue;
    }
    Asked& asked = *running_;
    const bool counted = asked.request.scans > 0;
    Asked reply = asked;
    if (counted) reply.request.scans = asked.request.scans - 1;
    emit(reply, asked.next_scan);
    asked.next_scan += asked.request.interval + 1;
    if (counted && --asked.request.scans == 0) {
      running_.reset();
      laser_ = false;
    }
  }
}

void ScipDevice::emit(const Asked& asked, std::uint64_t scan) {
  if (output_.size() > options_.backlog_bytes) {
    ++counters_.scans_dropped;
    return;
  }
  const ScannerParameters& p = model_.parameters;
  std::fill(range_mm_.begin(), range_mm_.end(), model_.unmeasured_code);
  std::fill(intensity_.begin(), intensity_.end(), 0);
  const DeviceTime zero = step_zero(scan);
  const Duration to_first(std::llround(turn_ns_ * p.first_step / p.steps_per_turn));
  if (!measure_ || !measure_(scan, zero + to_first, range_mm_, intensity_)) {
    ++counters_.scans_missing;
    return;
  }
  const ScanRequest& r = asked.request;
  merged_range_.clear();
  merged_intensity_.clear();
  for (std::uint32_t from = r.first_step; from <= r.last_step; from += r.width()) {
    const std::uint32_t to = std::min(from + r.width() - 1, r.last_step);
    std::uint32_t best = from;
    for (std::uint32_t s = from; s <= to; ++s) {
      const bool good = range_mm_[s] >= p.min_range_mm;
      const bool best_good = range_mm_[best] >= p.min_range_mm;
      if (good && (!best_good || range_mm_[s] < range_mm_[best])) best = s;
    }
    merged_range_.push_back(range_mm_[best]);
    merged_intensity_.push_back(intensity_[best]);
  }
  encode_scan(r, asked.label, r.continuous ? "99" : "00", clock_ms(zero), merged_range_, merged_intensity_,
              output_);
  ++counters_.scans_sent;
}

void ScipDevice::receive(std::string_view bytes, DeviceTime t) {
  advance(t);
  reader_.push(bytes);
  std::string_view line;
  while (reader_.next(line)) {
    ++counters_.commands;
    // A host that only sends and never reads gets no more answers.
    if (output_.size() > options_.backlog_bytes + kMostReplyBytes) {
      ++counters_.refused;
      continue;
    }
    execute(line, t);
  }
}

void ScipDevice::host_gone() {
  running_.reset();
  single_.reset();
  laser_ = time_mode_ = false;
  output_.clear();
  reader_.clear();
}

void ScipDevice::set_speed(std::uint32_t level, DeviceTime t) {
  const std::uint64_t next = first_scan_from(t);
  const DeviceTime zero = step_zero(next);
  anchor_ = zero;
  anchor_scan_ = next;
  speed_level_ = level;
  turn_ns_ = model_.parameters.turn_s() * 1e9 * (1 + 0.01 * level);
}

void ScipDevice::ask_for(const ScipCommand& command, std::string_view line, DeviceTime t) {
  const std::size_t semicolon = line.find(';');
  Asked asked{command.scan, semicolon == std::string_view::npos ? "" : std::string(line.substr(semicolon)),
              0};
  if (command.scan.values == 'E' && !model_.intensity) return encode_status(line, "0E", output_);
  if (command.scan.last_step > model_.end_step) return encode_status(line, "04", output_);
  if (command.scan.continuous) {
    if (!laser_) laser_since_ = t;
    laser_ = true;
    asked.next_scan = first_scan_from(t);
    encode_status(line, "00", output_);
    running_ = std::move(asked);
    return;
  }
  if (!laser_) return encode_status(line, "10", output_);
  // The latest scan that was measured with the laser on, or the first one that will be.
  const std::uint64_t first = first_scan_from(laser_since_);
  asked.next_scan = std::max(first, first_scan_from(t));
  while (asked.next_scan > first && scan_end(asked.next_scan) > t) --asked.next_scan;
  if (scan_end(asked.next_scan) <= t)
    emit(asked, asked.next_scan);
  else
    single_ = std::move(asked);
}

void ScipDevice::state(DeviceTime t, std::string& out) const {
  char text[64];
  encode_field("MODL", model_.parameters.model, out);
  encode_field("LASR", laser_ ? "ON" : "OFF", out);
  std::snprintf(text, sizeof text, "%s(%u[rpm])", speed_level_ == 0 ? "Initial" : "Changed",
                static_cast<unsigned>(std::lround(60e9 / turn_ns_)));
  encode_field("SCSP", text, out);
  encode_field("MESM",
               running_ ? (sensitive_ ? "Measuring by Sensitive Mode" : "Measuring by Normal Mode") : "IDLE",
               out);
  std::snprintf(text, sizeof text, "%u[bps]", bit_rate_);
  encode_field("SBPS", text, out);
  std::snprintf(text, sizeof text, "%06X", clock_ms(t));
  encode_field("TIME", text, out);
  encode_field("STAT", "Sensor works well.", out);
}

void ScipDevice::execute(std::string_view line, DeviceTime t) {
  using Kind = ScipCommand::Kind;
  const ScipCommand c = parse_scip_command(line);
  const auto answer = [&](const char* status) {
    if (std::string_view(status) != "00") ++counters_.refused;
    encode_status(line, status, output_);
  };
  const bool of_time = c.kind == Kind::time_on || c.kind == Kind::time_read || c.kind == Kind::time_off;
  if (std::string_view(c.status) != "00") return answer(c.status);
  if (time_mode_ && !of_time) return answer("0E");
  const auto texts = [&](auto&& fill) {
    output_ += line;
    output_ += "\n00P\n";
    fill();
    output_ += '\n';
  };
  switch (c.kind) {
    case Kind::version:
      return texts([&] {
        const ScannerIdentity& id = model_.identity;
        encode_field("VEND", id.vendor, output_);
        encode_field("PROD", id.product, output_);
        encode_field("FIRM", id.firmware, output_);
        encode_field("PROT", id.protocol, output_);
        encode_field("SERI", id.serial, output_);
      });
    case Kind::parameters:
      return texts([&] {
        const ScannerParameters& p = model_.parameters;
        encode_field("MODL", p.model, output_);
        encode_field("DMIN", std::to_string(p.min_range_mm), output_);
        encode_field("DMAX", std::to_string(p.max_range_mm), output_);
        encode_field("ARES", std::to_string(p.steps_per_turn), output_);
        encode_field("AMIN", std::to_string(p.first_step), output_);
        encode_field("AMAX", std::to_string(p.last_step), output_);
        encode_field("AFRT", std::to_string(p.front_step), output_);
        encode_field("SCAN", std::to_string(p.rpm), output_);
      });
    case Kind::state:
      return texts([&] { state(t, output_); });
    case Kind::laser_on:
      if (laser_) return answer("02");
      laser_ = true;
      laser_since_ = t;
      return answer("00");
    case Kind::quit:
    case Kind::reset:
      running_.reset();
      single_.reset();
      laser_ = false;
      if (c.kind == Kind::reset) {
        set_speed(0, t);
        bit_rate_ = 115200;
        sensitive_ = false;
        clock_zero_ns_ = t.ns();
        options_.clock_start_ms = 0;
      }
      return answer("00");
    case Kind::time_on:
      if (time_mode_) return answer("02");
      running_.reset();
      single_.reset();
      laser_ = false;
      time_mode_ = true;
      return answer("00");
    case Kind::time_off:
      if (!time_mode_) return answer("03");
      time_mode_ = false;
      return answer("00");
    case Kind::time_read: {
      if (!time_mode_) return answer("04");
      std::string time;
      scip_encode(clock_ms(t), 4, time);
      output_ += line;
      output_ += "\n00P\n" + time + scip_sum(time) + "\n\n";
      return;
    }
    case Kind::motor_speed:
      if (!model_.motor_speed) return answer("04");
      if (c.value > 10 && c.value != 99) return answer("02");
      if ((c.value % 99) == speed_level_) return answer("03");
      set_speed(c.value % 99, t);
      return answer("00");
    case Kind::bit_rate: {
      bool known = false;
      for (const unsigned rate : {19200u, 57600u, 115200u, 250000u, 500000u, 750000u})
        known |= c.value == rate;
      if (!known) return answer("02");
      if (c.value == bit_rate_) return answer("03");
      bit_rate_ = c.value;
      return answer("00");
    }
    case Kind::sensitivity:
      if (!model_.motor_speed) return answer("03");
      if (c.value > 1) return answer("01");
      if ((c.value == 1) == sensitive_) return answer("02");
      sensitive_ = c.value == 1;
      return answer("00");
    case Kind::scan:
      return ask_for(c, line, t);
    case Kind::switch_to_scip2:  // it speaks nothing else
    case Kind::unknown:
      return answer("0E");
  }
}

}  // namespace rigor::usb
