// A message of any type. The first byte of the input names the type, the rest is the message. What can be
// decoded is encoded, and must decode again to what encodes to the same bytes.
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "sensor-hal/record/ros2_messages.h"

using namespace rigor::record;

namespace {

std::vector<std::byte> join(Pieces pieces) {
  std::vector<std::byte> all;
  for (const Bytes& piece : pieces) all.insert(all.end(), piece.begin(), piece.end());
  return all;
}

template <class M>
void round_trip(Bytes data) {
  M message;
  if (!CdrReader::read(data, message)) return;
  CdrWriter writer;
  const auto pieces = writer.write(message);
  if (!pieces) std::abort();
  const std::vector<std::byte> first = join(*pieces);
  M again;
  if (!CdrReader::read(first, again)) std::abort();
  CdrWriter other;
  const auto second = other.write(again);
  if (!second || join(*second) != first) std::abort();
}

template <class... M>
void any_of(std::size_t which, Bytes data) {
  constexpr std::array<void (*)(Bytes), sizeof...(M)> kAll{&round_trip<M>...};
  kAll[which % kAll.size()](data);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  any_of<msg::Image, msg::CompressedImage, msg::CameraInfo, msg::PointCloud2, msg::LaserScan, msg::Imu,
         msg::NavSatFix, msg::Odometry, msg::PoseStamped, msg::TFMessage, msg::Frame, msg::DiagnosticArray,
         msg::SampleStamp, msg::ImageSettings, msg::CanFdFrame, msg::RegisterBlock, msg::PortVisibility,
         msg::Event, msg::Command, msg::Fault>(data[0],
                                               {reinterpret_cast<const std::byte*>(data + 1), size - 1});
  return 0;
}
