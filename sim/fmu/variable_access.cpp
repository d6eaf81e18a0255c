#include "sim/fmu/variable_access.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <sstream>

#include "sim/fmu/fmi_api.h"

namespace rigor::fmu {
namespace {

template <class T>
T from_double(double value) noexcept {
  if constexpr (std::is_same_v<T, bool>) {
    return value != 0;
  } else if constexpr (std::is_floating_point_v<T>) {
    return static_cast<T>(value);
  } else {
    // The limits of 64 bits are not doubles: 2^63 and 2^64 are, and stand for one more than the largest.
    const double rounded = std::nearbyint(value);
    if (!(rounded > static_cast<double>(std::numeric_limits<T>::min()))) return std::numeric_limits<T>::min();
    if (rounded >= static_cast<double>(std::numeric_limits<T>::max())) return std::numeric_limits<T>::max();
    return static_cast<T>(rounded);
  }
}

/// `Counted`: FMI 3.0, whose functions are told how many values there are.
template <class T, bool Counted>
class TypedGroup final : public VariableAccess::Group {
 public:
  TypedGroup(void* get, void* set) : get_(get), set_(set) {}
  void allocate() override { buffer_ = std::make_unique<T[]>(std::max<std::size_t>(count, 1)); }
  int get(void* instance, std::span<double> values) noexcept override {
    int status = 0;
    if constexpr (Counted)
      status = reinterpret_cast<int (*)(void*, const std::uint32_t*, std::size_t, T*, std::size_t)>(get_)(
          instance, references.data(), references.size(), buffer_.get(), count);
    else
      status = reinterpret_cast<int (*)(void*, const std::uint32_t*, std::size_t, T*)>(get_)(
          instance, references.data(), references.size(), buffer_.get());
    std::size_t at = 0;
    for (const Place& p : places)
      for (std::size_t i = 0; i < p.count; ++i) values[p.position + i] = static_cast<double>(buffer_[at++]);
    return status;
  }
  int set(void* instance, std::span<const double> values) noexcept override {
    std::size_t at = 0;
    for (const Place& p : places)
      for (std::size_t i = 0; i < p.count; ++i) buffer_[at++] = from_double<T>(values[p.position + i]);
    if constexpr (Counted)
      return reinterpret_cast<int (*)(void*, const std::uint32_t*, std::size_t, const T*, std::size_t)>(set_)(
          instance, references.data(), references.size(), buffer_.get(), count);
    else
      return reinterpret_cast<int (*)(void*, const std::uint32_t*, std::size_t, const T*)>(set_)(
          instance, references.data(), references.size(), buffer_.get());
  }

