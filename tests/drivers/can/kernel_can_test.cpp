// The driver on a real kernel's vcan interfaces, beside can-utils.
#include <gmock/gmock.h>

#include <cstring>

#include "drivers/can/can_emulator.h"
#include "drivers/can/can_sink.h"
#include "drivers/can/can_source.h"
#include "drivers/can/isotp_codec.h"
#include "tests/drivers/can/kernel_can_tools.h"

namespace rigor::can {
namespace {

using test::config_of;
using test::entries_of;
using test::frame;
using test::run_tool;
using test::wait_for;
using testing::HasSubstr;

class KernelCan : public test::VcanTest {
 protected:
  ChannelConfig raw(const std::string& more = "") {
    return config_of(SampleKind::can_frame, "{interface: " + bus + (more.empty() ? "" : ", " + more) + "}");
  }
  /// Polls until `n` samples are there.
  std::vector<SampleLease> collect(Source& s, std::size_t n, int limit_s = 60) {
    std::vector<SampleLease> out;
    (void)wait_for(
        [&] {
          while (auto sample = s.poll(bench_now())) out.push_back(sample);
          return out.size() >= n;
        },
        limit_s);
    return out;
  }
};

TEST_F(KernelCan, InterfacesAreListedMadeAndRemoved) {
  auto found = find_interface(bus);
  ASSERT_TRUE(found) << found.error().text();
  EXPECT_EQ(found->kind, "vcan");
  EXPECT_TRUE(found->up);
  EXPECT_TRUE(found->fd);
  ASSERT_TRUE(set_up(bus, false));
  EXPECT_FALSE(find_interface(bus)->up);
  CanSource source;
  ASSERT_TRUE(source.configure(raw()));
  auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::unavailable);
  EXPECT_THAT(s.error().text(), HasSubstr("sudo ip link set " + bus + " up"));
  ear.close();
  ASSERT_TRUE(remove_interface(bus));
  s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_found);
  EXPECT_THAT(s.error().text(), HasSubstr("ip link add"));
}

