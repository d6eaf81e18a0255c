#include "sim/render/device.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <limits>

#include "sim/render/device_impl.h"

namespace rigor::render {
namespace {

constexpr const char* kValidationLayer = "VK_LAYER_KHRONOS_validation";

VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT,
                                          VkDebugUtilsMessageTypeFlagsEXT,
                                          const VkDebugUtilsMessengerCallbackDataEXT* data, void* user) {
  auto& impl = *static_cast<Device::Impl*>(user);
  const std::lock_guard lock(impl.message_mutex);
  impl.messages.emplace_back(data->pMessage != nullptr ? data->pMessage : "(no text)");
  return VK_FALSE;
}

bool validation_wanted(const DeviceOptions& options) {
  const char* const env = std::getenv("RIGOR_VULKAN_VALIDATION");
  return options.validation || (env != nullptr && std::strcmp(env, "1") == 0);
}

Result<VkInstance> make_instance(bool validation) {
  VkApplicationInfo app{};
  app.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO;
  app.pApplicationName = "rigor";
  app.apiVersion = VK_API_VERSION_1_3;
  VkInstanceCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO;
  info.pApplicationInfo = &app;
  const char* const extension = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
  if (validation) {
    std::uint32_t count = 0;
    vkEnumerateInstanceLayerProperties(&count, nullptr);
    std::vector<VkLayerProperties> layers(count);
    vkEnumerateInstanceLayerProperties(&count, layers.data());
    if (std::none_of(layers.begin(), layers.end(), [](const VkLayerProperties& l) {
          return std::strcmp(l.layerName, kValidationLayer) == 0;
        }))
      return fail(ErrorCode::unavailable, "vulkan",
                  "the validation layer was asked for but is not installed: install vulkan-validationlayers");
    info.enabledLayerCount = 1;
    info.ppEnabledLayerNames = &kValidationLayer;
    info.enabledExtensionCount = 1;
    info.ppEnabledExtensionNames = &extension;
  }
  VkInstance instance = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateInstance(&info, nullptr, &instance); r != VK_SUCCESS)
    return fail(ErrorCode::unavailable, "vulkan",
                "no Vulkan driver answers (vkCreateInstance: VkResult " + std::to_string(r) +
                    "): install mesa-vulkan-drivers, whose lavapipe needs no GPU");
  return instance;
}

/// Physical devices, best kind first, in the driver's order within a kind.
std::vector<std::pair<VkPhysicalDevice, std::string>> physical_devices(VkInstance instance) {
  std::uint32_t count = 0;
  vkEnumeratePhysicalDevices(instance, &count, nullptr);
  std::vector<VkPhysicalDevice> devices(count);
  vkEnumeratePhysicalDevices(instance, &count, devices.data());
  devices.resize(count);
  const auto rank = [](VkPhysicalDevice d) {
    VkPhysicalDeviceProperties p{};
    vkGetPhysicalDeviceProperties(d, &p);
    switch (p.deviceType) {
      case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU:
        return 0;
      case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU:
        return 1;
      case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU:
        return 2;
      default:
        return 3;
    }
  };
  std::stable_sort(devices.begin(), devices.end(),
                   [&](VkPhysicalDevice a, VkPhysicalDevice b) { return rank(a) < rank(b); });
  std::vector<std::pair<VkPhysicalDevice, std::string>> out;
  for (VkPhysicalDevice d : devices) {
    VkPhysicalDeviceProperties p{};
    vkGetPhysicalDeviceProperties(d, &p);
    out.emplace_back(d, p.deviceName);
  }
  return out;
}

}  // namespace

Device::Impl::~Impl() {
  if (device != VK_NULL_HANDLE) vkDestroyDevice(device, nullptr);
  if (messenger != VK_NULL_HANDLE) {
    const auto destroy = reinterpret_cast<PFN_vkDestroyDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(instance, "vkDestroyDebugUtilsMessengerEXT"));
    if (destroy != nullptr) destroy(instance, messenger, nullptr);
  }
  if (instance != VK_NULL_HANDLE) vkDestroyInstance(instance, nullptr);
}

Result<vk::Memory> Device::Impl::allocate(const VkMemoryRequirements& needs, VkMemoryPropertyFlags wanted,
                                          VkMemoryPropertyFlags also_good) const {
  const auto find = [&](VkMemoryPropertyFlags flags) -> int {
    for (std::uint32_t i = 0; i < memory.memoryTypeCount; ++i)
      if ((needs.memoryTypeBits & (1u << i)) != 0 && (memory.memoryTypes[i].propertyFlags & flags) == flags)
        return static_cast<int>(i);
    return -1;
  };
  int type = find(wanted | also_good);
  if (type < 0) type = find(wanted);
  if (type < 0)
    return fail(ErrorCode::unavailable, "vulkan", "the device has no memory of the kind that is needed");
  VkMemoryAllocateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
  info.allocationSize = needs.size;
  info.memoryTypeIndex = static_cast<std::uint32_t>(type);
  VkDeviceMemory out = VK_NULL_HANDLE;
  if (const VkResult r = vkAllocateMemory(device, &info, nullptr, &out); r != VK_SUCCESS)
    return vk::failed("allocating " + std::to_string(needs.size) + " bytes", r);
  return vk::Memory(device, out);
}

