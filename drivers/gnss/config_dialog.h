// How a receiver is set to what a rig asks for: requests and the answers to be waited for. No socket, no
// clock.
//
//   ConfigDialog dialog(settings, period);
//   while (!dialog.done()) {
//     send(dialog.request());
//     for each message that comes:  dialog.answer(message)   // true: go on; an error: refused
//   }
//
// Generation 9 takes one CFG-VALSET into RAM; generation 8 a CFG-PRT, a CFG-RATE and a CFG-MSG for each
// message. Each is answered by ACK-ACK or ACK-NAK. All messages that this driver knows and that the rig does
// not ask for are switched off.
#pragma once

#include "drivers/gnss/gnss_settings.h"

namespace rigor::gnss {

class ConfigDialog {
 public:
  /// `where`: the channel, for messages.
  ConfigDialog(const ConfigureSettings& settings, Duration period, std::string where);

  [[nodiscard]] bool done() const { return step_ == requests_.size() && !asks_; }
  /// The next request. Precondition: not done.
  [[nodiscard]] Bytes request();
  /// Whether this answers the request; protocol: the receiver refuses it.
  [[nodiscard]] Result<bool> answer(const Message& message);
  /// What the request that is waiting for its answer was: "CFG-VALSET".
  [[nodiscard]] std::string asked() const;
  [[nodiscard]] const std::optional<MonVer>& version() const { return version_; }

 private:
  void prepare(unsigned generation);
  struct Request {
    UbxId id;
    Buffer bytes;
  };
  ConfigureSettings settings_;
  Duration period_;
  std::string where_;
  bool asks_ = false;  ///< MON-VER is not answered yet
  Buffer poll_;
  std::vector<Request> requests_;
  std::size_t step_ = 0;
  std::optional<MonVer> version_;
};

/// Sets the speed of the receiver's UART; not answered at a speed that both know.
void append_baud_request(Buffer& out, const ConfigureSettings& settings, unsigned generation);

}  // namespace rigor::gnss
