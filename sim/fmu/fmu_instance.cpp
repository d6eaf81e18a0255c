#include "sim/fmu/fmu_instance.h"

#include <dlfcn.h>

#include <algorithm>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>

#include "sim/fmu/fmi_api.h"
#include "sim/fmu/variable_access.h"

namespace rigor::fmu {
namespace {

/// Of events at one instant, and of early returns in one step: more are taken for a loop without end.
constexpr int kMostIterations = 1000;
constexpr int kMostLines = 20;  ///< of an FMU's log that are printed

constexpr const char* kStatusNames[] = {"OK", "Warning", "Discard", "Error", "Fatal", "Pending"};

class Loaded : public FmuInstance {
 public:
  Loaded(const ModelDescription& description, const InstanceSetup& setup)
      : description_(description), name_(setup.name) {}
  ~Loaded() override {
    if (library_ && !dead_) dlclose(library_);  // after Fatal nothing of it may be called, not even to leave
  }
  Loaded(const Loaded&) = delete;
  Loaded& operator=(const Loaded&) = delete;

  Status open(const InstanceSetup& setup) {
    const auto binary = binary_of(setup.folder, description_);
    if (!binary) return tl::unexpected<Error>(binary.error());
    library_ = dlopen(binary->c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!library_) {
      const char* const why = dlerror();
      return fail(ErrorCode::unavailable, name_,
                  std::string("the FMU cannot be loaded: ") + (why ? why : "?"));
    }
    if (auto s = instantiate(setup); !s) return s;
    for (const auto& [variable, text] : setup.start_values) {
      const auto found = description_.find(variable);
      if (!found) return fail(ErrorCode::bad_input, name_, "there is no variable " + variable);
      if (auto s = set_start(found->variable, text); !s) return s;
    }
    if (auto s = make_access(setup); !s) return s;
    return initialise(setup);
  }

  Status read(std::span<double> outputs) override {
    return good(outputs_.get(instance_, outputs), "Get…", t_s_);
  }

  /// What the FMU says.
  void log(int status, const char* category, const char* message) noexcept {
    if (status <= kFmiOk || !message) return;
    std::snprintf(said_, sizeof said_, "%s", message);
    if (lines_ > kMostLines) return;
    std::fprintf(stderr, "rigor: FMU %s: %s (%s%s)\n", name_.c_str(),
                 lines_ == kMostLines ? "says more, which is not printed" : said_,
                 status <= kFmiPending ? kStatusNames[status] : "?",
                 category && *category ? (std::string(", ") + category).c_str() : "");
    ++lines_;
  }

 protected:
  virtual Status instantiate(const InstanceSetup& setup) = 0;
  virtual Status initialise(const InstanceSetup& setup) = 0;
  virtual Status set_start(std::size_t variable, const std::string& text) {
    const auto status = set_from_text(
        description_, variable, text, instance_, [this](const std::string& f) { return find(f); }, name_);
    if (!status) return tl::unexpected<Error>(status.error());
    return good(*status, ("Set… of " + description_.variables[variable].name).c_str(), t_s_);
  }

  [[nodiscard]] std::string prefix() const {
    return description_.version == FmiVersion::v2 ? "fmi2" : "fmi3";
  }
  void* find(const std::string& function) const { return dlsym(library_, (prefix() + function).c_str()); }
  template <class F>
  Status need(F& out, const char* function) {
    out = reinterpret_cast<F>(find(function));
    if (out) return {};
    return fail(ErrorCode::unavailable, name_, "the FMU has no function " + prefix() + function);
  }
  /// Calls one with no arguments but the instance.
  Status call(const char* function) {
    FmiPlain f = nullptr;
    if (auto s = need(f, function); !s) return s;
    return good(f(instance_), function, t_s_);
  }
  /// An error for a status that is none of OK and Warning.
  Status good(int status, const char* function, double t_s) {
    if (status == kFmiOk || status == kFmiWarning) return {};
    if (status == kFmiFatal) dead_ = true;
    failed_ = true;
    char at[64];
    std::snprintf(at, sizeof at, " at t = %.9g s", t_s);
    std::string message =
        prefix() + function + " returned " + prefix() +
        (status >= 0 && status <= kFmiPending ? kStatusNames[status] : "a status that FMI has not") + at;
    if (said_[0]) message += std::string(": ") + said_;
    return fail(ErrorCode::protocol, name_, std::move(message));
  }
  Status ended() {
    char at[96];
    std::snprintf(at, sizeof at, "the FMU ended the simulation by itself at t = %.9g s", t_s_);
    return fail(ErrorCode::protocol, name_, at);
  }
  /// Terminates what runs, and frees it.
  void end() noexcept {
    if (!instance_ || dead_) return;
    if (initialised_ && !failed_)
      if (const auto f = reinterpret_cast<FmiPlain>(find("Terminate"))) (void)f(instance_);
    if (const auto f = reinterpret_cast<FmiFreeInstance>(find("FreeInstance"))) f(instance_);
    instance_ = nullptr;
  }

