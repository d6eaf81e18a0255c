#include "rt-core/trace.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>

#include "rt-core/executive.h"

namespace rigor {
namespace {

class TraceTest : public testing::Test {
 protected:
  TraceTest() : path_(testing::TempDir() + "rigor_trace_" + std::to_string(getpid()) + ".json") {}
  ~TraceTest() override { unlink(path_.c_str()); }
  nlohmann::json written(const Trace& trace) {
    const Status s = trace.write(path_);
    EXPECT_TRUE(s) << s.error().text();
    std::ifstream file(path_);
    return nlohmann::json::parse(file);
  }
  std::string path_;
};

TEST_F(TraceTest, IsJsonThatHoldsWhatWasRecorded) {
  Trace trace;
  const TraceName grab = trace.name("grab \"left\"\n\\");
  EXPECT_EQ(trace.name("grab \"left\"\n\\"), grab);
  const TraceName depth = trace.name("depth");
  TraceThread& t = trace.thread("camera", 100);
  t.begin_at(grab, 1'234'567'890'123'457);
  t.counter_at(depth, 1'234'567'890'123'458, 2.5);
  t.counter_at(depth, 1'234'567'890'123'459, std::numeric_limits<double>::quiet_NaN());
  t.instant(depth);
  t.end_at(grab, 1'234'567'890'200'000);
  const auto json = written(trace);
  const auto& events = json.at("traceEvents");
  ASSERT_EQ(events.size(), 2u + 5u);
  EXPECT_EQ(events[1]["args"]["name"], "camera");
  EXPECT_EQ(events[2]["ph"], "B");
  EXPECT_EQ(events[2]["name"], "grab \"left\"\n\\");
  EXPECT_NEAR(events[2]["ts"].get<double>(), 1'234'567'890'123.457, 1e-3);
  EXPECT_EQ(events[3]["args"]["value"], 2.5);
  EXPECT_EQ(events[6]["ph"], "E");
  EXPECT_EQ(json["otherData"]["dropped_events"], "0");
}

TEST_F(TraceTest, AFullBufferDropsCountsAndKeepsSpansWhole) {
  Trace trace;
  const TraceName outer = trace.name("outer"), inner = trace.name("inner");
  TraceThread& t = trace.thread("loop", 9);
  t.begin_at(outer, 0);
  for (int i = 0; i < 10; ++i) {
    t.begin_at(inner, 10 * i + 1);
    t.instant_at(inner, 10 * i + 2);
    t.end_at(inner, 10 * i + 3);
  }
  t.end_at(outer, 1000);
  t.end_at(outer, 1001);  // has no begin
  EXPECT_EQ(t.recorded() + t.dropped(), 2u + 30u + 1u);
  EXPECT_GT(t.dropped(), 0u);
  const auto json = written(trace);
  int depth = 0, most = 0;
  std::string last;
  for (const auto& e : json["traceEvents"]) {
    if (e["ph"] == "B") most = std::max(most, ++depth);
    if (e["ph"] == "E") --depth, last = e["name"];
    EXPECT_GE(depth, 0);
  }
  EXPECT_EQ(depth, 0);
  EXPECT_EQ(most, 2);
  EXPECT_EQ(last, "outer");
  EXPECT_EQ(json["otherData"]["dropped_events"], std::to_string(t.dropped()));
}

TEST_F(TraceTest, TheExecutiveTracesItsSteps) {
  Trace trace;
  ExecutiveConfig c;
  c.cycles = 20;
  c.period = milliseconds(1);
  c.trace = &trace;
  Executive loop(c);
  ASSERT_TRUE(loop.add_step({.name = "poll"}, [](const CycleContext&) noexcept {}));
  ASSERT_TRUE(loop.arm());
  ASSERT_TRUE(loop.run({}, bench_now() + milliseconds(150)));
  int begun = 0, wakes = 0;
  const auto json = written(trace);
  for (const auto& e : json["traceEvents"]) {
    begun += e["ph"] == "B" && e["name"] == "poll";
    wakes += e["ph"] == "C";
  }
  EXPECT_GT(begun, 0);
  EXPECT_EQ(begun, wakes);
}

TEST_F(TraceTest, HasRoomForTheWholeRunAndSaysSinceWhenItIsFull) {
  Trace trace;
  Executive loop({.clock = RunClock::virtual_time, .cycles = 100'000, .trace = &trace});
  for (const char* name : {"a", "b", "c", "d"})
    ASSERT_TRUE(loop.add_step({.name = name}, [](const CycleContext&) noexcept {}));
  ASSERT_TRUE(loop.arm());
  StopSource stop;
  ASSERT_TRUE(loop.run(stop.token(), BenchTime{}));
  EXPECT_EQ(trace.dropped(), 0u);
  EXPECT_FALSE(trace.full_since_ns());

  Trace small;
  const TraceName name = small.name("x");
  TraceThread& t = small.thread("t", 2);
  for (const std::int64_t t_ns : {10, 20, 30, 40}) t.instant_at(name, t_ns);
  EXPECT_EQ(small.dropped(), 2u);
  EXPECT_EQ(small.full_since_ns(), 30);
}

TEST_F(TraceTest, SaysWhereItCannotBeWritten) {
  const Trace trace;
  const Status s = trace.write("/nowhere/at/all.json");
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_writable);
  EXPECT_EQ(s.error().where, "/nowhere/at/all.json");
  const Status full = trace.write("/dev/full");
  ASSERT_FALSE(full);
  EXPECT_EQ(full.error().code, ErrorCode::disk_full);
}

}  // namespace
}  // namespace rigor
