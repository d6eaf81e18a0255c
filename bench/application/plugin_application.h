// The software under test as a shared object, called by the loop's own thread:
//
//   application:
//     library: ./libdetector.so   against the rig's folder; RIGOR_APPLICATION of clients/cpp/rigor_client.h
//     makes one rate_hz: 50                 turns; without it what the application asks for, or every cycle
//     of the loop params: { … }               given to it as they are
//
// It is shown and answers what a process would be shown and answer (process_protocol.h), by an interface of
// plain C with a version of its own: compiler and libraries need not be those of the bench. How long it
// computes is the loop's own time, and if it crashes, the devices are made safe and the bench ends.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "sensor-hal/channel/application.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

namespace application {

/// What the symbol `rigor_application` of a shared object returns a pointer to. Each call: bytes in, bytes
/// out; 0, or 1 with the error's text in place of the answer.
struct PluginEntry {
  std::uint32_t size;  ///< of this struct
  std::uint32_t protocol;
  void* (*create)();
  int (*start)(void* self, const char* in, std::size_t in_size, char* out, std::size_t capacity,
               std::size_t* out_size);
  int (*turn)(void* self, const char* in, std::size_t in_size, char* out, std::size_t capacity,
              std::size_t* out_size);
  int (*finish)(void* self, char* out, std::size_t capacity, std::size_t* out_size);
  void (*destroy)(void* self);
};

}  // namespace application

/// `rig` has an application with `library`, and outlives what is made. bad_input: the file is not there, is
/// no shared object for this machine, or no application of this protocol. Setup context.
[[nodiscard]] Result<std::unique_ptr<Application>> make_plugin_application(const RigConfig& rig);

}  // namespace rigor
