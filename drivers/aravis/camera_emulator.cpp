#include "drivers/aravis/camera_emulator.h"

#include "drivers/aravis/gige_channel_emulator.h"
#include "drivers/aravis/u3v_channel_emulator.h"

namespace rigor {
namespace {

class CameraEmulator final : public Emulator {
 public:
  ~CameraEmulator() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
  }
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override { return inner_ ? inner_->endpoint() : "camera"; }
  [[nodiscard]] HealthSnapshot health() const noexcept override {
    return inner_ ? inner_->health() : HealthSnapshot{};
  }

 protected:
  Status do_configure(const ChannelConfig& config) override {
    std::unique_ptr<Emulator> chosen;
    if (config.params.choice_or("as", {"gige", "usb3vision"}, "gige") == "usb3vision")
      chosen = std::make_unique<U3vChannelEmulator>();
    else
      chosen = std::make_unique<GigeChannelEmulator>();
    if (auto s = chosen->configure(config); !s) return s;
    inner_ = std::move(chosen);
    description_ = inner_->describe();
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    inner_->attach(parts_);
    if (auto s = inner_->arm(context); !s) return s;
    description_ = inner_->describe();
    return {};
  }
  Status do_start(BenchTime t0) override { return inner_->start(t0); }
  Status do_stop() override { return inner_->stop(); }

 private:
  DeviceParts parts_;
  std::unique_ptr<Emulator> inner_;
};

}  // namespace

std::unique_ptr<Emulator> make_camera_emulator() { return std::make_unique<CameraEmulator>(); }

}  // namespace rigor