 private:
  void *get_, *set_;
  std::unique_ptr<T[]> buffer_;
};

/// The word in names of functions: fmi2GetReal, fmi3GetFloat64.
std::string function_word(FmiVersion version, VariableType type) {
  if (version == FmiVersion::v3)
    return std::string(type == VariableType::enumeration ? "Int64" : name_of(type));
  switch (type) {
    case VariableType::float64:
      return "Real";
    case VariableType::boolean:
      return "Boolean";
    case VariableType::string:
      return "String";
    default:
      return "Integer";
  }
}

std::unique_ptr<VariableAccess::Group> make_group(FmiVersion version, VariableType type, void* get,
                                                  void* set) {
  if (version == FmiVersion::v2) {
    if (type == VariableType::float64) return std::make_unique<TypedGroup<double, false>>(get, set);
    return std::make_unique<TypedGroup<int, false>>(get, set);
  }
  switch (type) {
    case VariableType::float32:
      return std::make_unique<TypedGroup<float, true>>(get, set);
    case VariableType::float64:
      return std::make_unique<TypedGroup<double, true>>(get, set);
    case VariableType::int8:
      return std::make_unique<TypedGroup<std::int8_t, true>>(get, set);
    case VariableType::uint8:
      return std::make_unique<TypedGroup<std::uint8_t, true>>(get, set);
    case VariableType::int16:
      return std::make_unique<TypedGroup<std::int16_t, true>>(get, set);
    case VariableType::uint16:
      return std::make_unique<TypedGroup<std::uint16_t, true>>(get, set);
    case VariableType::int32:
      return std::make_unique<TypedGroup<std::int32_t, true>>(get, set);
    case VariableType::uint32:
      return std::make_unique<TypedGroup<std::uint32_t, true>>(get, set);
    case VariableType::uint64:
      return std::make_unique<TypedGroup<std::uint64_t, true>>(get, set);
    case VariableType::boolean:
      return std::make_unique<TypedGroup<bool, true>>(get, set);
    default:
      return std::make_unique<TypedGroup<std::int64_t, true>>(get, set);
  }
}

/// Values of a variable from text. Empty: there is one that is none of the type.
std::vector<double> numbers_in(const Variable& v, const std::string& text) {
  std::vector<double> values;
  std::istringstream in(text);
  for (std::string word; in >> word;) {
    double value = 0;
    if (word == "true" || word == "false") {
      value = word == "true";
    } else {
      const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
      if (error != std::errc() || end != word.data() + word.size()) return {};
    }
    if (!fits(v.type, value)) return {};
    values.push_back(value);
  }
  return values;
}

}  // namespace

bool fits(VariableType type, double value) noexcept {
  if (!std::isfinite(value)) return false;
  const auto within = [&](auto limit) {
    using T = decltype(limit);
    const double r = std::nearbyint(value);
    return r >= static_cast<double>(std::numeric_limits<T>::min()) &&
           (sizeof(T) < 8 ? r <= static_cast<double>(std::numeric_limits<T>::max())
                          : r < std::ldexp(1.0, std::numeric_limits<T>::digits));
  };
  switch (type) {
    case VariableType::float32:
      return std::abs(value) <= static_cast<double>(std::numeric_limits<float>::max());
    case VariableType::float64:
    case VariableType::boolean:
      return true;
    case VariableType::int8:
      return within(std::int8_t{});
    case VariableType::uint8:
      return within(std::uint8_t{});
    case VariableType::int16:
      return within(std::int16_t{});
    case VariableType::uint16:
      return within(std::uint16_t{});
    case VariableType::int32:
      return within(std::int32_t{});
    case VariableType::uint32:
      return within(std::uint32_t{});
    case VariableType::int64:
    case VariableType::enumeration:
      return within(std::int64_t{});
    case VariableType::uint64:
      return within(std::uint64_t{});
    default:
      return false;
  }
}

Result<VariableAccess> VariableAccess::make(const ModelDescription& description,
                                            std::span<const Entry> entries, const FunctionFinder& find,
                                            bool get, const std::string& where) {
  VariableAccess access;
  std::vector<VariableType> types;
  for (const Entry& e : entries) {
    const Variable& v = description.variables[e.variable];
    auto at = static_cast<std::size_t>(std::find(types.begin(), types.end(), v.type) - types.begin());
    if (at == types.size()) {
      const std::string word = function_word(description.version, v.type);
      void* const function = find((get ? "Get" : "Set") + word);
      if (!function)
        return fail(ErrorCode::unavailable, where,
                    std::string("the FMU has no function to ") + (get ? "get" : "set") + " " + word +
                        ", which " + v.name + " needs");
      types.push_back(v.type);
      access.groups_.push_back(
          make_group(description.version, v.type, get ? function : nullptr, get ? nullptr : function));
    }
    Group& group = *access.groups_[at];
    group.references.push_back(v.value_reference);
    group.places.push_back({e.position, v.elements});
    group.count += v.elements;
  }
  for (auto& group : access.groups_) group->allocate();
  return access;
}

int VariableAccess::get(void* instance, std::span<double> values) const noexcept {
  int worst = kFmiOk;
  for (const auto& group : groups_) {
    worst = std::max(worst, group->get(instance, values));
    if (worst > kFmiWarning) return worst;
  }
  return worst;
}

int VariableAccess::set(void* instance, std::span<const double> values) const noexcept {
  int worst = kFmiOk;
  for (const auto& group : groups_) {
    worst = std::max(worst, group->set(instance, values));
    if (worst > kFmiWarning) return worst;
  }
  return worst;
}

bool VariableAccess::differ(std::span<const double> a, std::span<const double> b) const noexcept {
  for (const auto& group : groups_)
    for (const Group::Place& p : group->places)
      for (std::size_t i = 0; i < p.count; ++i)
        if (a[p.position + i] != b[p.position + i]) return true;
  return false;
}

Result<int> set_from_text(const ModelDescription& description, std::size_t variable, const std::string& text,
                          void* instance, const FunctionFinder& find, const std::string& where) {
  const Variable& v = description.variables[variable];
  if (v.type == VariableType::string) {
    void* const function = find("SetString");
    if (!function) return fail(ErrorCode::unavailable, where, "the FMU has no function to set String");
    const char* const value = text.c_str();
    if (description.version == FmiVersion::v2)
      return reinterpret_cast<int (*)(void*, const std::uint32_t*, std::size_t, const char* const*)>(
          function)(instance, &v.value_reference, 1, &value);
    return reinterpret_cast<int (*)(void*, const std::uint32_t*, std::size_t, const char* const*,
                                    std::size_t)>(function)(instance, &v.value_reference, 1, &value, 1);
  }
  const std::vector<double> values = numbers_in(v, text);
  if (values.size() != v.elements)
    return fail(ErrorCode::bad_input, where,
                "expected " +
                    (v.elements == 1 ? std::string("a value") : std::to_string(v.elements) + " values") +
                    " of type " + std::string(name_of(v.type)) + " for " + v.name + ", got \"" + text + "\"");
  const VariableAccess::Entry entry{variable, 0};
  auto access = VariableAccess::make(description, {&entry, 1}, find, false, where);
  if (!access) return tl::unexpected<Error>(access.error());
  return access->set(instance, values);
}

}  // namespace rigor::fmu
