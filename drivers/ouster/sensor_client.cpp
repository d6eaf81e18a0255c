#include "drivers/ouster/sensor_client.h"

#include <poll.h>

#include <algorithm>
#include <cstdio>

#include "drivers/network/http.h"
#include "drivers/network/tcp_stream.h"
#include "drivers/ouster/bounded_json.h"

namespace rigor::ouster {
namespace {

using network::HttpReply;
using network::HttpRequest;
using nlohmann::json;

constexpr Duration kOneRequest = seconds(5);

Result<HttpReply> ask(const SensorAddress& sensor, const std::string& target, MonotonicTime limit,
                      const std::string& method = "GET", const std::string& body = "") {
  return network::http_request(sensor.host, sensor.http_port, {method, target, body},
                               std::min(limit, monotonic_now() + kOneRequest), sensor.cut_fd);
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    const bool plain = (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                       c == '-' || c == '_' || c == '.';
    if (plain) {
      out += c;
    } else {
      char hex[4];
      std::snprintf(hex, sizeof hex, "%%%02X", static_cast<unsigned>(static_cast<unsigned char>(c)));
      out += hex;
    }
  }
  return out;
}

/// Answers of the commands of TCP 7501, one after the other; of `names` those that have one, as a map.
Result<std::string> metadata_by_tcp(const SensorAddress& sensor, MonotonicTime limit) {
  network::TcpStream stream;
  limit = std::min(limit, monotonic_now() + kOneRequest);
  if (auto s = stream.connect(sensor.host, sensor.tcp_port, limit, sensor.cut_fd); !s)
    return tl::unexpected<Error>(s.error());
  const std::string where = sensor.host + ":" + std::to_string(sensor.tcp_port);
  std::string got;
  const auto command = [&](const std::string& line) -> Result<json> {
    const std::string sent = line + "\n";
    if (!stream.send({reinterpret_cast<const std::uint8_t*>(sent.data()), sent.size()}, limit))
      return fail(ErrorCode::timeout, where, "expected to send " + line + ", the sensor did not take it");
    std::size_t end = got.find('\n');
    while (end == std::string::npos) {
      std::uint8_t piece[4096];
      std::size_t size = 0;
      if (stream.receive(piece, limit, size) != network::TcpStream::Outcome::data || got.size() > (1U << 20))
        return fail(ErrorCode::timeout, where, "expected an answer to " + line + ", got none");
      got.append(reinterpret_cast<const char*>(piece), size);
      end = got.find('\n');
    }
    const json answer = parse_bounded(got.substr(0, end));
    got.erase(0, end + 1);
    return answer;
  };
  json all;
  for (const auto& [name, line] :
       {std::pair{"sensor_info", "get_sensor_info"}, std::pair{"beam_intrinsics", "get_beam_intrinsics"},
        std::pair{"imu_intrinsics", "get_imu_intrinsics"},
        std::pair{"lidar_intrinsics", "get_lidar_intrinsics"},
        std::pair{"lidar_data_format", "get_lidar_data_format"},
        std::pair{"config_params", "get_config_param active"}}) {
    auto answer = command(line);
    if (!answer) return tl::unexpected<Error>(answer.error());
    if (answer->is_object()) all[name] = std::move(*answer);
  }
  return all.dump();
}

/// By the commands that firmware 2.1 has over HTTP; where one is missing, its part is left out.
Result<std::string> metadata_by_commands(const SensorAddress& sensor, MonotonicTime limit) {
  json all;
  for (const auto& [name, command] :
       {std::pair{"sensor_info", "get_sensor_info"}, std::pair{"beam_intrinsics", "get_beam_intrinsics"},
        std::pair{"imu_intrinsics", "get_imu_intrinsics"},
        std::pair{"lidar_intrinsics", "get_lidar_intrinsics"},
        std::pair{"lidar_data_format", "get_lidar_data_format"},
        std::pair{"config_params", "get_config_param?args=active"}}) {
    const auto reply = ask(sensor, std::string("/api/v1/sensor/cmd/") + command, limit);
    if (!reply) return tl::unexpected<Error>(reply.error());
    json answer = parse_bounded(reply->body);
    if (reply->status == 200 && answer.is_object()) all[name] = std::move(answer);
  }
  if (!all.contains("beam_intrinsics"))
    return fail(ErrorCode::protocol, "http://" + sensor.host + ":" + std::to_string(sensor.http_port),
                "expected the metadata of an Ouster sensor, got a server that knows none of its paths");
  return all.dump();
}

}  // namespace

Result<Metadata> fetch_metadata(const SensorAddress& sensor, MonotonicTime limit) {
  const std::string name = "http://" + sensor.host + ":" + std::to_string(sensor.http_port);
  auto reply = ask(sensor, "/api/v1/sensor/metadata", limit);
  if (reply && reply->status == 200) return parse_metadata(reply->body, name);
  if (reply && reply->status != 404)
    return fail(ErrorCode::unavailable, name,
                "expected the sensor's metadata, got status " + std::to_string(reply->status) + " of HTTP");
  Result<std::string> text = reply ? metadata_by_commands(sensor, limit)
                             : reply.error().code == ErrorCode::not_found && sensor.tcp_port != 0
                                 ? metadata_by_tcp(sensor, limit)
                                 : Result<std::string>(tl::unexpected<Error>(reply.error()));
  // That nobody is at the older port either says less than the first error.
  if (!text) return tl::unexpected<Error>(reply ? text.error() : reply.error());
  return parse_metadata(*text, name);
}

Result<Metadata> wait_for_metadata(const SensorAddress& sensor, MonotonicTime limit) {
  std::string status;
  while (true) {
    auto m = fetch_metadata(sensor, limit);
    if (m && (m->status == "RUNNING" || m->status.empty())) return m;
    // One that starts up may not answer yet; one that is not there is known at once.
    if (!m && m.error().code != ErrorCode::unavailable) return m;
    if (m) status = m->status;
    if (m && m->status == "STANDBY")
      return fail(
          ErrorCode::unavailable, sensor.host,
          "expected a sensor that is RUNNING, got one in STANDBY: `configure: { operating_mode: NORMAL }` "
          "wakes it");
    if (monotonic_now() + milliseconds(100) > limit)
      return fail(ErrorCode::unavailable, sensor.host,
                  "expected a sensor that is RUNNING within `ready_s`, got one that is " +
                      (status.empty() ? m.error().text() : status));
    pollfd p{sensor.cut_fd, POLLIN, 0};
    if (::poll(&p, 1, 100) > 0) return fail(ErrorCode::unavailable, sensor.host, "stopped");
  }
}

Result<bool> configure_sensor(const SensorAddress& sensor, const std::string& parameters,
                              MonotonicTime limit) {
  json wanted = parse_bounded(parameters);
  if (!wanted.is_object())
    return fail(ErrorCode::bad_input, "configure", "expected a map of the sensor's parameters");
  const std::string cmd = "/api/v1/sensor/cmd/";
  const auto checked = [&](const Result<HttpReply>& reply, const std::string& what) -> Status {
    if (!reply) return tl::unexpected<Error>(reply.error());
    if (reply->status == 200) return {};
    return fail(ErrorCode::bad_input, sensor.host,
                "expected the sensor to take " + what + ", it refuses: " + reply->body.substr(0, 300));
  };
  const auto active = ask(sensor, cmd + "get_config_param?args=active", limit);
  if (auto s = checked(active, "get_config_param"); !s) return tl::unexpected<Error>(s.error());
  const json now = parse_bounded(active->body);
  bool to_us = false;
  if (const auto dest = wanted.find("udp_dest"); dest != wanted.end() && *dest == "auto") {
    wanted.erase(dest);
    to_us = true;
  }
  bool differs = false;
  for (const auto& [key, value] : wanted.items())
    differs = differs || !now.is_object() || !now.contains(key) || now[key] != value;
  if (to_us) {
    if (auto s = checked(ask(sensor, cmd + "set_udp_dest_auto", limit), "set_udp_dest_auto"); !s)
      return tl::unexpected<Error>(s.error());
    const auto staged = ask(sensor, cmd + "get_config_param?args=staged", limit);
    if (auto s = checked(staged, "get_config_param"); !s) return tl::unexpected<Error>(s.error());
    const json after = parse_bounded(staged->body);
    differs = differs || !after.is_object() || !now.is_object() ||
              after.value("udp_dest", "") != now.value("udp_dest", "");
  }
  if (!differs) return false;
  if (!wanted.empty())
    if (auto s = checked(ask(sensor, cmd + "set_config_param?args=.+" + escaped(wanted.dump()), limit),
                         "`configure`");
        !s)
      return tl::unexpected<Error>(s.error());
  if (auto s = checked(ask(sensor, cmd + "reinitialize", limit), "reinitialize"); !s)
    return tl::unexpected<Error>(s.error());
  return true;
}

}  // namespace rigor::ouster
