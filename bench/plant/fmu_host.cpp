#include "bench/plant/fmu_host.h"

#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/application/process_protocol.h"
#include "bench/plant/fmu_protocol.h"
#include "sensor-hal/config/json_text.h"
#include "sim/fmu/fmu_instance.h"

namespace rigor::plant {
namespace {

using application::MessageHeader;
using application::MessageType;
using nlohmann::json;

class Connection {
 public:
  ~Connection() {
    if (fd_ >= 0) ::close(fd_);
  }
  bool open(const char* path) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    if (!path || std::strlen(path) >= sizeof address.sun_path) return false;
    std::strcpy(address.sun_path, path);
    fd_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    return fd_ >= 0 && ::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  }
  /// False: the bench is gone.
  bool send(MessageType type, const void* body, std::size_t size) {
    message_.resize(sizeof(MessageHeader) + size);
    const MessageHeader header{static_cast<std::uint32_t>(size), type};
    std::memcpy(message_.data(), &header, sizeof header);
    if (size > 0) std::memcpy(message_.data() + sizeof header, body, size);
    for (std::size_t sent = 0; sent < message_.size();) {
      const ssize_t n = ::send(fd_, message_.data() + sent, message_.size() - sent, MSG_NOSIGNAL);
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return false;
      sent += static_cast<std::size_t>(n);
    }
    return true;
  }
  bool send(MessageType type, const json& text) {
    const std::string body = text.dump(-1, ' ', false, json::error_handler_t::replace);
    return send(type, body.data(), body.size());
  }
  bool receive(MessageHeader& header, std::vector<std::byte>& body) {
    if (!take(&header, sizeof header) ||
        header.size_bytes > sizeof(StepRequest) + kMaxStepValues * sizeof(double))
      return false;
    body.resize(header.size_bytes);
    return take(body.data(), body.size());
  }

 private:
  bool take(void* out, std::size_t size) {
    for (std::size_t got = 0; got < size;) {
      const ssize_t n = ::recv(fd_, static_cast<std::byte*>(out) + got, size - got, 0);
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return false;
      got += static_cast<std::size_t>(n);
    }
    return true;
  }
  int fd_ = -1;
  std::vector<std::byte> message_;
};

struct Hosted {
  std::unique_ptr<fmu::FmuInstance> instance;
  std::size_t inputs = 0, outputs = 0;
};

Result<Hosted> make(std::string_view text) {
  const auto setup = parse_json(text, "setup");
  if (!setup) return tl::unexpected<Error>(setup.error());
  fmu::InstanceSetup s;
  try {
    s.name = setup->at("name").get<std::string>();
    s.folder = setup->at("folder").get<std::string>();
    s.start_time_s = setup->at("start_time_s").get<double>();
    s.start_values = setup->at("start_values").get<fmu::StartValues>();
    s.inputs = setup->at("inputs").get<std::vector<std::size_t>>();
    s.outputs = setup->at("outputs").get<std::vector<std::size_t>>();
  } catch (const json::exception& e) {
    return fail(ErrorCode::protocol, "setup", e.what());
  }
  auto description = fmu::read_description(s.folder);
  if (!description) return tl::unexpected<Error>(description.error());
  if (auto applied = fmu::apply_start_values(*description, s.start_values, s.name); !applied)
    return tl::unexpected<Error>(applied.error());
  for (const auto& list : {s.inputs, s.outputs})
    for (const std::size_t v : list)
      if (v >= description->variables.size())
        return fail(ErrorCode::protocol, "setup", "a variable that does not exist");
  Hosted hosted;
  hosted.inputs = fmu::values_of(*description, s.inputs);
  hosted.outputs = fmu::values_of(*description, s.outputs);
  auto instance = fmu::load_instance(*description, s);
  if (!instance) return tl::unexpected<Error>(instance.error());
  hosted.instance = std::move(*instance);
  return hosted;
}

bool refuse(Connection& connection, const Error& error) {
  return connection.send(MessageType::failed, json{{"error", error.message}});
}

}  // namespace

int host_fmu() {
  const rlimit no_core{0, 0};
  (void)setrlimit(RLIMIT_CORE, &no_core);  // a crash is an ordinary end here
  Connection connection;
  if (!connection.open(std::getenv("RIGOR_SOCKET"))) {
    std::fputs(
        "rigor fmu-host: expected RIGOR_SOCKET to name a socket of a run, which starts this command itself\n",
        stderr);
    return 2;
  }
  if (!connection.send(MessageType::hello, json{{"protocol", application::kProtocolVersion}})) return 1;
  MessageHeader header;
  std::vector<std::byte> body;
  if (!connection.receive(header, body) || header.type != MessageType::setup) return 1;
  auto hosted = make({reinterpret_cast<const char*>(body.data()), body.size()});
  if (!hosted) return refuse(connection, hosted.error()) ? 0 : 1;
  if (!connection.send(MessageType::ready, json::object())) return 1;

  std::vector<double> inputs(hosted->inputs);
  std::vector<std::byte> answer(sizeof(StepAnswer) + hosted->outputs * sizeof(double));
  const StepAnswer head{static_cast<std::uint32_t>(hosted->outputs), 0};
  std::memcpy(answer.data(), &head, sizeof head);
  std::vector<double> outputs(hosted->outputs);
  while (connection.receive(header, body)) {
    if (header.type == MessageType::finish) {
      hosted->instance.reset();
      return connection.send(MessageType::done, json::object()) ? 0 : 1;
    }
    StepRequest request;
    if (header.type != MessageType::turn || body.size() < sizeof request) return 1;
    std::memcpy(&request, body.data(), sizeof request);
    if (request.count != inputs.size() || body.size() != sizeof request + inputs.size() * sizeof(double))
      return 1;
    std::memcpy(inputs.data(), body.data() + sizeof request, inputs.size() * sizeof(double));
    const Status s = request.read_only ? hosted->instance->read(outputs)
                                       : hosted->instance->step(request.t_s, request.step_s, inputs,
                                                                request.inputs_changed != 0, outputs);
    if (!s) {
      (void)refuse(connection, s.error());
      return 0;
    }
    std::memcpy(answer.data() + sizeof head, outputs.data(), outputs.size() * sizeof(double));
    if (!connection.send(MessageType::commands, answer.data(), answer.size())) return 1;
  }
  return 0;  // the bench is gone
}

}  // namespace rigor::plant
