// The udev rules of tools/install/udev at work: devices that the kernel makes up get the names, groups and
// modes that the rules promise. Needs root, dummy_hcd with configfs, vivid, a running udev and the rules in
// its folders; the guest of the kernel lane has them all.
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <string>
#include <thread>

namespace rigor {
namespace {

namespace fs = std::filesystem;

bool there(const fs::path& path) {
  std::error_code error;
  return fs::exists(path, error);
}

/// What this machine lacks for these tests; empty when nothing.
std::string missing_here() {
  if (geteuid() != 0) return "you are not root";
  if (!there("/sys/class/udc/dummy_udc.0")) return "this kernel has no dummy_hcd";
  if (!there("/sys/kernel/config/usb_gadget")) return "this kernel has no USB gadgets by configfs";
  if (!there("/run/udev/control")) return "udev does not run";
  for (const char* folder : {"/run/udev/rules.d", "/etc/udev/rules.d", "/usr/lib/udev/rules.d"})
    if (there(fs::path(folder) / "60-rigor.rules")) return "";
  return "the udev rules are not installed";
}

/// Far longer than it takes; an emulated machine may be slow.
bool wait_for(const std::function<bool()>& seen) {
  for (int i = 0; i < 300; ++i) {
    if (seen()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  return false;
}

std::string text_of(const fs::path& file) {
  std::ifstream in(file);
  std::string text;
  std::getline(in, text);
  return text;
}

/// The device node of a USB device of that name; empty when there is none.
fs::path node_of_product(const std::string& product) {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator("/sys/bus/usb/devices", error)) {
    if (text_of(entry.path() / "product") != product) continue;
    std::ifstream in(entry.path() / "uevent");
    for (std::string line; std::getline(in, line);)
      if (line.starts_with("DEVNAME=")) return "/dev/" + line.substr(8);
  }
  return {};
}

std::string names_in(const fs::path& folder, const std::string& prefix) {
  std::string names;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.path().filename().string().starts_with(prefix)) names += entry.path().filename().string() + " ";
  return names.empty() ? "none" : names;
}

/// "group mode" of a device node, such as "video 660".
std::string access_to(const fs::path& node) {
  struct stat s {};
  if (stat(node.c_str(), &s) != 0) return "no " + node.string();
  const group* g = getgrgid(s.st_gid);
  char mode[8];
  std::snprintf(mode, sizeof mode, "%o", s.st_mode & 0777U);
  return (g != nullptr ? std::string(g->gr_name) : std::to_string(s.st_gid)) + " " + mode;
}

/// A USB device of the kernel's own making, seen by this machine as if it had been plugged in.
class AcmGadget {
 public:
  AcmGadget() {
    fs::create_directory(path_);
    set("idVendor", "0x15d1");
    set("idProduct", "0x0000");
    fs::create_directory(path_ / "strings/0x409");
    set("strings/0x409/product", "udev rule test");
    fs::create_directory(path_ / "configs/c.1");
    fs::create_directory(path_ / "functions/acm.rigor");
    fs::create_directory_symlink(path_ / "functions/acm.rigor", path_ / "configs/c.1/acm.rigor");
    set("UDC", "dummy_udc.0");
  }
  /// The first file that could not be written; empty when all were.
  [[nodiscard]] const std::string& problem() const { return problem_; }
  ~AcmGadget() {
    set("UDC", "\n");
    for (const char* part :
         {"configs/c.1/acm.rigor", "functions/acm.rigor", "configs/c.1", "strings/0x409", ""}) {
      std::error_code error;  // configfs removes folders that it filled itself by rmdir alone
      fs::remove(path_ / part, error);
    }
  }
  AcmGadget(const AcmGadget&) = delete;
  AcmGadget& operator=(const AcmGadget&) = delete;

 private:
  void set(const char* file, const char* value) {
    std::ofstream out(path_ / file);
    out << value << std::flush;
    if (!out && problem_.empty()) problem_ = (path_ / file).string() + " does not take " + value;
  }
  std::string problem_;
  fs::path path_ = "/sys/kernel/config/usb_gadget/rigor_udev_test";
};

class KernelUdevRules : public testing::Test {
 protected:
  void SetUp() override {
    const std::string missing = missing_here();
    if (missing.empty()) return;
    if (std::getenv("RIGOR_GUEST") != nullptr) FAIL() << "the guest must have it, but: " << missing;
    GTEST_SKIP() << missing;
  }
};

TEST_F(KernelUdevRules, AHokuyoScannerGetsItsNameAndItsGroupsWhilePlugged) {
  std::optional<AcmGadget> scanner(std::in_place);
  ASSERT_EQ(scanner->problem(), "");
  fs::path serial, device;
  ASSERT_TRUE(wait_for([&] {
    device = node_of_product("udev rule test");
    return !device.empty();
  })) << "the gadget is not on the bus";
  ASSERT_TRUE(wait_for([&] {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator("/dev/rigor", error))
      if (entry.path().filename().string().starts_with("hokuyo-ttyACM")) serial = entry.path();
    return !serial.empty();
  })) << "/dev/rigor has no hokuyo-ttyACM*; terminals: "
      << names_in("/sys/class/tty", "ttyACM");
  EXPECT_EQ(access_to(serial), "dialout 660");
  EXPECT_TRUE(wait_for([&] { return access_to(device) == "plugdev 660"; }))
      << device << " " << access_to(device);
  scanner.reset();
  EXPECT_TRUE(wait_for([&] { return !fs::is_symlink(serial); }))
      << "the name stays after the scanner has gone";
}

TEST_F(KernelUdevRules, CamerasBelongToGroupVideo) {
  int cameras = 0;
  for (const auto& entry : fs::directory_iterator("/sys/class/video4linux")) {
    if (!text_of(entry.path() / "name").starts_with("vivid")) continue;
    ++cameras;
    const fs::path node = fs::path("/dev") / entry.path().filename();
    EXPECT_TRUE(wait_for([&] { return access_to(node) == "video 660"; })) << node << " " << access_to(node);
  }
  if (cameras == 0 && std::getenv("RIGOR_GUEST") == nullptr) GTEST_SKIP() << "this kernel has no vivid";
  EXPECT_GT(cameras, 0);
}

TEST_F(KernelUdevRules, UsbTransfersGetTheirMemory) {
  EXPECT_EQ(text_of("/sys/module/usbcore/parameters/usbfs_memory_mb"), "256");
}

}  // namespace
}  // namespace rigor
