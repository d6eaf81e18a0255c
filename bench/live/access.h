// Who may connect to the live view's port, decided from what an HTTP request says. No sockets here.
//
// A page of any web site may open a WebSocket to 127.0.0.1 from the browser of whoever looks at it: the
// browser says which site in `Origin`, and that is all that tells it from ours. A site may also give its own
// name the address 127.0.0.1 (DNS rebinding), so that its pages seem to be ours: then `Host` has its name.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "rt-core/result.h"

namespace rigor::live {

struct Endpoint {
  std::string address = "127.0.0.1";
  std::uint16_t port = 8765;
  /// Numerically; a name is none.
  [[nodiscard]] bool loopback() const;
};
/// `[ADDRESS:]PORT`, ADDRESS numeric (IPv6 in brackets) or `localhost`; empty: the default. bad_input.
[[nodiscard]] Result<Endpoint> parse_endpoint(std::string_view text);
/// 128 bits of the kernel's random numbers in hexadecimal. unavailable: it has none. Any thread.
[[nodiscard]] Result<std::string> make_token();
/// bad_input where the address is not loopback and the token is empty, or shorter than 8 characters.
[[nodiscard]] Status check_token(const Endpoint& endpoint, std::string_view token);

/// What a request says of itself; empty: it does not.
struct Asking {
  std::string_view host{}, origin{}, target{}, authorization{};
};
/// Why it may not have this server's pages; empty: it may. `loopback`: what is listened on.
[[nodiscard]] std::string refuse_page(const Asking& asking, bool loopback);
/// Whether it brings the token, in `?token=` or as `Authorization: Bearer`; also where none is asked for.
/// Takes as long for a wrong one as for the right one.
[[nodiscard]] bool token_fits(const Asking& asking, std::string_view token);
/// `max_rate_hz=R` of the target's query: what a client takes of each topic at most; 0: it does not say.
/// bad_input: no number from 0.01 to 1000.
[[nodiscard]] Result<double> max_rate_of(const Asking& asking);
/// Why it may not open the WebSocket; empty: it may. `with_token`: it brought the one that is asked for.
[[nodiscard]] std::string refuse_socket(const Asking& asking, bool loopback, bool with_token);

}  // namespace rigor::live
