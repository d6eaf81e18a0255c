// A simulated channel leaves the bench as a GigE Vision camera: gige_emulator.h behind the emulator
// interface. Exposure, gain, region and format are what the client sets; the picture is the provider's for
// the middle of each exposure on CLOCK_MONOTONIC. Keys: emulated_camera.h, and `link_mbit_per_s`.
#pragma once

#include <memory>
#include <optional>

#include "drivers/aravis/emulated_camera.h"
#include "drivers/aravis/gige_emulator.h"
#include "drivers/aravis/health_watch.h"

namespace rigor {

class GigeChannelEmulator final : public Emulator {
 public:
  GigeChannelEmulator();
  ~GigeChannelEmulator() override;

  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  /// Pulses the camera's Line1 now; only while running. Any thread.
  void pulse_line() {
    if (camera_) camera_->pulse_line();
  }
  [[nodiscard]] std::string endpoint() const override;
  /// What went out; zeros before start. Setup thread.
  [[nodiscard]] gige::GigeEmulatorHealth counters() const;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  DeviceParts parts_;
  std::string name_;
  EmulatedCameraSettings settings_;
  gige::GigeEmulatorOptions options_;
  std::unique_ptr<gige::GigeEmulator> camera_;
  gige::GigeEmulatorHealth last_;
  std::optional<HealthWatch> watch_;  ///< while it runs
};

}  // namespace rigor
