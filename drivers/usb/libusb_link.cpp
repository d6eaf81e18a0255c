#include "drivers/usb/libusb_link.h"

#include <libusb.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdio>
#include <cstring>
#include <deque>

#include "rt-core/device_text.h"

namespace rigor::usb {
namespace {

constexpr std::size_t kTransfers = 8, kTransferBytes = 16 * 1024;
constexpr unsigned kSendLimit_ms = 500, kControlLimit_ms = 500;
constexpr unsigned kErrorsInARow = 8;
constexpr std::uint8_t kToInterface = 0x21;  // class request, host to interface
// USB CDC 1.2, PSTN subclass: requests of an abstract control model.
constexpr std::uint8_t kSetLineCoding = 0x20, kSetControlLineState = 0x22;

std::string path_of(libusb_device* device) {
  std::array<std::uint8_t, 8> ports{};
  const int n = libusb_get_port_numbers(device, ports.data(), static_cast<int>(ports.size()));
  std::string path = std::to_string(libusb_get_bus_number(device)) + "-";
  for (int i = 0; i < n; ++i) path += (i > 0 ? "." : "") + std::to_string(ports[static_cast<std::size_t>(i)]);
  return n > 0 ? path : path + "0";
}

std::string string_of(libusb_device_handle* handle, std::uint8_t index) {
  unsigned char text[256];
  if (index == 0) return {};
  const int n = libusb_get_string_descriptor_ascii(handle, index, text, sizeof text);
  return n > 0 ? device_text({reinterpret_cast<char*>(text), static_cast<std::size_t>(n)}) : std::string();
}

std::string ids_of(const UsbAddress& a) {
  char text[16];
  std::snprintf(text, sizeof text, "%04x:%04x", a.vendor, a.product);
  return text;
}

const char* access_cure() {
  return "no right to open it; install the rule that comes with Rigor (60-rigor.rules) into "
         "/etc/udev/rules.d, then: "
         "sudo udevadm control --reload && sudo udevadm trigger, and plug the device in again";
}

/// Interfaces and endpoints of what is to be read.
struct Way {
  int communication = -1, data = -1;
  std::uint8_t in = 0, out = 0;
};

bool is_bulk(const libusb_endpoint_descriptor& e) {
  return (e.bmAttributes & LIBUSB_TRANSFER_TYPE_MASK) == LIBUSB_ENDPOINT_TRANSFER_TYPE_BULK;
}

Way find_way(libusb_device* device, const UsbAddress& address) {
  Way way;
  libusb_config_descriptor* config = nullptr;
  if (libusb_get_active_config_descriptor(device, &config) != 0) return way;
  for (int i = 0; i < config->bNumInterfaces; ++i) {
    if (config->interface[i].num_altsetting < 1) continue;
    const libusb_interface_descriptor& d = config->interface[i].altsetting[0];
    if (address.interface < 0) {
      if (d.bInterfaceClass == LIBUSB_CLASS_COMM && d.bInterfaceSubClass == 2 && way.communication < 0)
        way.communication = d.bInterfaceNumber;
      if (d.bInterfaceClass != LIBUSB_CLASS_DATA || way.data >= 0) continue;
    } else if (d.bInterfaceNumber != address.interface) {
      continue;
    }
    for (int k = 0; k < d.bNumEndpoints; ++k) {
      const libusb_endpoint_descriptor& e = d.endpoint[k];
      if (!is_bulk(e)) continue;
      const bool in = (e.bEndpointAddress & LIBUSB_ENDPOINT_IN) != 0;
      if (in && (address.endpoint == 0 || address.endpoint == e.bEndpointAddress))
        way.in = e.bEndpointAddress;
      if (!in) way.out = e.bEndpointAddress;
    }
    if (way.in != 0) way.data = d.bInterfaceNumber;
  }
  libusb_free_config_descriptor(config);
  return way;
}

class LibusbLink final : public ByteLink {
 public:
  explicit LibusbLink(UsbAddress address) : address_(std::move(address)) {
    for (Transfer& t : transfers_) t.owner = this;
  }
  ~LibusbLink() override {
    LibusbLink::close();
    for (Transfer& t : transfers_)
      if (t.transfer) libusb_free_transfer(t.transfer);
    if (!context_) return;
    if (hotplug_) libusb_hotplug_deregister_callback(context_, callback_);
    if (!leaked_) libusb_exit(context_);
  }

