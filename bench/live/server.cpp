#include "bench/live/server.h"

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <condition_variable>
#include <deque>
#include <fstream>
#include <future>
#include <mutex>
#include <set>
#include <thread>

#include "bench/live/page_files.h"

namespace rigor::live {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using tcp = asio::ip::tcp;
using beast::error_code;

constexpr std::string_view kProtocols[] = {"foxglove.websocket.v1", "foxglove.sdk.v1"};
constexpr auto kRequestTimeout = std::chrono::seconds(10), kIdleTimeout = std::chrono::seconds(60);
constexpr std::string_view kAsked = "read";
/// In the kernel: little, so that a client that does not read is known by its backlog here.
constexpr int kSendBuffer = 256 << 10;

std::string_view view(beast::string_view s) { return {s.data(), s.size()}; }

/// The first of ours in a list of subprotocols; empty: none.
std::string_view protocol_of(std::string_view offered) {
  while (!offered.empty()) {
    const std::size_t end = offered.find(',');
    std::string_view one = offered.substr(0, end);
    while (!one.empty() && (one.front() == ' ' || one.front() == '\t')) one.remove_prefix(1);
    while (!one.empty() && (one.back() == ' ' || one.back() == '\t')) one.remove_suffix(1);
    for (const std::string_view p : kProtocols)
      if (one == p) return p;
    offered = end == std::string_view::npos ? std::string_view() : offered.substr(end + 1);
  }
  return {};
}

std::string_view content_type(std::string_view path) {
  const std::size_t dot = path.rfind('.');
  const std::string_view ending = dot == std::string_view::npos ? std::string_view() : path.substr(dot + 1);
  if (ending == "html") return "text/html; charset=utf-8";
  if (ending == "js" || ending == "mjs") return "text/javascript; charset=utf-8";
  if (ending == "css") return "text/css; charset=utf-8";
  if (ending == "json") return "application/json";
  if (ending == "svg") return "image/svg+xml";
  if (ending == "png") return "image/png";
  if (ending == "woff2") return "font/woff2";
  return "text/plain; charset=utf-8";
}

/// The file that a request's target names; empty: it names none.
std::string path_of(std::string_view target) {
  std::string path(target.substr(0, target.find_first_of("?#")));
  if (path.empty() || path.front() != '/') return {};
  path.erase(0, 1);
  if (path.empty()) return "index.html";
  for (const char c : path)
    if (!std::isalnum(static_cast<unsigned char>(c)) && c != '.' && c != '-' && c != '_' && c != '/')
      return {};
  return path.find("..") == std::string::npos && path.front() != '/' ? path : std::string();
}

/// Tasks that take their time, one after the other.
class SerialExecutor {
 public:
  SerialExecutor() : thread_([this] { work(); }) {}
  ~SerialExecutor() {
    {
      const std::lock_guard lock(mutex_);
      end_ = true;
    }
    wake_.notify_one();
    thread_.join();
  }
  void push(std::function<void()> task) {
    {
      const std::lock_guard lock(mutex_);
      tasks_.push_back(std::move(task));
    }
    wake_.notify_one();
  }

 private:
  void work() {
    std::unique_lock lock(mutex_);
    while (true) {
      wake_.wait(lock, [this] { return end_ || !tasks_.empty(); });
      if (end_) return;
      auto task = std::move(tasks_.front());
      tasks_.pop_front();
      lock.unlock();
      task();
      task = nullptr;
      lock.lock();
    }
  }
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<std::function<void()>> tasks_;
  bool end_ = false;
  std::thread thread_;
};

class Connection;

/// What all connections share.
struct Site {
  Hub* hub = nullptr;
  std::string token;
  std::filesystem::path page_dir;
  bool loopback = true;
  std::size_t sockets = 0;
  std::set<Connection*> all;
  std::set<Connection*> open;  ///< WebSockets
};

/// One connection: requests for files until it asks for a WebSocket or goes.
class Connection final : public Link, public std::enable_shared_from_this<Connection> {
 public:
  Connection(tcp::socket socket, Site& site) : site_(site), ws_(std::move(socket)) { site_.all.insert(this); }
  ~Connection() override {
    site_.all.erase(this);
    if (is_socket_) --site_.sockets;
  }

  void read_request() {
    parser_.emplace();
    parser_->header_limit(Server::kMaxHeader);
    parser_->body_limit(0);
    beast::get_lowest_layer(ws_).expires_after(kRequestTimeout);
    http::async_read(ws_.next_layer(), buffer_, *parser_,
                     [self = shared_from_this()](error_code error, std::size_t) {
                       if (!error) self->answer();
                     });
  }

