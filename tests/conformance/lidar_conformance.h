// Packet LiDARs under the tests of conformance: in virtual time, over loopback, from a recording, and their
// emulators. A driver is described by
//
//   struct Driver {
//     using Emulator = …; using LiveSource = …; using VirtualSource = …;
//     static DeviceParts parts();
//     static ChannelConfig config(const std::string& params, SampleKind kind);
//     static std::string emulator_keys();                          // at ports of its own
//     static std::string source_keys(const Emulator& emulator, const std::string& emulator_keys);
//     static std::string record(const test::TemporaryDirectory&);  // four seconds; the keys that read it
//   };
#pragma once

#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/lidar/lidar_test_tools.h"

namespace rigor::conformance {

template <class Driver, SampleKind kind = SampleKind::point_cloud, std::size_t buffers = 8>
class LidarSource : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override { return std::make_unique<typename Driver::LiveSource>(); }
  std::size_t slots() const override { return buffers; }
  ChannelConfig config() override {
    return Driver::config("{buffers: " + std::to_string(buffers) + keys_ + "}", kind);
  }
  ChannelConfig config_with_unknown_key() override {
    return Driver::config("{no_such_key: 1" + keys_ + "}", kind);
  }

 protected:
  std::string keys_;  ///< each behind a comma
};

template <class Driver, SampleKind kind = SampleKind::point_cloud, std::size_t buffers = 8>
class VirtualLidar : public LidarSource<Driver, kind, buffers> {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<typename Driver::VirtualSource>(
        Driver::parts(), Driver::config("{}", SampleKind::point_cloud).params);
  }
};

template <class Driver, SampleKind kind = SampleKind::point_cloud>
class LoopbackLidar : public LidarSource<Driver, kind> {
 public:
  LoopbackLidar() {
    emulator_.attach(Driver::parts());
    const std::string keys = Driver::emulator_keys();
    const auto first_error = [&]() -> Status {
      if (auto s = emulator_.configure(Driver::config("{" + keys + "}", SampleKind::point_cloud)); !s)
        return s;
      if (auto s = emulator_.arm({}); !s) return s;
      this->keys_ = ", " + Driver::source_keys(emulator_, keys);
      return emulator_.start(bench_now());
    };
    if (auto s = first_error(); !s) problem_ = s.error().text();
  }
  ~LoopbackLidar() override { (void)emulator_.stop(); }
  bool virtual_time() const override { return false; }
  Duration settle() const override { return seconds(1); }
  std::unique_ptr<Source> make() override {
    EXPECT_EQ(problem_, "");
    return LidarSource<Driver, kind>::make();
  }

 private:
  typename Driver::Emulator emulator_;
  std::string problem_;
};

template <class Driver, bool in_virtual_time = true>
class RecordedLidar : public LidarSource<Driver> {
 public:
  RecordedLidar() { this->keys_ = ", " + Driver::record(directory_); }
  bool virtual_time() const override { return in_virtual_time; }
  Duration settle() const override { return milliseconds(200); }

 private:
  test::TemporaryDirectory directory_;
};

template <class Driver>
class EmulatedLidar final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<typename Driver::Emulator>();
    emulator->attach(Driver::parts());
    return emulator;
  }
  ChannelConfig config() override {
    return Driver::config("{" + Driver::emulator_keys() + "}", SampleKind::point_cloud);
  }
  ChannelConfig config_with_unknown_key() override {
    return Driver::config("{no_such_key: 1, " + Driver::emulator_keys() + "}", SampleKind::point_cloud);
  }
};

}  // namespace rigor::conformance
