// A GigE Vision camera with a moving ramp, to try clients by hand:
//   gige_emulator_main [ADDRESS [WIDTH HEIGHT [RATE_HZ [SECONDS]]]]
//   arv-tool-0.8 -n Rigor-… features; arv-camera-test-0.8 …
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <thread>

#include "drivers/aravis/gige_emulator.h"

namespace {
volatile std::sig_atomic_t stop_asked = 0;
}

int main(int argc, char** argv) {
  using namespace rigor::gige;
  GigeEmulatorOptions o;
  if (argc > 1) o.address = argv[1];
  if (argc > 3) {
    o.camera.sensor_width_px = static_cast<std::uint32_t>(std::atoi(argv[2]));
    o.camera.sensor_height_px = static_cast<std::uint32_t>(std::atoi(argv[3]));
  }
  if (argc > 4) o.camera.frame_rate_hz = std::atof(argv[4]);
  const double seconds = argc > 5 ? std::atof(argv[5]) : 1e9;
  o.camera.formats = {PixelFormat::mono8,  PixelFormat::mono12p,   PixelFormat::mono12_packed,
                      PixelFormat::mono16, PixelFormat::bayer_rg8, PixelFormat::rgb8};
  auto camera = GigeEmulator::start(o, [](const FrameRequest& r, MutableBytes out) {
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = static_cast<std::uint8_t>(i + r.index);
    return true;
  });
  if (!camera) {
    std::fprintf(stderr, "%s\n", camera.error().text().c_str());
    return camera.error().exit_status();
  }
  std::signal(SIGINT, [](int) { stop_asked = 1; });
  std::signal(SIGTERM, [](int) { stop_asked = 1; });
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(std::min(seconds, 1e8));
  while (stop_asked == 0 && std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  (*camera)->stop();
  const auto h = (*camera)->health();
  std::printf(
      "frames %llu packets %llu late %llu skipped %llu dropped %llu resend requests %llu resent %llu "
      "unavailable %llu malformed %llu refused %llu send errors %llu\n",
      static_cast<unsigned long long>(h.frames_sent), static_cast<unsigned long long>(h.packets_sent),
      static_cast<unsigned long long>(h.pictures_late), static_cast<unsigned long long>(h.exposures_skipped),
      static_cast<unsigned long long>(h.blocks_dropped), static_cast<unsigned long long>(h.resend_requests),
      static_cast<unsigned long long>(h.packets_resent),
      static_cast<unsigned long long>(h.resends_unavailable), static_cast<unsigned long long>(h.malformed),
      static_cast<unsigned long long>(h.refused), static_cast<unsigned long long>(h.send_errors));
  return 0;
}
