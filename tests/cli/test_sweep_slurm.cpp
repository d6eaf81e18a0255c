// `rigor sweep --slurm` on a Slurm of the test's own: munged, slurmctld and slurmd of Debian with their files
// in a temporary folder and on free ports.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <functional>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "tests/cli/sweep_fixture.h"

namespace rigor::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr std::chrono::seconds kPatience{60};

bool installed(const std::string& program) {
  for (const char* folder : {"/usr/sbin/", "/usr/bin/"})
    if (::access((folder + program).c_str(), X_OK) == 0) return true;
  return false;
}

/// A port that was free a moment ago.
int free_port() {
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  EXPECT_EQ(::bind(fd, reinterpret_cast<sockaddr*>(&address), size), 0);
  EXPECT_EQ(::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size), 0);
  ::close(fd);
  return ntohs(address.sin_port);
}

bool wait_for(const std::function<bool()>& there) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!there() && std::chrono::steady_clock::now() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  return there();
}

/// A cluster of one node with two processors; it ends with this.
class Slurm {
 public:
  /// `most_tasks`: of a job array.
  explicit Slurm(int most_tasks) {
    fs::create_directories(dir / "spool");
    fs::create_directories(dir / "state");
    ::chmod(dir.path().c_str(), 0700);
    std::string key;
    std::random_device random;
    for (int i = 0; i < 128; ++i) key += static_cast<char>(random());
    write_file(dir / "key", key);
    ::chmod((dir / "key").c_str(), 0400);
    std::string host(256, '\0');
    ::gethostname(host.data(), host.size() - 1);
    host = host.substr(0, std::min(host.find('.'), host.find('\0')));
    const std::string at = dir.path().string() + "/";
    write_file(
        dir / "slurm.conf",
        "ClusterName=test\nSlurmctldHost=" + host +
            "(127.0.0.1)\nSlurmctldPort=" + std::to_string(free_port()) +
            "\nSlurmdPort=" + std::to_string(free_port()) + "\nAuthType=auth/munge\nAuthInfo=socket=" + at +
            "munge.sock\nCredType=cred/munge\n"
            "SlurmUser=root\nSlurmdUser=root\nStateSaveLocation=" +
            at + "state\nSlurmdSpoolDir=" + at + "spool\nSlurmctldPidFile=" + at +
            "slurmctld.pid\nSlurmdPidFile=" + at + "slurmd.pid\nSlurmctldLogFile=" + at +
            "slurmctld.log\nSlurmdLogFile=" + at +
            "slurmd.log\nProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\n"
            "JobAcctGatherType=jobacct_gather/none\nAccountingStorageType=accounting_storage/none\n"
            "JobCompType=jobcomp/none\nSelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\n"
            "MpiDefault=none\nReturnToService=2\nMailProg=/bin/true\nSchedulerParameters=sched_interval=1,"
            "batch_sched_delay=0,sched_min_interval=0\nMaxArraySize=" +
            std::to_string(most_tasks) + "\nNodeName=" + host +
            " NodeAddr=127.0.0.1 CPUs=2 RealMemory=64 State=UNKNOWN\n"
            "PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP\n");
    ::setenv("SLURM_CONF", (at + "slurm.conf").c_str(), 1);
    run({"munged", "--force", "--key-file=" + at + "key", "--socket=" + at + "munge.sock",
         "--pid-file=" + at + "munged.pid", "--log-file=" + at + "munged.log", "--seed-file=" + at + "seed"});
    run({"slurmctld", "-f", at + "slurm.conf"});
    run({"slurmd", "-f", at + "slurm.conf"});
    up_ = wait_for([] {
      return Command({"sinfo", "--noheader", "--format", "%T"}).wait().out.find("idle") != std::string::npos;
    });
  }
  ~Slurm() {
    (void)Command({"scancel", "--user", "root"}).wait();
    for (const char* name : {"slurmd", "slurmctld", "munged"}) {
      const int pid = std::atoi(read_file(dir / (std::string(name) + ".pid")).c_str());
      if (pid <= 1) continue;
      ::kill(pid, SIGTERM);
      if (!wait_for([&] { return ::kill(pid, 0) != 0; })) ::kill(pid, SIGKILL);
    }
    ::unsetenv("SLURM_CONF");
  }
  Slurm(const Slurm&) = delete;
  Slurm& operator=(const Slurm&) = delete;
  [[nodiscard]] bool up() const { return up_; }
  [[nodiscard]] std::string logs() const {
    std::string all;
    for (const char* name : {"munged.log", "slurmctld.log", "slurmd.log"})
      if (std::error_code ec; fs::exists(dir / name, ec))
        all += std::string(name) + ":\n" + read_file(dir / name);
    return all;
  }

