// USB/IP as bytes: how a host asks for the devices of a server, imports one, and sends its transfers over the
// same connection (https://docs.kernel.org/usb/usbip_protocol.html). All numbers are big-endian.
//
// clang-format off
//   host → server                               server → host
//   version:16 0x8005 status:32                 version:16 0x0005 status:32 count:32, for each: device, interfaces
//   version:16 0x8003 status:32 bus_id[32]      version:16 0x0003 status:32, the device where status is 0
//   from then on
//   CMD_SUBMIT   48 bytes, the data of an OUT   RET_SUBMIT   48 bytes, the data of an IN
//   CMD_UNLINK   48 bytes                       RET_UNLINK   48 bytes
//   isochronous transfers have 16 bytes for each packet after the data
// clang-format on
//
// Headers are decoded by themselves; what follows one is as long as the header says, which its reader bounds.
// No sockets; any thread.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace rigor::usbip {

using Bytes = std::span<const std::uint8_t>;

inline constexpr std::uint16_t kPort = 3240, kVersion = 0x0111;
inline constexpr std::uint16_t kListRequest = 0x8005, kListReply = 0x0005;
inline constexpr std::uint16_t kImportRequest = 0x8003, kImportReply = 0x0003;
inline constexpr std::size_t kOperationBytes = 8, kBusIdBytes = 32, kDeviceBytes = 312, kHeaderBytes = 48;
/// Status of a reply.
inline constexpr std::uint32_t kOk = 0, kUnavailable = 1, kNoDevice = 4;

/// Speeds as the kernel counts them.
enum class Speed : std::uint32_t { full = 2, high = 3, super = 5 };

struct InterfaceClass {
  std::uint8_t device_class = 0, subclass = 0, protocol = 0;
};
/// A device as a server lists it.
struct ExportedDevice {
  std::string path, bus_id;  ///< "/sys/devices/…/1-1", "1-1"
  std::uint32_t bus = 1, number = 1;
  Speed speed = Speed::super;
  std::uint16_t vendor = 0, product = 0, release = 0;
  InterfaceClass device_class;
  std::uint8_t configuration = 1, configurations = 1;
  std::vector<InterfaceClass> interfaces;
};

struct Operation {
  std::uint16_t version = 0, code = 0;
  std::uint32_t status = 0;
};
/// Precondition: kOperationBytes.
[[nodiscard]] Operation decode_operation(Bytes bytes);
void append_operation(std::string& out, const Operation& operation);
/// The 312 bytes of a device; of a list, the interfaces follow.
void append_device(std::string& out, const ExportedDevice& device, bool with_interfaces);
/// A bus id in its field of 32 bytes.
void append_bus_id(std::string& out, const std::string& bus_id);
[[nodiscard]] std::string decode_bus_id(Bytes field);
/// Empty where `bytes` is shorter than the device and, of a list, its interfaces.
[[nodiscard]] std::optional<ExportedDevice> decode_device(Bytes bytes, bool with_interfaces);

enum class Command : std::uint32_t { submit = 1, unlink = 2, submitted = 3, unlinked = 4 };

/// The eight bytes of a control transfer's setup stage (USB 2.0, 9.3).
struct SetupPacket {
  std::uint8_t request_type = 0, request = 0;
  std::uint16_t value = 0, index = 0, length = 0;
};

/// Of all four messages; what a message does not have is 0.
struct Header {
  Command command = Command::submit;
  std::uint32_t sequence = 0, device_id = 0;
  bool in = false;
  std::uint32_t endpoint = 0;
  std::uint32_t length = 0;       ///< of a transfer's buffer; of a return: the bytes that went over
  std::uint32_t packets = 0;      ///< of an isochronous transfer
  std::uint32_t start_frame = 0;  ///< of an isochronous transfer: where on the bus it begins
  std::int32_t status = 0;        ///< of a return: 0 or a negative errno
  std::uint32_t unlink = 0;       ///< CMD_UNLINK: the sequence number of the transfer that is given up
  std::array<std::uint8_t, 8> setup{};
};
/// Precondition: kHeaderBytes. Empty for an unknown command.
[[nodiscard]] std::optional<Header> decode_header(Bytes bytes);
/// The 48 bytes; data follows separately.
void append_header(std::string& out, const Header& header);
/// A packet of an isochronous transfer; its 16 bytes follow the data.
struct IsochronousPacket {
  std::uint32_t offset = 0, length = 0, actual_length = 0;
  std::int32_t status = 0;
};
inline constexpr std::size_t kIsochronousPacketBytes = 16;
/// Precondition: kIsochronousPacketBytes.
[[nodiscard]] IsochronousPacket decode_isochronous_packet(Bytes bytes);
void append_isochronous_packet(std::string& out, const IsochronousPacket& packet);
[[nodiscard]] SetupPacket decode_setup(const std::array<std::uint8_t, 8>& bytes);
[[nodiscard]] std::array<std::uint8_t, 8> encode_setup(const SetupPacket& setup);

}  // namespace rigor::usbip
