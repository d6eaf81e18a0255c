// A receiver on a line, for all channels of a process that belong to it: one thread reads it, configures it,
// looks for it when it is away, and passes corrections on.
//
//   auto receiver = Receiver::join(settings, client, "rover");   // arm: the first one opens the line
//   receiver->leave(client);                                     // stop: the last one closes it
#pragma once

#include <atomic>
#include <fstream>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "drivers/gnss/config_dialog.h"
#include "drivers/gnss/gnss_settings.h"
#include "drivers/gnss/pulse_input.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::gnss {

/// Of a line, counting since it was opened.
struct LineCounters {
  std::uint64_t messages = 0, bad = 0, garbage = 0;  ///< messages that came whole; broken ones; bytes between
  std::uint64_t rtcm_passed = 0, rtcm_failed = 0;    ///< corrections to the receiver
  std::uint64_t reconnects = 0, silences = 0, clock_steps = 0, rollovers = 0, edges = 0;
};

class ReceiverClient {
 public:
  virtual ~ReceiverClient() = default;
  // I/O thread of the receiver.
  virtual void on_solution(const Solution& solution, const ReceiverStream::Place& place) = 0;
  virtual void on_sky(const Sky& sky, const ReceiverStream::Place& place) = 0;
  virtual void on_pulse(const TimePulse& pulse) = 0;
  virtual void on_connection(bool connected) = 0;
  virtual void on_counters(const LineCounters& counters) = 0;
};

class Receiver {
 public:
  /// Setup thread. bad_input: another channel of this receiver says other things; else what keeps the line
  /// from being opened, with what to do.
  [[nodiscard]] static Result<std::shared_ptr<Receiver>> join(const ReceiverSettings& settings,
                                                              ReceiverClient* client,
                                                              const std::string& channel);
  /// Setup thread. The client hears no more afterwards.
  void leave(ReceiverClient* client);
  ~Receiver();
  /// What the receiver says of itself, where it was configured.
  [[nodiscard]] const std::optional<MonVer>& version() const { return version_; }

 private:
  Receiver(ReceiverSettings settings, std::string channel);
  Status open();
  Status connect();
  Status find_speed();
  Status configure();
  Status await_message();
  void close_line();
  void run();
  void run_corrections();
  void run_pulses();
  void take_edges();
  bool reconnect();
  void lost();
  void publish();
  template <class F>
  void for_clients(F&& f);

  ReceiverSettings settings_;
  std::string channel_;  ///< of the one that opened it, for messages
  std::unique_ptr<serial::ByteLink> link_, corrections_;
  PulseInput pulses_;
  std::unique_ptr<ReceiverStream> stream_;
  std::optional<MonVer> version_;
  std::ofstream log_;
  std::mutex clients_mutex_;
  std::vector<ReceiverClient*> clients_;
  std::mutex line_mutex_;  ///< sending, and opening and closing, which another thread does
  std::mutex edges_mutex_;
  std::vector<PulseInput::Edge> edges_;
  std::atomic<bool> stop_{false};
  std::atomic<std::uint64_t> rtcm_passed_{0}, rtcm_failed_{0};
  LineCounters counters_;
  Backoff backoff_;
  MonotonicTime heard_;
  std::uint64_t heard_messages_ = 0;
  std::thread thread_, corrections_thread_, pulses_thread_;
};

}  // namespace rigor::gnss
