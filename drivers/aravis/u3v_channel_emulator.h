// A simulated channel leaves the bench as a USB3 Vision camera: u3v_emulator.h behind the emulator interface.
// Exposure, gain, region and format are what the client sets; the picture is the provider's for the middle of
// each exposure on CLOCK_MONOTONIC. Keys: emulated_camera.h.
#pragma once

#include <memory>
#include <optional>

#include "drivers/aravis/emulated_camera.h"
#include "drivers/aravis/health_watch.h"
#include "drivers/aravis/u3v_emulator.h"

namespace rigor {

class U3vChannelEmulator final : public Emulator {
 public:
  U3vChannelEmulator();
  ~U3vChannelEmulator() override;

  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;
  /// What went out; zeros before start. Setup thread.
  [[nodiscard]] u3v::EmulatorHealth counters() const { return camera_ ? camera_->health() : last_; }
  /// While running: for tests that pull its plug, and its port. Otherwise null.
  [[nodiscard]] u3v::Emulator* camera() { return camera_.get(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  DeviceParts parts_;
  std::string name_;
  EmulatedCameraSettings settings_;
  u3v::EmulatorOptions options_;
  std::unique_ptr<u3v::Emulator> camera_;
  u3v::EmulatorHealth last_;
  std::optional<HealthWatch> watch_;  ///< while it runs
};

}  // namespace rigor
