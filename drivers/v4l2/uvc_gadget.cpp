#include "drivers/v4l2/uvc_gadget.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <utility>

#include "drivers/v4l2/device_table.h"
#include "rt-core/file_descriptor.h"

namespace rigor::v4l2 {
namespace {

namespace fs = std::filesystem;
constexpr const char* kFunction = "uvc.rigor";

/// Collects the first error, so that the tree below reads as what it makes.
class Tree {
 public:
  explicit Tree(fs::path root) : root_(std::move(root)) {}
  void folder(const std::string& path) {
    if (!status_) return;
    std::error_code error;
    fs::create_directories(root_ / path, error);
    if (error) note(path, error.message());
  }
  void write(const std::string& path, std::string_view value) {
    if (!status_) return;
    const FileDescriptor fd(open((root_ / path).c_str(), O_WRONLY | O_CLOEXEC));
    if (!fd || ::write(fd.get(), value.data(), value.size()) != static_cast<ssize_t>(value.size()))
      note(path, std::strerror(errno));
  }
  void write(const std::string& path, std::uint64_t value) { write(path, std::to_string(value)); }
  void link(const std::string& target, const std::string& path) {
    if (!status_) return;
    std::error_code error;
    fs::create_symlink(root_ / target, root_ / path, error);
    if (error) note(path, error.message());
  }
  [[nodiscard]] Status status() const { return status_; }

