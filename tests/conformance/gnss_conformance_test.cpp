// A satellite receiver: its stand-in in virtual time, the source over a pseudo-terminal and TCP fed by our
// emulator, a recording, and the emulator.
#include <fstream>

#include "drivers/gnss/gnss_source.h"
#include "drivers/gnss/gnss_virtual_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/gnss/formula_receiver.h"

namespace rigor::conformance {
namespace {

using gnss::test::config_of;
using gnss::test::FormulaReceiver;
using gnss::test::parts_of;

ChannelConfig quick(const std::string& keys) {
  return config_of(keys, SampleKind::nav_fix, milliseconds(50), milliseconds(60));
}

class VirtualReceiver final : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<gnss::GnssVirtualSource>(parts_of(std::make_shared<FormulaReceiver>()),
                                                     quick("{rate_hz: 20}").params);
  }
  ChannelConfig config() override { return quick("{buffers: 8}"); }
  ChannelConfig config_with_unknown_key() override { return quick("{no_such_key: 1}"); }
  std::size_t slots() const override { return 8; }
};

/// The emulated receiver, on what `As` says.
template <int As>
class OverALine final : public SourceUnderTest {
 public:
  OverALine()
      : emulator_(
            gnss::test::start_emulator(std::string("{rate_hz: 20") + (As == 0 ? "}" : ", as: tcp, port: 0}"),
                                       std::make_shared<FormulaReceiver>())) {}
  bool virtual_time() const override { return false; }
  Duration settle() const override { return seconds(1); }
  std::size_t slots() const override { return 8; }
  std::unique_ptr<Source> make() override { return std::make_unique<gnss::GnssSource>(); }
  ChannelConfig config() override { return quick(keys("buffers: 8")); }
  ChannelConfig config_with_unknown_key() override { return quick(keys("no_such_key: 1")); }

 private:
  std::string keys(const std::string& more) {
    const std::string at = emulator_->where();
    return (As == 0 ? "{device: " + at : "{address: 127.0.0.1, port: " + at.substr(at.find(':') + 1)) +
           ", ready_s: 20, " + more + "}";
  }
  std::unique_ptr<gnss::GnssEmulator> emulator_;
};

class Recording final : public SourceUnderTest {
 public:
  Recording() : file_(testing::TempDir() + "rigor-gnss-conformance.ubx") {
    gnss::ReceiverDevice device(gnss::read_emulator_settings(quick("{rate_hz: 20}").params));
    gnss::MeasuredFix measured(parts_of(std::make_shared<FormulaReceiver>()), "rover", 1, 0);
    std::ofstream out(file_, std::ios::binary);
    for (int k = 0; k < 400; ++k) {
      const BenchTime t(k * 50'000'000LL);
      device.speak(measured.at(static_cast<std::uint64_t>(k), t, BenchTime(0)),
                   RealtimeTime(1'700'000'000'000'000'000 + t.ns()), static_cast<std::uint64_t>(k), t);
    }
    out.write(reinterpret_cast<const char*>(device.output().data()),
              static_cast<std::streamsize>(device.output().size()));
  }
  std::unique_ptr<Source> make() override { return std::make_unique<gnss::GnssSource>(); }
  ChannelConfig config() override { return quick("{file: " + file_ + ", buffers: 8}"); }
  ChannelConfig config_with_unknown_key() override { return quick("{file: " + file_ + ", no_such_key: 1}"); }
  std::size_t slots() const override { return 8; }

 private:
  std::string file_;
};

INSTANTIATE_TEST_SUITE_P(Gnss, SourceConformance,
                         testing::Values(under_test<VirtualReceiver>("virtual_receiver"),
                                         under_test<OverALine<0>>("receiver_over_pty"),
                                         under_test<OverALine<1>>("receiver_over_tcp"),
                                         under_test<Recording>("recording")),
                         name_of_case);

class ReceiverEmulator final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<gnss::GnssEmulator>();
    emulator->attach(parts_of(std::make_shared<FormulaReceiver>()));
    return emulator;
  }
  ChannelConfig config() override { return quick("{as: tcp, port: 0}"); }
  ChannelConfig config_with_unknown_key() override { return quick("{as: tcp, port: 0, no_such_key: 1}"); }
};
INSTANTIATE_TEST_SUITE_P(Gnss, LifecycleConformance,
                         testing::Values(channel_under_test<ReceiverEmulator>("receiver_emulator")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
