// How a client sets a scanner up and starts its stream: one request after the other, each with its answer.
// No transport: whoever owns it sends `request()` and gives what comes back to `answer()`.
//
//   ClientDialog dialog(wish);
//   while (!dialog.done()) { send(dialog.request()); … dialog.answer(telegram); }   // set-up, at arm
//   dialog.begin_stream();                                                          // the same loop, at
//   start
//
// What the rig does not ask for is left as the device has it, and read. What it asks for is written, read
// back and compared; a device that has it otherwise is an error that names both.
//
// Source: the dialogues of SICK's own driver (sick_scan_xd) with a LMS511 and a TiM781S, as recorded.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/sick/scan_geometry.h"
#include "drivers/sick/telegram.h"
#include "rt-core/result.h"

namespace rigor::sick {

enum class Rssi : std::uint8_t { device, off, bits8, bits16 };  ///< device: 16 bits for a TiM, else 8

/// Angles in the device's frame. Empty: as the device has it.
struct Wish {
  std::string where;  ///< channel's name, for errors
  std::uint8_t level = 3;
  std::optional<std::uint32_t> password_hash;  ///< empty: SICK's own, of either kind of device
  std::optional<double> scan_frequency_hz;
  std::optional<double> resolution_deg;
  std::optional<double> start_deg, stop_deg;
  std::optional<EchoFilter> echoes;
  Rssi rssi = Rssi::device;
  std::uint16_t output_interval = 1;
};

/// What the device said of itself.
struct DeviceFacts {
  std::string name, firmware;  ///< empty where it did not say
  bool scan_config_known = false;
  double scan_frequency_hz = 0;
  std::uint32_t step_deg_e4 = 0;
  std::int32_t start_deg_e4 = 0, stop_deg_e4 = 0;  ///< of the output range
  bool range_known = false;
  std::uint32_t echoes = 1;  ///< channels that were asked for
};

class ClientDialog {
 public:
  explicit ClientDialog(Wish wish);

  [[nodiscard]] bool done() const { return step_ == Step::ready || step_ == Step::streaming; }
  [[nodiscard]] bool streaming() const { return step_ == Step::streaming; }
  /// The framed request whose answer is waited for. Not when done.
  void request(Buffer& out) const;
  /// False when this telegram is not the answer (an event, a late scan): wait on.
  [[nodiscard]] Result<bool> answer(const Telegram& telegram);
  void begin_stream() { step_ = Step::start_measurement; }
  /// Appends what ends the stream.
  static void end_stream(Buffer& out);

  [[nodiscard]] const DeviceFacts& facts() const { return facts_; }
  /// Points of a scan at most.
  [[nodiscard]] std::size_t max_points() const;

 private:
  enum class Step : std::uint8_t {
    login,
    login_other,  ///< the hash of the TiM7xxS
    dialect,
    identity,
    state,
    read_scan,
    set_scan,
    read_range,
    write_range,
    check_range,
    echo_filter,
    write_data,
    check_data,
    ready,
    start_measurement,
    run,
    subscribe,
    streaming
  };
  struct Expected {
    std::string_view type, name;
  };
  [[nodiscard]] Expected expected() const;
  [[nodiscard]] std::string_view request_type() const;
  void values(Buffer& out) const;
  Status take(const Telegram& telegram);
  Status refused(const Telegram& telegram);
  [[nodiscard]] Step after() const;
  [[nodiscard]] tl::unexpected<Error> wrong(std::string message) const;
  [[nodiscard]] std::vector<std::uint8_t> data_config() const;
  [[nodiscard]] bool wants_scan_config() const;
  [[nodiscard]] bool range_is_wanted() const;

  Wish wish_;
  DeviceFacts facts_;
  Step step_ = Step::login;
};

}  // namespace rigor::sick
