// CAN channels, sinks and emulated nodes in virtual time, on a bus in memory (virtual_bus.h).
//
// All that name the same interface share one bus; a node is on it when a channel or a sink names it
// (`emulated_by`). Capture is the end of the frame, as the interrupt of a controller tells it. The bus runs
// at the node's `bitrate` and `data_bitrate`; nodes of one interface state the same.
#pragma once

#include <map>
#include <memory>
#include <string>

#include "drivers/can/emulated_node.h"
#include "drivers/can/virtual_bus.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::can {

/// A node on a bus; runs while one of its channels does.
class NodeOnBus final : private VirtualBus::Participant {
 public:
  NodeOnBus(std::shared_ptr<VirtualBus> bus, std::unique_ptr<EmulatedNode> node)
      : bus_(std::move(bus)), node_(std::move(node)) {}
  ~NodeOnBus() override { bus_->leave(this); }
  [[nodiscard]] Status start(BenchTime t0);
  void stop();
  [[nodiscard]] const std::shared_ptr<VirtualBus>& bus() const noexcept { return bus_; }
  [[nodiscard]] const EmulatedNode& node() const noexcept { return *node_; }

 private:
  [[nodiscard]] BenchTime next_action(BenchTime now) const noexcept override;
  void act(BenchTime t) override;
  void receive(const CanFrame& frame, BenchTime t) override;

  std::shared_ptr<VirtualBus> bus_;
  std::unique_ptr<EmulatedNode> node_;
  LogWriter log_;
  unsigned users_ = 0;
};

/// The buses and nodes of all rigs of this process; each lives as long as a channel uses it. Setup thread.
class VirtualBuses {
 public:
  [[nodiscard]] Result<std::shared_ptr<NodeOnBus>> node(const DeviceParts& parts, const ConfigNode& params);

 private:
  using Key = std::pair<const void*, std::string>;  ///< the device world, and a name in it
  std::map<Key, std::weak_ptr<VirtualBus>> buses_;
  std::map<Key, std::weak_ptr<NodeOnBus>> nodes_;
};

/// The stand-ins for CanSource and CanSink; they read the same keys.
[[nodiscard]] std::unique_ptr<Source> make_virtual_source(std::shared_ptr<NodeOnBus> node);
[[nodiscard]] std::unique_ptr<Sink> make_virtual_sink(std::shared_ptr<NodeOnBus> node);

}  // namespace rigor::can