  [[nodiscard]] std::string name() const override {
    return "USB " + ids_of(address_) + (path_.empty() ? "" : " at " + path_);
  }
  [[nodiscard]] bool is_open() const noexcept override { return handle_ != nullptr; }
  [[nodiscard]] Counters counters() const override { return counters_; }

  [[nodiscard]] Status open() override {
    close();
    if (auto s = make_context(); !s) return s;
    arrived_ = false;
    libusb_device** list = nullptr;
    const ssize_t n = libusb_get_device_list(context_, &list);
    Status result = fail(ErrorCode::not_found, name(), not_found());
    for (ssize_t i = 0; i < n && !handle_; ++i) {
      libusb_device_descriptor d{};
      if (libusb_get_device_descriptor(list[i], &d) != 0 || d.idVendor != address_.vendor ||
          d.idProduct != address_.product)
        continue;
      if (!address_.path.empty() && path_of(list[i]) != address_.path) continue;
      if (auto s = open_device(list[i], d); !s)
        result = s;
      else
        result = {};
    }
    if (n >= 0) libusb_free_device_list(list, 1);
    return result;
  }

  void close() noexcept override {
    if (!handle_) return;
    take_back();
    if (way_.communication >= 0 && !gone_)
      libusb_control_transfer(handle_, kToInterface, kSetControlLineState, 0,
                              static_cast<std::uint16_t>(way_.communication), nullptr, 0, kControlLimit_ms);
    release();
    libusb_close(handle_);
    handle_ = nullptr;
    done_.clear();
  }

  [[nodiscard]] bool send(std::string_view bytes) override {
    std::string copy(bytes);
    std::size_t at = 0;
    for (int tries = 0; at < copy.size() && tries < 3; ++tries) {
      int n = 0;
      const int e =
          libusb_bulk_transfer(handle_, way_.out, reinterpret_cast<unsigned char*>(copy.data()) + at,
                               static_cast<int>(copy.size() - at), &n, kSendLimit_ms);
      at += static_cast<std::size_t>(std::max(0, n));
      if (e == 0) continue;
      if (e != LIBUSB_ERROR_PIPE) return false;
      ++counters_.stalls;
      if (libusb_clear_halt(handle_, way_.out) != 0) return false;
    }
    return at == copy.size() && !gone_;
  }

  [[nodiscard]] Received receive(std::span<char> into, MonotonicTime until) override {
    Received r;
    while (true) {
      if (cut_.load(std::memory_order_acquire)) {
        r.state = State::cut;
        return r;
      }
      if (!done_.empty()) {
        Transfer& t = *done_.front();
        const std::size_t left = static_cast<std::size_t>(t.transfer->actual_length) - t.taken;
        r.bytes = std::min(left, into.size());
        std::memcpy(into.data(), t.buffer.data() + t.taken, r.bytes);
        t.taken += r.bytes;
        r.arrival = t.arrival;
        r.state = State::data;
        if (r.bytes == left) {
          done_.pop_front();
          submit(t);
        }
        return r;
      }
      if (stalled_ && !gone_) clear_stall();
      if (gone_) {
        r.state = State::gone;
        return r;
      }
      const MonotonicTime now = monotonic_now();
      if (now >= until) return r;
      handle_events(until - now);
    }
  }

  [[nodiscard]] bool wait(MonotonicTime until) override {
    while (!cut_.load(std::memory_order_acquire) && !arrived_) {
      const MonotonicTime now = monotonic_now();
      if (now >= until) return true;
      handle_events(until - now);
    }
    return !cut_.load(std::memory_order_acquire);
  }
  void cut() noexcept override {
    cut_.store(true, std::memory_order_release);
    if (context_) libusb_interrupt_event_handler(context_);
  }
  void uncut() noexcept override { cut_.store(false, std::memory_order_release); }

