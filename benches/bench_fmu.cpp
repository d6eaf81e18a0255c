// The cost of a step of an FMU (examples/fmu/arm.c: one input, two outputs, 5 steps of Euler): the plain
// calls of C beside an instance in this process and one in a process of its own. Each takes the same inputs
// at the same instants and has to give the same values.
//
//   bench_fmu [--steps 20000] [--json FILE]
#include <dlfcn.h>
#include <fmt/format.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>

#include "bench/plant/fmu_process.h"
#include "rt-core/histogram.h"
#include "rt-core/time.h"
#include "sim/fmu/fmu_instance.h"

namespace {

using namespace rigor;
namespace fs = std::filesystem;

constexpr double kStep_s = 0.005;

double input_at(int k) { return std::sin(0.01 * k); }

struct Measured {
  Histogram step;
  double sum = 0;  ///< of all outputs: who computes something else is found out
};

Measured bare(const fs::path& library, int steps) {
  void* const handle = dlopen(library.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!handle) throw std::runtime_error(dlerror());
  const auto find = [&]<class F>(F& f, const char* name) { f = reinterpret_cast<F>(dlsym(handle, name)); };
  void* (*instantiate)(const char*, const char*, const char*, bool, bool, bool, bool, const std::uint32_t*,
                       std::size_t, void*, void*, void*);
  int (*enter)(void*, bool, double, double, bool, double);
  int (*leave)(void*);
  int (*set)(void*, const std::uint32_t*, std::size_t, const double*, std::size_t);
  int (*get)(void*, const std::uint32_t*, std::size_t, double*, std::size_t);
  int (*do_step)(void*, double, double, bool, bool*, bool*, bool*, double*);
  find(instantiate, "fmi3InstantiateCoSimulation");
  find(enter, "fmi3EnterInitializationMode");
  find(leave, "fmi3ExitInitializationMode");
  find(set, "fmi3SetFloat64");
  find(get, "fmi3GetFloat64");
  find(do_step, "fmi3DoStep");
  void* const arm = instantiate("arm", "rigor-example-arm", "", false, false, false, false, nullptr, 0,
                                nullptr, nullptr, nullptr);
  enter(arm, false, 0, 0, false, 0);
  leave(arm);
  Measured m;
  const std::uint32_t in[] = {1}, out[] = {2, 3};
  for (int k = 0; k < steps; ++k) {
    const double u = input_at(k);
    double y[2];
    bool event, terminate, early;
    double reached;
    const MonotonicTime before = monotonic_now();
    set(arm, in, 1, &u, 1);
    do_step(arm, k * kStep_s, kStep_s, true, &event, &terminate, &early, &reached);
    get(arm, out, 2, y, 2);
    m.step.record(monotonic_now() - before);
    m.sum += y[0] + y[1];
  }
  return m;
}

Measured measure(fmu::FmuInstance& instance, int steps) {
  Measured m;
  std::vector<double> in(1), out(2);
  for (int k = 0; k < steps; ++k) {
    in[0] = input_at(k);
    const MonotonicTime before = monotonic_now();
    if (auto s = instance.step(k * kStep_s, kStep_s, in, true, out); !s)
      throw std::runtime_error(s.error().text());
    m.step.record(monotonic_now() - before);
    m.sum += out[0] + out[1];
  }
  return m;
}

}  // namespace

int main(int argc, char** argv) {
  int steps = 20'000;
  std::string json;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (std::strcmp(argv[i], "--steps") == 0) steps = std::atoi(argv[i + 1]);
    if (std::strcmp(argv[i], "--json") == 0) json = argv[i + 1];
  }
  try {
    // An FMU as it lies in the folder that a rig unpacks it to.
    std::string name = (fs::temp_directory_path() / "rigor-bench-fmu-XXXXXX").string();
    if (!mkdtemp(name.data())) return 1;
    const fs::path folder = name, library = folder / "binaries" / RIGOR_FMU_PLATFORM / "arm.so";
    fs::create_directories(library.parent_path());
    fs::create_directories(folder / "resources");
    fs::copy_file(RIGOR_BENCH_ARM, library);
    fs::copy_file(RIGOR_BENCH_DESCRIPTION, folder / "modelDescription.xml");
    const auto description = fmu::read_description(folder);
    if (!description) throw std::runtime_error(description.error().text());
    const fmu::InstanceSetup setup{
        "arm",
        folder,
        0,
        {},
        {description->find("target")->variable},
        {description->find("angle")->variable, description->find("rate")->variable}};
    auto loaded = fmu::load_instance(*description, setup);
    if (!loaded) throw std::runtime_error(loaded.error().text());
    auto process = plant::start_instance(*description, setup, {}, {});
    if (!process) throw std::runtime_error(process.error().text());

    const Measured plain = bare(library, steps), here = measure(**loaded, steps),
                   apart = measure(**process, steps);
    process->reset();
    fs::remove_all(folder);
    std::string text = "{";
    std::printf("%-16s %10s %10s %10s   ns for a step, of %d\n", "", "p50", "p99", "max", steps);
    for (const auto& [what, m] : {std::pair{"bare", &plain}, {"in_process", &here}, {"sandboxed", &apart}}) {
      std::printf("%-16s %10lld %10lld %10lld\n", what, static_cast<long long>(m->step.percentile(0.5).ns()),
                  static_cast<long long>(m->step.percentile(0.99).ns()),
                  static_cast<long long>(m->step.max().ns()));
      text += fmt::format("\"{}\": {{\"p50_ns\": {}, \"p99_ns\": {}, \"max_ns\": {}}}, ", what,
                          m->step.percentile(0.5).ns(), m->step.percentile(0.99).ns(), m->step.max().ns());
    }
    const bool same = plain.sum == here.sum && here.sum == apart.sum;
    std::printf("values: %s\n", same ? "the same three times" : "NOT the same");
    text += fmt::format("\"steps\": {}, \"same\": {}}}\n", steps, same);
    if (!json.empty()) std::ofstream(json) << text;
    return same ? 0 : 1;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "bench_fmu: %s\n", e.what());
    return 1;
  }
}
