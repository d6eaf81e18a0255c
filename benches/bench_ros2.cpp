// The bridge to ROS 2 beside the plainest program of Cyclone DDS that sends the same bytes: pictures of
// 1280x1024 at 30 Hz and registers at 1 kHz, reliable, to a reader in a process of its own. Time from the
// stamp in the header (the instant of the loop's grid, or of the plain program's) to the reader; CPU of the
// sender; messages sent, received and counted as dropped; wake-up error of the loop with and without a
// bridge.
//
// The plain program sleeps until each grid instant, writes what is due and goes on: no loop, no channels, no
// copy. The CPU of the bridge is that of the run with it less that of the same run without it.
//
//   bench_ros2 [--seconds 10] [--rounds 3] [--json FILE]
#include <dds/dds.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/bench.h"
#include "bridges/ros2/definition.h"
#include "bridges/ros2/participant.h"
#include "bridges/ros2/payload.h"
#include "builtin/registry.h"
#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/bridges/ros2/made_samples.h"

namespace {

using namespace rigor;
using namespace rigor::ros2;
using nlohmann::json;

constexpr std::uint32_t kDomain = 211;
constexpr std::uint32_t kWidth = 1280, kHeight = 1024, kPictureHz = 30, kValueHz = 1000;

struct Topic {
  const char *name, *type;
};
constexpr std::array<Topic, 2> kTopics{
    {{"/left/image", "sensor_msgs/msg/Image"}, {"/table/registers", "rigor_msgs/msg/RegisterBlock"}}};

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "bench_ros2: %s\n", what.c_str());
  std::exit(1);
}
template <class T>
T need(Result<T> r) {
  if (!r) give_up(r.error().text());
  return std::move(*r);
}

double cpu_s() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  return static_cast<double>(u.ru_utime.tv_sec + u.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(u.ru_utime.tv_usec + u.ru_stime.tv_usec);
}

double quantile(std::vector<double>& v, double q) {
  if (v.empty()) return 0;
  std::sort(v.begin(), v.end());
  return v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1) + 0.5)];
}

/// A process of this program's that writes one line of JSON to its standard output.
class Child {
 public:
  explicit Child(const std::function<json()>& work) {
    int out[2], end[2];
    if (pipe(out) != 0 || pipe(end) != 0) give_up("no pipe");
    pid_ = fork();
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      close(out[0]), close(end[1]);
      dup2(end[0], STDIN_FILENO);
      const std::string text = work().dump() + "\n";
      std::size_t done = 0;
      while (done < text.size()) {
        const ssize_t n = ::write(out[1], text.data() + done, text.size() - done);
        if (n <= 0) break;
        done += static_cast<std::size_t>(n);
      }
      std::_Exit(0);
    }
    close(out[1]), close(end[0]);
    from_ = out[0], to_ = end[1];
  }
  /// Lets it end, and returns what it says.
  json result(bool tell_to_end) {
    if (tell_to_end) close(to_);
    std::string text;
    char buffer[4096];
    for (ssize_t n; (n = ::read(from_, buffer, sizeof buffer)) > 0;)
      text.append(buffer, static_cast<std::size_t>(n));
    if (!tell_to_end) close(to_);
    close(from_);
    waitpid(pid_, nullptr, 0);
    if (text.empty()) give_up("a process ended without a result");
    return json::parse(text);
  }

 private:
  pid_t pid_ = -1;
  int from_ = -1, to_ = -1;
};

bool told_to_end() {
  pollfd p{STDIN_FILENO, POLLIN, 0};
  return poll(&p, 1, 0) > 0;
}

