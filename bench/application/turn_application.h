// An application in this process that is called in turns: it is shown and answers what a process would be
// shown and answer (process_protocol.h), as bytes, by the loop's own thread.
//
//   struct Mine final : application::TurnHandler { … };
//   registry.add(NamedApplication{"mine", [rig] { return make_turn_application(rig,
//   std::make_unique<Mine>()); }});
//
// How long a turn takes is the loop's own time. What a handler allocates or waits for is its own business: in
// wall-clock time it should do neither.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "sensor-hal/channel/application.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

namespace application {

/// What an application in turns does. Errors end the run, which then says what they say.
class TurnHandler {
 public:
  virtual ~TurnHandler() = default;
  /// Setup thread, once: the setup message as JSON. Gives the message `ready`, as JSON.
  [[nodiscard]] virtual Result<std::string> start(const std::string& setup) = 0;
  /// Loop thread: the body of a turn, in which the place of a sample's bytes is their address. They may be
  /// read until the next turn. Gives the body of an answer, valid until the next call; nothing: it cannot go
  /// on, and `finish` says why.
  [[nodiscard]] virtual std::optional<std::span<const std::byte>> turn(
      std::span<const std::byte> body) noexcept = 0;
  /// Setup thread, once after the last turn.
  [[nodiscard]] virtual Status finish() = 0;
};

}  // namespace application

/// Keys `rate_hz` and `params` of the rig's application, as a process has
/// them. `rig` outlives what is made. Setup context.
[[nodiscard]] std::unique_ptr<Application> make_turn_application(
    const RigConfig& rig, std::unique_ptr<application::TurnHandler> handler);

}  // namespace rigor