TEST_F(KernelCan, FramesOfAllFormatsArriveWithTheKernelsTime) {
  CanSource source;
  start(source, raw("fd: true"));
  auto out = sender();
  std::vector<CanFrame> sent{frame(0x123, {1, 2, 3}), frame(0x1abcdef0, {9}, true), frame(0x7ff, {})};
  sent.push_back(frame(0x10, {}));
  sent.back().remote = true;
  sent.back().length = 4;
  CanFrame fd = frame(0x200, {1});
  fd.fd = fd.bit_rate_switch = true;
  fd.length = 64;
  for (int i = 0; i < 64; ++i) fd.data[static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(i);
  sent.push_back(fd);
  const BenchTime before(monotonic_now().ns());
  for (const auto& f : sent) ASSERT_EQ(out.send(f), 0);
  const auto samples = collect(source, sent.size());
  const BenchTime after(monotonic_now().ns());
  ASSERT_EQ(samples.size(), sent.size());
  BenchTime last;
  for (std::size_t i = 0; i < sent.size(); ++i) {
    const auto& f = *samples[i]->as<CanFrame>();
    EXPECT_EQ(f.id, sent[i].id);
    EXPECT_EQ(f.extended, sent[i].extended);
    EXPECT_EQ(f.remote, sent[i].remote);
    EXPECT_EQ(f.fd, sent[i].fd);
    EXPECT_EQ(f.bit_rate_switch, sent[i].bit_rate_switch);
    EXPECT_EQ(f.length, sent[i].length);
    EXPECT_TRUE(f.remote || f.data == sent[i].data);
    EXPECT_EQ(samples[i]->stamp.sequence, i);
    EXPECT_EQ(samples[i]->stamp.validity, kValid) << "no kernel time";
    EXPECT_GT(samples[i]->stamp.t_capture, last);
    last = samples[i]->stamp.t_capture;
    // A pair of clocks read on a busy machine may be a little off.
    EXPECT_GE(samples[i]->stamp.t_capture, before - milliseconds(20));
    EXPECT_LE(samples[i]->stamp.t_capture, after + milliseconds(20));
  }
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelCan, FiltersAreTheKernels) {
  CanSource source;
  start(source,
        raw("filters: [{id: 0x100, mask: 0x700}, {id: 0x1f000000, mask: 0x1f000000, extended: true}]"));
  auto out = sender();
  for (const auto& f : {frame(0x100, {1}), frame(0x200, {2}), frame(0x1ff, {3}), frame(0x100, {4}, true),
                        frame(0x1f000001, {5}, true), frame(0x101, {6})})
    ASSERT_EQ(out.send(f), 0);
  const auto samples = collect(source, 4);
  std::vector<int> got;
  for (const auto& s : samples) got.push_back(s->as<CanFrame>()->data[0]);
  EXPECT_EQ(got, (std::vector<int>{1, 3, 5, 6}));
  EXPECT_EQ(source.health().received, 4u) << "the kernel let others through";
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelCan, FdFramesDoNotComeUnlessAskedFor) {
  CanSource source;
  start(source, raw());
  auto out = sender();
  CanFrame fd = frame(0x100, {1});
  fd.fd = true;
  ASSERT_EQ(out.send(fd), 0);
  ASSERT_EQ(out.send(frame(0x101, {2})), 0);
  const auto samples = collect(source, 1);
  ASSERT_EQ(samples.size(), 1u);
  EXPECT_EQ(samples[0]->as<CanFrame>()->id, 0x101u);
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelCan, WhatIsSentIsReceivedOrReportedLost) {
  CanSource source;
  start(source, raw("slots: 4096"));
  auto out = sender();
  constexpr std::uint64_t kFrames = 3000;
  std::atomic<std::uint64_t> sent{0};
  // A thousand and more a second where the machine keeps up.
  const MonotonicTime began = monotonic_now();
  std::atomic<std::int64_t> took_ns{0};
  std::thread feeder([&] {
    for (std::uint64_t i = 0; i < kFrames; ++i) {
      CanFrame f = frame(0x100 + i % 16, {0, 0, 0, 0});
      std::memcpy(f.data.data(), &i, 4);
      if (out.send(f) == 0) ++sent;
      if (i % 10 == 9) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    took_ns = (monotonic_now() - began).ns();
  });
  std::uint64_t got = 0, gaps = 0, next = 0, told = 0;
  const auto take = [&] {
    while (auto s = source.poll(bench_now())) {
      ++got;
      told += s->stamp.lost_before;
      gaps += s->stamp.sequence - next;
      next = s->stamp.sequence + 1;
    }
    return got + source.health().lost >= kFrames;
  };
  EXPECT_TRUE(wait_for(take, 120));
  feeder.join();
  (void)take();
  const HealthSnapshot h = source.health();
  EXPECT_EQ(sent.load(), kFrames);
  EXPECT_EQ(h.received + h.lost, sent.load());
  EXPECT_EQ(got + h.no_slot + h.ring_full + h.lost, sent.load());
  const auto n = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
  std::printf("%llu CAN frames sent (%.0f/s), %llu received, %llu reported lost\n", n(sent.load()),
              static_cast<double>(sent.load()) / (static_cast<double>(took_ns.load()) * 1e-9), n(h.received),
              n(h.lost));
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelCan, ASocketThatOverflowsIsCountedToTheFrame) {
  // The smallest receive buffer, and a source that is armed but reads only when it is started: the kernel has
  // to drop. Its count and the frames that remain make up what was sent.
  RawOptions o;
  o.receive_buffer_bytes = 4096;
  RawSocket small;
  ASSERT_TRUE(small.open(bus, o));
  auto out = sender();
  for (int i = 0; i < 500; ++i) ASSERT_EQ(out.send(frame(0x100, {1})), 0);
  std::uint64_t got = 0;
  std::vector<ReceivedFrame> part(RawSocket::kBatch);
  for (int n; (n = small.receive(part)) > 0;) got += static_cast<std::uint64_t>(n);
  EXPECT_LT(got, 500u) << "nothing was dropped, the test shows nothing";
  EXPECT_EQ(got + small.dropped(), 500u);

  CanSource source;
  start(source, raw("receive_buffer_kib: 4, slots: 65536"));
  constexpr std::uint64_t kFrames = 20000;
  for (std::uint64_t i = 0; i < kFrames; ++i) ASSERT_EQ(out.send(frame(0x100, {1})), 0);
  const auto counted = [&] { return source.health().received + source.health().lost; };
  EXPECT_TRUE(wait_for([&] { return counted() >= kFrames; }));
  EXPECT_EQ(counted(), kFrames);
  std::printf("%llu CAN frames sent into a buffer of 4 KiB, %llu received, %llu reported lost\n",
              static_cast<unsigned long long>(kFrames),
              static_cast<unsigned long long>(source.health().received),
              static_cast<unsigned long long>(source.health().lost));
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelCan, AnInterfaceThatGoesDownComesBack) {
  CanSource source;
  start(source, raw());
  auto out = sender();
  std::uint64_t sent = 0;
  const auto send = [&](int n) {
    for (int i = 0; i < n; ++i) sent += out.send(frame(0x100, {1})) == 0;
  };
  send(100);
  ASSERT_TRUE(set_up(bus, false));
  EXPECT_TRUE(wait_for([&] { return !source.health().connected; }));
  send(50);  // refused: the bus is not there
  EXPECT_EQ(sent, 100u);
  ASSERT_TRUE(set_up(bus, true));
  EXPECT_TRUE(wait_for([&] { return source.health().connected; }));
  EXPECT_EQ(source.health().reconnects, 1u);
  (void)out.pending_error();  // the sender was told, too
  send(100);
  const auto counted = [&] { return source.health().received + source.health().lost; };
  EXPECT_TRUE(wait_for([&] { return counted() >= sent; }));
  EXPECT_EQ(counted(), sent);
  // And taken away altogether, as an adapter that is unplugged.
  out.close();
  ear.close();
  ASSERT_TRUE(remove_interface(bus));
  EXPECT_TRUE(wait_for([&] { return !source.health().connected; }));
  ASSERT_TRUE(create_vcan(bus));
  EXPECT_TRUE(wait_for([&] { return source.health().connected; }));
  EXPECT_EQ(source.health().reconnects, 2u);
  out = sender();
  send(10);
  EXPECT_TRUE(wait_for([&] { return counted() >= sent; }));
  EXPECT_EQ(counted(), sent);
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelCan, SampledSignalsCountTheInstantsWithoutTheInterface) {
  CanSource source;
  auto c = config_of(SampleKind::register_block,
                     "{interface: " + bus + ", dbc: " + folder.dbc() +
                         ", timeout_ms: 0, signals: [{message: Clock, signal: clock_ms}]}",
                     milliseconds(10));
  start(source, c);
  auto out = sender();
  ASSERT_EQ(out.send(frame(0x100, {42, 0, 0, 0, 0, 0, 0, 0})), 0);
  double value = 0;
  EXPECT_TRUE(wait_for([&] {
    while (auto s = source.poll(bench_now())) value = s->as<RegisterBlock>()->value[0];
    return value == 42;
  }));
  ASSERT_TRUE(set_up(bus, false));
  EXPECT_TRUE(wait_for([&] { return !source.health().connected; }));
  const auto lost = source.health().lost;
  EXPECT_TRUE(wait_for([&] { return source.health().lost >= lost + 10; }));
  ASSERT_TRUE(set_up(bus, true));
  EXPECT_TRUE(wait_for([&] { return source.health().connected; }));
  std::uint64_t before = 0;
  EXPECT_TRUE(wait_for([&] {
    while (auto s = source.poll(bench_now()))
      if (s->stamp.lost_before >= 10) before = s->stamp.lost_before, value = s->as<RegisterBlock>()->value[0];
    return before != 0;
  }));
  EXPECT_TRUE(std::isnan(value)) << "what was known before the interruption is not known after it";
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelCan, ErrorFramesAreSamplesAndHealth) {
  CanSource source;
  start(source, raw("restart_ms: 50"));
  auto out = sender();
  CanFrame e = frame(0x40, {0, 0, 0, 0, 0, 0, 0, 0});  // CAN_ERR_BUSOFF
  e.error = true;
  ASSERT_EQ(out.send(e), 0);
  auto samples = collect(source, 1);
  ASSERT_EQ(samples.size(), 1u);
  EXPECT_TRUE(samples[0]->as<CanFrame>()->error);
  EXPECT_EQ(samples[0]->as<CanFrame>()->id, 0x40u);
  EXPECT_EQ(source.bus_state(), BusState::bus_off);
  EXPECT_FALSE(source.health().connected);
  EXPECT_EQ(source.health().protocol_errors, 1u);
  // The restart is asked for; vcan has no controller, so it is refused, and asked for again.
  EXPECT_TRUE(wait_for([&] { return source.health().retries >= 1; }));
  e.id = 0x100;  // CAN_ERR_RESTARTED
  ASSERT_EQ(out.send(e), 0);
  EXPECT_TRUE(wait_for([&] { return source.health().connected; }));
  EXPECT_EQ(source.bus_state(), BusState::error_active);
  EXPECT_EQ(source.health().reconnects, 1u);
  e.id = 0x4;        // CAN_ERR_CRTL
  e.data[1] = 0x20;  // CAN_ERR_CRTL_TX_PASSIVE
  ASSERT_EQ(out.send(e), 0);
  EXPECT_TRUE(wait_for([&] { return source.bus_state() == BusState::error_passive; }));
  EXPECT_TRUE(source.health().connected);
  ASSERT_TRUE(source.stop());
}

// ------------------------------------------------------------------ sending

TEST_F(KernelCan, TheBroadcastManagerSendsCyclicallyAndIsUpdated) {
  BroadcastManager bcm;
  ASSERT_TRUE(bcm.open(bus));
  ASSERT_EQ(bcm.start(frame(0x123, {1}), milliseconds(10)), 0);
  std::size_t ones = 0, twos = 0;
  EXPECT_TRUE(wait_for([&] {
    for (const auto& r : heard()) ones += r.frame.data[0] == 1;
    return ones >= 20;
  }));
  ASSERT_EQ(bcm.update(frame(0x123, {2}), false), 0);
  std::vector<RealtimeTime> times;
  EXPECT_TRUE(wait_for([&] {
    for (const auto& r : heard())
      if (r.frame.data[0] == 2) ++twos, times.push_back(r.t);
    return twos >= 20;
  }));
  // No more than the cycle allows: the content changed, the rhythm did not.
  const double span_ms = static_cast<double>((times.back() - times.front()).ns()) * 1e-6;
  EXPECT_LE(static_cast<double>(times.size() - 1), span_ms / 10 + 3);
  CanFrame fd = frame(0x124, {7});
  fd.fd = fd.bit_rate_switch = true;
  fd.length = 48;
  ASSERT_EQ(bcm.send_once(fd), 0);
  bool seen = false;
  EXPECT_TRUE(wait_for([&] {
    for (const auto& r : heard()) seen |= r.frame.fd && r.frame.length == 48 && r.frame.bit_rate_switch;
    return seen;
  }));
  bcm.close();
  (void)heard();
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  (void)heard();
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  EXPECT_TRUE(heard().empty()) << "it goes on after its socket was closed";
}

class KernelCanSink : public KernelCan {
 protected:
  ChannelConfig config() {
    return config_of(SampleKind::none,
                     "{interface: " + bus + ", dbc: " + folder.dbc() +
                         ", signals: [{message: Command, signal: enable}, {message: Command, signal: "
                         "target}, {message: Cyclic, signal: level}], safe: {enable: 0, level: 7}}");
  }
  void arm(CanSink& sink, Duration deadline) {
    auto s = sink.configure(config());
    ASSERT_TRUE(s) << s.error().text();
    heartbeat.restart(false);
    sink.watch(&heartbeat, deadline);
    s = sink.arm({});
    ASSERT_TRUE(s) << s.error().text();
    ASSERT_TRUE(sink.start(bench_now()));
  }
  Command command(double enable, double target, double level) {
    Command c;
    c.count = 3;
    c.value = {enable, target, level};
    c.t_effect = bench_now();
    return c;
  }
  bool hears(const std::function<bool(const CanFrame&)>& which) {
    return wait_for([&] {
      bool any = false;
      for (const auto& r : heard()) any |= which(r.frame);
      return any;
    });
  }
  Heartbeat heartbeat;
};

TEST_F(KernelCanSink, CommandsLeaveAndASilentLoopMakesTheDeviceSafe) {
  CanSink sink;
  arm(sink, seconds(5));
  EXPECT_TRUE(hears([](const CanFrame& f) { return f.id == 0x201 && f.data[0] == 7; })) << "safe from arm on";
  heartbeat.beat(bench_now());
  ASSERT_TRUE(sink.command(command(1, -12.3, 500)));
  EXPECT_TRUE(hears([](const CanFrame& f) {
    return f.id == 0x200 && f.data[0] == 1 && f.data[1] == 0xff && f.data[2] == 0x85;
  }));
  EXPECT_TRUE(hears([](const CanFrame& f) { return f.id == 0x201 && f.data[0] == 0xf4 && f.data[1] == 1; }))
      << "and goes on cyclically";
  EXPECT_EQ(sink.counters().applied, 1u);
  ASSERT_TRUE(sink.command(command(1, 9999, 500)));
  EXPECT_TRUE(wait_for([&] { return sink.counters().failed == 1; }));
  // No beat for five seconds.
  EXPECT_TRUE(hears([](const CanFrame& f) { return f.id == 0x200 && f.data[0] == 0; }));
  EXPECT_TRUE(hears([](const CanFrame& f) { return f.id == 0x201 && f.data[0] == 7 && f.data[1] == 0; }));
  EXPECT_EQ(sink.counters().made_safe, 1u);
  ASSERT_TRUE(sink.stop());
  EXPECT_FALSE(sink.health().connected);
}

TEST_F(KernelCanSink, AnInterfaceThatWasAwayIsToldTheLastCommand) {
  CanSink sink;
  arm(sink, seconds(600));
  ASSERT_TRUE(sink.command(command(1, 5, 300)));
  EXPECT_TRUE(wait_for([&] { return sink.counters().applied == 1; }));
  ASSERT_TRUE(set_up(bus, false));
  EXPECT_TRUE(wait_for([&] { return !sink.health().connected; }));
  ASSERT_TRUE(sink.command(command(1, 6, 301)));
  EXPECT_TRUE(wait_for([&] { return sink.counters().failed == 1; }));
  ASSERT_TRUE(set_up(bus, true));
  EXPECT_TRUE(wait_for([&] { return sink.health().connected; }));
  EXPECT_GE(sink.health().reconnects, 1u);
  ear.close();
  ASSERT_TRUE(ear.open(bus, {}));
  EXPECT_TRUE(hears([](const CanFrame& f) { return f.id == 0x201 && f.data[0] == 301 - 256; }));
  ASSERT_TRUE(sink.stop());
}

TEST_F(KernelCan, AnEmulatedNodeSendsAndObeys) {
  CanEmulator emulator;
  auto model = std::make_shared<test::CountingModel>();
  emulator.attach({.image = {}, .samples = {}, .motion = {}, .registers = {}, .signals = model});
  start(emulator,
        config_of(SampleKind::none, "{interface: " + bus + ", dbc: " + folder.dbc() + ", node: Device}"));
  EXPECT_THAT(emulator.endpoint(), HasSubstr(bus));
  CanSource source;
  start(source,
        config_of(SampleKind::register_block,
                  "{interface: " + bus + ", dbc: " + folder.dbc() +
                      ", signals: [{message: Clock, signal: clock_ms}, {message: State, signal: state}]}"));
  auto samples = collect(source, 20);
  ASSERT_GE(samples.size(), 20u);
  model->set_state(8);
  double state = 0;
  EXPECT_TRUE(wait_for([&] {
    while (auto s = source.poll(bench_now())) state = s->as<RegisterBlock>()->value[1];
    return state == 8;
  }));
  auto out = sender();
  ASSERT_EQ(out.send(frame(0x200, {1, 0, 50, 0, 0, 0, 0, 0})), 0);
  EXPECT_TRUE(wait_for([&] { return model->writes().size() == 2; }));
  ASSERT_EQ(model->writes().size(), 2u);
  EXPECT_EQ(model->writes()[1].value, 5);
  // Down: what could not be sent is counted, and it goes on afterwards.
  ASSERT_TRUE(set_up(bus, false));
  EXPECT_TRUE(wait_for([&] { return emulator.health().lost > 0 && !emulator.health().connected; }));
  ASSERT_TRUE(set_up(bus, true));
  EXPECT_TRUE(wait_for([&] { return emulator.health().connected && source.health().connected; }));
  const auto received = source.health().received;
  EXPECT_TRUE(wait_for([&] { return source.health().received > received + 5; }));
  EXPECT_TRUE(source.stop());
  EXPECT_TRUE(emulator.stop());
  EXPECT_GT(emulator.counters().sent, 20u);
}

// ------------------------------------------------------------------ beside other people's programs

TEST_F(KernelCan, CandumpWritesWhatWeWriteByteForByte) {
  if (!test::has_tool("candump") || !test::has_tool("cansend")) GTEST_SKIP() << "can-utils are not installed";
  CanSource source;
  const std::string ours = folder.file("ours.log"), theirs = folder.file("theirs.log");
  start(source, raw("fd: true, log: " + ours));
  test::Peer candump({"candump", "-L", bus + ",0:0,#FFFFFFFF"}, theirs);
  auto out = sender();
  // candump is there when it has written its first line.
  std::uint64_t sent = 0;
  ASSERT_TRUE(wait_for([&] {
    sent += out.send(frame(0x1, {})) == 0;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    return !test::read_file(theirs).empty();
  }));
  for (const char* f :
       {"123#DEADBEEF", "1F334455#1122334455667788", "7FF#", "456#R", "213##311", "00000001##0AABB"}) {
    ASSERT_EQ(run_tool({"cansend", bus, f}), 0) << f;
    ++sent;
  }
  CanFrame error = frame(0x4, {0, 4, 0, 0, 0, 0, 0, 0});
  error.error = true;
  ASSERT_EQ(out.send(error), 0);
  ASSERT_EQ(out.send(frame(0x7fe, {0xee})), 0);
  sent += 2;
  ASSERT_TRUE(wait_for([&] { return source.health().received >= sent; }));
  ASSERT_TRUE(wait_for([&] { return test::read_file(theirs).find("7FE#EE") != std::string::npos; }));
  candump.stop();
  ASSERT_TRUE(source.stop());
  const auto mine = test::read_file(ours), foreign = test::read_file(theirs);
  ASSERT_LT(foreign.size(), mine.size() + 1);
  EXPECT_EQ(mine.substr(mine.size() - foreign.size()), foreign);
  // And what candump wrote is read and written again as it was.
  std::string again;
  for (const LogEntry& e : entries_of(theirs)) again += format_log_line(e) + "\n";
  EXPECT_EQ(again, foreign);
}

TEST_F(KernelCan, CanplayerPlaysOurLogsAndWePlayCandumps) {
  if (!test::has_tool("canplayer") || !test::has_tool("candump"))
    GTEST_SKIP() << "can-utils are not installed";
  const std::string file = folder.file("play.log");
  std::string text;
  for (int i = 0; i < 50; ++i) {
    char line[80];
    std::snprintf(line, sizeof line, "(1436509052.%06d) %s %03X#%02X%02X\n", i * 1000, bus.c_str(), 0x100 + i,
                  i, 255 - i);
    text += line;
  }
  std::ofstream(file) << text;
  CanSource source;
  start(source, raw());
  ASSERT_EQ(run_tool({"canplayer", "-I", file}), 0);
  auto samples = collect(source, 50);
  ASSERT_EQ(samples.size(), 50u);
  for (int i = 0; i < 50; ++i) {
    EXPECT_EQ(samples[static_cast<std::size_t>(i)]->as<CanFrame>()->id, 0x100u + static_cast<unsigned>(i));
    EXPECT_EQ(samples[static_cast<std::size_t>(i)]->as<CanFrame>()->data[1], 255 - i);
  }
  CanEmulator player;
  player.attach({});
  start(player, config_of(SampleKind::none, "{interface: " + bus + ", replay: " + file + "}"));
  samples = collect(source, 50);
  ASSERT_EQ(samples.size(), 50u);
  for (int i = 0; i < 50; ++i)
    EXPECT_EQ(samples[static_cast<std::size_t>(i)]->as<CanFrame>()->id, 0x100u + static_cast<unsigned>(i));
  EXPECT_TRUE(player.stop());
  EXPECT_TRUE(source.stop());
}

TEST_F(KernelCan, IsoTpTalksToIsotpsendAndIsotprecv) {
  if (!test::has_tool("isotpsend") || !test::has_tool("isotprecv"))
    GTEST_SKIP() << "can-utils are not installed";
  IsoTpSocket::Options o;
  o.tx_id = 0x7e0;
  o.rx_id = 0x7e8;
  IsoTpSocket socket;
  auto s = socket.open(bus, o);
  ASSERT_TRUE(s) << s.error().text();
  std::string hex;
  std::vector<std::uint8_t> message;
  for (int i = 0; i < 100; ++i) {
    char two[4];
    std::snprintf(two, sizeof two, "%02X ", i);
    hex += two;
    message.push_back(static_cast<std::uint8_t>(i));
  }
  std::ofstream(folder.file("hex")) << hex << "\n";
  {
    test::Peer peer({"isotpsend", "-s", "7e8", "-d", "7e0", bus}, "/dev/null", folder.file("hex"));
    const auto got = socket.receive(seconds(60));
    ASSERT_TRUE(got) << got.error().text();
    EXPECT_EQ(*got, message);
    peer.wait();
  }
  // The other way: until the peer listens, nobody answers the first frame.
  test::Peer peer({"isotprecv", "-s", "7e8", "-d", "7e0", bus}, folder.file("got"));
  bool taken = false;
  EXPECT_TRUE(wait_for([&] { return taken = static_cast<bool>(socket.send(message)); }));
  EXPECT_EQ(peer.wait(), 0);
  const auto got = test::read_file(folder.file("got"));
  EXPECT_EQ(got.substr(0, hex.size() - 1), hex.substr(0, hex.size() - 1));
}

TEST_F(KernelCan, OurIsoTpAndTheKernelsUnderstandEachOther) {
  for (const bool fd : {false, true}) {
    IsoTpSocket::Options k;
    k.tx_id = 0x7e8;
    k.rx_id = 0x7e0;
    k.fd = fd;
    k.block_size = 4;
    IsoTpSocket kernel;
    auto s = kernel.open(bus, k);
    ASSERT_TRUE(s) << s.error().text();
    IsoTpOptions o;
    o.tx_id = 0x7e0;
    o.rx_id = 0x7e8;
    o.fd = fd;
    o.timeout = seconds(30);
    o.block_size = 3;
    RawOptions only;
    only.filters = {{0x7e8, kStandardMask, false}};
    only.fd = true;
    RawSocket line;
    ASSERT_TRUE(line.open(bus, only));
    std::vector<std::uint8_t> message(777);
    for (std::size_t i = 0; i < message.size(); ++i) message[i] = static_cast<std::uint8_t>(i * 7);
    const auto now = [] { return bench_now(); };
    std::vector<ReceivedFrame> part(8);
    IsoTpSender sender(o);
    ASSERT_TRUE(sender.start(message, now()));
    EXPECT_TRUE(wait_for([&] {
      const int n = line.receive(part);
      for (int i = 0; i < n; ++i) sender.receive(part[static_cast<std::size_t>(i)].frame, now());
      while (auto f = sender.next(now()))
        if (line.send(*f) != 0) return true;
      return sender.state() != IsoTpState::busy;
    }));
    EXPECT_EQ(sender.state(), IsoTpState::done);
    const auto got = kernel.receive(seconds(60));
    ASSERT_TRUE(got) << got.error().text();
    EXPECT_EQ(*got, message);
    IsoTpReceiver receiver(o);
    std::thread answer([&] { EXPECT_TRUE(kernel.send(message)); });
    EXPECT_TRUE(wait_for([&] {
      const int n = line.receive(part);
      for (int i = 0; i < n; ++i)
        if (auto f = receiver.receive(part[static_cast<std::size_t>(i)].frame, now())) {
          EXPECT_EQ(line.send(*f), 0);
        }
      return receiver.state() == IsoTpState::done || receiver.state() == IsoTpState::wrong_frame;
    }));
    answer.join();
    EXPECT_EQ(receiver.state(), IsoTpState::done);
    EXPECT_EQ(std::vector<std::uint8_t>(receiver.message().begin(), receiver.message().end()), message);
  }
}

TEST_F(KernelCan, ThePairOfAVxcanAreTwoMachines) {
  if (!test::has_tool("ip")) GTEST_SKIP() << "iproute2 is not installed";
  const std::string a = bus + "a", b = bus + "b";
  if (run_tool({"ip", "link", "add", a, "type", "vxcan", "peer", "name", b}) != 0) {
    ASSERT_FALSE(test::in_guest());
    GTEST_SKIP() << "this kernel has no vxcan";
  }
  ASSERT_TRUE(set_up(a, true));
  ASSERT_TRUE(set_up(b, true));
  EXPECT_EQ(find_interface(a)->kind, "vxcan");
  CanEmulator emulator;
  emulator.attach({.image = {},
                   .samples = {},
                   .motion = {},
                   .registers = {},
                   .signals = std::make_shared<test::CountingModel>()});
  start(emulator,
        config_of(SampleKind::none, "{interface: " + a + ", dbc: " + folder.dbc() + ", node: Device}"));
  CanSource source;
  start(source, config_of(SampleKind::can_frame, "{interface: " + b + "}"));
  EXPECT_GE(collect(source, 20).size(), 20u);
  EXPECT_TRUE(source.stop());
  EXPECT_TRUE(emulator.stop());
  (void)remove_interface(a);
}

TEST_F(KernelCan, TsharkFindsNothingMalformed) {
  if (!test::has_tool("tshark")) GTEST_SKIP() << "tshark is not installed";
  CanEmulator emulator;
  emulator.attach({.image = {},
                   .samples = {},
                   .motion = {},
                   .registers = {},
                   .signals = std::make_shared<test::CountingModel>()});
  start(emulator,
        config_of(SampleKind::none, "{interface: " + bus + ", dbc: " + folder.dbc() + ", node: Device}"));
  const std::string file = folder.file("bus.pcapng");
  ASSERT_EQ(run_tool({"dumpcap", "-q", "-i", bus, "-c", "100", "-w", file}), 0);
  EXPECT_TRUE(emulator.stop());
  // Once: it takes its time to start where the processor is emulated.
  ASSERT_EQ(run_tool({"tshark", "-n", "-r", file, "-T", "fields", "-e", "frame.number", "-e", "can.id", "-e",
                      "_ws.malformed", "-e", "_ws.expert.message"},
                     folder.file("dissected")),
            0);
  std::ifstream dissected(folder.file("dissected"));
  int frames = 0, clocks = 0;
  for (std::string line; std::getline(dissected, line); ++frames) {
    const auto id = line.find('\t');
    ASSERT_NE(id, std::string::npos) << line;
    const auto rest = line.find('\t', id + 1);
    ASSERT_NE(rest, std::string::npos) << line;
    clocks += std::stoul(line.substr(id + 1, rest - id - 1), nullptr, 0) == 0x100;
    EXPECT_EQ(line.find_first_not_of('\t', rest), std::string::npos) << line;
  }
  EXPECT_EQ(frames, 100);
  EXPECT_GT(clocks, 0);
}

}  // namespace
}  // namespace rigor::can
