// A GigE Vision camera in a process of its own, to be killed by tests: stamped_camera ADDRESS SERIAL WIDTH
// HEIGHT Prints "ready" once it serves, ends on SIGTERM with what it sent.
#include <csignal>
#include <cstdio>
#include <cstdlib>

#include "drivers/aravis/gige_emulator.h"
#include "tests/drivers/aravis/stamped_picture.h"

int main(int argc, char** argv) {
  using namespace rigor::gige;
  if (argc != 5) {
    std::fprintf(stderr, "usage: stamped_camera ADDRESS SERIAL WIDTH HEIGHT\n");
    return 2;
  }
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  GigeEmulatorOptions o;
  o.address = argv[1];
  o.camera.serial = argv[2];
  o.camera.sensor_width_px = static_cast<std::uint32_t>(std::atoi(argv[3]));
  o.camera.sensor_height_px = static_cast<std::uint32_t>(std::atoi(argv[4]));
  auto camera = GigeEmulator::start(o, testing::fill_stamped);
  if (!camera) {
    std::fprintf(stderr, "%s\n", camera.error().text().c_str());
    return camera.error().exit_status();
  }
  std::printf("ready\n");
  std::fflush(stdout);
  int which = 0;
  sigwait(&signals, &which);
  (*camera)->stop();
  const auto h = (*camera)->health();
  std::printf(
      "sent %llu skipped %llu dropped %llu resent %llu\n", static_cast<unsigned long long>(h.frames_sent),
      static_cast<unsigned long long>(h.exposures_skipped), static_cast<unsigned long long>(h.blocks_dropped),
      static_cast<unsigned long long>(h.packets_resent));
  return 0;
}
