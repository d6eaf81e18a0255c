// Asking a run over its control socket: a request that comes again is done once, and one that stays without
// an answer is told.
#include "bench/control/control_socket.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
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

TEST(ControlCommands, ARequestThatNestsTooDeeplyIsRefusedBeforeAnyHandlerSeesIt) {
  ControlCommands commands;
  commands.add("echo", [](const json& request) -> Result<json> { return request; });
  const std::size_t levels = 500'000;
  const std::string answer = commands.answer(R"({"command": "echo", "id": "a", "fault": )" +
                                             std::string(levels, '[') + std::string(levels, ']') + "}");
  EXPECT_EQ(json::parse(answer)["error"]["code"], "bad_input");
  EXPECT_THAT(answer, HasSubstr("nested at most 64 levels"));
}

class ControlSockets : public ::testing::Test {
 protected:
  void SetUp() override { setenv("XDG_RUNTIME_DIR", dir.path().c_str(), 1); }
  void TearDown() override { unsetenv("XDG_RUNTIME_DIR"); }
  TempDir dir;
  const std::string me = std::to_string(getpid());
};

/// A socket file at which nobody listens.
void leave_socket(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  ASSERT_LT(path.native().size(), sizeof address.sun_path);
  std::copy(path.native().begin(), path.native().end(), address.sun_path);
  const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
  ASSERT_EQ(bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  close(fd);
}

TEST_F(ControlSockets, WhatDeadRunsLeftIsRemovedWhenARunBegins) {
  std::filesystem::create_directory(dir / "rigor");
  std::filesystem::permissions(dir / "rigor", std::filesystem::perms::owner_all);
  const pid_t child = fork();
  if (child == 0) _exit(0);
  waitpid(child, nullptr, 0);
  const auto dead = dir / ("rigor/dead." + std::to_string(child) + ".sock");
  // Its number belongs to another process by now: to this one's parent, say.
  const auto reused = dir / ("rigor/reused." + std::to_string(getppid()) + ".sock");
  const auto fresh = dir / ("rigor/fresh." + std::to_string(getppid()) + ".sock");
  for (const auto& path : {dead, reused, fresh}) leave_socket(path);
  const timespec old[2] = {{1'000'000'000, 0}, {1'000'000'000, 0}};
  ASSERT_EQ(utimensat(AT_FDCWD, reused.c_str(), old, 0), 0);
  ControlCommands commands;
  const auto socket = ControlSocket::open("me", commands);
  ASSERT_TRUE(socket) << socket.error().text();
  EXPECT_FALSE(std::filesystem::exists(dead));
  EXPECT_FALSE(std::filesystem::exists(reused));
  EXPECT_TRUE(std::filesystem::exists(fresh)) << "it may be about to listen";
}

TEST_F(ControlSockets, AFolderThatIsNotThisUsersIsRefusedAloud) {
  std::filesystem::create_directory_symlink("/etc", dir / "rigor");
  write_file(dir / "rig.yaml", "name: none\nclock: virtual\nduration_s: 0.01\n");
  const Said run = rigor({"run", "rig.yaml"}, dir.path());
  EXPECT_EQ(run.status, 0) << run.err;
  EXPECT_THAT(run.err, HasSubstr("warning: no `rigor fault` for this run: "));
  EXPECT_THAT(run.err, HasSubstr("it is no folder; remove it, or set XDG_RUNTIME_DIR"));
  const Said fault = rigor({"fault", "any", "eye", "drop"});
  EXPECT_EQ(fault.status, 1) << fault.err;
  EXPECT_THAT(fault.err, HasSubstr("it is no folder"));
}

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
