// The host's side of a scanner: what to say next, and what the answers mean. No I/O: the caller carries the
// bytes and says when they went and came, so that it works alike over USB, a terminal, a socket and in
// memory.
//
//   begin     leave whatever was going on (SCIP2.0, TM2, QT), then VV, PP, and the clock: TM0, TM1 …, TM2
//   ready     parameters() and identity() are known
//   start     MD, MS or ME without an end; a scan is there for next_scan() as soon as its last byte came
//   II        now and then while measuring: it tells the time without stopping the laser, which TM does
//   stop      QT
//
// A silence that is too long, or a refusal, ends the session: `failed`, and `failure()` says why. The caller
// opens a new one with `begin`. One thread.
#pragma once

#include <deque>
#include <optional>

#include "drivers/usb/scip_codec.h"
#include "rt-core/time.h"

namespace rigor::usb {

struct ScanSettings {
  std::optional<std::uint32_t> first_step{}, last_step{};  ///< default: the detection range
  std::uint32_t cluster = 1;
  std::uint32_t skip = 0;  ///< scans left out between two
  bool intensity = false;
  bool two_characters = false;
};

class ScipClient {
 public:
  enum class Phase : std::uint8_t {
    idle,
    clearing,
    identity,
    parameters,
    clock,
    ready,
    measuring,
    stopping,
    failed
  };
  struct Options {
    ScanSettings scan;
    unsigned clock_readings = 16;
    Duration clock_every = seconds(1);  ///< II while measuring; 0: never
    Duration reply_limit = milliseconds(500);
  };
  /// The scanner's clock was `ms` somewhere between the two instants.
  struct Reading {
    std::uint32_t ms = 0;
    std::int64_t before_ns = 0, after_ns = 0;
  };
  struct Counters {
    std::uint64_t broken = 0;  ///< replies and scans with wrong sums or of no known form
    std::uint64_t retries = 0;
  };

  explicit ScipClient(const Options& options) : options_(options) {}

  void begin(std::int64_t now_ns);
  void start(std::int64_t now_ns);  ///< ready
  void stop(std::int64_t now_ns);
  void receive(std::string_view bytes, std::int64_t arrival_ns);
  /// Time passes. Call at `due_ns()` or later.
  void tick(std::int64_t now_ns);
  [[nodiscard]] std::int64_t due_ns() const noexcept {
    return phase_ == Phase::measuring && started_ && next_state_ < due_ ? next_state_ : due_;
  }
  /// What is to be sent now; then `sent`, with the instant just before it went.
  [[nodiscard]] const std::string& output() const noexcept { return output_; }
  void sent(std::int64_t before_ns);

  [[nodiscard]] bool next_scan(ScipScan& scan, std::int64_t& arrival_ns);
  [[nodiscard]] bool next_reading(Reading& reading);

  [[nodiscard]] Phase phase() const noexcept { return phase_; }
  [[nodiscard]] const std::string& failure() const noexcept { return failure_; }
  [[nodiscard]] const ScannerParameters& parameters() const noexcept { return parameters_; }
  [[nodiscard]] const ScannerIdentity& identity() const noexcept { return identity_; }
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }
  [[nodiscard]] std::uint64_t dropped_replies() const noexcept { return reader_.dropped(); }
  /// What `start` asks for, once the parameters are known.
  [[nodiscard]] ScanRequest request() const;
  /// Empty, or why this scanner cannot do what the settings ask: which key, and what it offers.
  struct Refusal {
    std::string key, message;
  };
  [[nodiscard]] std::optional<Refusal> check() const;

 private:
  void say(std::string_view line, std::int64_t now_ns);
  void fail(std::string why);
  void handle(const ScipReply& reply, std::int64_t now_ns);
  void read_clock(std::int64_t now_ns);
  [[nodiscard]] Duration scan_limit() const;

  Options options_;
  Phase phase_ = Phase::idle;
  std::string failure_, output_, waiting_for_;
  ScipReplyReader reader_;
  ScipReply reply_;
  ScannerParameters parameters_;
  ScannerIdentity identity_;
  std::deque<std::pair<ScipScan, std::int64_t>> scans_;
  std::deque<Reading> readings_;
  ScipScan scan_;
  std::int64_t due_ = 0, asked_time_ns_ = 0, next_state_ = 0;
  bool time_asked_ = false;  ///< TM1 or II is on its way
  bool started_ = false;
  unsigned clock_left_ = 0, tries_ = 0;
  Counters counters_;
};

}  // namespace rigor::usb
