// A Hokuyo scanner as it looks from the wire: commands in, replies and scans out, at instants of its own
// clock. No I/O and no threads; the same model stands behind a USB gadget, a pseudo-terminal, a socket, and
// in virtual time.
//
//   device.receive(bytes, t);          // a command came
//   device.advance(t);                 // scans that have ended by t go out
//   send(device.output());             // … as far as the wire takes them
//
// The mirror turns all the time: scan k passes step 0 at phase + k · turn, and its reply is there when the
// last step of the detection range has been measured. A stamp is the clock at step 0, in whole milliseconds.
// Bytes that nobody takes pile up to `backlog_bytes`; a scan that finds no room is dropped whole and counted.
//
// Behaviour by the specification named in scip_codec.h. That levels of CR slow the motor by 1 % each is a
// choice: it says that there are ten.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include "drivers/usb/scip_codec.h"
#include "rt-core/time.h"

namespace rigor::usb {

struct ScannerModel {
  std::string name;  ///< as rigs write it: urg-04lx
  ScannerParameters parameters;
  ScannerIdentity identity;
  std::uint32_t end_step = 0;         ///< last step that may be asked for; at least parameters.last_step
  bool intensity = false;             ///< has ME and GE
  bool motor_speed = false;           ///< has CR and HS
  std::uint32_t no_return_code = 0;   ///< range of a step without an echo; below min_range_mm
  std::uint32_t unmeasured_code = 0;  ///< of a step outside the detection range
};
/// URG-04LX: 240 degrees in 682 steps, 10 Hz, 20 to 5600 mm. UTM-30LX: 270 degrees in 1081 steps, 40 Hz.
/// Values: PP of the devices, as in the specification and in urg_library's tests.
[[nodiscard]] const ScannerModel& urg_04lx();
[[nodiscard]] const ScannerModel& utm_30lx();
/// nullptr for names that are none.
[[nodiscard]] const ScannerModel* find_scanner_model(std::string_view name);

class ScipDevice {
 public:
  /// Fills one scan, indexed by step from 0 to end_step; `t_first` is when `parameters.first_step` is
  /// measured. False: nothing was measured, the scan does not go out.
  using Measure = std::function<bool(std::uint64_t scan, DeviceTime t_first,
                                     std::span<std::uint32_t> range_mm, std::span<std::uint32_t> intensity)>;
  struct Options {
    Duration phase{};                  ///< step 0 of scan 0, after power-on; 0 or more
    std::uint32_t clock_start_ms = 0;  ///< what the clock shows at power-on
    double clock_ppm = 0;              ///< how fast it runs
    std::size_t backlog_bytes = 256 * 1024;
  };
  struct Counters {
    std::uint64_t scans_sent = 0, scans_dropped = 0, scans_missing = 0, commands = 0, refused = 0;
  };

  ScipDevice(ScannerModel model, Measure measure, const Options& options);

  /// Times since power-on, never decreasing.
  void receive(std::string_view bytes, DeviceTime t);
  void advance(DeviceTime t);
  /// When the next scan goes out; never() while nothing is asked for.
  [[nodiscard]] DeviceTime next_event() const;
  /// Bytes for the host; the caller removes what it has sent.
  [[nodiscard]] std::string& output() noexcept { return output_; }
  /// The host closed its end: laser off, nothing pending, back in normal mode.
  void host_gone();

  [[nodiscard]] const ScannerModel& model() const noexcept { return model_; }
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }
  [[nodiscard]] bool laser() const noexcept { return laser_; }
  [[nodiscard]] bool measuring() const noexcept { return running_.has_value(); }
  [[nodiscard]] std::uint32_t clock_ms(DeviceTime t) const noexcept;
  [[nodiscard]] DeviceTime step_zero(std::uint64_t scan) const noexcept;

 private:
  struct Asked {
    ScanRequest request;
    std::string label;  ///< with its semicolon
    std::uint64_t next_scan = 0;
  };
  void execute(std::string_view line, DeviceTime t);
  void ask_for(const ScipCommand& command, std::string_view line, DeviceTime t);
  void emit(const Asked& asked, std::uint64_t scan);
  void state(DeviceTime t, std::string& out) const;
  void set_speed(std::uint32_t level, DeviceTime t);
  [[nodiscard]] DeviceTime scan_end(std::uint64_t scan) const noexcept;
  [[nodiscard]] std::uint64_t first_scan_from(DeviceTime t) const noexcept;

  ScannerModel model_;
  Measure measure_;
  Options options_;
  Counters counters_;
  ScipCommandReader reader_;
  std::string output_;
  std::vector<std::uint32_t> range_mm_, intensity_, merged_range_, merged_intensity_;
  std::optional<Asked> running_, single_;
  bool laser_ = false, time_mode_ = false, sensitive_ = false;
  DeviceTime laser_since_;
  std::uint32_t speed_level_ = 0, bit_rate_ = 115200;
  // The rotation: scan `anchor_scan_` passes step 0 at `anchor_`.
  DeviceTime anchor_;
  std::uint64_t anchor_scan_ = 0;
  double turn_ns_ = 0;
  std::int64_t clock_zero_ns_ = 0;
};

}  // namespace rigor::usb
