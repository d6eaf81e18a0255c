#include "bench/live/protocol.h"

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <type_traits>

#include "sensor-hal/config/json_text.h"

namespace rigor::live {
namespace {

using nlohmann::json;

tl::unexpected<Error> wrong(const std::string& where, const std::string& what) {
  return fail(ErrorCode::protocol, where, what);
}

/// What a client sent goes into messages cut short.
std::string cited(std::string_view s) {
  std::string out = "\"";
  out += s.substr(0, 60);
  return out + (s.size() > 60 ? "…\"" : "\"");
}

std::optional<std::uint32_t> id_of(const json& j) {
  if (!j.is_number_integer()) return {};
  if (j.is_number_unsigned())
    return j.get<std::uint64_t>() <= 0xffffffffu ? std::optional(j.get<std::uint32_t>()) : std::nullopt;
  const auto v = j.get<std::int64_t>();
  return v >= 0 && v <= 0xffffffffll ? std::optional(static_cast<std::uint32_t>(v)) : std::nullopt;
}

Result<const json*> list_in(const json& message, const std::string& op, const char* key) {
  const auto it = message.find(key);
  if (it == message.end() || !it->is_array()) return wrong(op, std::string("expected a list `") + key + "`");
  if (it->size() > kMaxEntries)
    return wrong(op + "." + key, "expected at most " + std::to_string(kMaxEntries) + " entries, got " +
                                     std::to_string(it->size()));
  return &*it;
}

Result<std::optional<std::string>> id_in(const json& message, const std::string& op) {
  const auto it = message.find("id");
  if (it == message.end() || it->is_null()) return std::optional<std::string>();
  if (!it->is_string()) return wrong(op + ".id", "expected text");
  return std::optional(it->get<std::string>());
}

Result<ClientMessage> subscribe(const json& message) {
  const auto list = list_in(message, "subscribe", "subscriptions");
  if (!list) return tl::unexpected<Error>(list.error());
  Subscribe s;
  for (const json& e : **list) {
    const auto id = e.is_object() && e.contains("id") ? id_of(e["id"]) : std::nullopt;
    const auto channel = e.is_object() && e.contains("channelId") ? id_of(e["channelId"]) : std::nullopt;
    if (!id || !channel)
      return wrong("subscribe.subscriptions", "expected numbers `id` and `channelId` of 32 bits in each");
    double rate_hz = 0;
    if (const auto rate = e.find("rate_hz"); rate != e.end() && !rate->is_null()) {
      rate_hz = rate->is_number() ? rate->get<double>() : -1;
      if (!(rate_hz >= kLeastRate_hz && rate_hz <= kMostRate_hz))
        return wrong("subscribe.subscriptions", "expected `rate_hz` from 0.01 to 1000");
    }
    s.entries.push_back({*id, *channel, rate_hz});
  }
  return ClientMessage(std::move(s));
}

Result<ClientMessage> unsubscribe(const json& message) {
  const auto list = list_in(message, "unsubscribe", "subscriptionIds");
  if (!list) return tl::unexpected<Error>(list.error());
  Unsubscribe u;
  for (const json& e : **list) {
    const auto id = id_of(e);
    if (!id) return wrong("unsubscribe.subscriptionIds", "expected numbers of 32 bits");
    u.ids.push_back(*id);
  }
  return ClientMessage(std::move(u));
}

Result<ClientMessage> get_parameters(const json& message) {
  const auto list = list_in(message, "getParameters", "parameterNames");
  if (!list) return tl::unexpected<Error>(list.error());
  const auto id = id_in(message, "getParameters");
  if (!id) return tl::unexpected<Error>(id.error());
  GetParameters g{{}, *id};
  for (const json& e : **list) {
    if (!e.is_string()) return wrong("getParameters.parameterNames", "expected names");
    g.names.push_back(e);
  }
  return ClientMessage(std::move(g));
}

Result<ClientMessage> set_parameters(const json& message) {
  const auto list = list_in(message, "setParameters", "parameters");
  if (!list) return tl::unexpected<Error>(list.error());
  const auto id = id_in(message, "setParameters");
  if (!id) return tl::unexpected<Error>(id.error());
  SetParameters s{{}, *id};
  for (const json& e : **list) {
    if (!e.is_object() || !e.contains("name") || !e["name"].is_string())
      return wrong("setParameters.parameters", "expected a `name` in each");
    s.entries.push_back({e["name"], e.contains("value") ? e["value"].dump() : std::string()});
  }
  return ClientMessage(std::move(s));
}

class Reader {
 public:
  explicit Reader(std::span<const std::byte> bytes) : bytes_(bytes) {}
  std::optional<std::uint32_t> u32() {
    if (bytes_.size() < 4) return {};
    std::uint32_t v = 0;
    for (int i = 3; i >= 0; --i)
      v = v << 8 | std::to_integer<std::uint32_t>(bytes_[static_cast<std::size_t>(i)]);
    bytes_ = bytes_.subspan(4);
    return v;
  }
  std::optional<std::string> text(std::size_t n) {
    if (bytes_.size() < n) return {};
    std::string s(reinterpret_cast<const char*>(bytes_.data()), n);
    bytes_ = bytes_.subspan(n);
    return s;
  }
  [[nodiscard]] std::size_t left() const { return bytes_.size(); }

