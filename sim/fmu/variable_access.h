// Values of an FMU's variables as doubles: one Get and one Set call for each type.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sim/fmu/model_description.h"

namespace rigor::fmu {

/// Whether a variable of this type can hold the value: NaN and infinity in none, 300 not in UInt8. Integers
/// are rounded. Above 2^53 doubles do not know every integer.
[[nodiscard]] bool fits(VariableType type, double value) noexcept;

/// Looks a function of the FMU up by its name without `fmi2` or `fmi3`; null: it has none.
using FunctionFinder = std::function<void*(const std::string& name)>;

class VariableAccess {
 public:
  struct Entry {
    std::size_t variable = 0;  ///< index in the description
    std::size_t position = 0;  ///< of its first element among the values
  };
  /// unavailable: the FMU lacks a function.
  [[nodiscard]] static Result<VariableAccess> make(const ModelDescription& description,
                                                   std::span<const Entry> entries, const FunctionFinder& find,
                                                   bool get, const std::string& where);
  VariableAccess() = default;
  VariableAccess(VariableAccess&&) noexcept = default;
  VariableAccess& operator=(VariableAccess&&) noexcept = default;

  /// An FmiStatus. No allocation.
  [[nodiscard]] int get(void* instance, std::span<double> values) const noexcept;
  [[nodiscard]] int set(void* instance, std::span<const double> values) const noexcept;
  /// Whether the values of its entries differ.
  [[nodiscard]] bool differ(std::span<const double> a, std::span<const double> b) const noexcept;
  [[nodiscard]] bool empty() const noexcept { return groups_.empty(); }

  class Group;

 private:
  std::vector<std::unique_ptr<Group>> groups_;
};

class VariableAccess::Group {
 public:
  virtual ~Group() = default;
  struct Place {
    std::size_t position = 0, count = 1;
  };
  std::vector<std::uint32_t> references;
  std::vector<Place> places;
  std::size_t count = 0;  ///< of values
  virtual void allocate() = 0;
  [[nodiscard]] virtual int get(void* instance, std::span<double> values) noexcept = 0;
  [[nodiscard]] virtual int set(void* instance, std::span<const double> values) noexcept = 0;
};

/// Sets one variable from text, of an array all elements. bad_input: no value of its type, or not as many as
/// it has. An FmiStatus else.
[[nodiscard]] Result<int> set_from_text(const ModelDescription& description, std::size_t variable,
                                        const std::string& text, void* instance, const FunctionFinder& find,
                                        const std::string& where);

}  // namespace rigor::fmu
