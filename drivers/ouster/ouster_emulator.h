// An emulated Ouster: it serves metadata and configuration over HTTP and TCP (sensor_control.h), and sends
// the packets of a simulated LiDAR to where its configuration says. Keys: ouster_settings.h.
//
//   server thread     answers clients; a reinitialization starts the sensor up anew
//   measuring thread  frames, ahead of those that are due (ScanAhead)
//   sending thread    each packet when its last column has fired, absolute; IMU packets between them
//
// Its time and its phase are those of sensor_time.h, by this machine's UTC. `connected`: nobody said that
// nobody listens (ICMP).
#pragma once

#include <mutex>
#include <optional>
#include <thread>

#include "drivers/lidar/scan_ahead.h"
#include "drivers/network/http.h"
#include "drivers/network/udp_sender.h"
#include "drivers/ouster/ouster_settings.h"
#include "drivers/ouster/sensor_control.h"
#include "rt-core/deadline.h"
#include "rt-core/epoch.h"

namespace rigor::ouster {

class OusterEmulator final : public Emulator {
 public:
  ~OusterEmulator() override;
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;
  /// Once armed: where it serves.
  [[nodiscard]] std::uint16_t http_port() const { return http_port_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  [[nodiscard]] SensorControl::Active active();
  Status listen();
  /// Where frames begin, and the sensor's time there.
  void set_out(const SensorControl::Active& active, BenchTime earliest);
  void run();
  void send_frames(const SensorControl::Active& active);
  void send_imu(std::uint16_t port, BenchTime until);
  void send(Bytes bytes, std::uint16_t port);

  DeviceParts parts_;
  EmulatorSettings settings_;
  std::optional<SensorDevice> device_;
  std::mutex mutex_;  ///< of control_
  std::optional<SensorControl> control_;
  network::TcpServer server_;
  std::uint16_t http_port_ = 0;
  std::optional<packet_lidar::ScanAhead> scans_;
  network::UdpSender sender_;
  std::string sender_dest_;
  EpochPair epoch_{};
  BenchTime t_on_, t_first_;
  BenchTime t_start_;           ///< of frame 0
  std::uint64_t start_ns_ = 0;  ///< the sensor's time there
  std::uint64_t imu_sent_ = 0;
  Deadline sending_;
  std::thread thread_;
};

}  // namespace rigor::ouster