 private:
  struct Transfer {
    LibusbLink* owner = nullptr;
    libusb_transfer* transfer = nullptr;
    std::vector<unsigned char> buffer;
    std::size_t taken = 0;
    MonotonicTime arrival;
    bool in_flight = false;
  };

  Status make_context() {
    if (context_) return {};
    if (const int e = libusb_init(&context_); e != 0) {
      context_ = nullptr;
      return fail(
          ErrorCode::unavailable, name(),
          std::string("libusb cannot start: ") + libusb_strerror(e) + "; is there a USB bus (/dev/bus/usb)?");
    }
    hotplug_ = libusb_has_capability(LIBUSB_CAP_HAS_HOTPLUG) != 0 &&
               libusb_hotplug_register_callback(
                   context_, LIBUSB_HOTPLUG_EVENT_DEVICE_ARRIVED | LIBUSB_HOTPLUG_EVENT_DEVICE_LEFT, 0,
                   address_.vendor, address_.product, LIBUSB_HOTPLUG_MATCH_ANY, on_hotplug, this,
                   &callback_) == LIBUSB_SUCCESS;
    return {};
  }

  [[nodiscard]] std::string not_found() const {
    std::string text = "expected a device " + ids_of(address_);
    if (!address_.path.empty()) text += " at " + address_.path;
    if (!address_.serial.empty()) text += " with the serial " + address_.serial;
    return text + ", found none; plug it in, or look at what is there with: rigor devices";
  }

  Status open_device(libusb_device* device, const libusb_device_descriptor& d) {
    libusb_device_handle* handle = nullptr;
    path_ = path_of(device);
    if (const int e = libusb_open(device, &handle); e != 0)
      return fail(
          ErrorCode::unavailable, name(),
          e == LIBUSB_ERROR_ACCESS ? access_cure() : std::string("cannot open it: ") + libusb_strerror(e));
    // Many scanners have no serial number on USB; then it is for the protocol to ask.
    if (!address_.serial.empty()) {
      const std::string serial = string_of(handle, d.iSerialNumber);
      if (!serial.empty() && serial != address_.serial) {
        libusb_close(handle);
        return fail(ErrorCode::not_found, name(), not_found() + "; there is one with the serial " + serial);
      }
    }
    way_ = find_way(device, address_);
    if (way_.in == 0 || (address_.interface < 0 && (way_.communication < 0 || way_.out == 0))) {
      libusb_close(handle);
      return fail(ErrorCode::bad_input, name(),
                  address_.interface < 0
                      ? "expected a CDC-ACM device, which scanners are; this one has no such interfaces"
                      : "expected a bulk IN endpoint at `interface` and `endpoint`; look at what it has "
                        "with: rigor devices");
    }
    handle_ = handle;
    libusb_set_auto_detach_kernel_driver(handle_, 1);
    for (const int interface : {way_.communication, way_.data}) {
      if (interface < 0) continue;
      if (const int e = libusb_claim_interface(handle_, interface); e != 0) {
        release();
        libusb_close(handle_);
        handle_ = nullptr;
        return fail(ErrorCode::unavailable, name(),
                    "cannot take interface " + std::to_string(interface) + ": " + libusb_strerror(e) +
                        (e == LIBUSB_ERROR_BUSY ? "; another program has it" : ""));
      }
      claimed_.push_back(interface);
    }
    gone_ = stalled_ = false;
    errors_ = 0;
    // A stall that an earlier reader left behind.
    libusb_clear_halt(handle_, way_.in);
    if (way_.communication >= 0) {
      unsigned char coding[7] = {0x00, 0xc2, 0x01, 0x00, 0, 0, 8};  // 115200, one stop bit, no parity, 8 bits
      const auto index = static_cast<std::uint16_t>(way_.communication);
      libusb_control_transfer(handle_, kToInterface, kSetLineCoding, 0, index, coding, sizeof coding,
                              kControlLimit_ms);
      libusb_control_transfer(handle_, kToInterface, kSetControlLineState, 3, index, nullptr, 0,
                              kControlLimit_ms);
    }
    for (Transfer& t : transfers_) {
      t.buffer.resize(kTransferBytes);
      if (!t.transfer) t.transfer = libusb_alloc_transfer(0);
      if (!t.transfer) continue;
      libusb_fill_bulk_transfer(t.transfer, handle_, way_.in, t.buffer.data(),
                                static_cast<int>(t.buffer.size()), on_transfer, &t, 0);
      submit(t);
    }
    if (gone_) {
      close();
      return fail(ErrorCode::io, name(), "it takes no transfers");
    }
    return {};
  }

