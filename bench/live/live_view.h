// The live view of one run: what it shows and what can be asked of it, between a run's parts and the server.
//
//   auto server = live::Server::open(…);                 before anything is touched
//   LiveView view(*server, …);                           after the channels are armed
//   view.attach(recorder); run.set_live(&view.tap());
//   …                                                    the run; the destructor takes leave of the clients
#pragma once

#include <memory>

#include "bench/control/control_socket.h"
#include "bench/live/server.h"
#include "bench/run/bench_run.h"
#include "bench/run/tap.h"
#include "rt-core/epoch.h"

namespace rigor {
class Recorder;
class Simulation;
}  // namespace rigor

namespace rigor::live {

class LiveView {
 public:
  struct Context {
    RunParts& parts;
    const LoopCounters& counters;
    ControlCommands& commands;
    Simulation* simulation = nullptr;  ///< null: the run has no world
    EpochPair epoch;
    bool replay = false;
  };
  /// Setup context. All that is named outlives it.
  LiveView(Server& server, const Context& context);
  ~LiveView();
  /// Setup, before the run: pairs tell both the recorder (may be null) and this view.
  void attach(Recorder* recorder);
  [[nodiscard]] LiveTap& tap();
  /// Setup, after the run: clients are told that it has ended, and may look at what it left until this object
  /// goes. No command of theirs is being carried out when this returns, and none will be.
  void ended();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::live