  ModelDescription description_;
  std::string name_;
  void* library_ = nullptr;
  void* instance_ = nullptr;
  bool initialised_ = false, failed_ = false, dead_ = false;
  bool ended_ = false;  ///< the FMU has ended the simulation: what it has reached is its last state
  double t_s_ = 0;
  VariableAccess continuous_, discrete_, outputs_;  ///< inputs by their variability
  std::vector<double> last_inputs_;
  char said_[512] = "";
  int lines_ = 0;

 private:
  Status make_access(const InstanceSetup& setup) {
    std::vector<VariableAccess::Entry> continuous, discrete, outputs;
    std::size_t at = 0;
    for (const std::size_t v : setup.inputs) {
      const Variability w = description_.variables[v].variability;
      const bool event = w == Variability::discrete || w == Variability::tunable;
      (event ? discrete : continuous).push_back({v, at});
      at += description_.variables[v].elements;
    }
    last_inputs_.assign(at, std::nan(""));
    at = 0;
    for (const std::size_t v : setup.outputs) {
      outputs.push_back({v, at});
      at += description_.variables[v].elements;
    }
    const auto finder = [this](const std::string& f) { return find(f); };
    const auto make = [&](VariableAccess& out, const std::vector<VariableAccess::Entry>& entries,
                          bool get) -> Status {
      auto made = VariableAccess::make(description_, entries, finder, get, name_);
      if (!made) return tl::unexpected<Error>(made.error());
      out = std::move(*made);
      return {};
    };
    if (auto s = make(continuous_, continuous, false); !s) return s;
    if (auto s = make(discrete_, discrete, false); !s) return s;
    return make(outputs_, outputs, true);
  }
};

// ------------------------------------------------------------------ FMI 2.0

/// FMI 2.0.4, 2.1.5: the message is a format for printf.
void log2(void* environment, const char*, int status, const char* category, const char* message, ...) {
  char text[512] = "";
  va_list arguments;
  va_start(arguments, message);
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wformat-nonliteral"
  if (message) std::vsnprintf(text, sizeof text, message, arguments);
#pragma GCC diagnostic pop
  va_end(arguments);
  if (environment) static_cast<Loaded*>(environment)->log(status, category, text);
}

/// A path as a URI: characters that have a meaning there are written as %xx.
std::string file_uri(const std::string& path) {
  std::string uri = "file://";
  for (const char c : path) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                       c == '/' || c == '-' || c == '_' || c == '.' || c == '~';
    char code[4];
    std::snprintf(code, sizeof code, "%%%02X", static_cast<unsigned char>(c));
    uri += plain ? std::string(1, c) : code;
  }
  return uri;
}

class Loaded2 final : public Loaded {
 public:
  using Loaded::Loaded;
  ~Loaded2() override { end(); }