  void release() noexcept {
    // The data interface first: cdc_acm takes both when it is given back the other.
    for (auto i = claimed_.rbegin(); i != claimed_.rend(); ++i) libusb_release_interface(handle_, *i);
    claimed_.clear();
  }

  void submit(Transfer& t) {
    t.taken = 0;
    t.in_flight = false;
    if (!handle_ || gone_ || stalled_) return;
    const int e = libusb_submit_transfer(t.transfer);
    if (e == 0) t.in_flight = true;
    if (e == LIBUSB_ERROR_NO_DEVICE || e == LIBUSB_ERROR_NO_MEM || e == LIBUSB_ERROR_IO) gone_ = true;
  }

  [[nodiscard]] bool any_in_flight() const {
    return std::any_of(transfers_.begin(), transfers_.end(), [](const Transfer& t) { return t.in_flight; });
  }

  /// Every transfer is ours again.
  void take_back() {
    taking_back_ = true;
    for (Transfer& t : transfers_)
      if (t.in_flight) libusb_cancel_transfer(t.transfer);
    const MonotonicTime limit = monotonic_now() + seconds(2);
    while (any_in_flight() && monotonic_now() < limit) handle_events(milliseconds(20));
    taking_back_ = false;
    if (any_in_flight()) {
      // The kernel never gave them back: they are left to it for ever, better than freed under it.
      leaked_ = true;
      for (Transfer& t : transfers_)
        if (t.in_flight) t.transfer = nullptr, t.in_flight = false, orphans_.push_back(std::move(t.buffer));
    }
  }

  void clear_stall() {
    take_back();
    ++counters_.stalls;
    if (libusb_clear_halt(handle_, way_.in) != 0) {
      gone_ = true;
      return;
    }
    stalled_ = false;
    for (Transfer& t : transfers_)
      if (!t.in_flight && std::find(done_.begin(), done_.end(), &t) == done_.end()) submit(t);
  }

  void handle_events(Duration at_most) {
    const std::int64_t us = std::clamp<std::int64_t>(at_most.ns() / 1000, 0, 60'000'000);
    timeval tv{us / 1'000'000, us % 1'000'000};
    libusb_handle_events_timeout_completed(context_, &tv, nullptr);
  }

  static void LIBUSB_CALL on_transfer(libusb_transfer* transfer) {
    auto& t = *static_cast<Transfer*>(transfer->user_data);
    t.owner->completed(t);
  }
  void completed(Transfer& t) {
    t.in_flight = false;
    t.taken = 0;
    if (!t.transfer) return;
    if (t.transfer->actual_length > 0 && t.transfer->status != LIBUSB_TRANSFER_NO_DEVICE) {
      t.arrival = monotonic_now();
      done_.push_back(&t);
    }
    switch (t.transfer->status) {
      case LIBUSB_TRANSFER_COMPLETED:
        errors_ = 0;
        break;
      case LIBUSB_TRANSFER_CANCELLED:
      case LIBUSB_TRANSFER_TIMED_OUT:
        if (taking_back_) return;
        break;
      case LIBUSB_TRANSFER_STALL:
        stalled_ = true;
        return;
      case LIBUSB_TRANSFER_NO_DEVICE:
        gone_ = true;
        return;
      case LIBUSB_TRANSFER_ERROR:
      case LIBUSB_TRANSFER_OVERFLOW:
        ++counters_.transfer_errors;
        if (++errors_ >= kErrorsInARow) gone_ = true;
        break;
    }
    if (t.transfer->actual_length == 0 && !taking_back_) submit(t);
  }