 private:
  void note(const std::string& path, const std::string& why) {
    status_ = fail(
        ErrorCode::unavailable, (root_ / path).string(),
        "cannot set up the USB gadget: " + why +
            "; it needs root and the modules libcomposite and usb_f_uvc (rigor doctor says what is missing)");
  }
  fs::path root_;
  Status status_;
};

std::string read_line(const fs::path& file) {
  std::string line;
  std::ifstream in(file);
  std::getline(in, line);
  return line;
}

/// Folders and links of configfs go from the inside out; what the kernel made itself goes by itself.
void take_down(const fs::path& folder) noexcept {
  std::error_code ignored;
  std::vector<fs::path> inner;
  for (const auto& e : fs::directory_iterator(folder, ignored)) {
    if (e.is_symlink(ignored))
      unlink(e.path().c_str());
    else if (e.is_directory(ignored))
      inner.push_back(e.path());
  }
  for (const fs::path& p : inner) take_down(p);
  rmdir(folder.c_str());
}

}  // namespace

std::vector<std::uint8_t> uvc_guid(std::uint32_t code) {
  // "Universal Serial Bus Device Class Definition for Video Devices: Uncompressed Payload", 2.3; the rest as
  // the kernel has them (include/linux/usb/uvc.h): FourCC-0000-0010-8000-00aa00389b71.
  const char* name = code == kYuyv   ? "YUY2"
                     : code == kUyvy ? "UYVY"
                     : code == kNv12 ? "NV12"
                     : code == kGrey ? "Y800"
                     : code == kY10  ? "Y10 "
                     : code == kY12  ? "Y12 "
                     : code == kY16  ? "Y16 "
                     : code == kZ16  ? "Z16 "
                                     : nullptr;
  if (!name) return {};
  std::vector<std::uint8_t> guid(name, name + 4);
  static constexpr std::array<std::uint8_t, 12> kRest{0x00, 0x00, 0x10, 0x00, 0x80, 0x00,
                                                      0x00, 0xaa, 0x00, 0x38, 0x9b, 0x71};
  guid.insert(guid.end(), kRest.begin(), kRest.end());
  return guid;
}

bool uvc_can(std::uint32_t code) { return code == kMjpg || !uvc_guid(code).empty(); }

std::vector<std::string> free_controllers() {
  std::vector<std::string> names;
  std::error_code ignored;
  for (const auto& e : fs::directory_iterator("/sys/class/udc", ignored))
    if (read_line(e.path() / "function").empty()) names.push_back(e.path().filename());
  std::sort(names.begin(), names.end());
  return names;
}

void remove_gadget(const fs::path& root) noexcept {
  std::error_code ignored;
  if (!fs::exists(root, ignored)) return;
  if (const FileDescriptor fd(open((root / "UDC").c_str(), O_WRONLY | O_CLOEXEC)); fd) {
    [[maybe_unused]] const auto n = ::write(fd.get(), "\n", 1);
  }
  // Links first: a class refers to a header, a header to formats, a configuration to the function.
  take_down(root / "configs");
  const fs::path function = root / "functions" / kFunction;
  for (const char* part : {"streaming/class", "control/class", "streaming/header", "streaming", "control"})
    take_down(function / part);
  take_down(root / "functions");
  take_down(root);
}

UvcGadget& UvcGadget::operator=(UvcGadget&& o) noexcept {
  std::swap(root_, o.root_);
  std::swap(controller_, o.controller_);
  std::swap(bound_, o.bound_);
  return *this;
}
UvcGadget::~UvcGadget() {
  if (root_.empty()) return;
  unbind();
  remove_gadget(root_);
}

Result<UvcGadget> UvcGadget::create(const UvcGadgetOptions& o) {
  std::error_code ignored;
  if (!fs::is_directory(o.configfs, ignored))
    return fail(
        ErrorCode::unavailable, o.configfs.string(),
        "expected configfs with USB gadgets: sudo modprobe libcomposite (and, without a device controller, "
        "dummy_hcd); sudo mount -t configfs none /sys/kernel/config");
  UvcGadget g;
  g.controller_ = o.controller;
  if (g.controller_.empty()) {
    const auto controllers = free_controllers();
    if (controllers.empty())
      return fail(
          ErrorCode::unavailable, "/sys/class/udc",
          "expected a USB device controller that is free, found none: sudo modprobe dummy_hcd gives one that "
          "is wired to this machine");
    g.controller_ = controllers.front();
  }
  for (const uvc::StreamFormat& f : o.offer.formats)
    if (!uvc_can(f.code))
      return fail(
          ErrorCode::bad_input, "formats",
          "expected formats that USB cameras have: YUYV, UYVY, NV12, GREY, Y10, Y12, Y16, Z16, MJPG; got " +
              fourcc_text(f.code));
  remove_gadget(o.configfs / o.name);
  g.root_ = o.configfs / o.name;
  Tree t(g.root_);
  t.folder("strings/0x409");
  t.write("idVendor", fmt::format("{:#06x}", o.vendor));
  t.write("idProduct", fmt::format("{:#06x}", o.product));
  // An interface association needs these, or hosts look at one interface alone.
  t.write("bDeviceClass", "0xEF"), t.write("bDeviceSubClass", "0x02"), t.write("bDeviceProtocol", "0x01");
  t.write("strings/0x409/manufacturer", o.manufacturer);
  t.write("strings/0x409/product", o.product_name);
  t.write("strings/0x409/serialnumber", o.serial);
  t.folder("configs/c.1/strings/0x409");
  t.write("configs/c.1/strings/0x409/configuration", "camera");
  const std::string f = std::string("functions/") + kFunction;
  t.folder(f);
  t.write(f + "/streaming_maxpacket", o.offer.payload_bytes);
  t.folder(f + "/control/header/h");
  t.link(f + "/control/header/h", f + "/control/class/fs/h");
  t.link(f + "/control/header/h", f + "/control/class/ss/h");
  t.folder(f + "/streaming/header/h");
  std::string intervals;
  for (const std::uint32_t i : o.offer.intervals) intervals += std::to_string(i) + "\n";
  // Formats are numbered in the order in which they are linked.
  for (std::size_t i = 0; i < o.offer.formats.size(); ++i) {
    const uvc::StreamFormat& s = o.offer.formats[i];
    const bool jpeg = s.code == kMjpg;
    const std::string format =
        f + (jpeg ? "/streaming/mjpeg/f" : "/streaming/uncompressed/f") + std::to_string(i);
    t.folder(format + "/frame");
    if (!jpeg) {
      const auto guid = uvc_guid(s.code);
      t.write(format + "/guidFormat",
              std::string_view(reinterpret_cast<const char*>(guid.data()), guid.size()));
      t.write(format + "/bBitsPerPixel", s.code == kNv12 ? 12U : s.code == kGrey ? 8U : 16U);
    }
    t.write(format + "/frame/wWidth", s.width_px);
    t.write(format + "/frame/wHeight", s.height_px);
    t.write(format + "/frame/dwMaxVideoFrameBufferSize", s.frame_bytes);
    const std::uint64_t bits_per_s =
        std::uint64_t{s.frame_bytes} * 8 * 10'000'000 / o.offer.intervals.front();
    t.write(format + "/frame/dwMinBitRate", std::min<std::uint64_t>(bits_per_s, 0xFFFFFFFF));
    t.write(format + "/frame/dwMaxBitRate", std::min<std::uint64_t>(bits_per_s, 0xFFFFFFFF));
    t.write(format + "/frame/dwDefaultFrameInterval", o.offer.intervals.front());
    t.write(format + "/frame/dwFrameInterval", intervals);
    t.link(format, f + "/streaming/header/h/f" + std::to_string(i));
  }
  for (const char* speed : {"fs", "hs", "ss"})
    t.link(f + "/streaming/header/h", f + "/streaming/class/" + speed + "/h");
  t.link(f, "configs/c.1/uvc");
  if (auto s = t.status(); !s) return tl::unexpected<Error>(s.error());
  return g;
}

Status UvcGadget::bind() {
  const auto refused = [&](ErrorCode code, const char* more) {
    return fail(
        code, controller_,
        std::string("the USB device controller does not take the camera: usb_f_uvc streams "
                    "isochronously, and needs a controller with an isochronous endpoint that no other "
                    "gadget holds; ") +
            more);
  };
  // Not left to the kernel where it is known: a camera that was refused leaves the controller switched off,
  // and the next gadget there is not seen (Linux 6.1: usb_add_function does not take its deactivation back).
  std::ifstream about("/sys/class/udc/" + controller_ + "/uevent");
  for (std::string line; std::getline(about, line);)
    if (line == "USB_UDC_NAME=dummy_udc") return refused(ErrorCode::unavailable, "dummy_hcd has none");
  Tree t(root_);
  t.write("UDC", controller_);
  if (auto s = t.status(); !s) return refused(s.error().code, "the kernel's log says which it was");
  bound_ = true;
  return {};
}

void UvcGadget::unbind() noexcept {
  if (!bound_) return;
  Tree t(root_);
  t.write("UDC", "\n");
  bound_ = false;
}

Result<std::string> UvcGadget::node() const {
  std::error_code ignored;
  const std::string device = fs::canonical("/sys/class/udc/" + controller_ + "/device", ignored).string();
  for (const auto& e : fs::directory_iterator("/sys/class/video4linux", ignored)) {
    const std::string at = fs::canonical(e.path(), ignored).string();
    if (!device.empty() && at.starts_with(device + "/") && fs::exists(e.path() / "function_name", ignored))
      return "/dev/" + e.path().filename().string();
  }
  return fail(ErrorCode::unavailable, root_.string(), "the kernel made no video node for the USB gadget");
}

}  // namespace rigor::v4l2
