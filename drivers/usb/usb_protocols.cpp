#include "drivers/usb/usb_protocols.h"

#include "drivers/usb/scip_source.h"
#include "sensor-hal/channel/chosen_emulator.h"

namespace rigor::usb {
namespace {

std::string protocol_of(const ConfigNode& n) { return n.choice_or("protocol", {"scip", "bulk"}, "scip"); }

/// The source of the protocol that its keys choose.
class ChosenSource : public Source {
 public:
  ~ChosenSource() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
  }
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override {
    return inner_ ? inner_->poll(now) : SampleLease{};
  }
  void begin_cycle(BenchTime now) noexcept override {
    if (inner_) inner_->begin_cycle(now);
  }
  void complete_until(BenchTime now) override {
    if (inner_) inner_->complete_until(now);
  }
  [[nodiscard]] std::vector<std::string> warnings() const override {
    return inner_ ? inner_->warnings() : std::vector<std::string>();
  }
  [[nodiscard]] HealthSnapshot health() const noexcept override {
    return inner_ ? inner_->health() : HealthSnapshot{};
  }

 protected:
  [[nodiscard]] virtual std::unique_ptr<Source> choose(const std::string& protocol) = 0;
  Status do_configure(const ChannelConfig& config) override {
    auto chosen = choose(protocol_of(config.params));
    if (auto s = chosen->configure(config); !s) return s;
    inner_ = std::move(chosen);
    description_ = inner_->describe();
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    auto s = inner_->arm(context);
    description_ = inner_->describe();
    return s;
  }
  Status do_start(BenchTime t0) override { return inner_->start(t0); }
  Status do_stop() override { return inner_->stop(); }

 private:
  std::unique_ptr<Source> inner_;
};

class RealSource final : public ChosenSource {
 public:
  explicit RealSource(LinkFactory links) : links_(std::move(links)) {}

 protected:
  [[nodiscard]] std::unique_ptr<Source> choose(const std::string& protocol) override {
    if (protocol == "bulk") return std::make_unique<BulkSource>(links_);
    return std::make_unique<ScipSource>(links_);
  }

 private:
  LinkFactory links_;
};

class VirtualSource final : public ChosenSource {
 public:
  VirtualSource(DeviceParts parts, ConfigNode params)
      : parts_(std::move(parts)), params_(std::move(params)) {}

 protected:
  [[nodiscard]] std::unique_ptr<Source> choose(const std::string& protocol) override {
    if (protocol == "bulk") return std::make_unique<BulkVirtualSource>(parts_, params_);
    return std::make_unique<ScipVirtualSource>(parts_, params_);
  }

 private:
  DeviceParts parts_;
  ConfigNode params_;
};

class UsbEmulator final : public ChosenEmulator {
 public:
  UsbEmulator() : ChosenEmulator("USB device") {}

 protected:
  [[nodiscard]] std::unique_ptr<Emulator> choose(const ConfigNode& params) const override {
    if (protocol_of(params) == "bulk") return std::make_unique<BulkEmulator>();
    return std::make_unique<ScipEmulator>();
  }
};

}  // namespace

std::unique_ptr<Source> make_usb_source(LinkFactory links) {
  return std::make_unique<RealSource>(std::move(links));
}
std::unique_ptr<Source> make_usb_virtual_source(DeviceParts parts, ConfigNode emulator_params) {
  return std::make_unique<VirtualSource>(std::move(parts), std::move(emulator_params));
}
std::unique_ptr<Emulator> make_usb_emulator() { return std::make_unique<UsbEmulator>(); }

}  // namespace rigor::usb
