#include "drivers/network/http.h"

#include <utility>  // before asio of Boost 1.74, which lacks it

#include <boost/asio/buffer.hpp>
#include <boost/beast/http.hpp>
#include <sstream>

#include "drivers/network/tcp_stream.h"

namespace rigor::network {
namespace {

namespace http = boost::beast::http;

constexpr std::size_t kMaxReply = 4 << 20, kMaxRequest = 1 << 16;

template <class Message>
std::string text_of(Message& message) {
  message.prepare_payload();
  std::ostringstream out;
  out << message;
  return out.str();
}

}  // namespace

Result<HttpReply> http_request(const std::string& host, std::uint16_t port, const HttpRequest& request,
                               MonotonicTime limit, int cut_fd) {
  const std::string where = "http://" + host + ":" + std::to_string(port) + request.target;
  TcpStream stream;
  if (auto s = stream.connect(host, port, limit, cut_fd); !s) return tl::unexpected<Error>(s.error());
  http::request<http::string_body> message;
  message.method_string(request.method);
  message.target(request.target);
  message.version(11);
  message.set(http::field::host, host);
  message.set(http::field::connection, "close");
  if (!request.body.empty()) message.set(http::field::content_type, "application/json");
  message.body() = request.body;
  const std::string sent = text_of(message);
  if (!stream.send({reinterpret_cast<const std::uint8_t*>(sent.data()), sent.size()}, limit))
    return fail(ErrorCode::timeout, where, "expected to send a request, the device did not take it");

  http::response_parser<http::string_body> parser;
  parser.eager(true);
  parser.body_limit(kMaxReply);
  std::string got;
  boost::beast::error_code ec;
  const auto broken = [&](const std::string& what) {
    return fail(ErrorCode::protocol, where, "expected an answer of HTTP, got " + what);
  };
  while (!parser.is_done()) {
    std::uint8_t piece[8192];
    std::size_t size = 0;
    switch (stream.receive(piece, limit, size)) {
      case TcpStream::Outcome::data:
        got.append(reinterpret_cast<const char*>(piece), size);
        break;
      case TcpStream::Outcome::timeout:
        return fail(ErrorCode::timeout, where, "expected an answer in time, got none");
      case TcpStream::Outcome::cut:
        return fail(ErrorCode::unavailable, where, "stopped");
      case TcpStream::Outcome::closed:
        parser.put_eof(ec);
        if (ec || !parser.is_done()) return broken("its beginning");
        break;
    }
    while (!got.empty() && !parser.is_done()) {
      const std::size_t n = parser.put(boost::asio::buffer(got), ec);
      got.erase(0, n);
      if (ec == http::error::need_more) break;
      if (ec) return broken(ec.message());
    }
    if (got.size() > kMaxReply) return broken("more than 4 MiB");
  }
  const auto& reply = parser.get();
  return HttpReply{static_cast<int>(reply.result_int()), reply.body()};
}

TcpServer::Serve http_server(std::function<HttpReply(const HttpRequest&, std::string_view)> answer) {
  return [answer = std::move(answer)](TcpServer::Client& client) {
    while (!client.in.empty() && !client.close) {
      http::request_parser<http::string_body> parser;
      parser.eager(true);
      parser.header_limit(kMaxRequest);
      parser.body_limit(kMaxRequest);
      boost::beast::error_code ec;
      std::size_t consumed = 0;
      while (!parser.is_done() && consumed < client.in.size()) {
        const std::size_t n =
            parser.put(boost::asio::buffer(client.in.data() + consumed, client.in.size() - consumed), ec);
        consumed += n;
        if (ec || n == 0) break;
      }
      HttpReply reply{400, R"({"error": "expected a request of HTTP/1.1"})"};
      bool keep = false;
      if (parser.is_done()) {
        client.in.erase(0, consumed);
        const auto& r = parser.get();
        reply = answer({std::string(r.method_string()), std::string(r.target()), r.body()}, client.address);
        keep = r.keep_alive();
      } else if (!ec || ec == http::error::need_more) {
        return;
      }
      http::response<http::string_body> message;
      message.result(static_cast<unsigned>(reply.status));
      message.version(11);
      message.set(http::field::content_type, "application/json");
      message.keep_alive(keep);
      message.body() = reply.body;
      client.out += text_of(message);
      client.close = !keep;
    }
  };
}

}  // namespace rigor::network