 private:
  std::span<const std::byte> bytes_;
};

template <class T>
void put(std::byte*& at, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i, value = static_cast<T>(value >> 8))
    *at++ = static_cast<std::byte>(value & 0xff);
}

std::string text_of(const json& j) { return j.dump(-1, ' ', false, json::error_handler_t::replace); }

}  // namespace

Result<ClientMessage> parse_text(std::string_view text) {
  const auto parsed = parse_json(text, {}, kMaxMessageBytes);
  if (!parsed) return wrong("", parsed.error().message);
  const json& message = *parsed;
  if (!message.is_object()) return wrong("", "expected an object of JSON, got " + cited(text));
  const auto it = message.find("op");
  if (it == message.end() || !it->is_string()) return wrong("", "expected an object with an `op`");
  const std::string op = *it;
  if (op == "subscribe") return subscribe(message);
  if (op == "unsubscribe") return unsubscribe(message);
  if (op == "getParameters") return get_parameters(message);
  if (op == "setParameters") return set_parameters(message);
  for (const char* other :
       {"advertise", "unadvertise", "subscribeParameterUpdates", "unsubscribeParameterUpdates",
        "subscribeConnectionGraph", "unsubscribeConnectionGraph", "fetchAsset"})
    if (op == other) return ClientMessage(NotOffered{op});
  return wrong("op", "expected one of the protocol's, got " + cited(op));
}

Result<ClientMessage> parse_binary(std::span<const std::byte> bytes) {
  if (bytes.empty()) return wrong("", "expected an opcode, got an empty message");
  const auto opcode = std::to_integer<unsigned>(bytes[0]);
  if (opcode == 1) return ClientMessage(NotOffered{"message data"});
  if (opcode != 2) return wrong("", "expected opcode 1 or 2, got " + std::to_string(opcode));
  Reader in(bytes.subspan(1));
  const auto service = in.u32(), call = in.u32(), length = in.u32();
  if (!service || !call || !length)
    return wrong("service call", "expected 13 bytes or more, got " + std::to_string(bytes.size()));
  auto encoding = in.text(*length);
  if (!encoding)
    return wrong("service call", "expected an encoding of " + std::to_string(*length) + " bytes, " +
                                     std::to_string(in.left()) + " are left");
  return ClientMessage(ServiceCall{*service, *call, std::move(*encoding), *in.text(in.left())});
}

std::string server_info(std::string_view name, std::string_view session_id) {
  return text_of({{"op", "serverInfo"},
                  {"name", name},
                  {"capabilities", {"time", "services", "parameters"}},
                  {"supportedEncodings", {"json"}},
                  {"metadata", {{"program", "rigor"}}},
                  {"sessionId", session_id}});
}

std::string advertise(std::span<const ChannelInfo> channels) {
  json list = json::array();
  for (const ChannelInfo& c : channels)
    list.push_back({{"id", c.id},
                    {"topic", c.topic},
                    {"encoding", c.encoding},
                    {"schemaName", c.schema_name},
                    {"schemaEncoding", c.schema_encoding},
                    {"schema", c.schema}});
  return text_of({{"op", "advertise"}, {"channels", std::move(list)}});
}

std::string advertise_services(std::span<const ServiceInfo> services) {
  json list = json::array();
  const auto side = [](const std::string& name, const std::string& schema) {
    return json{
        {"encoding", "json"}, {"schemaName", name}, {"schemaEncoding", "jsonschema"}, {"schema", schema}};
  };
  for (const ServiceInfo& s : services)
    list.push_back({{"id", s.id},
                    {"name", s.name},
                    {"type", s.name},
                    {"request", side(s.name + ".request", s.request_schema)},
                    {"response", side(s.name + ".response", s.response_schema)},
                    // clients of before 2024 look for these
                    {"requestSchema", s.request_schema},
                    {"responseSchema", s.response_schema}});
  return text_of({{"op", "advertiseServices"}, {"services", std::move(list)}});
}

std::string status_message(StatusLevel level, std::string_view text) {
  return text_of({{"op", "status"}, {"level", static_cast<int>(level)}, {"message", text}});
}

std::string service_call_failure(std::uint32_t service, std::uint32_t call, std::string_view why) {
  return text_of({{"op", "serviceCallFailure"}, {"serviceId", service}, {"callId", call}, {"message", why}});
}

std::string parameter_values(const json& parameters, const std::optional<std::string>& id) {
  json message{{"op", "parameterValues"}, {"parameters", parameters}};
  if (id) message["id"] = *id;
  return text_of(message);
}

std::array<std::byte, 13> message_head(std::uint32_t subscription, std::uint64_t time_ns) {
  std::array<std::byte, 13> head{std::byte{1}};
  std::byte* at = head.data() + 1;
  put(at, subscription);
  put(at, time_ns);
  return head;
}

std::array<std::byte, 9> time_message(std::uint64_t time_ns) {
  std::array<std::byte, 9> message{std::byte{2}};
  std::byte* at = message.data() + 1;
  put(at, time_ns);
  return message;
}

std::string service_response(std::uint32_t service, std::uint32_t call, std::string_view encoding,
                             std::string_view answer) {
  std::array<std::byte, 13> head{std::byte{3}};
  std::byte* at = head.data() + 1;
  put(at, service);
  put(at, call);
  put(at, static_cast<std::uint32_t>(encoding.size()));
  std::string message(reinterpret_cast<const char*>(head.data()), head.size());
  message.append(encoding).append(answer);
  return message;
}

}  // namespace rigor::live
