#include "sim/world/graph/check_value.h"

#include <algorithm>
#include <cmath>
#include <sstream>

namespace rigor::world {
namespace {

std::string in_words(double v) {
  std::ostringstream s;
  s.imbue(std::locale::classic());
  s.precision(12);
  s << v;
  return s.str();
}

std::optional<std::string> check_number(const AttributeSpec& spec, double v) {
  if (std::isnan(v)) {
    if (spec.nan_is_unknown) return std::nullopt;
    return "expected a number, got NaN";
  }
  if (v >= spec.min && v <= spec.max) return std::nullopt;
  return "expected " + in_words(spec.min) + " to " + in_words(spec.max) +
         (spec.unit.empty() ? "" : " " + spec.unit) + ", got " + in_words(v);
}

}  // namespace

std::optional<std::string> check_value(const AttributeSpec& spec, const void* value) {
  switch (kind_of(spec.default_value)) {
    case ValueKind::integer:
      return check_number(spec, static_cast<double>(*static_cast<const std::int64_t*>(value)));
    case ValueKind::number:
      return check_number(spec, *static_cast<const double*>(value));
    case ValueKind::vector3: {
      const auto& v = *static_cast<const Vector3*>(value);
      for (int i = 0; i < 3; ++i)
        if (auto wrong = check_number(spec, v[i])) return wrong;
      return std::nullopt;
    }
    case ValueKind::numbers: {
      for (const double v : static_cast<const Numbers*>(value)->span())
        if (auto wrong = check_number(spec, v)) return wrong;
      return std::nullopt;
    }
    case ValueKind::text: {
      const auto& v = *static_cast<const std::string*>(value);
      if (spec.choices.empty() ||
          std::find(spec.choices.begin(), spec.choices.end(), v) != spec.choices.end())
        return std::nullopt;
      std::string words;
      for (const auto& c : spec.choices) words += (words.empty() ? "" : ", ") + c;
      return "expected one of " + words + ", got '" + v + "'";
    }
    default:
      return std::nullopt;
  }
}

}  // namespace rigor::world
