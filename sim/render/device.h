// A Vulkan device without a window system. Several may coexist; several renderers may share one (their
// submissions then take turns). A software device (Mesa's lavapipe) is as good as any.
//
// Lavapipe starts its worker threads when the device is made, and they inherit the policy and the affinity of
// the thread that makes it: make the device before a thread turns real-time.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::render {

struct DeviceOptions {
  /// Part of the device's name, e.g. "llvmpipe"; empty: any.
  std::string name_contains{};
  /// Among those that match; they are in the order of `Device::list`.
  int index = 0;
  /// Turn the Khronos validation layer on. The environment variable RIGOR_VULKAN_VALIDATION=1 does so too.
  bool validation = false;
};

class Device {
 public:
  /// Setup. Errors: unavailable (no Vulkan, no such device, the layer is not installed).
  [[nodiscard]] static Result<std::shared_ptr<Device>> create(const DeviceOptions& options = {});
  /// Names of the devices that Vulkan finds here: discrete, integrated, virtual, then software ones. Setup.
  [[nodiscard]] static Result<std::vector<std::string>> list();
  ~Device();
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  [[nodiscard]] const std::string& name() const;
  [[nodiscard]] bool validation_on() const;
  /// What the validation layer has said so far (warnings and errors); empty when all is well. Any thread.
  [[nodiscard]] std::vector<std::string> validation_messages() const;

  struct Impl;
  [[nodiscard]] Impl& impl() { return *impl_; }

 private:
  explicit Device(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
