// Rigs: a Bench, stepped or run, with its ports between the steps.
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>

#include "bench/application/setup_message.h"
#include "bench/application/turn_application.h"
#include "bench/bench.h"
#include "bench/live/server.h"
#include "builtin/registry.h"
#include "python/application.h"
#include "python/errors.h"
#include "python/interruptible.h"
#include "python/module.h"
#include "python/rig_options.h"
#include "python/samples.h"
#include "rt-core/affinity.h"
#include "rt-core/realtime_setup.h"

namespace rigor::python {
namespace {

/// A report, with all that is asked of it made when the run ends.
struct Report {
  std::string json, text, verdict;
  bool passed = false, ended_well = false;
  std::filesystem::path page, recording;
  std::vector<std::string> warnings, errors;
};

Report report_of(const RunReport& r) {
  Report report{r.json(),    r.text(),       name_of(r.verdict.worst()),
                r.passed(),  r.ended_well(), r.page,
                r.recording, r.warnings,     {}};
  for (const Error& e : r.errors) report.errors.push_back(e.text());
  if (!r.replay_difference.empty()) report.errors.push_back(r.replay_difference);
  return report;
}

class Rig {
 public:
  Rig(const std::string& file, const py::dict& options, const py::object& application) {
    RigOptions given(options);
    RigConfig rig = value_of(given.load(file));
    Registry registry = make_registry();
    if (!application.is_none()) {
      // The rig as the application's setup message describes it; the bench has its own copy.
      rig_config_ = std::make_shared<RigConfig>(rig);
      calls_ = std::make_shared<ApplicationCalls>(application);
      registry.add(NamedApplication{rig.application, [config = rig_config_, calls = calls_] {
                                      return make_turn_application(*config, python_handler(calls));
                                    }});
    }
    BenchOptions how = value_of(given.bench_options());
    if (given.live) {
      RealtimeConfig loop;
      loop.cpu = rig.loop.cpu < 0 ? RealtimeConfig::kAutoCpu : rig.loop.cpu;
      const AvoidCpu rest(rig.clock == ClockKind::virtual_time ? -1 : loop_cpu(loop));
      auto endpoint = value_of(live::parse_endpoint(*given.live));
      live::ServerOptions server;
      server.endpoint = endpoint;
      live_ = value_of(live::Server::open(server, rig.name));
      how.live = live_.get();
    }
    how.on_warning = [this](const std::string& text) { warnings_.push_back(text); };
    virtual_time_ = rig.clock == ClockKind::virtual_time;
    Result<std::unique_ptr<Bench>> bench = [&] {
      const py::gil_scoped_release without_gil;
      return Bench::create(std::move(rig), registry, std::move(how));
    }();
    bench_ = value_of(std::move(bench));
  }
  ~Rig() { close(); }
  Rig(const Rig&) = delete;
  Rig& operator=(const Rig&) = delete;

  void prepare() {
    if (!worker_) worker_ = std::make_unique<Worker>();
    const Status prepared = interruptible(
        *worker_, [this](StopToken stop) { return bench_->prepare(stop); }, [] {});
    if (!prepared) rethrow_application();
    check(prepared);
    inputs_.clear();
    for (const auto& [name, input] : bench_->ports().inputs) inputs_.push_back(&input);
  }
  void start() {
    const Status started = [&] {
      const py::gil_scoped_release without_gil;
      return bench_->start();
    }();
    check(started);
  }

  /// False: the run is over. Looks for Ctrl-C a few times a second.
  bool step(std::uint64_t cycles) {
    require_open();
    while (cycles > 0) {
      const std::uint64_t n = std::min(cycles, at_once_);
      const MonotonicTime began = monotonic_now();
      Result<bool> more = [&] {
        const py::gil_scoped_release without_gil;
        return bench_->step(n, stop_.token());
      }();
      if (!value_of(std::move(more))) {
        rethrow_application();
        return false;
      }
      cycles -= n;
      const Duration took = monotonic_now() - began;
      if (took < milliseconds(20) && n == at_once_)
        at_once_ = std::min<std::uint64_t>(at_once_ * 2, 1u << 16);
      if (took > milliseconds(100)) at_once_ = std::max<std::uint64_t>(at_once_ / 2, 1);
      if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    }
    return true;
  }

  /// In wall-clock time; `progress(cycle)` a few times a second.
  Report run(const py::object& progress) {
    require_open();
    if (!worker_) worker_ = std::make_unique<Worker>();
    Result<RunReport> report = interruptible(
        *worker_, [this](StopToken stop) { return bench_->run(stop); },
        [&] {
          if (!progress.is_none()) progress(bench_->cycle());
        });
    rethrow_application();
    return report_of(value_of(std::move(report)));
  }
  Report finish() {
    require_open();
    Result<RunReport> report = [&] {
      const py::gil_scoped_release without_gil;
      return bench_->finish();
    }();
    rethrow_application();
    return report_of(value_of(std::move(report)));
  }
  void request_stop() { stop_.request(); }
  void close() {
    inputs_.clear();
    {
      const py::gil_scoped_release without_gil;
      bench_.reset();
      live_.reset();
      worker_.reset();
    }
  }

