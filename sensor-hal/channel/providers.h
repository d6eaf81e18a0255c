// What a simulated device is made of, seen from the HAL: something that measures, and something that has
// registers. The simulators of `sim/` implement these; drivers' emulators and the simulated source use them;
// the command line wires them together. So an emulated GigE camera and a simulated channel show one and the
// same picture.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

namespace models {
struct LidarScan;
}

/// How the moving parts of a world stand around an instant: uniform acceleration from t_ref on. Small, copied
/// by value into a capture request, so that a capture depends on nothing else. Joints in the order of the
/// world file.
struct JointState {
  BenchTime t_ref;
  double position_rad = 0;
  double rate_radps = 0;
  double acceleration_radps2 = 0;
  [[nodiscard]] double at(BenchTime t) const noexcept {
    const double s = (t - t_ref).seconds();
    return position_rad + s * (rate_radps + 0.5 * s * acceleration_radps2);
  }
  [[nodiscard]] double rate_at(BenchTime t) const noexcept {
    return rate_radps + acceleration_radps2 * (t - t_ref).seconds();
  }
};
/// How a body that carries sensors (a vehicle's chassis) moves around an instant: uniform acceleration of its
/// origin, uniform turning. The world's frame is local Cartesian, z up; the body's x forward, y left, z up.
struct BodyState {
  BenchTime t_ref;
  Pose T_world_body;                          ///< at t_ref
  std::array<double, 3> velocity_mps{};       ///< of the body's origin, in the world's frame
  std::array<double, 3> acceleration_mps2{};  ///< of the body's origin, in the world's frame, without gravity
  std::array<double, 3> turn_rate_radps{};    ///< in the body's frame
  std::array<double, 3> turn_acceleration_radps2{};  ///< in the body's frame; not used by `at`
  [[nodiscard]] Pose at(BenchTime t) const noexcept;
};
struct WorldMotion {
  static constexpr std::size_t kMax = 16;
  static constexpr std::size_t kMaxBodies = 2;
  std::uint32_t count = 0;
  std::array<JointState, kMax> joint{};
  std::uint32_t body_count = 0;
  std::array<BodyState, kMaxBodies> body{};  ///< in the order of the rig's `simulation.platforms`
};

struct ImageRequest {
  std::uint64_t index = 0;  ///< capture index: keys the noise draws
  BenchTime t_capture;      ///< middle of the exposure
  BenchTime t_start{};      ///< of the run: a platform that carries the sensor sets out then
  Duration exposure;        ///< 0: the sensor model's default
  double gain_db = 0;
  std::uint32_t offset_x_px = 0, offset_y_px = 0, width_px = 0,
                height_px = 0;  ///< region; width 0: the whole sensor
  PixelFormat format = PixelFormat::mono8;
  WorldMotion motion;
};

/// Makes pictures. One thread at a time; may take milliseconds; same request, same bytes.
class ImageProvider {
 public:
  virtual ~ImageProvider() = default;
  struct Geometry {
    std::uint32_t width_px = 0, height_px = 0;  ///< full sensor
    PixelFormat format = PixelFormat::mono8;    ///< default
    Duration exposure = milliseconds(5);        ///< default
    std::string frame_id;
  };
  [[nodiscard]] virtual Geometry geometry() const = 0;
  /// `pixels` has image_bytes(format, width, height) bytes. Every PixelFormat but depth is offered.
  [[nodiscard]] virtual Status capture(const ImageRequest& request, std::span<std::byte> pixels) = 0;
};

/// Makes samples of any kind: point clouds, range images. One thread at a time; may take milliseconds; same
/// request, same bytes.
class SampleProvider {
 public:
  virtual ~SampleProvider() = default;
  struct Geometry {
    SampleKind kind = SampleKind::none;
    std::uint32_t width_px = 0, height_px = 0;  ///< of a range image
    std::size_t max_bytes = 0;                  ///< of one sample
    std::string frame_id;
  };
  struct Request {
    std::uint64_t index = 0;  ///< keys the noise draws
    BenchTime t_capture;
    BenchTime t_start{};  ///< of the run: a platform that carries the sensor sets out then
    WorldMotion motion;
    /// Of a turning LiDAR: how far beyond its usual start the scan begins (anticlockwise seen from above).
    /// For devices whose firings do not divide a turn, so that each turn begins a little elsewhere.
    double turn_rad = 0;
  };
  [[nodiscard]] virtual Geometry geometry() const = 0;
  /// Of a LiDAR: where and when each of its firings looks (sensor-hal/models/lidar/scan_grid.h finds the
  /// firing of a point); nullptr where there is none.
  [[nodiscard]] virtual const models::LidarScan* scan() const { return nullptr; }
  /// Whether `capture` is a matter of microseconds and neither allocates nor locks: the bench then measures
  /// on the loop's thread, and such samples never wait for workers that are busy with pictures.
  [[nodiscard]] virtual bool immediate() const { return false; }
  /// Fills info, memory and size of the sample; its stamp is the caller's.
  [[nodiscard]] virtual Status capture(const Request& request, Sample& sample) = 0;
};

/// Where the moving parts of a world are, as the owner of that world knows it. Any thread, wait-free.
class MotionSource {
 public:
  virtual ~MotionSource() = default;
  [[nodiscard]] virtual WorldMotion motion_at(BenchTime t) const noexcept = 0;
};

enum class RegisterTable : std::uint8_t { coils, discrete_inputs, input_registers, holding_registers };

/// A device that is known by its registers (a turntable, a valve). Times are bench time and never decrease.
/// One thread at a time.
class RegisterModel {
 public:
  virtual ~RegisterModel() = default;
  /// False: no such address (a Modbus exception 02 goes out).
  [[nodiscard]] virtual bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                                  BenchTime t) = 0;
  [[nodiscard]] virtual bool write(RegisterTable table, std::uint16_t address,
                                   std::span<const std::uint16_t> in, BenchTime t) = 0;
};

/// A device that is known by named values (a node on a bus): what it tells and what it can be told. A motor
/// can be this and a RegisterModel at once. Times are bench time and never decrease. One thread at a time.
class SignalModel {
 public:
  virtual ~SignalModel() = default;
  struct Signal {
    std::string name, unit;
    bool commanded = false;  ///< `write` takes it
  };
  /// Never changes; signals are known by their index here.
  [[nodiscard]] virtual const std::vector<Signal>& signals() const = 0;
  /// In the signal's unit; NaN while the device does not know. Of a commanded one, what it was told last.
  [[nodiscard]] virtual double read(std::size_t signal, BenchTime t) = 0;
  /// False: refused, nothing changed.
  [[nodiscard]] virtual bool write(std::size_t signal, double value, BenchTime t) = 0;
};

}  // namespace rigor