  static int LIBUSB_CALL on_hotplug(libusb_context*, libusb_device*, libusb_hotplug_event event, void* user) {
    auto* self = static_cast<LibusbLink*>(user);
    // A transfer tells sooner and surer that the device has left; this is for one whose transfers hang.
    if (event == LIBUSB_HOTPLUG_EVENT_DEVICE_ARRIVED) self->arrived_ = true;
    return 0;
  }

  const UsbAddress address_;
  std::string path_;
  libusb_context* context_ = nullptr;
  libusb_device_handle* handle_ = nullptr;
  libusb_hotplug_callback_handle callback_ = 0;
  bool hotplug_ = false, arrived_ = false, gone_ = false, stalled_ = false, taking_back_ = false,
       leaked_ = false;
  unsigned errors_ = 0;
  Way way_;
  std::vector<int> claimed_;
  std::array<Transfer, kTransfers> transfers_;
  std::vector<std::vector<unsigned char>> orphans_;
  std::deque<Transfer*> done_;
  std::atomic<bool> cut_{false};
  Counters counters_;
};

}  // namespace

std::unique_ptr<ByteLink> make_libusb_link(const UsbAddress& address) {
  return std::make_unique<LibusbLink>(address);
}

std::vector<UsbDeviceSeen> list_usb_devices() {
  std::vector<UsbDeviceSeen> seen;
  libusb_context* context = nullptr;
  if (libusb_init(&context) != 0) return seen;
  libusb_device** list = nullptr;
  const ssize_t n = libusb_get_device_list(context, &list);
  for (ssize_t i = 0; i < n; ++i) {
    libusb_device_descriptor d{};
    if (libusb_get_device_descriptor(list[i], &d) != 0 || d.bDeviceClass == LIBUSB_CLASS_HUB) continue;
    UsbDeviceSeen s;
    s.vendor = d.idVendor;
    s.product = d.idProduct;
    s.path = path_of(list[i]);
    s.cdc_acm = find_way(list[i], {}).communication >= 0;
    libusb_config_descriptor* config = nullptr;
    if (libusb_get_active_config_descriptor(list[i], &config) == 0) {
      for (int k = 0; k < config->bNumInterfaces && s.bulk_interface < 0; ++k) {
        if (config->interface[k].num_altsetting < 1) continue;
        const libusb_interface_descriptor& interface = config->interface[k].altsetting[0];
        if (interface.bInterfaceClass != LIBUSB_CLASS_VENDOR_SPEC) continue;
        for (int e = 0; e < interface.bNumEndpoints && s.bulk_interface < 0; ++e)
          if (is_bulk(interface.endpoint[e]) &&
              (interface.endpoint[e].bEndpointAddress & LIBUSB_ENDPOINT_IN) != 0) {
            s.bulk_interface = interface.bInterfaceNumber;
            s.bulk_endpoint = interface.endpoint[e].bEndpointAddress;
          }
      }
      libusb_free_config_descriptor(config);
    }
    libusb_device_handle* handle = nullptr;
    if (const int e = libusb_open(list[i], &handle); e == 0) {
      s.serial = string_of(handle, d.iSerialNumber);
      const std::string maker = string_of(handle, d.iManufacturer), product = string_of(handle, d.iProduct);
      s.text = maker + (maker.empty() || product.empty() ? "" : " ") + product;
      libusb_close(handle);
    } else {
      s.access = e == LIBUSB_ERROR_ACCESS ? access_cure() : libusb_strerror(e);
    }
    seen.push_back(std::move(s));
  }
  if (n >= 0) libusb_free_device_list(list, 1);
  libusb_exit(context);
  return seen;
}

std::string usb_library_version() {
  const libusb_version* v = libusb_get_version();
  return std::to_string(v->major) + "." + std::to_string(v->minor) + "." + std::to_string(v->micro);
}

}  // namespace rigor::usb