  Status step(double t_s, double step_s, std::span<const double> inputs, bool inputs_changed,
              std::span<double> outputs) override {
    if (ended_) return ended();
    if (inputs_changed) {
      if (auto s = good(continuous_.set(instance_, inputs), "Set…", t_s); !s) return s;
      if (auto s = good(discrete_.set(instance_, inputs), "Set…", t_s); !s) return s;
    }
    const int status = do_step_(instance_, t_s, step_s, 1);
    t_s_ = t_s + step_s;
    // An FMU that ends the simulation discards the step, and says so when it is asked (FMI 2.0.4, 4.2.2).
    int terminated = 0;
    if (status == kFmiDiscard && get_status_ &&
        get_status_(instance_, kFmi2Terminated, &terminated) == kFmiOk && terminated)
      ended_ = true;
    else if (auto s = good(status, "DoStep", t_s); !s)
      return s;
    return read(outputs);
  }

 private:
  Status instantiate(const InstanceSetup& setup) override {
    Fmi2Instantiate make = nullptr;
    if (auto s = need(make, "Instantiate"); !s) return s;
    if (auto s = need(do_step_, "DoStep"); !s) return s;
    get_status_ = reinterpret_cast<Fmi2GetBooleanStatus>(find("GetBooleanStatus"));
    callbacks_ = {log2, std::calloc, std::free, nullptr, this};
    instance_ = make(name_.c_str(), kFmi2CoSimulation, description_.token.c_str(),
                     file_uri((setup.folder / "resources").string()).c_str(), &callbacks_, 0, 0);
    if (instance_) return {};
    return fail(ErrorCode::protocol, name_,
                std::string("fmi2Instantiate returned no instance") + (said_[0] ? ": " : "") + said_);
  }
  Status initialise(const InstanceSetup& setup) override {
    t_s_ = setup.start_time_s;
    Fmi2SetupExperiment experiment = nullptr;
    if (auto s = need(experiment, "SetupExperiment"); !s) return s;
    if (auto s = good(experiment(instance_, 0, 0, t_s_, 0, 0), "SetupExperiment", t_s_); !s) return s;
    if (auto s = call("EnterInitializationMode"); !s) return s;
    if (auto s = call("ExitInitializationMode"); !s) return s;
    initialised_ = true;
    return {};
  }

  Fmi2DoStep do_step_ = nullptr;
  Fmi2GetBooleanStatus get_status_ = nullptr;  ///< null: it has none
  Fmi2Callbacks callbacks_{};
};

// ------------------------------------------------------------------ FMI 3.0

void log3(void* environment, int status, const char* category, const char* message) {
  if (environment) static_cast<Loaded*>(environment)->log(status, category, message);
}

class Loaded3 final : public Loaded {
 public:
  using Loaded::Loaded;
  ~Loaded3() override { end(); }

  Status step(double t_s, double step_s, std::span<const double> inputs, bool inputs_changed,
              std::span<double> outputs) override {
    if (ended_) return ended();
    t_s_ = t_s;
    if (inputs_changed)
      if (auto s = set_inputs(inputs); !s) return s;
    const double end_s = t_s + step_s;
    for (int i = 0;; ++i) {
      if (i == kMostIterations)
        return fail(ErrorCode::protocol, name_,
                    "fmi3DoStep returned early " + std::to_string(kMostIterations) + " times in one step");
      bool event = false, terminate = false, early = false;
      double reached_s = t_s_;
      // After an early return, what is left.
      const double piece_s = i == 0 ? step_s : end_s - t_s_;
      if (auto s = good(do_step_(instance_, t_s_, piece_s, true, &event, &terminate, &early, &reached_s),
                        "DoStep", t_s_);
          !s)
        return s;
      ended_ |= terminate;
      t_s_ = early ? std::min(reached_s, end_s) : end_s;
      if (ended_) {
        return read(outputs);
      }
      if (event_mode_ && (event || early)) {
        if (auto s = call("EnterEventMode"); !s) return s;
        if (auto s = leave_event_mode(); !s) return s;
      }
      if (!early || end_s - t_s_ <= 1e-12 * std::max(1.0, std::abs(end_s))) break;
    }
    t_s_ = end_s;
    return read(outputs);
  }