/// Reads both topics until its standard input is closed.
json receive() {
  auto participant = need(Participant::open({.domain = kDomain}));
  std::vector<std::unique_ptr<Reader>> readers;
  Waiter waiter;
  for (const Topic& t : kTopics) {
    readers.push_back(
        need(participant->read(t.name, {t.type, definition_text(t.type)}, {Qos::Profile::reliable, 1000})));
    waiter.add(*readers.back());
  }
  std::array<std::vector<double>, 2> latency_us;
  std::vector<std::byte> joined;
  bool ending = false;
  for (int idle = 0; idle < 20;) {
    waiter.wait(milliseconds(20));
    bool any = false;
    for (std::size_t i = 0; i < readers.size(); ++i)
      while (ddsi_serdata* message = readers[i]->take()) {
        const std::int64_t now = realtime_now().ns();
        const auto bytes = bytes_of(message, joined);
        std::int32_t sec = 0;
        std::uint32_t nanosec = 0;
        std::memcpy(&sec, bytes.data() + 4, 4);
        std::memcpy(&nanosec, bytes.data() + 8, 4);
        latency_us[i].push_back(static_cast<double>(now - (std::int64_t{sec} * 1'000'000'000 + nanosec)) *
                                1e-3);
        Reader::release(message);
        any = true;
      }
    ending = ending || told_to_end();
    idle = ending && !any ? idle + 1 : 0;
  }
  json j;
  for (std::size_t i = 0; i < 2; ++i)
    j[kTopics[i].name] = {{"received", latency_us[i].size()},
                          {"p50_us", quantile(latency_us[i], 0.5)},
                          {"p99_us", quantile(latency_us[i], 0.99)}};
  return j;
}

std::string rig_text(double seconds, bool bridge) {
  std::string text = "name: bench\nclock: wall\nduration_s: " + std::to_string(seconds) +
                     "\nloop: { rate_hz: 1000 }\nchannels:\n  left: { kind: image, backend: made, rate_hz: " +
                     std::to_string(kPictureHz) + ", width_px: " + std::to_string(kWidth) +
                     ", height_px: " + std::to_string(kHeight) +
                     " }\n  table: { kind: registers, backend: made, rate_hz: " + std::to_string(kValueHz) +
                     " }\n";
  if (bridge)
    text +=
        "bridges:\n  ros2:\n    domain: " + std::to_string(kDomain) +
        "\n    qos: reliable\n    depth: 1000\n    wait_for: [/left/image, /table/registers]\n    topics:\n"
        "      \"*\": { send: false }\n      /left/image: { send: true }\n      /table/registers: { send: "
        "true }\n";
  return text;
}

/// A run of the bench, with or without the bridge.
json run_rig(double seconds, bool bridge) {
  auto root = need(ConfigDocument::parse(rig_text(seconds, bridge), "bench_ros2"));
  Registry registry = make_registry();
  registry.add(test::made_backend());
  auto bench = need(Bench::create(need(parse_rig(root, "bench_ros2.yaml")), registry, {}));
  if (auto s = bench->prepare(); !s) give_up(s.error().text());
  const double cpu = cpu_s();
  const RunReport report = need(bench->run());
  json j{{"cpu_s", cpu_s() - cpu},
         {"wake_p50_us", static_cast<double>(report.outcome.loop.wake_error.percentile(0.5).ns()) * 1e-3},
         {"wake_p99_us", static_cast<double>(report.outcome.loop.wake_error.percentile(0.99).ns()) * 1e-3},
         {"skipped", report.outcome.loop.cycles_skipped}};
  for (const RunBridgeReport& b : report.bridges) {
    j["bridge_thread_cpu_s"] = b.cpu_s;
    j["dropped_before"] = b.dropped;
    for (const auto& t : b.traffic.topics)
      j["topics"][t.topic] = {{"messages", t.messages}, {"accepted", t.accepted}, {"dropped", t.dropped}};
    for (std::size_t i = 0; i < report.channels.size(); ++i)
      j["samples"][report.channels[i].name] = {{"loop", report.channels[i].taken},
                                               {"sent", b.channels[i].samples},
                                               {"dropped", b.channels[i].dropped}};
  }
  return j;
}

/// The same bytes, by a program that does nothing else.
json run_plain(double seconds) {
  namespace msg = record::msg;
  auto participant = need(Participant::open({.domain = kDomain}));
  std::array<std::unique_ptr<Writer>, 2> writers;
  for (std::size_t i = 0; i < 2; ++i)
    writers[i] = need(participant->write(kTopics[i].name, {kTopics[i].type, definition_text(kTopics[i].type)},
                                         {Qos::Profile::reliable, 1000}));
  while (writers[0]->peers() == 0 || writers[1]->peers() == 0) usleep(2000);
  usleep(100'000);
  // A camera fills buffers in turn, none of which is in a cache any more.
  std::vector<std::vector<std::byte>> buffers(16, std::vector<std::byte>(std::size_t{kWidth} * kHeight));
  std::uint64_t pictures = 0;
  record::CdrWriter picture_cdr, values_cdr;
  msg::Image picture{{{}, "left_frame"}, kHeight, kWidth, "mono8", 0, kWidth, {}};
  msg::RegisterBlock values{{{}, "table_frame"}, {"n", "minus_n"}, {1, -1}, {"", ""}, {}};
  std::array<std::uint64_t, 2> accepted{}, dropped{};
  const double cpu = cpu_s();
  timespec next{};
  clock_gettime(CLOCK_REALTIME, &next);
  const auto send = [&](std::size_t i, const auto& message, record::CdrWriter& cdr) {
    const auto pieces = need(cdr.write(message));
    (writers[i]->send(make_message(writers[i]->type(), pieces, {}, {})) ? accepted : dropped)[i] += 1;
  };
  const auto count = static_cast<std::uint64_t>(seconds * kValueHz);
  for (std::uint64_t k = 0; k < count; ++k) {
    next.tv_nsec += 1'000'000'000 / kValueHz;
    next.tv_sec += next.tv_nsec / 1'000'000'000;
    next.tv_nsec %= 1'000'000'000;
    clock_nanosleep(CLOCK_REALTIME, TIMER_ABSTIME, &next, nullptr);
    const msg::Time stamp{static_cast<std::int32_t>(next.tv_sec), static_cast<std::uint32_t>(next.tv_nsec)};
    values.header.stamp = stamp;
    send(1, values, values_cdr);
    if (k * kPictureHz / kValueHz == (k + 1) * kPictureHz / kValueHz) continue;
    // The sensor's work, which the channel of the bench has, too.
    std::vector<std::byte>& pixels = buffers[pictures++ % buffers.size()];
    std::memset(pixels.data(), static_cast<int>(k), pixels.size());
    picture.data = pixels;
    picture.header.stamp = stamp;
    send(0, picture, picture_cdr);
  }
  json j{{"cpu_s", cpu_s() - cpu}};
  for (std::size_t i = 0; i < 2; ++i) writers[i]->drain(rigor::seconds(1));
  for (std::size_t i = 0; i < 2; ++i)
    j["topics"][kTopics[i].name] = {
        {"messages", accepted[i] + dropped[i]}, {"accepted", accepted[i]}, {"dropped", dropped[i]}};
  return j;
}

json with_reader(const std::function<json()>& send) {
  Child reader(receive);
  json sent = Child(send).result(false);
  sent["reader"] = reader.result(true);
  return sent;
}

double median(std::vector<double> v) { return quantile(v, 0.5); }

}  // namespace

int main(int argc, char** argv) {
  double duration = 10;
  int rounds = 3;
  std::string file;
  for (int i = 1; i < argc; ++i) {
    const std::string key = argv[i];
    if (i + 1 < argc && key == "--seconds")
      duration = std::atof(argv[++i]);
    else if (i + 1 < argc && key == "--rounds")
      rounds = std::atoi(argv[++i]);
    else if (i + 1 < argc && key == "--json")
      file = argv[++i];
    else
      return std::fprintf(stderr, "usage: bench_ros2 [--seconds S] [--rounds N] [--json FILE]\n"), 2;
  }
  json all = json::array();
  std::vector<double> wake, wake_bridge, cpu_ratio;
  std::array<std::vector<double>, 2> p50_ratio, p99_ratio;
  bool whole = true;
  for (int round = 0; round < rounds; ++round) {
    const json loop = Child([&] { return run_rig(duration, false); }).result(false);
    const json bridge = with_reader([&] { return run_rig(duration, true); });
    const json plain = with_reader([&] { return run_plain(duration); });
    all.push_back({{"loop", loop}, {"bridge", bridge}, {"plain", plain}});
    wake.push_back(loop["wake_p99_us"]);
    wake_bridge.push_back(bridge["wake_p99_us"]);
    const double bridge_cpu = bridge["cpu_s"].get<double>() - loop["cpu_s"].get<double>();
    cpu_ratio.push_back(bridge_cpu / plain["cpu_s"].get<double>());
    std::printf(
        "round %d\n  loop alone   wake p50 %.0f us, p99 %.0f us; %.2f s of CPU\n  with bridge  wake p50 %.0f "
        "us, p99 %.0f us; %.2f s of CPU, %.2f s for the bridge\n  plain        %.2f s of CPU\n",
        round, loop["wake_p50_us"].get<double>(), wake.back(), loop["cpu_s"].get<double>(),
        bridge["wake_p50_us"].get<double>(), wake_bridge.back(), bridge["cpu_s"].get<double>(), bridge_cpu,
        plain["cpu_s"].get<double>());
    for (std::size_t i = 0; i < 2; ++i) {
      const auto& t = kTopics[i];
      for (const json* j : {&bridge, &plain}) {
        const json& sent = (*j)["topics"][t.name];
        const json& got = (*j)["reader"][t.name];
        std::printf(
            "  %-12s %-17s p50 %7.0f us, p99 %7.0f us; %llu messages = %llu accepted + %llu dropped, %llu "
            "received\n",
            j == &bridge ? "with bridge" : "plain", t.name, got["p50_us"].get<double>(),
            got["p99_us"].get<double>(), sent["messages"].get<unsigned long long>(),
            sent["accepted"].get<unsigned long long>(), sent["dropped"].get<unsigned long long>(),
            got["received"].get<unsigned long long>());
        whole = whole &&
                sent["messages"] ==
                    sent["accepted"].get<std::uint64_t>() + sent["dropped"].get<std::uint64_t>() &&
                sent["accepted"] == got["received"];
      }
      p50_ratio[i].push_back(bridge["reader"][t.name]["p50_us"].get<double>() /
                             plain["reader"][t.name]["p50_us"].get<double>());
      p99_ratio[i].push_back(bridge["reader"][t.name]["p99_us"].get<double>() /
                             plain["reader"][t.name]["p99_us"].get<double>());
    }
    for (const auto& [name, s] : bridge["samples"].items())
      whole = whole && s["loop"] == s["sent"].get<std::uint64_t>() + s["dropped"].get<std::uint64_t>();
    std::fflush(stdout);
  }
  std::printf(
      "median of %d rounds of %.0f s: bridge / plain: CPU %.2f; pictures p50 %.2f, p99 %.2f; registers p50 "
      "%.2f, p99 %.2f\n"
      "loop's wake-up p99: with / without %.2f; every sample %s\n",
      rounds, duration, median(cpu_ratio), median(p50_ratio[0]), median(p99_ratio[0]), median(p50_ratio[1]),
      median(p99_ratio[1]), median(wake_bridge) / median(wake),
      whole ? "received or counted" : "NOT in the account");
  if (!file.empty())
    std::ofstream(file) << json{{"rounds", all},
                                {"cpu_ratio", median(cpu_ratio)},
                                {"wake_p99_ratio", median(wake_bridge) / median(wake)},
                                {"whole", whole}}
                               .dump(2)
                        << "\n";
  return whole ? 0 : 1;
}
