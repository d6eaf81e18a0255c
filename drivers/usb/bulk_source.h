// Frames from a bulk endpoint as a channel: range_image or image. `backend: usb`, `protocol: bulk`; keys in
// usb_settings.h and bulk_frame.h, and
//
//   delay_ms: 0               from the capture to the arrival of a frame's first byte, at its shortest
//   delay_sigma_ms: 0         its standard uncertainty
//
// With a stamp in the frames the device's clock is mapped by the quickest arrivals; without one a frame was
// captured `delay_ms` before its first byte came. A gap in the device's own count of frames is a loss;
// without such a count, and over a reconnection, losses are counted by the channel's period.
//
// BulkVirtualSource: the same in virtual time, frames encoded and decoded in process at t0 + k·period.
#pragma once

#include <thread>

#include "drivers/usb/bulk_frame.h"
#include "drivers/usb/usb_settings.h"
#include "rt-core/clock_map.h"
#include "sensor-hal/channel/backoff.h"
#include "sensor-hal/channel/emulator.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::usb {

struct BulkSettings {
  LinkSettings link;
  BulkFormat format;
  Duration delay, delay_sigma;
  std::size_t slots = 16;
};
/// Throws ConfigError.
[[nodiscard]] BulkSettings read_bulk_settings(const ChannelConfig& config);

/// A frame's place in time and in the sequence; shared by both sources.
class FrameKeeper {
 public:
  /// Before a run.
  void begin(const ChannelConfig& config, const BulkSettings& settings);
  void forget_device() noexcept;
  struct Kept {
    std::uint64_t lost = 0;  ///< frames that are missing since the one before
    bool in_run = true;      ///< false: captured before the run; it taught the clock
    bool in_order = true;    ///< false: not later than the one before; it is of no use
  };
  /// Call once a frame, before `fill`; sequences count from t0.
  [[nodiscard]] Kept place(const BulkReader::Frame& frame, const RunOrigin& origin) noexcept;
  void fill(const BulkReader::Frame& frame, Sample& sample) const noexcept;
  [[nodiscard]] std::uint64_t missing_by(BenchTime now) noexcept;
  /// In virtual time arrivals are the truth, and the device's stamps tell no more.
  void trust_arrivals() noexcept { trusted_ = true; }

 private:
  const BulkSettings* settings_ = nullptr;
  Duration period_, latency_;
  std::unique_ptr<ClockMap> map_;
  Stamp stamp_;
  std::uint64_t device_sequence_ = 0, device_ticks_ = 0;
  std::int64_t extended_ticks_ = 0;
  bool any_ = false, counted_ = false, trusted_ = false;
};

class BulkSource final : public StreamSource {
 public:
  explicit BulkSource(LinkFactory links) : links_(std::move(links)) {}
  ~BulkSource() override;
  [[nodiscard]] ByteLink::Counters link_counters() const noexcept { return link_counters_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  void run();
  LinkFactory links_;
  BulkSettings settings_;
  std::unique_ptr<ByteLink> link_;
  std::unique_ptr<BulkReader> reader_;
  FrameKeeper keeper_;
  Backoff backoff_;
  ByteLink::Counters link_counters_;
  std::thread thread_;
};

class BulkVirtualSource final : public StreamSource {
 public:
  BulkVirtualSource(DeviceParts parts, ConfigNode emulator_params);
  ~BulkVirtualSource() override;
  void complete_until(BenchTime now) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  DeviceParts parts_;
  ConfigNode emulator_params_;
  BulkSettings settings_;
  std::unique_ptr<BulkReader> reader_;
  std::unique_ptr<class WorldFrames> world_;
  FrameKeeper keeper_;
  BenchTime t0_;
  std::uint64_t index_ = 0;
  std::string bytes_;
};

/// What a world shows, as frames. One thread at a time.
class WorldFrames {
 public:
  /// bad_input where the world gives nothing of that kind and size.
  [[nodiscard]] static Result<std::unique_ptr<WorldFrames>> create(DeviceParts parts, BulkFormat format,
                                                                   const std::string& name);
  /// Appends the frame of that instant to `out`; false: nothing was measured.
  bool frame(std::uint64_t index, BenchTime t, std::int64_t stamp_ns, std::string& out);
  [[nodiscard]] const BulkFormat& format() const { return format_; }

 private:
  WorldFrames(DeviceParts parts, BulkFormat format);
  DeviceParts parts_;
  BulkFormat format_;
  Sample sample_;
};

}  // namespace rigor::usb
