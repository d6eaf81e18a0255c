// What a simulated channel measures with, whatever its kind: the keys of the kind, and one sample at a time.
#pragma once

#include <memory>

#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/providers.h"

namespace rigor {

class Measurer {
 public:
  virtual ~Measurer() = default;
  /// Reads the kind's own keys and describes what comes. May throw ConfigError. Setup thread.
  virtual Status configure(const ChannelConfig& config, ChannelDescription& description) = 0;
  /// As SampleProvider::immediate.
  [[nodiscard]] virtual bool immediate() const { return false; }
  /// Fills info, memory and size; the stamp is the caller's. One thread at a time.
  virtual Status measure(const SampleProvider::Request& request, Sample& sample) = 0;
};

/// Null for a null provider.
[[nodiscard]] std::unique_ptr<Measurer> make_measurer(std::shared_ptr<ImageProvider> provider);
[[nodiscard]] std::unique_ptr<Measurer> make_measurer(std::shared_ptr<SampleProvider> provider);

}  // namespace rigor
