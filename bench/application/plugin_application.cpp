#include "bench/application/plugin_application.h"

#include <dlfcn.h>

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "bench/application/process_protocol.h"
#include "bench/application/turn_application.h"

namespace rigor {
namespace application {
namespace {

class PluginHandler final : public TurnHandler {
 public:
  explicit PluginHandler(const PluginEntry* entry) : entry_(entry), answer_(kMaxCommandsBytes) {}
  ~PluginHandler() override {
    if (self_) entry_->destroy(self_);
  }

  Result<std::string> start(const std::string& setup) override {
    if (!self_) self_ = entry_->create();
    if (!self_) return fail(ErrorCode::unavailable, "", "the application could not be made");
    if (entry_->start(self_, setup.data(), setup.size(), answer_.data(), answer_.size(), &answered_) != 0)
      return tl::unexpected<Error>(said());
    return text();
  }
  std::optional<std::span<const std::byte>> turn(std::span<const std::byte> body) noexcept override {
    refused_ = entry_->turn(self_, reinterpret_cast<const char*>(body.data()), body.size(), answer_.data(),
                            answer_.size(), &answered_) != 0;
    if (refused_) return std::nullopt;
    return std::as_bytes(std::span<const char>(answer_)).first(std::min(answered_, answer_.size()));
  }
  Status finish() override {
    if (!refused_ && (!self_ || entry_->finish(self_, answer_.data(), answer_.size(), &answered_) == 0))
      return {};
    return tl::unexpected<Error>(said());
  }

 private:
  [[nodiscard]] std::string text() const { return {answer_.data(), std::min(answered_, answer_.size())}; }
  [[nodiscard]] Error said() const { return {ErrorCode::unavailable, "", "the application says: " + text()}; }

  const PluginEntry* entry_;
  void* self_ = nullptr;
  std::vector<char> answer_;
  std::size_t answered_ = 0;
  bool refused_ = false;
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
  return make_turn_application(rig, std::make_unique<application::PluginHandler>(entry));
}

}  // namespace rigor