 private:
  static void run(const std::vector<std::string>& words) {
    std::vector<std::string> found = words;
    found.front() = "/usr/sbin/" + words.front();
    const Said said = Command(found).wait();
    EXPECT_EQ(said.status, 0) << words.front() << ": " << said.out << said.err;
  }
  TempDir dir;
  bool up_ = false;
};

class SweepOnSlurm : public Sweep {
 protected:
  void SetUp() override {
    for (const char* program : {"munged", "slurmctld", "slurmd", "sbatch"})
      if (!installed(program)) GTEST_SKIP() << program << " is not installed";
    if (::geteuid() != 0) GTEST_SKIP() << "Slurm is started as root alone";
  }
  [[nodiscard]] bool report_there() const {
    std::error_code ec;
    return fs::exists(out / "index.html", ec);
  }
};

TEST_F(SweepOnSlurm, GivesTheSameBytesAsHere) {
  const std::vector<std::string> words =
      more_runs({"--vary", "application.command=[sh, -c, exit 4],[sh, -c, \"kill -KILL $PPID; sleep 9\"]"});
  EXPECT_EQ(sweep(words).status, 1);
  const std::string here = read_file(out / "table.csv");
  ASSERT_EQ(table().size(), 2 * kRuns);
  fs::remove_all(out);

  const Slurm slurm(10);
  ASSERT_TRUE(slurm.up()) << slurm.logs();
  std::vector<std::string> submitted = words;
  submitted.insert(submitted.end(), {"--slurm", "--sbatch=--time=5", "--json"});
  const Said said = sweep(submitted);
  ASSERT_EQ(said.status, 0) << said.err;
  const json jobs = json::parse(said.out);
  EXPECT_EQ(jobs["tasks"], 10) << "as many as the array may have, for 24 runs";
  EXPECT_THAT(jobs["commands"][0].get<std::string>(), AllOf(HasSubstr("--array 0-9"), HasSubstr("--time=5")));
  EXPECT_THAT(jobs["commands"][1].get<std::string>(),
              HasSubstr("afterany:" + jobs["array"].get<std::string>()));
  ASSERT_TRUE(wait_for([&] { return report_there(); }))
      << Command({"squeue"}).wait().out << slurm.logs() << read_file(out / "slurm" / "report.txt");
  EXPECT_EQ(read_file(out / "table.csv"), here);
}

TEST_F(SweepOnSlurm, MakesTheRunsThatAreMissing) {
  ASSERT_EQ(sweep(more_runs({})).status, 0);
  const std::string here = read_file(out / "table.csv");
  for (const char* row : {"000003", "000007", "000008"})
    fs::remove(out / "runs" / (std::string(row) + ".json"));
  for (const char* name : {"table.csv", "index.html"}) fs::remove(out / name);
  const Slurm slurm(1001);
  ASSERT_TRUE(slurm.up()) << slurm.logs();
  const Said said = go_on({"--slurm", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(json::parse(said.out)["commands"][0].get<std::string>(), HasSubstr("--array 3,7-8"));
  ASSERT_TRUE(wait_for([&] { return report_there(); })) << slurm.logs();
  EXPECT_EQ(read_file(out / "table.csv"), here);

  const Said refused = go_on({"--slurm", "--sbatch=--partition=none"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, AllOf(HasSubstr("sbatch refused"), HasSubstr("partition")));
}

TEST_F(Sweep, WithoutSlurmSaysThatItIsNotThere) {
  const Said said = Command({"/usr/bin/env", "PATH=/nowhere", rigor_words({}).front(), "sweep", "rig.yaml",
                             "-o", "out", "--slurm"},
                            dir.path())
                        .wait();
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("expected Slurm's command scontrol on the path"));
}

}  // namespace
}  // namespace rigor::test
