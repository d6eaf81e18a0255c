// A SampleProvider of numbers that have names: what a channel of registers says of itself.
#pragma once

#include <string>
#include <vector>

namespace rigor {

class NamedValues {
 public:
  virtual ~NamedValues() = default;
  /// In the order of the block's values; as many units as names. Never changes.
  [[nodiscard]] virtual const std::vector<std::string>& names() const = 0;
  [[nodiscard]] virtual const std::vector<std::string>& units() const = 0;
};

}  // namespace rigor
