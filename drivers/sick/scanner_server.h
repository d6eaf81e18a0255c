// A scanner's model on TCP: any number of clients up to a limit, each with its own access level and stream.
//
// One thread answers requests, another measures: it takes the points of a scan when the mirror passes the
// zero index, and sends the telegram when the last beam has been fired, to all who asked for it. A client
// that reads too slowly misses whole scans (its next one shows by the counter how many); one that reads
// nothing for long, floods, or is half gone costs its own connection and nothing else.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "drivers/sick/scanner_device.h"

namespace rigor::sick {

class ScannerServer {
 public:
  struct Options {
    unsigned max_clients = 8;              ///< one more is turned away at once
    Duration idle_limit = seconds(60);     ///< for a client without a whole request or a stream; 0: never
    Duration stall_limit = seconds(10);    ///< for one whose socket takes nothing more
    std::size_t max_request = 4096;        ///< bytes of a telegram
    std::size_t max_garbage = 64 * 1024;   ///< bytes that are no telegram
    std::size_t max_pending = 256 * 1024;  ///< bytes that wait for a client; one scan more is left out
    int send_buffer = 0;                   ///< of each socket; 0: the system's
  };
  struct Counters {
    std::atomic<std::uint64_t> scans{0};          ///< made and given out
    std::atomic<std::uint64_t> scans_late{0};     ///< not made: measuring took too long, or failed
    std::atomic<std::uint64_t> scans_skipped{0};  ///< left out for a client that reads too slowly
    std::atomic<std::uint64_t> turned_away{0}, dropped{0}, malformed{0}, requests{0};
    std::atomic<std::uint32_t> clients{0};
  };
  /// Measuring thread: the points of the scan with this number, first beam at this instant; empty on failure.
  using Measure = std::function<std::optional<std::span<const LidarPoint>>(std::uint64_t, BenchTime)>;

  /// `measure` may be null: then the device answers and has no scans.
  ScannerServer(ScannerConfig config, Measure measure, Options options);
  ~ScannerServer();
  ScannerServer(const ScannerServer&) = delete;
  ScannerServer& operator=(const ScannerServer&) = delete;

  /// Port 0 takes a free one. not_found for an address this machine does not have, unavailable for a port
  /// that is taken or not allowed. Setup thread, before start.
  [[nodiscard]] Status listen(const std::string& address, std::uint16_t port);
  [[nodiscard]] std::uint16_t port() const noexcept;
  /// Makes a client out of a connected stream socket. Setup thread, before start.
  void adopt(int socket);
  /// Called on a thread of the server's with the number of clients whenever it changes.
  void on_clients(std::function<void(unsigned)> tell);
  [[nodiscard]] Status start();
  void stop();
  [[nodiscard]] const Counters& counters() const noexcept;
  /// When the mirror passed its zero index for the first time, once started: scan k begins k periods later.
  [[nodiscard]] MonotonicTime switched_on() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::sick
