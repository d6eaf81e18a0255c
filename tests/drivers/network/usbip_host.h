// A host's end of USB/IP for tests: over a session in memory, or over a socket to a server.
#pragma once

#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "drivers/network/usbip_codec.h"
#include "drivers/network/usbip_session.h"
#include "rt-core/byte_order.h"
#include "rt-core/file_descriptor.h"
#include "rt-core/time.h"

namespace rigor::usbip::testing {

/// The return of a transfer.
struct Return {
  std::int32_t status = 0;
  std::uint32_t length = 0;
  std::string data;  ///< of an IN transfer
};

class Host {
 public:
  /// In memory: the session answers at once.
  explicit Host(Session& session) : session_(&session) {}
  /// Over TCP, to 127.0.0.1.
  explicit Host(std::uint16_t port) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    open_ = ::connect(socket_.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0;
  }

  /// False once the other end has closed the connection.
  [[nodiscard]] bool open() const { return open_; }

  [[nodiscard]] std::vector<ExportedDevice> list() {
    std::string out;
    append_operation(out, {kVersion, kListRequest, 0});
    write(out);
    std::vector<ExportedDevice> all;
    if (!read(kOperationBytes + 4)) return all;
    const auto count = load_be<std::uint32_t>(in_, kOperationBytes);
    in_.erase(0, kOperationBytes + 4);
    for (std::uint32_t i = 0; i < count; ++i) {
      if (!read(kDeviceBytes)) return all;
      const std::size_t bytes = kDeviceBytes + 4u * static_cast<std::uint8_t>(in_[kDeviceBytes - 1]);
      if (!read(bytes)) return all;
      if (auto d = decode_device(front(bytes), true)) all.push_back(*d);
      in_.erase(0, bytes);
    }
    return all;
  }
  /// The status of the server's reply.
  [[nodiscard]] std::uint32_t import(const std::string& bus_id) {
    std::string out;
    append_operation(out, {kVersion, kImportRequest, 0});
    append_bus_id(out, bus_id);
    write(out);
    if (!read(kOperationBytes)) return 0xFFFFFFFF;
    const Operation o = decode_operation(front(kOperationBytes));
    in_.erase(0, kOperationBytes);
    if (o.status == kOk && read(kDeviceBytes)) {
      imported = decode_device(front(kDeviceBytes), false);
      in_.erase(0, kDeviceBytes);
    }
    return o.status;
  }
  std::optional<ExportedDevice> imported;

  /// Sends a transfer; `endpoint` 0x81 is an IN. Gives its sequence number.
  std::uint32_t submit(std::uint8_t endpoint, std::uint32_t length, const std::string& data = {},
                       const SetupPacket& setup = {}) {
    Header h;
    h.sequence = ++sequence_;
    h.device_id = 0x00010002;
    h.in = (endpoint & 0x80) != 0 || (setup.request_type & 0x80) != 0;
    h.endpoint = endpoint & 0x0F;
    h.length = length;
    h.setup = encode_setup(setup);
    std::string out;
    append_header(out, h);
    out += data;
    in_flight_[h.sequence] = h.in;
    write(out);
    return h.sequence;
  }
  /// Its return; empty where none came within `wait`.
  [[nodiscard]] std::optional<Return> take(std::uint32_t sequence, Duration wait = seconds(5)) {
    const MonotonicTime end = monotonic_now() + wait;
    while (returns_.count(sequence) == 0) {
      if (!read(kHeaderBytes, end)) return std::nullopt;
      const auto h = decode_header(front(kHeaderBytes));
      if (!h) return std::nullopt;
      const bool with_data = h->command == Command::submitted && in_flight_[h->sequence];
      const std::size_t bytes = kHeaderBytes + (with_data ? h->length : 0);
      if (!read(bytes, end)) return std::nullopt;
      returns_[h->sequence] = {h->status, h->length, in_.substr(kHeaderBytes, bytes - kHeaderBytes)};
      in_.erase(0, bytes);
    }
    const Return r = returns_[sequence];
    returns_.erase(sequence);
    return r;
  }
  [[nodiscard]] std::optional<Return> transfer(std::uint8_t endpoint, std::uint32_t length,
                                               const std::string& data = {}) {
    return take(submit(endpoint, length, data));
  }
  [[nodiscard]] std::optional<Return> control(const SetupPacket& setup, const std::string& data = {}) {
    return take(submit(0, setup.length, data, setup));
  }
  /// Gives a transfer up; the status of the return.
  [[nodiscard]] std::optional<std::int32_t> unlink(std::uint32_t which) {
    Header h;
    h.command = Command::unlink;
    h.sequence = ++sequence_;
    h.unlink = which;
    std::string out;
    append_header(out, h);
    write(out);
    const auto r = take(h.sequence);
    return r ? std::optional(r->status) : std::nullopt;
  }
  /// What the server sends without being asked, or false when nothing came.
  void write(const std::string& bytes) {
    if (session_ == nullptr) {
      open_ = open_ && ::send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL) ==
                           static_cast<ssize_t>(bytes.size());
      return;
    }
    to_session_ += bytes;
    open_ = open_ && session_->receive(to_session_, in_);
  }

 private:
  [[nodiscard]] Bytes front(std::size_t n) const {
    return {reinterpret_cast<const std::uint8_t*>(in_.data()), n};
  }
  /// At least `n` bytes are in `in_`.
  [[nodiscard]] bool read(std::size_t n, MonotonicTime end = monotonic_now() + seconds(5)) {
    while (in_.size() < n) {
      if (session_ != nullptr) {
        const std::size_t before = in_.size();
        session_->pump(in_);
        if (in_.size() == before) return false;
        continue;
      }
      pollfd p{socket_.get(), POLLIN, 0};
      const auto left = (end - monotonic_now()).ns() / 1'000'000;
      if (left <= 0 || ::poll(&p, 1, static_cast<int>(left)) <= 0) return false;
      char piece[65536];
      const auto got = ::recv(socket_.get(), piece, sizeof piece, 0);
      if (got <= 0) {
        open_ = false;
        return false;
      }
      in_.append(piece, static_cast<std::size_t>(got));
    }
    return true;
  }

  Session* session_ = nullptr;
  FileDescriptor socket_;
  bool open_ = true;
  std::string in_, to_session_;
  std::uint32_t sequence_ = 0;
  std::map<std::uint32_t, bool> in_flight_;  ///< whether it is an IN transfer
  std::map<std::uint32_t, Return> returns_;
};

}  // namespace rigor::usbip::testing
