#include "bench/application/process_protocol.h"

#include <bit>
#include <cstring>

namespace rigor::application {
namespace {

static_assert(std::endian::native == std::endian::little, "the protocol's numbers are little-endian");

constexpr std::size_t kTurnHead = sizeof(MessageHeader) + 24;

/// Writes plain values one after the other; where there is no room, `fits` says so and nothing is written.
class Out {
 public:
  explicit Out(std::span<std::byte> room) : room_(room) {}
  template <class T>
  void put(const T& v) noexcept {
    static_assert(std::is_trivially_copyable_v<T>);
    raw(&v, sizeof v);
  }
  void raw(const void* data, std::size_t n) noexcept {
    if (!fits_ || room_.size() - size_ < n) {
      fits_ = false;
      return;
    }
    std::memcpy(room_.data() + size_, data, n);
    size_ += n;
  }
  [[nodiscard]] bool fits() const noexcept { return fits_; }
  [[nodiscard]] std::size_t size() const noexcept { return size_; }

 private:
  std::span<std::byte> room_;
  std::size_t size_ = 0;
  bool fits_ = true;
};

void put_pose(Out& out, const Pose& p) noexcept {
  out.put(p.position_m);
  out.put(p.orientation_wxyz);
}

void put_info(Out& out, const Sample& s) noexcept {
  switch (s.kind()) {
    case SampleKind::image: {
      const auto& i = *s.as<ImageInfo>();
      out.put(i.width_px), out.put(i.height_px), out.put(i.offset_x_px), out.put(i.offset_y_px);
      out.put(i.exposure.ns()), out.put(i.gain_db);
      std::array<char, 32> name{};
      const std::string_view format = pfnc_name(i.format);
      std::memcpy(name.data(), format.data(), std::min(format.size(), name.size() - 1));
      out.put(name);
      break;
    }
    case SampleKind::range_image:
      out.put(s.as<RangeImageInfo>()->width_px), out.put(s.as<RangeImageInfo>()->height_px);
      break;
    case SampleKind::point_cloud:
      out.put(s.as<PointCloudInfo>()->count), out.put(std::uint32_t{sizeof(LidarPoint)});
      break;
    case SampleKind::can_frame: {
      const auto& f = *s.as<CanFrame>();
      out.put(f.id);
      out.put(static_cast<std::uint8_t>(f.extended | f.remote << 1 | f.error << 2 | f.fd << 3 |
                                        f.bit_rate_switch << 4));
      out.put(f.length), out.put(std::uint16_t{0}), out.put(f.data);
      break;
    }
    case SampleKind::register_block: {
      const auto& r = *s.as<RegisterBlock>();
      const auto n = std::min<std::uint32_t>(r.count, RegisterBlock::kMax);
      out.put(n), out.put(std::uint32_t{0});
      out.raw(r.value.data(), n * sizeof(double));
      break;
    }
    case SampleKind::pose:
      put_pose(out, *s.as<Pose>());
      break;
    case SampleKind::event: {
      const auto& e = *s.as<EventInfo>();
      out.put(e.code), out.put(std::uint32_t{0}), out.put(e.value), out.put(e.text);
      break;
    }
    case SampleKind::imu: {
      const auto& i = *s.as<ImuSample>();
      out.put(i.specific_force_mps2), out.put(i.angular_rate_radps), out.put(i.temperature_c);
      break;
    }
    case SampleKind::nav_fix: {
      const auto& f = *s.as<NavFix>();
      out.put(static_cast<std::uint32_t>(f.status)), out.put(std::uint32_t{f.satellites});
      out.put(f.latitude_deg), out.put(f.longitude_deg), out.put(f.height_m), out.put(f.covariance_enu_m2);
      break;
    }
    case SampleKind::odometry: {
      const auto& o = *s.as<Odometry>();
      put_pose(out, o.T_odom_base);
      out.put(o.velocity_mps), out.put(o.turn_rate_radps), out.put(o.pose_variance),
          out.put(o.twist_variance);
      out.put(o.wheel_angle_rad), out.put(o.wheel_rate_radps);
      break;
    }
    case SampleKind::none:
      break;
  }
}

}  // namespace

TurnMessage::TurnMessage(std::size_t inputs, std::size_t capacity_bytes)
    : inputs_(inputs),
      begin_(kTurnHead + (inputs + 1) / 2 * 8),
      end_(begin_),
      bytes_(begin_ + capacity_bytes) {}

bool TurnMessage::add(std::uint32_t input, const Sample& s, std::uint64_t offset) noexcept {
  Out out(std::span<std::byte>(bytes_).subspan(end_));
  out.put(input), out.put(static_cast<std::uint32_t>(s.kind())), out.put(s.stamp.sequence);
  out.put(s.stamp.t_capture.ns()), out.put(s.stamp.t_release.ns()), out.put(s.stamp.t_arrival.ns());
  out.put(s.stamp.sigma_capture.ns()), out.put(s.stamp.lost_before), out.put(s.stamp.validity);
  out.put(offset), out.put(static_cast<std::uint64_t>(s.size_bytes)), out.put(std::uint64_t{0});
  if (!out.fits()) return false;
  const std::size_t head = out.size();
  put_info(out, s);
  if (!out.fits()) return false;
  // So that every record, and every number in it, lies where any machine can read it.
  const auto info_bytes = static_cast<std::uint32_t>(out.size() - head);
  const std::uint64_t zeros = 0;
  out.raw(&zeros, (8 - out.size() % 8) % 8);
  if (!out.fits()) return false;
  std::memcpy(bytes_.data() + end_ + head - 8, &info_bytes, sizeof info_bytes);
  end_ += out.size();
  ++samples_;
  return true;
}

std::uint32_t TurnMessage::clear() noexcept {
  end_ = begin_;
  return std::exchange(samples_, 0);
}

void TurnMessage::set_status(std::uint32_t input, PortStatus status) noexcept {
  const auto word = static_cast<std::uint32_t>(status);
  std::memcpy(bytes_.data() + kTurnHead + std::size_t{4} * input, &word, sizeof word);
}

std::span<const std::byte> TurnMessage::finish(std::uint64_t cycle, BenchTime t) noexcept {
  Out out(std::span<std::byte>{bytes_});
  out.put(MessageHeader{static_cast<std::uint32_t>(end_ - sizeof(MessageHeader)), MessageType::turn});
  out.put(cycle), out.put(t.ns()), out.put(static_cast<std::uint32_t>(inputs_)), out.put(samples_);
  return std::span(bytes_).first(end_);
}

bool AnswerReader::open(std::span<const std::byte> body) noexcept {
  if (body.size() < 16) return false;
  std::memcpy(&cycle_, body.data(), 8);
  std::memcpy(&left_, body.data() + 8, 4);
  rest_ = body.subspan(16);
  return true;
}

AnswerReader::Next AnswerReader::next(std::span<const std::size_t> values_of_output,
                                      AnsweredCommand& out) noexcept {
  if (left_ == 0) return rest_.empty() ? Next::end : Next::malformed;
  --left_;
  if (rest_.size() < 8) return Next::malformed;
  std::memcpy(&out.output, rest_.data(), 4);
  std::memcpy(&out.count, rest_.data() + 4, 4);
  rest_ = rest_.subspan(8);
  if (out.output >= values_of_output.size() || out.count != values_of_output[out.output] ||
      out.count > out.value.size() || rest_.size() < out.count * sizeof(double))
    return Next::malformed;
  std::memcpy(out.value.data(), rest_.data(), out.count * sizeof(double));
  rest_ = rest_.subspan(out.count * sizeof(double));
  return Next::command;
}

}  // namespace rigor::application
