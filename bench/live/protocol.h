// The Foxglove WebSocket protocol, version 1 (github.com/foxglove/ws-protocol, docs/spec.md): what clients
// say as structs, and what they are told as text and bytes. No sockets here.
//
//   client                                       server
//                                                serverInfo, advertise, advertiseServices
//   subscribe {id 7, channel 3}                  01 | 7 | time | message, …
//   02 | service | call | encoding | request     03 | service | call | encoding | answer, or
//   serviceCallFailure
//
// Numbers in binary messages are little-endian. Nothing that a client says is trusted: lengths and counts are
// checked, and what is not understood is an error that names it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "rt-core/result.h"

namespace rigor::live {

// ------------------------------------------------------------------ from clients

struct Subscribe {
  struct Entry {
    std::uint32_t id = 0, channel = 0;
    /// `rate_hz`, which the protocol does not have and other servers pass over: at most so many messages a
    /// second of the run's time; 0: as the connection says.
    double rate_hz = 0;
  };
  std::vector<Entry> entries;
};
/// What a client may ask for, in a subscription and in its address.
inline constexpr double kLeastRate_hz = 0.01, kMostRate_hz = 1000;
struct Unsubscribe {
  std::vector<std::uint32_t> ids;
};
struct GetParameters {
  std::vector<std::string> names;  ///< empty: all
  std::optional<std::string> id;
};
struct SetParameters {
  struct Entry {
    std::string name, value;  ///< the value as JSON; empty: to be removed
  };
  std::vector<Entry> entries;
  std::optional<std::string> id;
};
struct ServiceCall {
  std::uint32_t service = 0, call = 0;
  std::string encoding, request;
};
/// A message of the protocol for something that this server has not said it can do.
struct NotOffered {
  std::string what;
};
using ClientMessage =
    std::variant<Subscribe, Unsubscribe, GetParameters, SetParameters, ServiceCall, NotOffered>;

/// Of a message of a client.
inline constexpr std::size_t kMaxMessageBytes = 256u << 10;
/// Entries of one message at most.
inline constexpr std::size_t kMaxEntries = 4096;

/// protocol: not JSON, no such op, a field missing or of another type, too many entries. Any thread.
[[nodiscard]] Result<ClientMessage> parse_text(std::string_view text);
/// protocol: too short, an unknown opcode, a length beyond the message. Any thread.
[[nodiscard]] Result<ClientMessage> parse_binary(std::span<const std::byte> bytes);

// ------------------------------------------------------------------ to clients

struct ChannelInfo {
  std::uint32_t id = 0;
  std::string topic, encoding, schema_name, schema_encoding, schema;
};
struct ServiceInfo {
  std::uint32_t id = 0;
  std::string name, request_schema, response_schema;  ///< JSON schemas
};
enum class StatusLevel : std::uint8_t { info = 0, warning = 1, error = 2 };

[[nodiscard]] std::string server_info(std::string_view name, std::string_view session_id);
[[nodiscard]] std::string advertise(std::span<const ChannelInfo> channels);
[[nodiscard]] std::string advertise_services(std::span<const ServiceInfo> services);
[[nodiscard]] std::string status_message(StatusLevel level, std::string_view text);
[[nodiscard]] std::string service_call_failure(std::uint32_t service, std::uint32_t call,
                                               std::string_view why);
/// `parameters`: [{"name": …, "value": …}].
[[nodiscard]] std::string parameter_values(const nlohmann::json& parameters,
                                           const std::optional<std::string>& id);

/// What goes before a message's bytes.
[[nodiscard]] std::array<std::byte, 13> message_head(std::uint32_t subscription, std::uint64_t time_ns);
[[nodiscard]] std::array<std::byte, 9> time_message(std::uint64_t time_ns);
[[nodiscard]] std::string service_response(std::uint32_t service, std::uint32_t call,
                                           std::string_view encoding, std::string_view answer);

}  // namespace rigor::live
