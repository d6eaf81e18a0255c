// Whole rigs in virtual time with all that has threads of its own: recording, faults and switches of pairs
// from another thread, and a client of the live view that subscribes to every topic. What is looked for are
// data races, under the thread sanitizer; without it, that all of them come to their end and account for what
// they did. Nothing here depends on how fast the machine is.
#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <nlohmann/json.hpp>
#include <thread>

#include "bench/bench.h"
#include "bench/live/server.h"
#include "builtin/registry.h"
#include "tests/bench/live/websocket_client.h"
#include "tests/cli/command.h"
#include "tests/paths.h"

namespace rigor::test {
namespace {

using live::WebSocketClient;

/// Subscribes to all topics that are advertised, until the server says goodbye.
class Viewer {
 public:
  explicit Viewer(const std::string& url) : client_(url), thread_([this] { view(); }) {}
  ~Viewer() { thread_.join(); }
  /// Once it has subscribed to the topics of a run. False: not within a minute.
  bool subscribed() {
    return subscribed_.get_future().wait_for(std::chrono::minutes(1)) == std::future_status::ready;
  }
  /// After the end of the run.
  void join() {
    thread_.join();
    thread_ = std::thread([] {});
  }
  int messages = 0;
  bool said_goodbye = false;

 private:
  void view() {
    client_.upgrade();
    bool asked = false;
    while (const auto frame = client_.read_frame()) {
      if (frame->opcode == WebSocketClient::kPing) client_.send_frame(WebSocketClient::kPong, frame->content);
      if (frame->opcode == WebSocketClient::kClose) {
        said_goodbye = frame->content.find("run has ended") != std::string::npos;
        client_.send_frame(WebSocketClient::kClose, frame->content);
      }
      messages += frame->opcode == WebSocketClient::kBinary && frame->content.at(0) == 1;
      if (frame->opcode != WebSocketClient::kText) continue;
      const auto message = nlohmann::json::parse(frame->content);
      if (message["op"] == "advertise")
        for (const auto& channel : message["channels"]) {
          const nlohmann::json one{{"id", channel["id"]}, {"channelId", channel["id"]}};
          say({{"op", "subscribe"}, {"subscriptions", nlohmann::json::array({one})}});
          asked = true;
        }
      // An answer to what was asked after the subscriptions: they have been read.
      if (message["op"] == "advertise" && asked)
        say({{"op", "getParameters"}, {"parameterNames", nlohmann::json::array()}, {"id", "subscribed"}});
      if (message.value("id", "") == "subscribed" && !std::exchange(told_, true)) subscribed_.set_value();
    }
  }
  void say(const nlohmann::json& message) { client_.send_frame(WebSocketClient::kText, message.dump()); }

  WebSocketClient client_;
  std::promise<void> subscribed_;
  bool told_ = false;
  std::thread thread_;
};

class WholeRig : public testing::TestWithParam<const char*> {
 protected:
  TempDir dir;
};

TEST_P(WholeRig, RunsWithFaultsSwitchesAndALiveClientToItsEnd) {
  auto rig = load_rig(source_dir() + "/configs/" + GetParam() + ".yaml", {});
  ASSERT_TRUE(rig) << rig.error().text();
  rig->clock = ClockKind::virtual_time;
  rig->duration = milliseconds(200);
  rig->record.file = dir / "run.mcap";
  rig->report.clear();
  live::ServerOptions at;
  at.endpoint = {"127.0.0.1", 0};
  auto server = live::Server::open(at, "whole rig");
  ASSERT_TRUE(server) << server.error().text();
  BenchOptions options;
  options.live = server->get();
  options.control = true;
  auto bench = Bench::create(std::move(*rig), make_registry(), std::move(options));
  ASSERT_TRUE(bench) << bench.error().text();
  Viewer viewer((*server)->url());
  const Status prepared = (*bench)->prepare();
  ASSERT_TRUE(prepared) << prepared.error().text();
  ASSERT_TRUE(viewer.subscribed());
  ASSERT_TRUE((*bench)->start());

  std::vector<std::string> pairs, disturbed;
  for (const auto& c : (*bench)->rig().channels) {
    if (!c.is_pair) {
      disturbed.push_back(c.name);
      continue;
    }
    pairs.push_back(c.name);
    disturbed.push_back(c.name + ".real");
    disturbed.push_back(c.name + ".simulated");
  }
  std::atomic<bool> over{false};
  std::promise<void> once;
  int injected = 0, switched = 0;
  std::thread disturber([&] {
    for (int k = 0; !over; ++k) {
      for (const std::string& channel : disturbed)
        for (const char* fault :
             {"{ kind: drop, probability: 0.3, for_s: 0.02 }", "{ kind: jitter, max_ms: 5, for_s: 0.02 }",
              "{ kind: disconnect, for_s: 0.01 }"})
          injected += (*bench)->inject_fault(channel, std::string(fault)).has_value();
      for (const std::string& pair : pairs)
        switched += (*bench)->switch_pair(pair, k % 2 == 0 ? "simulated" : "real").has_value();
      if (k == 0) once.set_value();
      (void)(*bench)->clear_faults();
      std::this_thread::yield();
    }
  });
  once.get_future().wait();
  Result<bool> more = true;
  while (more && *more) more = (*bench)->step();
  over = true;
  disturber.join();
  EXPECT_TRUE(more) << more.error().text();
  const auto report = (*bench)->finish();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_TRUE(report->ended_well());
  EXPECT_TRUE(report->errors.empty()) << report->errors.front().text();
  EXPECT_GT(injected, 0);
  EXPECT_TRUE(pairs.empty() || switched > 0);
  viewer.join();
  EXPECT_TRUE(viewer.said_goodbye);
  EXPECT_GT(viewer.messages, 0);
}

std::string name_of_rig(const testing::TestParamInfo<const char*>& info) {
  std::string name = info.param;
  for (char& c : name)
    if (std::isalnum(static_cast<unsigned char>(c)) == 0) c = '_';
  return name;
}
// One of each family of drivers, and of what is measured in a world.
INSTANTIATE_TEST_SUITE_P(Tree, WholeRig,
                         testing::Values("demo", "rigs/aravis", "rigs/can", "rigs/gnss", "rigs/inertial",
                                         "rigs/modbus", "rigs/ouster", "rigs/pairs", "rigs/ros2", "rigs/sick",
                                         "rigs/skid-steer-can", "rigs/usb", "rigs/v4l2", "rigs/velodyne"),
                         name_of_rig);

}  // namespace
}  // namespace rigor::test