 private:
  Status instantiate(const InstanceSetup& setup) override {
    Fmi3InstantiateCoSimulation make = nullptr;
    if (auto s = need(make, "InstantiateCoSimulation"); !s) return s;
    if (auto s = need(do_step_, "DoStep"); !s) return s;
    event_mode_ = description_.co_simulation->event_mode;
    instance_ = make(name_.c_str(), description_.token.c_str(), (setup.folder / "resources/").c_str(), false,
                     false, event_mode_, event_mode_, nullptr, 0, this, log3, nullptr);
    if (!instance_)
      return fail(
          ErrorCode::protocol, name_,
          std::string("fmi3InstantiateCoSimulation returned no instance") + (said_[0] ? ": " : "") + said_);
    // Structural parameters come first, and in a mode of their own.
    bool configures = false;
    for (const auto& [variable, text] : setup.start_values) {
      const auto found = description_.find(variable);
      if (!found || description_.variables[found->variable].causality != Causality::structural_parameter)
        continue;
      if (!configures)
        if (auto s = call("EnterConfigurationMode"); !s) return s;
      configures = true;
      if (auto s = Loaded::set_start(found->variable, text); !s) return s;
    }
    return configures ? call("ExitConfigurationMode") : Status{};
  }
  Status set_start(std::size_t variable, const std::string& text) override {
    if (description_.variables[variable].causality == Causality::structural_parameter) return {};
    return Loaded::set_start(variable, text);
  }
  Status initialise(const InstanceSetup& setup) override {
    t_s_ = setup.start_time_s;
    Fmi3EnterInitializationMode enter = nullptr;
    if (auto s = need(enter, "EnterInitializationMode"); !s) return s;
    if (auto s = good(enter(instance_, false, 0, t_s_, false, 0), "EnterInitializationMode", t_s_); !s)
      return s;
    if (auto s = call("ExitInitializationMode"); !s) return s;
    initialised_ = true;
    return event_mode_ ? leave_event_mode() : Status{};  // it is in Event Mode now (FMI 3.0.2, 4.2.1)
  }
  /// With Event Mode in use, discrete inputs change in it alone (FMI 3.0.2, 4.2.4).
  Status set_inputs(std::span<const double> inputs) {
    if (auto s = good(continuous_.set(instance_, inputs), "Set…", t_s_); !s) return s;
    if (discrete_.empty() || !discrete_.differ(inputs, last_inputs_)) return {};
    last_inputs_.assign(inputs.begin(), inputs.end());
    if (event_mode_)
      if (auto s = call("EnterEventMode"); !s) return s;
    if (auto s = good(discrete_.set(instance_, inputs), "Set…", t_s_); !s) return s;
    return event_mode_ ? leave_event_mode() : Status{};
  }
  Status leave_event_mode() {
    Fmi3UpdateDiscreteStates update = nullptr;
    if (auto s = need(update, "UpdateDiscreteStates"); !s) return s;
    for (int i = 0;; ++i) {
      if (i == kMostIterations)
        return fail(ErrorCode::protocol, name_,
                    "fmi3UpdateDiscreteStates asked for another iteration " +
                        std::to_string(kMostIterations) + " times at one instant");
      bool again = false, terminate = false, nominals = false, states = false, next_defined = false;
      double next_s = 0;
      if (auto s = good(update(instance_, &again, &terminate, &nominals, &states, &next_defined, &next_s),
                        "UpdateDiscreteStates", t_s_);
          !s)
        return s;
      ended_ |= terminate;
      if (!again || ended_) return call("EnterStepMode");
    }
  }
  Fmi3DoStep do_step_ = nullptr;
  bool event_mode_ = false;
};

}  // namespace

std::size_t values_of(const ModelDescription& description, std::span<const std::size_t> variables) {
  std::size_t count = 0;
  for (const std::size_t v : variables) count += description.variables[v].elements;
  return count;
}

Result<std::unique_ptr<FmuInstance>> load_instance(const ModelDescription& description,
                                                   const InstanceSetup& setup) {
  std::unique_ptr<Loaded> instance;
  if (description.version == FmiVersion::v2)
    instance = std::make_unique<Loaded2>(description, setup);
  else
    instance = std::make_unique<Loaded3>(description, setup);
  if (auto s = instance->open(setup); !s) return tl::unexpected<Error>(s.error());
  return std::unique_ptr<FmuInstance>(std::move(instance));
}

}  // namespace rigor::fmu