  // Link
  void send_text(std::string text) override { enqueue({true, std::move(text), nullptr}); }
  void send_binary(std::string head, Bytes body) override {
    enqueue({false, std::move(head), std::move(body)});
  }
  [[nodiscard]] std::size_t backlog_bytes() const override { return backlog_; }
  [[nodiscard]] bool behind() const override { return asked_ && monotonic_now() - asked_at_ > kBehind; }
  void close(const std::string&) override { cut_off(); }
  void say_goodbye() {
    closing_ = true;
    if (queue_.empty()) end_socket();
  }
  void cut_off() { beast::get_lowest_layer(ws_).close(); }

 private:
  struct Outgoing {
    bool text;
    std::string head;
    Bytes body;
    [[nodiscard]] std::size_t size() const { return head.size() + (body ? body->size() : 0); }
  };

  // ---- HTTP ----
  void answer() {
    const auto& request = parser_->get();
    const Asking asking{view(request[http::field::host]), view(request[http::field::origin]),
                        view(request.target()), view(request[http::field::authorization])};
    if (websocket::is_upgrade(request)) return open_socket(asking);
    if (const std::string why = refuse_page(asking, site_.loopback); !why.empty())
      return send(http::status::forbidden, "text/plain; charset=utf-8", why);
    if (request.method() != http::verb::get && request.method() != http::verb::head)
      return send(http::status::method_not_allowed, "text/plain; charset=utf-8", "expected GET or HEAD");
    if (asking.target.substr(0, asking.target.find('?')) == "/token")
      return send(token_fits(asking, site_.token) ? http::status::no_content : http::status::unauthorized,
                  "text/plain; charset=utf-8", "");
    const std::string path = path_of(asking.target);
    std::string content;
    if (path.empty() || !load(path, content))
      return send(http::status::not_found, "text/plain; charset=utf-8", "there is no such file");
    send(http::status::ok, content_type(path), std::move(content));
  }

  /// What the folder does not have, such as libraries, comes from the program.
  bool load(const std::string& path, std::string& content) const {
    const auto file = site_.page_dir / path;
    std::error_code none;
    if (!site_.page_dir.empty() && std::filesystem::is_regular_file(file, none)) {
      std::ifstream in(file, std::ios::binary);
      content.assign(std::istreambuf_iterator<char>(in), {});
      return in.good() || in.eof();
    }
    for (const PageFile& f : page_files())
      if (f.path == path) return content = std::string(f.bytes), true;
    return false;
  }

  void send(http::status status, std::string_view type, std::string content) {
    const auto& request = parser_->get();
    response_ = {};
    response_.version(request.version());
    response_.result(status);
    response_.set(http::field::server, "rigor");
    response_.set(http::field::content_type, beast::string_view(type.data(), type.size()));
    response_.set(http::field::cache_control, "no-cache");
    response_.set("X-Content-Type-Options", "nosniff");
    response_.set("X-Frame-Options", "DENY");
    response_.set("Referrer-Policy", "no-referrer");
    response_.set(
        "Content-Security-Policy",
        "default-src 'self'; connect-src 'self' ws: wss:; img-src 'self' data: blob:; style-src 'self' "
        "'unsafe-inline'; worker-src 'self' blob:; frame-ancestors 'none'; base-uri 'none'");
    response_.keep_alive(request.keep_alive());
    response_.body() = std::move(content);
    response_.prepare_payload();
    if (request.method() == http::verb::head) response_.body().clear();  // its length has been said
    beast::get_lowest_layer(ws_).expires_after(kRequestTimeout);
    http::async_write(ws_.next_layer(), response_,
                      [self = shared_from_this()](error_code error, std::size_t) {
                        if (error) return;
                        if (self->response_.keep_alive()) return self->read_request();
                        self->ws_.next_layer().socket().shutdown(tcp::socket::shutdown_send, error);
                      });
  }

