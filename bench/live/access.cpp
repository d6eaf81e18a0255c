#include "bench/live/access.h"

#include <arpa/inet.h>
#include <sys/random.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <optional>

#include "bench/live/protocol.h"

namespace rigor::live {
namespace {

constexpr std::size_t kLeastToken = 8;

/// Hosted applications that speak the protocol; their desktop editions send no Origin, or the token.
constexpr std::string_view kApplications[] = {"https://app.foxglove.dev", "https://studio.foxglove.dev",
                                              "https://lichtblick-suite.github.io"};

bool is_loopback(const std::string& address) {
  in_addr v4{};
  if (inet_pton(AF_INET, address.c_str(), &v4) == 1) return ntohl(v4.s_addr) >> 24 == 127;
  in6_addr v6{};
  return inet_pton(AF_INET6, address.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

std::string lower(std::string_view s) {
  std::string out(s);
  for (char& c : out)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return out;
}

/// The name in `name:port`, `name`, `[::1]:port`.
std::string name_in(std::string_view host) {
  if (!host.empty() && host.front() == '[') {
    const std::size_t end = host.find(']');
    return end == std::string_view::npos ? std::string() : std::string(host.substr(1, end - 1));
  }
  return lower(host.substr(0, host.find(':')));
}

bool local_host(std::string_view host) {
  const std::string name = name_in(host);
  return name == "localhost" || is_loopback(name);
}

bool same_token(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  unsigned differs = 0;
  for (std::size_t i = 0; i < a.size(); ++i) differs |= static_cast<unsigned char>(a[i] ^ b[i]);
  return differs == 0;
}

std::optional<unsigned> hex(char c) {
  if (c >= '0' && c <= '9') return static_cast<unsigned>(c - '0');
  if (c >= 'a' && c <= 'f') return static_cast<unsigned>(c - 'a' + 10);
  if (c >= 'A' && c <= 'F') return static_cast<unsigned>(c - 'A' + 10);
  return {};
}

std::string percent_decoded(std::string_view s) {
  std::string out;
  for (std::size_t i = 0; i < s.size(); ++i) {
    const auto high = s[i] == '%' && i + 2 < s.size() ? hex(s[i + 1]) : std::nullopt;
    const auto low = high ? hex(s[i + 2]) : std::nullopt;
    if (low) {
      out += static_cast<char>(*high * 16 + *low);
      i += 2;
    } else {
      out += s[i] == '+' ? ' ' : s[i];
    }
  }
  return out;
}

std::optional<std::string> value_in_query(std::string_view target, std::string_view key) {
  const std::size_t query = target.find('?');
  if (query == std::string_view::npos) return {};
  std::string_view rest = target.substr(query + 1);
  while (!rest.empty()) {
    const std::size_t end = rest.find('&');
    const std::string_view pair = rest.substr(0, end);
    if (pair.starts_with(key) && pair.substr(key.size(), 1) == "=")
      return percent_decoded(pair.substr(key.size() + 1));
    rest = end == std::string_view::npos ? std::string_view() : rest.substr(end + 1);
  }
  return {};
}

std::string token_in(const Asking& asking) {
  constexpr std::string_view kBearer = "Bearer ";
  if (asking.authorization.substr(0, kBearer.size()) == kBearer)
    return std::string(asking.authorization.substr(kBearer.size()));
  return value_in_query(asking.target, "token").value_or("");
}

bool own_origin(std::string_view origin, std::string_view host) {
  const std::string o = lower(origin), h = lower(host);
  return !h.empty() && (o == "http://" + h || o == "https://" + h);
}

}  // namespace

bool Endpoint::loopback() const { return is_loopback(address); }

Result<Endpoint> parse_endpoint(std::string_view text) {
  Endpoint e;
  const auto wrong = [&] {
    return fail(ErrorCode::bad_input, "--live",
                "expected [ADDRESS:]PORT with a numeric address and a port of 0 to 65535, such as 8765 or "
                "127.0.0.1:8765, got \"" +
                    std::string(text) + "\"");
  };
  if (text.empty()) return e;
  std::string_view port = text;
  if (const std::size_t colon = text.rfind(':'); colon != std::string_view::npos) {
    e.address = std::string(text.substr(0, colon));
    port = text.substr(colon + 1);
    if (e.address.size() > 2 && e.address.front() == '[' && e.address.back() == ']')
      e.address = e.address.substr(1, e.address.size() - 2);
    if (e.address == "localhost") e.address = "127.0.0.1";
    in6_addr any{};
    if (inet_pton(AF_INET, e.address.c_str(), &any) != 1 && inet_pton(AF_INET6, e.address.c_str(), &any) != 1)
      return wrong();
  }
  const auto [end, ec] = std::from_chars(port.data(), port.data() + port.size(), e.port);
  if (ec != std::errc{} || end != port.data() + port.size()) return wrong();
  return e;
}

Result<std::string> make_token() {
  std::array<unsigned char, 16> random{};
  if (getrandom(random.data(), random.size(), 0) != static_cast<ssize_t>(random.size()))
    return fail(ErrorCode::unavailable, "--live",
                std::string("expected random numbers for a token, got: ") + std::strerror(errno) +
                    "; give one with --live-token");
  constexpr char kDigits[] = "0123456789abcdef";
  std::string token;
  for (const unsigned char byte : random) {
    token += kDigits[byte >> 4];
    token += kDigits[byte & 15];
  }
  return token;
}

Status check_token(const Endpoint& endpoint, std::string_view token) {
  if (token.empty() && !endpoint.loopback())
    return fail(ErrorCode::bad_input, "--live",
                "expected a token for an address that is not loopback, got none: whoever reaches " +
                    endpoint.address +
                    " could command the bench; leave --live-open out, or give --live-token T");
  if (!token.empty() && token.size() < kLeastToken)
    return fail(ErrorCode::bad_input, "--live-token",
                "expected at least " + std::to_string(kLeastToken) + " characters, got " +
                    std::to_string(token.size()));
  return {};
}

std::string refuse_page(const Asking& asking, bool loopback) {
  if (loopback && !local_host(asking.host))
    return "expected localhost or a loopback address as Host of a server that listens on loopback alone";
  return {};
}

bool token_fits(const Asking& asking, std::string_view token) {
  return token.empty() || same_token(token_in(asking), token);
}

Result<double> max_rate_of(const Asking& asking) {
  const auto text = value_in_query(asking.target, "max_rate_hz");
  if (!text) return 0.0;
  double rate_hz = 0;
  const auto [end, ec] = std::from_chars(text->data(), text->data() + text->size(), rate_hz);
  if (ec != std::errc{} || end != text->data() + text->size() ||
      !(rate_hz >= kLeastRate_hz && rate_hz <= kMostRate_hz))
    return fail(ErrorCode::bad_input, "max_rate_hz",
                "expected a number from 0.01 to 1000, got \"" + text->substr(0, 40) + "\"");
  return rate_hz;
}

std::string refuse_socket(const Asking& asking, bool loopback, bool with_token) {
  if (std::string why = refuse_page(asking, loopback); !why.empty()) return why;
  if (with_token) return {};  // another site cannot know it
  if (asking.origin.empty() || own_origin(asking.origin, asking.host)) return {};
  for (const std::string_view application : kApplications)
    if (asking.origin == application) return {};
  return "expected a page of this server or a known application as Origin; others need a token "
         "(--live-token)";
}

}  // namespace rigor::live