Result<vk::Buffer> Device::Impl::make_buffer(std::size_t size_bytes, VkBufferUsageFlags usage,
                                             VkMemoryPropertyFlags also_good) const {
  VkBufferCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO;
  info.size = std::max<std::size_t>(size_bytes, 16);
  info.usage = usage;
  if ((usage & VK_BUFFER_USAGE_STORAGE_BUFFER_BIT) != 0 && info.size > limits.maxStorageBufferRange)
    return fail(ErrorCode::unavailable, "vulkan",
                "expected a buffer of at most the " + std::to_string(limits.maxStorageBufferRange) +
                    " bytes that " + name + " allows, got " + std::to_string(size_bytes));
  VkBuffer handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateBuffer(device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a buffer", r);
  vk::Buffer out;
  out.handle = vk::BufferHandle(device, handle);
  out.size_bytes = size_bytes;
  VkMemoryRequirements needs{};
  vkGetBufferMemoryRequirements(device, handle, &needs);
  auto bound =
      allocate(needs, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT, also_good);
  if (!bound) return tl::unexpected(bound.error());
  out.memory = std::move(*bound);
  if (const VkResult r = vkBindBufferMemory(device, handle, out.memory.get(), 0); r != VK_SUCCESS)
    return vk::failed("binding a buffer's memory", r);
  void* mapped = nullptr;
  if (const VkResult r = vkMapMemory(device, out.memory.get(), 0, VK_WHOLE_SIZE, 0, &mapped); r != VK_SUCCESS)
    return vk::failed("mapping a buffer", r);
  out.data = static_cast<std::byte*>(mapped);
  std::memset(out.data, 0, info.size);
  return out;
}

Result<vk::Image> Device::Impl::make_image(VkFormat format, std::uint32_t width, std::uint32_t height,
                                           VkImageUsageFlags usage, VkImageAspectFlags aspect) const {
  return make_image({.format = format, .width = width, .height = height, .usage = usage, .aspect = aspect});
}

Result<vk::Image> Device::Impl::make_image(const ImageWanted& w) const {
  VkImageCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO;
  info.imageType = VK_IMAGE_TYPE_2D;
  info.format = w.format;
  info.extent = {w.width, w.height, 1};
  info.mipLevels = w.mip_levels;
  info.arrayLayers = w.layers;
  info.samples = w.samples;
  info.tiling = VK_IMAGE_TILING_OPTIMAL;
  info.usage = w.usage;
  VkImage handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateImage(device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a picture of " + std::to_string(w.width) + "x" + std::to_string(w.height), r);
  vk::Image out;
  out.handle = vk::ImageHandle(device, handle);
  VkMemoryRequirements needs{};
  vkGetImageMemoryRequirements(device, handle, &needs);
  auto bound = allocate(needs, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, 0);
  if (!bound) return tl::unexpected(bound.error());
  out.memory = std::move(*bound);
  if (const VkResult r = vkBindImageMemory(device, handle, out.memory.get(), 0); r != VK_SUCCESS)
    return vk::failed("binding a picture's memory", r);
  VkImageViewCreateInfo view{};
  view.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO;
  view.image = handle;
  view.viewType = w.array_view || w.layers > 1 ? VK_IMAGE_VIEW_TYPE_2D_ARRAY : VK_IMAGE_VIEW_TYPE_2D;
  view.format = w.format;
  view.subresourceRange = {w.aspect, 0, w.mip_levels, 0, w.layers};
  VkImageView view_handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateImageView(device, &view, nullptr, &view_handle); r != VK_SUCCESS)
    return vk::failed("making a view of a picture", r);
  out.view = vk::ImageView(device, view_handle);
  return out;
}

Result<vk::ShaderModule> Device::Impl::make_shader(std::span<const std::uint32_t> words) const {
  VkShaderModuleCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
  info.codeSize = words.size_bytes();
  info.pCode = words.data();
  VkShaderModule handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateShaderModule(device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("loading a shader", r);
  return vk::ShaderModule(device, handle);
}

Status Device::Impl::run(VkCommandBuffer commands, VkFence fence) const {
  VkSubmitInfo submit{};
  submit.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO;
  submit.commandBufferCount = 1;
  submit.pCommandBuffers = &commands;
  if (const VkResult r = vkResetFences(device, 1, &fence); r != VK_SUCCESS)
    return vk::failed("resetting a fence", r);
  {
    const std::lock_guard lock(queue_mutex);
    if (const VkResult r = vkQueueSubmit(queue, 1, &submit, fence); r != VK_SUCCESS)
      return vk::failed("submitting work", r);
  }
  // However long it takes: while the device works, none of what the commands name may be given back or used
  // again, and in virtual time a busy machine must not change what is measured. A device that hangs is lost
  // to its driver.
  if (const VkResult r =
          vkWaitForFences(device, 1, &fence, VK_TRUE, std::numeric_limits<std::uint64_t>::max());
      r != VK_SUCCESS)
    return vk::failed("waiting for a picture", r);
  return {};
}

Device::Device(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Device::~Device() = default;
const std::string& Device::name() const { return impl_->name; }
bool Device::validation_on() const { return impl_->validation; }
std::vector<std::string> Device::validation_messages() const {
  const std::lock_guard lock(impl_->message_mutex);
  return impl_->messages;
}

Result<std::vector<std::string>> Device::list() {
  auto instance = make_instance(false);
  if (!instance) return tl::unexpected(instance.error());
  std::vector<std::string> names;
  for (auto& [device, name] : physical_devices(*instance)) names.push_back(std::move(name));
  vkDestroyInstance(*instance, nullptr);
  return names;
}

Result<std::shared_ptr<Device>> Device::create(const DeviceOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->validation = validation_wanted(options);
  auto instance = make_instance(impl->validation);
  if (!instance) return tl::unexpected(instance.error());
  impl->instance = *instance;
  if (impl->validation) {
    VkDebugUtilsMessengerCreateInfoEXT info{};
    info.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT;
    info.messageSeverity =
        VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
    info.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT;
    info.pfnUserCallback = on_message;
    info.pUserData = impl.get();
    const auto create = reinterpret_cast<PFN_vkCreateDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(impl->instance, "vkCreateDebugUtilsMessengerEXT"));
    if (create == nullptr || create(impl->instance, &info, nullptr, &impl->messenger) != VK_SUCCESS)
      return fail(ErrorCode::unavailable, "vulkan", "the validation layer takes no messenger");
  }

  auto found = physical_devices(impl->instance);
  std::string all;
  for (const auto& [device, name] : found) all += (all.empty() ? "" : ", ") + name;
  std::erase_if(found,
                [&](const auto& d) { return d.second.find(options.name_contains) == std::string::npos; });
  if (options.index < 0 || static_cast<std::size_t>(options.index) >= found.size())
    return fail(
        ErrorCode::unavailable, "vulkan",
        "expected a device number " + std::to_string(options.index) +
            (options.name_contains.empty() ? "" : " whose name holds '" + options.name_contains + "'") +
            ", got " + (all.empty() ? "no device (install mesa-vulkan-drivers)" : "only: " + all));
  const auto& chosen = found[static_cast<std::size_t>(options.index)];
  impl->physical = chosen.first;
  impl->name = chosen.second;
  VkPhysicalDeviceProperties properties{};
  vkGetPhysicalDeviceProperties(impl->physical, &properties);
  impl->limits = properties.limits;
  if (properties.apiVersion < VK_API_VERSION_1_3)
    return fail(ErrorCode::unavailable, impl->name,
                "expected Vulkan 1.3 (dynamic rendering), got an older driver");
  vkGetPhysicalDeviceMemoryProperties(impl->physical, &impl->memory);

  std::uint32_t families = 0;
  vkGetPhysicalDeviceQueueFamilyProperties(impl->physical, &families, nullptr);
  std::vector<VkQueueFamilyProperties> family(families);
  vkGetPhysicalDeviceQueueFamilyProperties(impl->physical, &families, family.data());
  constexpr VkQueueFlags kNeeded = VK_QUEUE_GRAPHICS_BIT | VK_QUEUE_COMPUTE_BIT;
  const auto usable = std::find_if(family.begin(), family.end(), [](const VkQueueFamilyProperties& f) {
    return (f.queueFlags & kNeeded) == kNeeded;
  });
  if (usable == family.end())
    return fail(ErrorCode::unavailable, impl->name, "expected a queue for graphics and compute, got none");
  impl->queue_family = static_cast<std::uint32_t>(usable - family.begin());

  const float priority = 1.0f;
  VkDeviceQueueCreateInfo queue{};
  queue.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO;
  queue.queueFamilyIndex = impl->queue_family;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;
  VkPhysicalDeviceVulkan13Features features{};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES;
  features.dynamicRendering = VK_TRUE;
  features.synchronization2 = VK_TRUE;
  VkDeviceCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO;
  info.pNext = &features;
  VkPhysicalDeviceFeatures has{}, wanted{};
  vkGetPhysicalDeviceFeatures(impl->physical, &has);
  impl->dual_source_blend = has.dualSrcBlend == VK_TRUE;
  wanted.dualSrcBlend = has.dualSrcBlend;
  info.pEnabledFeatures = &wanted;
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue;
  if (const VkResult r = vkCreateDevice(impl->physical, &info, nullptr, &impl->device); r != VK_SUCCESS)
    return vk::failed("opening " + impl->name, r);
  vkGetDeviceQueue(impl->device, impl->queue_family, 0, &impl->queue);
  return std::shared_ptr<Device>(new Device(std::move(impl)));
}

}  // namespace rigor::render