  // ---- WebSocket ----
  void open_socket(const Asking& asking) {
    const auto refuse = [this](http::status status, const std::string& why) {
      send(status, "text/plain; charset=utf-8", why);
    };
    if (!token_fits(asking, site_.token))
      return refuse(http::status::unauthorized, "expected the token of this run: /?token=…");
    if (const std::string why = refuse_socket(asking, site_.loopback, !site_.token.empty()); !why.empty())
      return refuse(http::status::forbidden, why);
    const auto& request = parser_->get();
    const std::string_view protocol = protocol_of(view(request[http::field::sec_websocket_protocol]));
    if (protocol.empty())
      return refuse(http::status::bad_request, "expected the subprotocol foxglove.websocket.v1");
    if (site_.sockets >= Server::kMaxClients)
      return refuse(http::status::service_unavailable,
                    "expected at most " + std::to_string(Server::kMaxClients) + " clients; close one");
    const auto rate = max_rate_of(asking);
    if (!rate) return refuse(http::status::bad_request, rate.error().text());
    ++site_.sockets;
    is_socket_ = true;
    beast::get_lowest_layer(ws_).expires_never();
    ws_.set_option(websocket::stream_base::timeout{kRequestTimeout, kIdleTimeout, true});
    ws_.set_option(websocket::stream_base::decorator([protocol](websocket::response_type& r) {
      r.set(http::field::sec_websocket_protocol, beast::string_view(protocol.data(), protocol.size()));
    }));
    ws_.read_message_max(kMaxMessageBytes);
    ws_.auto_fragment(false);
    ws_.async_accept(request, [self = shared_from_this(), max_rate_hz = *rate](error_code error) {
      if (error) return;
      self->buffer_.consume(self->buffer_.size());
      self->site_.open.insert(self.get());
      self->hear_pongs();
      self->site_.hub->opened(*self, max_rate_hz);
      self->read_message();
    });
  }

  void read_message() {
    ws_.async_read(buffer_, [self = shared_from_this()](error_code error, std::size_t) {
      if (error) return self->gone();
      const auto data = self->buffer_.cdata();
      // After the goodbye nothing is done any more, and nothing may follow it.
      if (!self->closing_) {
        if (self->ws_.got_text())
          self->site_.hub->text(*self, {static_cast<const char*>(data.data()), data.size()});
        else
          self->site_.hub->binary(*self, {static_cast<const std::byte*>(data.data()), data.size()});
      }
      self->buffer_.consume(self->buffer_.size());
      self->read_message();
    });
  }

  void enqueue(Outgoing message) {
    if (closing_) return;
    backlog_ += message.size();
    queue_.push_back(std::move(message));
    if (queue_.size() == 1) write_next();
  }
  void write_next() {
    const Outgoing& m = queue_.front();
    ws_.text(m.text);
    const std::array<asio::const_buffer, 2> pieces{asio::buffer(m.head),
                                                   m.body ? asio::buffer(*m.body) : asio::const_buffer()};
    ws_.async_write(pieces, [self = shared_from_this()](error_code error, std::size_t) {
      self->backlog_ -= self->queue_.front().size();
      self->queue_.pop_front();
      if (error) return self->gone();
      self->ask_whether_it_reads();
      if (!self->queue_.empty()) return self->write_next();
      if (self->closing_) self->end_socket();
    });
  }
  // Much lies between this socket and whoever reads: buffers of two kernels, of a browser's processes. A ping
  // is answered when all that was sent before it has been taken in, so one is always on its way while
  // something is sent.
  void ask_whether_it_reads() {
    if (asked_ || closing_) return;
    asked_ = true;
    asked_at_ = monotonic_now();
    ws_.async_ping({kAsked.data(), kAsked.size()},
                   [self = shared_from_this()](error_code) { /* a write or a read will say so, too */ });
  }
  void hear_pongs() {
    ws_.control_callback([this](websocket::frame_type kind, beast::string_view payload) {
      if (kind == websocket::frame_type::pong && view(payload) == kAsked) asked_ = false;
    });
  }
  void end_socket() {
    ws_.async_close({websocket::close_code::going_away, "run has ended"},
                    [self = shared_from_this()](error_code) { self->gone(); });
  }
  void gone() {
    if (std::exchange(gone_, true)) return;
    site_.open.erase(this);
    site_.hub->closed(*this);
    cut_off();
  }

  Site& site_;
  websocket::stream<beast::tcp_stream> ws_;  // its next layer speaks HTTP until the upgrade
  beast::flat_buffer buffer_{kMaxMessageBytes + Server::kMaxHeader};
  std::optional<http::request_parser<http::empty_body>> parser_;
  http::response<http::string_body> response_;
  std::deque<Outgoing> queue_;
  std::size_t backlog_ = 0;
  bool is_socket_ = false, gone_ = false, closing_ = false;
  bool asked_ = false;  ///< a ping was sent and is not answered
  MonotonicTime asked_at_;
};

void be_nicer() { (void)setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), 5); }

}  // namespace

struct Server::Impl {
  struct Repeated {
    Duration period;
    std::function<void()> what;
    asio::steady_timer timer;
  };
  explicit Impl(const std::string& name)
      : hub(name, std::to_string(realtime_now().ns()), [this](auto task, auto done) {
          executor->push([this, task = std::move(task), done = std::move(done)] {
            task();
            asio::post(context, done);
          });
        }) {}

