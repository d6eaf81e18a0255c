// What clients of the live view say: text and binary messages, and the headers of their requests, through the
// hub.
#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "bench/live/access.h"
#include "bench/live/hub.h"

namespace {

class NoLink final : public rigor::live::Link {
 public:
  void send_text(std::string) override {}
  void send_binary(std::string, rigor::live::Bytes) override {}
  [[nodiscard]] std::size_t backlog_bytes() const override { return 0; }
  [[nodiscard]] bool behind() const override { return false; }
  void close(const std::string&) override {}
};

}  // namespace

/// The first byte chooses: text, binary, headers (the rest cut at zero bytes).
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string rest(reinterpret_cast<const char*>(data + 1), size - 1);
  if (data[0] % 3 == 2) {
    const std::size_t a = rest.find('\0'), b = a == std::string::npos ? a : rest.find('\0', a + 1);
    const std::string_view all = rest;
    const rigor::live::Asking asking{all.substr(0, a),
                                     a == std::string::npos ? "" : all.substr(a + 1, b - a - 1),
                                     b == std::string::npos ? "" : all.substr(b + 1), all};
    (void)rigor::live::token_fits(asking, "open-sesame");
    (void)rigor::live::refuse_socket(asking, true, false);
    (void)rigor::live::parse_endpoint(rest);
    return 0;
  }
  rigor::live::Hub hub("bench", "1", [](auto work, auto done) {
    work();
    done();
  });
  const auto channel = hub.add_channel({0, "/a", "cdr", "b", "ros2msg", ""});
  hub.add_service({0, "echo", "{}", "{}"}, [](const std::string& request) { return request; });
  hub.serve_parameters(
      [] {
        return nlohmann::json::array({{{"name", "/a/active"}, {"value", "real"}}});
      },
      [](const std::string&, const nlohmann::json& value) { return value.is_string(); });
  hub.advertise_new();
  NoLink link;
  hub.opened(link);
  if (data[0] % 3 == 0)
    hub.text(link, rest);
  else
    hub.binary(link, {reinterpret_cast<const std::byte*>(rest.data()), rest.size()});
  hub.publish(channel, 1, std::make_shared<const std::string>("x"));
  hub.closed(link);
  return 0;
}
