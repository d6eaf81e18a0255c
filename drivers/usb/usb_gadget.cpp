#include "drivers/usb/usb_gadget.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <set>
#include <vector>

namespace rigor::usb {
namespace {

namespace fs = std::filesystem;

const fs::path kGadgets = "/sys/kernel/config/usb_gadget";
const fs::path kControllers = "/sys/class/udc";

/// configfs takes a value in one write, and says by errno what it thinks of it.
bool put(const fs::path& file, const std::string& text) {
  FILE* f = std::fopen(file.c_str(), "w");
  if (!f) return false;
  std::setvbuf(f, nullptr, _IONBF, 0);
  const bool good =
      text.empty() ? std::fputc('\n', f) != EOF : std::fwrite(text.data(), 1, text.size(), f) == text.size();
  const int error = errno;
  std::fclose(f);
  errno = error;
  return good;
}

std::string get(const fs::path& file) {
  std::ifstream in(file);
  std::string text;
  std::getline(in, text);
  return text;
}

std::vector<std::string> entries(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  for (const auto& e : fs::directory_iterator(folder, error)) names.push_back(e.path().filename());
  return names;
}

std::string hex(unsigned value) {
  char text[16];
  std::snprintf(text, sizeof text, "0x%04x", value);
  return text;
}

void remove_gadget(const fs::path& folder) {
  std::error_code error;
  if (!fs::exists(folder, error)) return;
  if (!get(folder / "UDC").empty()) (void)put(folder / "UDC", "");
  for (const std::string& c : entries(folder / "configs")) {
    const fs::path config = folder / "configs" / c;
    for (const std::string& f : entries(config))
      if (fs::is_symlink(config / f, error)) fs::remove(config / f, error);
    for (const std::string& s : entries(config / "strings")) fs::remove(config / "strings" / s, error);
    fs::remove(config, error);
  }
  for (const std::string& f : entries(folder / "functions")) fs::remove(folder / "functions" / f, error);
  for (const std::string& s : entries(folder / "strings")) fs::remove(folder / "strings" / s, error);
  fs::remove(folder, error);
}

}  // namespace

std::string gadget_obstacle() {
  std::error_code error;
  if (::geteuid() != 0) return "only root may make USB gadgets: run it with sudo";
  if (!fs::exists(kGadgets, error))
    return "the kernel has no USB gadgets: sudo modprobe libcomposite, and mount configfs at "
           "/sys/kernel/config";
  if (entries(kControllers).empty()) return "there is no USB device controller: sudo modprobe dummy_hcd";
  return {};
}

Status UsbGadget::create(const GadgetSettings& settings) {
  remove();
  settings_ = settings;
  if (const std::string why = gadget_obstacle(); !why.empty())
    return fail(ErrorCode::unavailable, settings.name, why);
  folder_ = kGadgets / settings.name;
  remove_gadget(folder_);
  std::error_code error;
  const auto failed = [&](const std::string& what) {
    const std::string why = error ? error.message() : std::strerror(errno);
    remove_gadget(folder_);
    folder_.clear();
    return fail(ErrorCode::unavailable, settings.name, "cannot make the USB gadget: " + what + ": " + why);
  };
  if (!fs::create_directory(folder_, error)) return failed(folder_);
  if (!put(folder_ / "idVendor", hex(settings.vendor)) ||
      !put(folder_ / "idProduct", hex(settings.product)) || !put(folder_ / "bcdUSB", "0x0200") ||
      !put(folder_ / "bDeviceClass", hex(settings.device_class)))
    return failed("its ids");
  const fs::path strings = folder_ / "strings/0x409";
  if (!fs::create_directory(strings, error)) return failed(strings);
  (void)put(strings / "manufacturer", settings.manufacturer);
  (void)put(strings / "product", settings.description);
  if (!settings.serial.empty()) (void)put(strings / "serialnumber", settings.serial);
  const fs::path function = folder_ / "functions" / settings.function;
  if (!fs::create_directory(function, error))
    return failed(function.string() + (settings.function.rfind("ffs", 0) == 0
                                           ? " (sudo modprobe usb_f_fs)"
                                           : " (sudo modprobe usb_f_acm)"));
  const fs::path config = folder_ / "configs/c.1";
  if (!fs::create_directory(config, error)) return failed(config);
  fs::create_directory_symlink(function, config / settings.function, error);
  if (error) return failed("the function in its configuration");
  return {};
}

Status UsbGadget::bind() {
  std::set<std::string> taken;
  for (const std::string& g : entries(kGadgets))
    if (const std::string udc = get(kGadgets / g / "UDC"); !udc.empty()) taken.insert(udc);
  std::vector<std::string> candidates = entries(kControllers);
  std::sort(candidates.begin(), candidates.end());
  if (!settings_.udc.empty())
    candidates = {settings_.udc};
  else if (!udc_.empty())
    candidates = {udc_};
  std::string why = "every USB device controller has a gadget already";
  for (const std::string& udc : candidates) {
    if (taken.count(udc) != 0) continue;
    if (put(folder_ / "UDC", udc)) {
      udc_ = udc;
      bound_ = true;
      return {};
    }
    why = udc + ": " + std::strerror(errno);
  }
  return fail(ErrorCode::unavailable, settings_.name, "cannot plug the USB gadget in: " + why);
}

void UsbGadget::unbind() noexcept {
  if (!bound_) return;
  (void)put(folder_ / "UDC", "");
  bound_ = false;
}

void UsbGadget::remove() noexcept {
  if (folder_.empty()) return;
  try {
    remove_gadget(folder_);
  } catch (...) {  // nothing that a destructor could do about it
  }
  folder_.clear();
  bound_ = false;
}

Result<int> UsbGadget::acm_port() const {
  const std::string text = get(folder_ / "functions" / settings_.function / "port_num");
  if (text.empty()) return fail(ErrorCode::unavailable, settings_.name, "the gadget's function has no port");
  return std::atoi(text.c_str());
}

}  // namespace rigor::usb
