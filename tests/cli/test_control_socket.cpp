// Asking a run over its control socket: a request that comes again is done once, and one that stays without
// an answer is told.
#include "cli/control_socket.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <future>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

TEST(ControlCommands, ARequestThatComesAgainIsDoneOnce) {
  ControlCommands commands;
  int count = 0;
  commands.add("count", [&](const json&) -> Result<json> { return json{{"count", ++count}}; });
  commands.add("refuse", [&](const json&) -> Result<json> {
    ++count;
    return fail(ErrorCode::bad_input, "", "no");
  });
  const std::string first = commands.answer(R"({"command": "count", "id": "a"})");
  EXPECT_EQ(json::parse(first)["result"]["count"], 1);
  EXPECT_EQ(commands.answer(R"({"command": "count", "id": "a"})"), first);
  EXPECT_EQ(json::parse(commands.answer(R"({"command": "count", "id": "b"})"))["result"]["count"], 2);
  EXPECT_EQ(json::parse(commands.answer(R"({"command": "count"})"))["result"]["count"], 3);
  EXPECT_EQ(json::parse(commands.answer(R"({"command": "count"})"))["result"]["count"], 4);
  // What was refused stays refused.
  const std::string refused = commands.answer(R"({"command": "refuse", "id": "c"})");
  EXPECT_EQ(commands.answer(R"({"command": "refuse", "id": "c"})"), refused);
  EXPECT_EQ(count, 5);
  // Not for ever.
  for (int i = 0; i < 64; ++i)
    (void)commands.answer(json{{"command", "count"}, {"id", std::to_string(i)}}.dump());
  EXPECT_NE(commands.answer(R"({"command": "count", "id": "a"})"), first);
}

class ControlSockets : public ::testing::Test {
 protected:
  void SetUp() override { setenv("XDG_RUNTIME_DIR", dir.path().c_str(), 1); }
  void TearDown() override { unsetenv("XDG_RUNTIME_DIR"); }
  TempDir dir;
  const std::string me = std::to_string(getpid());
};

TEST_F(ControlSockets, WhoeverHadNoAnswerInTimeAsksAgainAndIsAnsweredOnce) {
  ControlCommands commands;
  std::atomic<int> count{0};
  std::promise<void> asked_again;
  const auto until_asked_again = asked_again.get_future();
  commands.add("slow", [&](const json&) -> Result<json> {
    ++count;
    until_asked_again.wait();
    return json{{"count", count.load()}};
  });
  auto socket = ControlSocket::open("slow", commands);
  ASSERT_TRUE(socket) << socket.error().text();
  testing::internal::CaptureStderr();
  auto answer = std::async(std::launch::async, [&] {
    return ask_bench(me, {{"command", "slow"}}, {.each = milliseconds(20), .times = 1000});
  });
  while (count == 0) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  answer.wait_for(std::chrono::milliseconds(600));
  asked_again.set_value();  // by now it has, some thirty times
  const auto got = answer.get();
  const std::string said = testing::internal::GetCapturedStderr();
  ASSERT_TRUE(got) << got.error().text();
  EXPECT_EQ((*got)["count"], 1);
  EXPECT_EQ(count, 1) << "it was done once";
  EXPECT_THAT(said, HasSubstr("no answer within 0.02 s; asking again"));
}

TEST_F(ControlSockets, ARunThatDoesNotAnswerIsToldAsSuch) {
  ControlCommands commands;
  std::promise<void> over;
  const auto until_over = over.get_future();
  commands.add("never", [&](const json&) -> Result<json> {
    until_over.wait();
    return json::object();
  });
  auto socket = ControlSocket::open("never", commands);
  ASSERT_TRUE(socket) << socket.error().text();
  testing::internal::CaptureStderr();
  const auto got = ask_bench(me, {{"command", "never"}}, {.each = milliseconds(50), .times = 2});
  (void)testing::internal::GetCapturedStderr();
  over.set_value();
  ASSERT_FALSE(got);
  EXPECT_EQ(got.error().code, ErrorCode::timeout);
  EXPECT_THAT(got.error().text(), HasSubstr("asked 2 times: no answer within 0.05 s; whether it did"));
}

TEST_F(ControlSockets, ARunThatIsGoneIsNotAskedAgain) {
  ControlCommands commands;
  {
    auto socket = ControlSocket::open("gone", commands);
    ASSERT_TRUE(socket) << socket.error().text();
    const auto path = (*socket)->path();
    socket->reset();
    // As a process leaves it that was killed; its number is that of a live process.
    write_file(path, "");
  }
  const auto got = ask_bench(me, {{"command", "run"}});
  ASSERT_FALSE(got);
  EXPECT_EQ(got.error().code, ErrorCode::io);
  EXPECT_THAT(got.error().text(), HasSubstr("does not answer"));
}

}  // namespace
}  // namespace rigor::test
