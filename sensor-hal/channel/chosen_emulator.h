// An emulator whose keys choose which of several it is: by protocol, or by the bus that it is on.
#pragma once

#include <memory>
#include <string>
#include <utility>

#include "sensor-hal/channel/emulator.h"

namespace rigor {

/// Passes everything on to the emulator that `choose` makes when it is configured. As any channel: one thread
/// at a time but for health().
class ChosenEmulator : public Emulator {
 public:
  ~ChosenEmulator() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
  }
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override { return inner_ ? inner_->endpoint() : unchosen_; }
  [[nodiscard]] HealthSnapshot health() const noexcept override {
    return inner_ ? inner_->health() : HealthSnapshot{};
  }

 protected:
  /// `unchosen`: the endpoint before configuration, such as "camera".
  explicit ChosenEmulator(std::string unchosen) : unchosen_(std::move(unchosen)) {}
  /// Not configured yet. Throws ConfigError.
  [[nodiscard]] virtual std::unique_ptr<Emulator> choose(const ConfigNode& params) const = 0;

  Status do_configure(const ChannelConfig& config) override {
    auto chosen = choose(config.params);
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
  std::string unchosen_;
  DeviceParts parts_;
  std::unique_ptr<Emulator> inner_;
};

}  // namespace rigor
