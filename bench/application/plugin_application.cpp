#include "bench/application/plugin_application.h"

#include <dlfcn.h>

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bench/application/setup_message.h"
#include "bench/application/turns.h"
#include "sensor-hal/config/json_text.h"

namespace rigor {
namespace application {
namespace {

constexpr std::size_t kRoom = std::size_t{1} << 20;  ///< of a turn's samples

class PluginApplication final : public Application {
 public:
  PluginApplication(const RigConfig& rig, const PluginEntry* entry) : rig_(rig), entry_(entry) {}
  ~PluginApplication() override {
    if (self_) entry_->destroy(self_);
  }

  Status configure(ConfigNode params, const ApplicationPorts& ports, Period loop_period) override {
    double rate_hz = 0;
    nlohmann::json own;
    const auto read = catch_config([&] {
      where_ = params.error("library", "").error().where;
      (void)params.text("library");
      rate_hz = params.number_or("rate_hz", 0, {.min = 0.001, .max = loop_period.hz()});
      own = nlohmann::json::parse(params.map_or_absent("params").json());
      params.finish();
      return 0;
    });
    if (!read) return tl::unexpected<Error>(read.error());
    turns_.emplace(ports, kRoom, [](const Sample& sample) noexcept {
      return static_cast<std::uint64_t>(reinterpret_cast<std::uintptr_t>(sample.bytes().data()));
    });
    answer_.resize(kMaxCommandsBytes);
    if (!self_) self_ = entry_->create();
    if (!self_) return fail(ErrorCode::unavailable, where_, "the application could not be made");
    const std::string setup = setup_message(rig_, ports, loop_period, own)
                                  .dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
    if (entry_->start(self_, setup.data(), setup.size(), answer_.data(), answer_.size(), &answered_) != 0)
      return fail(ErrorCode::unavailable, where_, "the application says: " + text());
    const auto ready = parse_json(text()).value_or(nlohmann::json());  // it need not say anything
    const auto rate = rate_of_turns(rate_hz, ready, loop_period, where_);
    if (!rate) return tl::unexpected<Error>(rate.error());
    every_ = cycles_of_turn(*rate, loop_period);
    return {};
  }

  void step(std::uint64_t cycle, BenchTime t) noexcept override {
    if (failed_) return;
    turns_->collect();
    if (cycle % every_ != 0) return;
    const auto bytes = turns_->make(cycle, t).subspan(sizeof(MessageHeader));
    const MonotonicTime began = monotonic_now();
    refused_ = entry_->turn(self_, reinterpret_cast<const char*>(bytes.data()), bytes.size(), answer_.data(),
                            answer_.size(), &answered_) != 0;
    turns_->given();
    turns_->facts.answer.record(monotonic_now() - began);
    const auto answer =
        std::as_bytes(std::span<const char>(answer_)).first(std::min(answered_, answer_.size()));
    failed_ = refused_ || !turns_->is_answer(answer, cycle);
    if (failed_) return;
    ++turns_->facts.answered;
    turns_->command(answer, t);
  }

  Status finish() override {
    if (!turns_) return {};
    turns_->end();
    if (refused_) return fail(ErrorCode::unavailable, where_, "the application says: " + text());
    if (failed_)
      return fail(ErrorCode::protocol, where_,
                  "the application gave an answer that the protocol does not know");
    if (self_ && entry_->finish(self_, answer_.data(), answer_.size(), &answered_) != 0)
      return fail(ErrorCode::unavailable, where_, "the application says: " + text());
    return {};
  }
  bool failed() const noexcept override { return failed_; }
  std::optional<ApplicationFacts> facts() const override {
    return turns_ ? std::optional(turns_->facts) : std::nullopt;
  }

 private:
  [[nodiscard]] std::string text() const { return {answer_.data(), std::min(answered_, answer_.size())}; }

  const RigConfig& rig_;
  const PluginEntry* entry_;
  void* self_ = nullptr;
  std::string where_;
  std::optional<Turns> turns_;
  std::vector<char> answer_;
  std::size_t answered_ = 0;
  std::uint64_t every_ = 1;
  bool refused_ = false, failed_ = false;
};

}  // namespace
}  // namespace application

Result<std::unique_ptr<Application>> make_plugin_application(const RigConfig& rig) {
  const ConfigNode& n = rig.application_params;
  const std::string name = n.text("library");
  const auto refuse = [&](const std::string& what) {
    return tl::unexpected<Error>(n.error("library", what).error());
  };
  const std::filesystem::path file = n.base_dir() / name;
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error))
    return refuse("expected a shared object, found no file " + file.string());
  // It stays loaded: threads that it made may outlive the run.
  void* library = dlopen(std::filesystem::absolute(file).c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  if (!library) {
    const char* why = dlerror();
    return refuse(std::string("expected a shared object that can be loaded: ") +
                  (why ? why : "unknown reason"));
  }
  using Entry = const application::PluginEntry* (*)();
  const auto entry_of = reinterpret_cast<Entry>(dlsym(library, "rigor_application"));
  if (!entry_of)
    return refuse(
        "expected a shared object with the symbol rigor_application (RIGOR_APPLICATION of rigor_client.h), "
        "found none in " +
        file.string());
  const application::PluginEntry* entry = entry_of();
  if (!entry || entry->protocol != application::kProtocolVersion || entry->size < sizeof *entry)
    return refuse("expected an application of protocol " + std::to_string(application::kProtocolVersion) +
                  ", got one of " + (entry ? std::to_string(entry->protocol) : "none") +
                  "; build it with the rigor_client.h of this version of Rigor");
  return std::make_unique<application::PluginApplication>(rig, entry);
}

}  // namespace rigor
