#include "bench/plant/fmu_process.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "bench/application/child_process.h"
#include "bench/files/installed_configs.h"
#include "bench/plant/fmu_protocol.h"
#include "sensor-hal/config/json_text.h"

namespace rigor::plant {
namespace {

using application::ChildProcess;
using application::MessageHeader;
using application::MessageType;
using nlohmann::json;

constexpr int kSlice_ms = 50;

class ProcessInstance final : public fmu::FmuInstance {
 public:
  ProcessInstance(ChildProcess child, std::string name, std::size_t inputs, std::size_t outputs,
                  const ProcessLimits& limits)
      : child_(std::move(child)),
        name_(std::move(name)),
        inputs_(inputs),
        outputs_(outputs),
        limits_(limits),
        request_(sizeof(MessageHeader) + sizeof(StepRequest) + inputs * sizeof(double)),
        answer_(sizeof(MessageHeader) +
                std::max(sizeof(StepAnswer) + outputs * sizeof(double), application::kMaxCommandsBytes)) {}
  ~ProcessInstance() override {
    // A process that failed ends by itself; another is asked to terminate its FMU.
    if (!failed_ && child_.send(MessageType::finish, json::object())) (void)child_.wait_for_death(seconds(1));
  }

  Status step(double t_s, double step_s, std::span<const double> inputs, bool inputs_changed,
              std::span<double> outputs) override {
    return ask({t_s, step_s, inputs_changed, 0, 0, 0}, inputs, outputs);
  }
  Status read(std::span<double> outputs) override {
    const std::vector<double> none(inputs_);
    return ask({0, 0, 0, 1, 0, 0}, none, outputs);
  }

 private:
  Status ask(StepRequest request, std::span<const double> inputs, std::span<double> outputs) {
    request.count = static_cast<std::uint32_t>(inputs_);
    const MessageHeader header{static_cast<std::uint32_t>(request_.size() - sizeof(MessageHeader)),
                               MessageType::turn};
    std::memcpy(request_.data(), &header, sizeof header);
    std::memcpy(request_.data() + sizeof header, &request, sizeof request);
    if (inputs_ > 0)
      std::memcpy(request_.data() + sizeof header + sizeof request, inputs.data(), inputs_ * sizeof(double));
    const MonotonicTime until = monotonic_now() + limits_.answer;
    if (auto s = send_all(until); !s) return s;
    return receive(until, request.t_s, outputs);
  }
  Status send_all(MonotonicTime until) {
    for (std::size_t sent = 0; sent < request_.size();) {
      const ssize_t n = ::send(child_.socket(), request_.data() + sent, request_.size() - sent, MSG_NOSIGNAL);
      if (n > 0) {
        sent += static_cast<std::size_t>(n);
        continue;
      }
      if (n < 0 && errno != EAGAIN && errno != EINTR) return gone();
      if (over(until)) return hangs();
      pollfd wait{child_.socket(), POLLOUT, 0};
      (void)poll(&wait, 1, kSlice_ms);
    }
    return {};
  }
  Status receive(MonotonicTime until, double t_s, std::span<double> outputs) {
    MessageHeader header;
    for (std::size_t got = 0;;) {
      const ssize_t n = ::recv(child_.socket(), answer_.data() + got, answer_.size() - got, 0);
      if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) return gone();
      if (n > 0) {
        got += static_cast<std::size_t>(n);
        if (got < sizeof header) continue;
        std::memcpy(&header, answer_.data(), sizeof header);
        if (header.size_bytes > answer_.size() - sizeof header) return broken();
        if (got < sizeof header + header.size_bytes) continue;
        return take(header, outputs);
      }
      if (over(until)) return hangs(t_s);
      pollfd wait{child_.socket(), POLLIN, 0};
      (void)poll(&wait, 1, kSlice_ms);
    }
  }
  Status take(const MessageHeader& header, std::span<double> outputs) {
    const std::byte* const body = answer_.data() + sizeof header;
    if (header.type == MessageType::failed) {
      failed_ = true;
      const auto text = parse_json({reinterpret_cast<const char*>(body), header.size_bytes}, name_);
      return fail(ErrorCode::protocol, name_, application::sentence_of(text.value_or(json())));
    }
    StepAnswer head;
    if (header.type != MessageType::commands || header.size_bytes != sizeof head + outputs_ * sizeof(double))
      return broken();
    std::memcpy(&head, body, sizeof head);
    if (head.count != outputs_) return broken();
    if (outputs_ > 0) std::memcpy(outputs.data(), body + sizeof head, outputs_ * sizeof(double));
    return {};
  }
  [[nodiscard]] bool interrupted() const { return limits_.interrupted && limits_.interrupted->load(); }
  [[nodiscard]] bool over(MonotonicTime until) const { return monotonic_now() > until || interrupted(); }
  Status gone() {
    failed_ = true;
    const auto how = child_.wait_for_death(seconds(1));
    return fail(ErrorCode::unavailable, name_,
                "the process of the FMU " + (how ? "ended: " + *how : std::string("closed its connection")));
  }
  Status hangs(double t_s = 0) {
    failed_ = true;
    child_.kill();
    return fail(
        ErrorCode::timeout, name_,
        fmt::format("the FMU gave no answer to the step from t = {:.9g} s within {:g} s, and was killed; see "
                    "`answer_timeout_s`",
                    t_s, limits_.answer.seconds()));
  }
  Status broken() {
    failed_ = true;
    child_.kill();
    return fail(ErrorCode::protocol, name_,
                "the process of the FMU sent an answer that makes no sense, and was killed");
  }

  ChildProcess child_;
  std::string name_;
  std::size_t inputs_, outputs_;
  ProcessLimits limits_;
  std::vector<std::byte> request_, answer_;
  bool failed_ = false;
};

}  // namespace

Result<std::unique_ptr<fmu::FmuInstance>> start_instance(const fmu::ModelDescription& description,
                                                         const fmu::InstanceSetup& setup,
                                                         const ProcessLimits& limits, StopToken stop) {
  const std::string program = installed_program().string();
  if (program.empty())
    return fail(ErrorCode::not_found, setup.name,
                "expected the program `rigor`, in whose process an FMU runs, in the prefix of this library, "
                "found none; "
                "install it, or set `sandbox: false`");
  ChildProcess::Command command;
  command.words = {program, "fmu-host"};
  command.directory = setup.folder;
  command.where = setup.name;
  command.who = "the process of the FMU";
  command.reads_samples = false;
  auto child = ChildProcess::start(command, limits.start, stop);
  if (!child) return tl::unexpected<Error>(child.error());
  const json text{{"name", setup.name},
                  {"folder", setup.folder.string()},
                  {"start_time_s", setup.start_time_s},
                  {"start_values", setup.start_values},
                  {"inputs", setup.inputs},
                  {"outputs", setup.outputs}};
  if (auto s = child->send(MessageType::setup, text); !s) return tl::unexpected<Error>(s.error());
  const auto ready = child->receive(MessageType::ready, limits.start, stop);
  if (!ready) return tl::unexpected<Error>(ready.error());
  return std::unique_ptr<fmu::FmuInstance>(std::make_unique<ProcessInstance>(
      std::move(*child), setup.name, fmu::values_of(description, setup.inputs),
      fmu::values_of(description, setup.outputs), limits));
}

}  // namespace rigor::plant