  void accept() {
    acceptor.async_accept([this](error_code error, tcp::socket socket) {
      if (error == asio::error::operation_aborted || ended) return;
      if (!error && site.all.size() < kMaxConnections) {
        socket.set_option(tcp::no_delay(true), error);
        socket.set_option(asio::socket_base::send_buffer_size(kSendBuffer), error);
        std::make_shared<Connection>(std::move(socket), site)->read_request();
      }
      if (!error) return accept();
      // Too many open files, or a client that was gone again: a moment's rest, or this thread does nothing
      // else.
      rest.expires_after(std::chrono::milliseconds(100));
      rest.async_wait([this](error_code) { accept(); });
    });
  }
  void stop() {
    if (!thread.joinable()) return;
    context.stop();
    thread.join();
    executor.reset();  // what it is at comes to its end, and is told nobody
  }
  void repeat(const std::shared_ptr<Repeated>& r) {
    r->timer.expires_after(std::chrono::nanoseconds(r->period.ns()));
    r->timer.async_wait([this, r](error_code error) {
      if (error || ended) return;
      r->what();
      repeat(r);
    });
  }

  void look_for_end(asio::steady_timer& timer, std::chrono::steady_clock::time_point until,
                    std::promise<void>& gone) {
    if (site.open.empty() || std::chrono::steady_clock::now() >= until) {
      // Nothing runs from here on that would close them: who has not answered would wait for ever.
      for (Connection* c : site.all) c->cut_off();
      return gone.set_value();
    }
    timer.expires_after(std::chrono::milliseconds(10));
    timer.async_wait([this, &timer, until, &gone](error_code) { look_for_end(timer, until, gone); });
  }

  Site site;
  bool ended = false;  ///< nothing is repeated any more
  std::string address;
  std::unique_ptr<SerialExecutor> executor;
  Hub hub;
  asio::io_context context{1};
  asio::executor_work_guard<asio::io_context::executor_type> work{context.get_executor()};
  tcp::acceptor acceptor{context};
  asio::steady_timer rest{context};
  std::thread thread;
};

Server::Server(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

Result<std::unique_ptr<Server>> Server::open(const ServerOptions& options, const std::string& name) {
  if (auto s = check_token(options.endpoint, options.token); !s) return tl::unexpected<Error>(s.error());
  auto impl = std::make_unique<Impl>(name);
  impl->site.hub = &impl->hub;
  impl->site.token = options.token;
  impl->site.page_dir = options.page_dir;
  impl->site.loopback = options.endpoint.loopback();
  const tcp::endpoint endpoint(asio::ip::make_address(options.endpoint.address), options.endpoint.port);
  error_code error;
  tcp::acceptor& acceptor = impl->acceptor;
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(16, error);
  if (error)
    return fail(ErrorCode::bad_input, "--live",
                "expected an address of this machine and a port that is free, got " +
                    options.endpoint.address + ":" + std::to_string(options.endpoint.port) + ": " +
                    error.message() + "; give another port, or 0 for any");
  const std::string host =
      endpoint.address().is_v6() ? "[" + options.endpoint.address + "]" : options.endpoint.address;
  impl->address = "http://" + host + ":" + std::to_string(acceptor.local_endpoint().port()) + "/";
  if (options.token_in_url) impl->address += "?token=" + options.token;
  impl->executor = std::make_unique<SerialExecutor>();
  impl->executor->push(be_nicer);
  impl->accept();
  impl->thread = std::thread([i = impl.get()] {
    be_nicer();
    i->context.run();
  });
  return std::unique_ptr<Server>(new Server(std::move(impl)));
}

Server::~Server() { impl_->stop(); }

void Server::end(std::function<void()> last) {
  std::promise<void> gone;
  asio::steady_timer timer(impl_->context);
  post([&] {
    last();
    impl_->ended = true;
    impl_->acceptor.close();
    for (Connection* c : std::set(impl_->site.open)) c->say_goodbye();
    // Until the last one has answered, or for as long as one may wait for it.
    impl_->look_for_end(timer, std::chrono::steady_clock::now() + std::chrono::nanoseconds(kGoodbye.ns()),
                        gone);
  });
  gone.get_future().wait();
  impl_->stop();
}

std::string Server::url() const { return impl_->address; }
Hub& Server::hub() { return impl_->hub; }
void Server::post(std::function<void()> what) { asio::post(impl_->context, std::move(what)); }

void Server::run_there(std::function<void()> what) {
  std::promise<void> done;
  post([&] {
    what();
    done.set_value();
  });
  done.get_future().wait();
}

void Server::every(Duration period, std::function<void()> what) {
  post([this, period, what = std::move(what)]() mutable {
    impl_->repeat(std::make_shared<Impl::Repeated>(
        Impl::Repeated{period, std::move(what), asio::steady_timer(impl_->context)}));
  });
}

}  // namespace rigor::live
