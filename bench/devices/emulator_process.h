// The rig's emulators in a process of their own, so that what a run talks to over its protocols shares
// nothing with it.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "rt-core/time.h"

namespace rigor {

class EmulatorProcess {
 public:
  /// Starts `rigor emulate RIG` and waits until every device is up, or it gave up, the time is over, or
  /// `stop` says so.
  [[nodiscard]] static Result<EmulatorProcess> start(const std::filesystem::path& rig,
                                                     const std::vector<std::string>& overrides,
                                                     Duration timeout, StopToken stop);
  EmulatorProcess(EmulatorProcess&& o) noexcept;
  EmulatorProcess& operator=(EmulatorProcess&& o) noexcept;
  /// Asks it to end (SIGTERM), and ends it (SIGKILL) after three seconds. It dies with this process too.
  ~EmulatorProcess();
  [[nodiscard]] pid_t pid() const { return pid_; }
  struct Death {
    BenchTime t;
    std::string how;  ///< "signal 9, Killed", "exit status 1"
  };
  /// Empty while it lives. That it died is also said on stderr, at once. Any thread.
  [[nodiscard]] std::optional<Death> death() const;

 private:
  struct Watch;
  explicit EmulatorProcess(pid_t pid);
  pid_t pid_ = -1;
  std::unique_ptr<Watch> watch_;
};

}  // namespace rigor
