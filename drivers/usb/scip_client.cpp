#include "drivers/usb/scip_client.h"

#include <algorithm>
#include <limits>

#include "rt-core/device_text.h"

namespace rigor::usb {
namespace {

constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();
constexpr std::size_t kMostScans = 64, kMostReadings = 256;
constexpr unsigned kTries = 4;
// A device that was in the middle of a line first gets its end; SCIP 1.1 is left, the clock's mode too.
constexpr std::string_view kClear = "\nSCIP2.0\nTM2\nQT\n";

}  // namespace

void ScipClient::fail(std::string why) {
  phase_ = Phase::failed;
  failure_ = std::move(why);
  due_ = kNever;
}

Duration ScipClient::scan_limit() const {
  const Duration scan = seconds_from(parameters_.turn_s() * (options_.scan.skip + 1));
  return std::max(seconds(1), scan * 4);
}

void ScipClient::say(std::string_view line, std::int64_t now_ns) {
  output_ += line;
  output_ += '\n';
  waiting_for_ = line;
  due_ = now_ns + options_.reply_limit.ns();
}

void ScipClient::begin(std::int64_t now_ns) {
  reader_.clear();
  scans_.clear();
  readings_.clear();
  output_ = kClear;
  waiting_for_ = "QT";
  phase_ = Phase::clearing;
  failure_.clear();
  due_ = now_ns + options_.reply_limit.ns();
  time_asked_ = started_ = false;
  tries_ = 0;
}

void ScipClient::start(std::int64_t now_ns) {
  if (phase_ != Phase::ready) return;
  phase_ = Phase::measuring;
  started_ = false;
  say(request().line(), now_ns);
  due_ = now_ns + scan_limit().ns();
  next_state_ = options_.clock_every.ns() > 0 ? now_ns + options_.clock_every.ns() : kNever;
}

void ScipClient::stop(std::int64_t now_ns) {
  if (phase_ == Phase::idle || phase_ == Phase::failed) return;
  phase_ = Phase::stopping;
  output_.clear();
  say("QT", now_ns);
}

ScanRequest ScipClient::request() const {
  ScanRequest r;
  r.continuous = true;
  r.values = options_.scan.intensity ? 'E' : options_.scan.two_characters ? 'S' : 'D';
  r.first_step = options_.scan.first_step.value_or(parameters_.first_step);
  r.last_step = options_.scan.last_step.value_or(parameters_.last_step);
  r.cluster = options_.scan.cluster;
  r.interval = options_.scan.skip;
  r.scans = 0;
  return r;
}

std::optional<ScipClient::Refusal> ScipClient::check() const {
  const ScannerParameters& p = parameters_;
  const std::string offers = " (" + p.model + " measures steps " + std::to_string(p.first_step) + " … " +
                             std::to_string(p.last_step) + ")";
  const ScanRequest r = request();
  const auto within = [&](std::uint32_t step) { return step >= p.first_step && step <= p.last_step; };
  if (!within(r.first_step))
    return Refusal{"start_step", "expected a step of the scanner's detection range, got " +
                                     std::to_string(r.first_step) + offers};
  if (!within(r.last_step))
    return Refusal{"end_step", "expected a step of the scanner's detection range, got " +
                                   std::to_string(r.last_step) + offers};
  if (r.first_step > r.last_step)
    return Refusal{"end_step", "expected a step not before start_step, " + std::to_string(r.first_step) +
                                   ", got " + std::to_string(r.last_step)};
  if (r.values == 'S' && p.max_range_mm > 4095)
    return Refusal{"characters", "expected 3: two characters hold 4095 mm, and " + p.model + " measures to " +
                                     std::to_string(p.max_range_mm) + " mm"};
  return std::nullopt;
}

void ScipClient::sent(std::int64_t before_ns) {
  output_.clear();
  if (time_asked_) asked_time_ns_ = before_ns;
}

void ScipClient::read_clock(std::int64_t now_ns) {
  if (clock_left_ == 0) {
    say("TM2", now_ns);
    return;
  }
  --clock_left_;
  time_asked_ = true;
  say("TM1", now_ns);
}

void ScipClient::tick(std::int64_t now_ns) {
  if (phase_ == Phase::idle || phase_ == Phase::failed || phase_ == Phase::ready) return;
  if (phase_ == Phase::measuring && now_ns >= next_state_ && started_) {
    next_state_ = now_ns + options_.clock_every.ns();
    if (!time_asked_) {
      output_ += "II\n";
      time_asked_ = true;
    } else {
      time_asked_ = false;  // it never came; the next one may
      ++counters_.retries;
    }
  }
  if (now_ns < due_) {
    return;
  }
  if (phase_ == Phase::clearing && ++tries_ < kTries) {
    ++counters_.retries;
    reader_.clear();
    output_ = kClear;
    due_ = now_ns + options_.reply_limit.ns();
    return;
  }
  if (phase_ == Phase::stopping) {
    phase_ = Phase::idle;
    return;
  }
  fail(phase_ == Phase::clearing
           ? "expected an answer to QT, got nothing: is it a SCIP 2.0 scanner, and its speed right?"
       : phase_ == Phase::measuring ? "expected a scan, got nothing for too long"
                                    : "expected an answer to " + waiting_for_ + ", got nothing");
}

void ScipClient::receive(std::string_view bytes, std::int64_t arrival_ns) {
  reader_.push(bytes, arrival_ns);
  while (reader_.next(reply_)) handle(reply_, arrival_ns);
}

void ScipClient::handle(const ScipReply& reply, std::int64_t now_ns) {
  const std::string_view echo = reply.echo(), status = reply.status();
  switch (phase_) {
    case Phase::idle:
    case Phase::failed:
    case Phase::ready:
      return;
    case Phase::stopping:
      if (echo == "QT") phase_ = Phase::idle, due_ = kNever;
      return;
    case Phase::clearing:
      if (echo != "QT" || status != "00") return;
      phase_ = Phase::identity;
      return say("VV", now_ns);
    case Phase::identity: {
      if (echo != "VV") return;
      const auto id = decode_identity(reply);
      if (!id) return fail("expected what VV tells, got an answer that is none");
      identity_ = *id;
      phase_ = Phase::parameters;
      return say("PP", now_ns);
    }
    case Phase::parameters: {
      if (echo != "PP") return;
      const auto p = decode_parameters(reply);
      if (!p) return fail("expected the scanner's parameters by PP, got an answer that is none");
      parameters_ = *p;
      if (options_.clock_readings == 0) {
        phase_ = Phase::ready;
        due_ = kNever;
        return;
      }
      phase_ = Phase::clock;
      clock_left_ = options_.clock_readings;
      return say("TM0", now_ns);
    }
    case Phase::clock:
      if (echo == "TM0") {
        // A scanner without the clock's mode is one whose scans are stamped by their arrival.
        if (status != "00" && status != "02") clock_left_ = 0;
        return read_clock(now_ns);
      }
      if (echo == "TM1") {
        const auto ms = decode_time(reply);
        if (!ms) ++counters_.broken;
        if (ms && time_asked_ && readings_.size() < kMostReadings)
          readings_.push_back({*ms, asked_time_ns_, reply.last_ns});
        time_asked_ = false;
        return read_clock(now_ns);
      }
      if (echo == "TM2") {
        phase_ = Phase::ready;
        due_ = kNever;
      }
      return;
    case Phase::measuring:
      break;
  }
  if (echo == "II") {
    const auto ms = decode_time(reply);
    if (!ms) ++counters_.broken;
    if (ms && time_asked_ && readings_.size() < kMostReadings)
      readings_.push_back({*ms, asked_time_ns_, reply.last_ns});
    time_asked_ = false;
    return;
  }
  const ScanDecode decoded = decode_scan(reply, scan_);
  const ScanRequest wanted = request();
  if (decoded == ScanDecode::scan) {
    ScanRequest got = scan_.request;
    got.scans = 0;
    if (got != wanted) {
      ++counters_.broken;
      return;
    }
    started_ = true;
    due_ = now_ns + scan_limit().ns();
    if (scans_.size() == kMostScans) scans_.pop_front();  // its gap tells
    scans_.emplace_back(std::move(scan_), reply.last_ns);
    scan_ = {};
    return;
  }
  if (decoded == ScanDecode::broken) {
    ++counters_.broken;
    return;
  }
  if (echo == wanted.line()) {
    if (status == "00") {
      started_ = true;
      return;
    }
    if (status == "98") return;  // it goes on after a check of its laser
    return fail("expected " + wanted.line() + " to be carried out, got status " + device_text(status) +
                (status == "0E" ? ": the scanner does not know that command" : ""));
  }
  ++counters_.broken;
}

bool ScipClient::next_scan(ScipScan& scan, std::int64_t& arrival_ns) {
  if (scans_.empty()) return false;
  scan = std::move(scans_.front().first);
  arrival_ns = scans_.front().second;
  scans_.pop_front();
  return true;
}

bool ScipClient::next_reading(Reading& reading) {
  if (readings_.empty()) return false;
  reading = readings_.front();
  readings_.pop_front();
  return true;
}

}  // namespace rigor::usb
