// An emulated USB device, as a session of USB/IP (usbip_session.h) sees it: descriptors, the requests of
// chapter 9 that every device answers, and queues of what its IN endpoints are to send.
//
//   class Camera : public usbip::Device { … };
//   send(0x83, bytes, 0, bytes->size());      // waits until the host has a transfer for it
//
// A transfer of the host takes one message, or the part of it that it has room for; the next transfer goes on
// with the rest. A message that is all sent ends its transfer, as a short packet does. An endpoint that is
// halted stalls and has lost its messages. One caller at a time.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "drivers/network/usbip_codec.h"

namespace rigor::usbip {

/// Type and index of the standard descriptors, and of requests (USB 3.2, table 9-5 and 9-6).
inline constexpr std::uint8_t kDeviceDescriptor = 1, kConfigurationDescriptor = 2, kStringDescriptor = 3,
                              kBosDescriptor = 15;

struct Descriptors {
  std::vector<std::uint8_t> device, configuration, bos;  ///< `bos` empty: it has none
  std::vector<std::string> strings;                      ///< string 1, 2, …; Latin-1
  ExportedDevice exported;
};

class Device {
 public:
  /// What an endpoint sends. Shared, so that a picture is not copied.
  using Message = std::shared_ptr<const std::vector<std::uint8_t>>;

  virtual ~Device() = default;
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  [[nodiscard]] const Descriptors& descriptors() const { return descriptors_; }
  /// False while its cable is pulled: it is not listed, and cannot be imported.
  [[nodiscard]] bool plugged() const { return plugged_; }
  [[nodiscard]] bool imported() const { return imported_; }

  /// A host has it, or has it no longer; it begins as after power-on.
  void attach();
  void detach();
  /// False: stall. `answer`: the data of an IN request, which the caller cuts to what the host asked for.
  [[nodiscard]] bool control(const SetupPacket& setup, Bytes data, std::string& answer);
  /// An OUT transfer on another endpoint. False: stall.
  [[nodiscard]] bool write(std::uint8_t endpoint, Bytes data);
  enum class Read : std::uint8_t { data, wait, stall };
  /// An IN transfer of `endpoint` (0x81 …) with room for `length` bytes, which are appended to `out`.
  [[nodiscard]] Read read(std::uint8_t endpoint, std::size_t length, std::string& out);

 protected:
  explicit Device(Descriptors descriptors);
  void set_plugged(bool is) { plugged_ = is; }
  /// `bytes` of a message from `at` on, as a message of its own. `tag` comes back in on_sent.
  void send(std::uint8_t endpoint, Message message, std::size_t at, std::size_t bytes,
            std::uint64_t tag = 0) {
    queues_[endpoint].push_back({std::move(message), at, at + bytes, tag});
  }
  void drop_messages(std::uint8_t endpoint) { queues_[endpoint].clear(); }
  [[nodiscard]] std::size_t waiting_messages(std::uint8_t endpoint) const;

  virtual void on_attach() = 0;
  virtual void on_detach() = 0;
  [[nodiscard]] virtual bool on_write(std::uint8_t endpoint, Bytes data) = 0;
  /// The last byte of a message has left.
  virtual void on_sent(std::uint8_t endpoint, std::uint64_t tag) = 0;
  /// The host halted an endpoint, or resets it; its messages are gone.
  virtual void on_reset(std::uint8_t endpoint) = 0;

 private:
  struct Queued {
    Message bytes;
    std::size_t at = 0, end = 0;
    std::uint64_t tag = 0;
  };
  [[nodiscard]] bool get_descriptor(const SetupPacket& setup, std::string& answer) const;
  [[nodiscard]] bool has_endpoint(std::uint8_t endpoint) const { return halted_.count(endpoint) != 0; }
  void reset_endpoint(std::uint8_t endpoint, bool halt);

  Descriptors descriptors_;
  std::map<std::uint8_t, std::deque<Queued>> queues_;
  std::map<std::uint8_t, bool> halted_;  ///< of each endpoint that the configuration describes
  std::uint8_t configuration_ = 0;
  bool plugged_ = true, imported_ = false;
};

/// A string as a descriptor of it (UTF-16).
[[nodiscard]] std::string string_descriptor(const std::string& text);

}  // namespace rigor::usbip