  [[nodiscard]] std::string setup() {
    require_open();
    return setup_text(bench_->rig(), bench_->ports());
  }
  [[nodiscard]] std::uint32_t status(std::size_t input) const {
    return static_cast<std::uint32_t>(port(input).status());
  }
  /// Sequence of the visible sample; −1: none.
  [[nodiscard]] std::int64_t sequence(std::size_t input) const {
    const SampleLease& sample = port(input).sample();
    return sample ? static_cast<std::int64_t>(sample->stamp.sequence) : -1;
  }
  /// Record and content, copied; None: no sample is visible.
  [[nodiscard]] py::object sample(std::size_t input) const {
    const SampleLease& sample = port(input).sample();
    if (!sample) return py::none();
    const auto bytes = sample->bytes();
    return py::make_tuple(sample_record(*sample),
                          py::bytes(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
  }
  void command(const std::string& sink, const std::vector<double>& values) {
    require_open();
    check(bench_->command(sink, values));
  }
  void fault(const std::string& channel, const std::string& fault) {
    require_open();
    check(bench_->inject_fault(channel, fault));
  }
  void clear_faults(const std::string& channel) {
    require_open();
    check(bench_->clear_faults(channel));
  }
  void switch_pair(const std::string& channel, const std::string& active) {
    require_open();
    check(bench_->switch_pair(channel, active));
  }
  [[nodiscard]] py::list expected() const {
    require_open();
    py::list all;
    for (const Expected& e : bench_->expected()) {
      py::dict d;
      d["of"] = e.of;
      d["quantity"] = e.quantity;
      d["bounds"] = e.bounds;
      d["state"] = e.state();
      d["sentence"] = e.sentence();
      d["looked_at"] = e.looked_at;
      d["outside"] = e.outside;
      d["first_s"] = e.first_s;
      if (e.looked_at > 0) {
        d["minimum"] = e.minimum;
        d["maximum"] = e.maximum;
      }
      all.append(std::move(d));
    }
    return all;
  }
  [[nodiscard]] std::uint64_t cycle() const { return bench_ ? bench_->cycle() : 0; }
  [[nodiscard]] bool virtual_time() const { return virtual_time_; }
  [[nodiscard]] std::vector<std::string> take_warnings() { return std::exchange(warnings_, {}); }
  [[nodiscard]] std::string live_url() const { return live_ ? live_->url() : ""; }

 private:
  void require_open() const {
    if (!bench_) raise({ErrorCode::wrong_state, "", "the rig is closed"});
  }
  [[nodiscard]] const SamplePort& port(std::size_t input) const {
    require_open();
    return *inputs_.at(input)->port;
  }
  void rethrow_application() {
    if (calls_) calls_->rethrow();
  }
  [[nodiscard]] static std::string setup_text(const RigConfig& rig, const ApplicationPorts& ports);

  std::vector<std::string> warnings_;
  std::shared_ptr<RigConfig> rig_config_;
  std::shared_ptr<ApplicationCalls> calls_;
  std::unique_ptr<live::Server> live_;
  std::unique_ptr<Worker> worker_;  // the bench's processes end with it
  std::unique_ptr<Bench> bench_;
  std::vector<const InputPort*> inputs_;
  StopSource stop_;
  std::uint64_t at_once_ = 16;
  bool virtual_time_ = true;
};

std::string Rig::setup_text(const RigConfig& rig, const ApplicationPorts& ports) {
  nlohmann::json setup = application::setup_message(rig, ports, rig.loop.period, nlohmann::json::object());
  setup["pairs"] = nlohmann::json::array();
  for (const ChannelEntry& c : rig.channels)
    if (c.is_pair) setup["pairs"].push_back(c.name);
  return setup.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace

void add_rigs(py::module_& m) {
  py::class_<Report>(m, "Report")
      .def_readonly("json", &Report::json)
      .def_readonly("text", &Report::text)
      .def_readonly("verdict", &Report::verdict)
      .def_readonly("passed", &Report::passed)
      .def_readonly("ended_well", &Report::ended_well)
      .def_property_readonly("page", [](const Report& r) { return r.page.string(); })
      .def_property_readonly("recording", [](const Report& r) { return r.recording.string(); })
      .def_readonly("warnings", &Report::warnings)
      .def_readonly("errors", &Report::errors);
  py::class_<Rig>(m, "Rig")
      .def(py::init<const std::string&, const py::dict&, const py::object&>())
      .def("prepare", &Rig::prepare)
      .def("start", &Rig::start)
      .def("step", &Rig::step)
      .def("run", &Rig::run)
      .def("finish", &Rig::finish)
      .def("request_stop", &Rig::request_stop)
      .def("close", &Rig::close)
      .def("setup", &Rig::setup)
      .def("status", &Rig::status)
      .def("sequence", &Rig::sequence)
      .def("sample", &Rig::sample)
      .def("command", &Rig::command)
      .def("fault", &Rig::fault)
      .def("clear_faults", &Rig::clear_faults)
      .def("switch_pair", &Rig::switch_pair)
      .def("expected", &Rig::expected)
      .def_property_readonly("cycle", &Rig::cycle)
      .def_property_readonly("virtual_time", &Rig::virtual_time)
      .def("take_warnings", &Rig::take_warnings)
      .def_property_readonly("live_url", &Rig::live_url);
}

}  // namespace rigor::python
