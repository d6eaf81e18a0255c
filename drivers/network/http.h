// HTTP/1.1 as devices speak it: one request by a client, answers of a server on TcpServer.
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "drivers/network/tcp_server.h"

namespace rigor::network {

struct HttpRequest {
  std::string method = "GET", target = "/", body;
};
struct HttpReply {
  int status = 200;
  std::string body;
};

/// One request on a connection of its own. not_found: nobody listens there; timeout; protocol: what came is
/// no answer, or more than 4 MiB. `cut_fd`: readable when everything is to end. I/O or setup thread.
[[nodiscard]] Result<HttpReply> http_request(const std::string& host, std::uint16_t port,
                                             const HttpRequest& request, MonotonicTime limit, int cut_fd);

/// For TcpServer::listen: answers whole requests by `answer`, JSON; refuses what is none. `client`: its
/// address.
[[nodiscard]] TcpServer::Serve http_server(
    std::function<HttpReply(const HttpRequest& request, std::string_view client)> answer);

}  // namespace rigor::network
