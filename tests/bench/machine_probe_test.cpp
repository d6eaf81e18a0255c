// What `rigor doctor` says about a machine, on machines of the test's own: a folder with the files that the
// kernel and the distribution would have.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>

#include "bench/run/machine_probe.h"
#include "tests/paths.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
using Level = DoctorFinding::Level;
using testing::HasSubstr;

class MachineProbe : public testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = testing::TempDir() + "/rigor-machine-XXXXXX";
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    machine.root = pattern;
    machine.kernel_release = "6.1.0-test";
    machine.groups = {"users", "dialout", "video", "plugdev"};
    write("proc/sys/net/core/rmem_max", "33554432\n");
    write("proc/sys/net/core/wmem_max", "8388608\n");
    write("sys/module/usbcore/parameters/usbfs_memory_mb", "256\n");
    write("etc/udev/rules.d/60-rigor.rules", "");
    for (const char* module : {"can", "vcan", "videodev", "uvcvideo", "v4l2loopback"})
      fs::create_directories(machine.root / "sys/module" / module);
    write("lib/modules/6.1.0-test/modules.builtin", "kernel/drivers/usb/class/cdc-acm.ko\n");
    write("lib/modules/6.1.0-test/modules.dep",
          "kernel/drivers/net/can/vcan.ko: kernel/drivers/net/can/dev.ko\n");
  }
  void TearDown() override { fs::remove_all(machine.root); }

  void write(const fs::path& file, const std::string& text) const {
    fs::create_directories((machine.root / file).parent_path());
    std::ofstream(machine.root / file) << text;
  }
  /// The one finding whose text holds `words`.
  [[nodiscard]] DoctorFinding about(const std::string& words) const {
    std::vector<DoctorFinding> found;
    for (auto& f : examine_machine(machine))
      if (f.what.find(words) != std::string::npos) found.push_back(f);
    EXPECT_EQ(found.size(), 1u) << words;
    return found.empty() ? DoctorFinding{} : found.front();
  }

  Machine machine;
};

TEST_F(MachineProbe, FindsNothingWrongWithAMachineThatHasAll) {
  for (const DoctorFinding& f : examine_machine(machine)) {
    EXPECT_EQ(f.level, Level::good) << f.what;
    EXPECT_EQ(f.cure, "") << f.what;
  }
}

TEST_F(MachineProbe, EverythingThatIsNotGoodHasACommandThatMendsIt) {
  machine.groups = {"users"};
  fs::remove_all(machine.root / "proc");
  fs::remove_all(machine.root / "sys");
  fs::remove_all(machine.root / "etc");
  fs::remove_all(machine.root / "lib");
  write("proc/sys/net/core/rmem_max", "212992\n");
  write("proc/sys/net/core/wmem_max", "212992\n");
  const auto all = examine_machine(machine);
  EXPECT_GE(all.size(), 12u);
  for (const DoctorFinding& f : all) {
    EXPECT_NE(f.level, Level::good) << f.what;
    EXPECT_NE(f.cure, "") << f.what;
  }
}

TEST_F(MachineProbe, SmallSocketBuffersAreMendedBySysctl) {
  write("proc/sys/net/core/rmem_max", "212992\n");
  const DoctorFinding by_hand = about("receive buffers");
  EXPECT_EQ(by_hand.level, Level::missing);
  EXPECT_THAT(by_hand.what, HasSubstr("208 KiB"));
  EXPECT_THAT(by_hand.cure, HasSubstr("sudo sysctl -w net.core.rmem_max=8388608"));

  machine.install_dir = machine.root / "share/rigor";
  write("share/rigor/sysctl/60-rigor-sysctl.conf", "");
  EXPECT_THAT(about("receive buffers").cure,
              HasSubstr("sudo cp " + (machine.install_dir / "sysctl/60-rigor-sysctl.conf").string()));
}

TEST_F(MachineProbe, TheInstalledSnippetGrantsWhatItAsksFor) {
  std::ifstream in(fs::path(rigor::test::source_dir()) / "tools/install/sysctl/60-rigor-sysctl.conf");
  ASSERT_TRUE(in);
  long rmem = 0, wmem = 0;
  for (std::string line; std::getline(in, line);) {
    const auto value = line.find('=');
    if (line.starts_with("net.core.rmem_max")) rmem = std::stol(line.substr(value + 1));
    if (line.starts_with("net.core.wmem_max")) wmem = std::stol(line.substr(value + 1));
  }
  EXPECT_GE(rmem, kWantedReceiveBytes);
  EXPECT_GE(wmem, kWantedSendBytes);
}

TEST_F(MachineProbe, GroupsCountForAllButRoot) {
  machine.groups = {"video"};
  EXPECT_EQ(about("group dialout").level, Level::missing);
  EXPECT_THAT(about("group dialout").cure, HasSubstr("usermod -aG dialout"));
  EXPECT_EQ(about("group video").level, Level::good);
  machine.root_user = true;
  for (const DoctorFinding& f : examine_machine(machine)) EXPECT_EQ(f.level, Level::good) << f.what;
}

TEST_F(MachineProbe, ModulesAreThereLoadableOrAbsent) {
  EXPECT_EQ(about("module cdc_acm").level, Level::good) << "built in, listed with a hyphen";
  fs::remove_all(machine.root / "sys/module/vcan");
  EXPECT_EQ(about("module vcan").level, Level::note);
  EXPECT_THAT(about("module vcan").cure, HasSubstr("sudo modprobe vcan"));
  fs::remove_all(machine.root / "sys/module/v4l2loopback");
  EXPECT_THAT(about("module v4l2loopback").what, HasSubstr("kernel 6.1.0-test has no module v4l2loopback"));
  EXPECT_THAT(about("module v4l2loopback").cure, HasSubstr("v4l2loopback-dkms"));
}

TEST_F(MachineProbe, UsbMemory) {
  write("sys/module/usbcore/parameters/usbfs_memory_mb", "16\n");
  EXPECT_EQ(about("USB transfers together").level, Level::note);
  EXPECT_THAT(about("USB transfers together").cure, HasSubstr("usbfs_memory_mb"));
  write("sys/module/usbcore/parameters/usbfs_memory_mb", "0\n");
  EXPECT_EQ(about("memory of USB transfers").level, Level::good) << "0 is no limit";
}

TEST_F(MachineProbe, UdevRulesAreCopiedFromWhereTheyWereInstalled) {
  fs::remove(machine.root / "etc/udev/rules.d/60-rigor.rules");
  EXPECT_EQ(about("udev rules are").level, Level::missing);
  machine.install_dir = machine.root / "share/rigor";
  write("share/rigor/udev/60-rigor.rules", "");
  EXPECT_THAT(
      about("udev rules are").cure,
      HasSubstr("sudo cp " + (machine.install_dir / "udev/60-rigor.rules").string() + " /etc/udev/rules.d/"));
}

TEST_F(MachineProbe, ThisMachineIsKnown) {
  const Machine here = this_machine();
  EXPECT_FALSE(here.kernel_release.empty());
  EXPECT_FALSE(examine_machine(here).empty());
}

}  // namespace
}  // namespace rigor
