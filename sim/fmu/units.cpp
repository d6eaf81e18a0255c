#include "sim/fmu/units.h"

#include <array>
#include <numbers>

namespace rigor::fmu {
namespace {

constexpr double kDeg = std::numbers::pi / 180;

struct Known {
  std::string_view name;
  std::array<int, 8> exponents;  // kg m s A K mol cd rad
  double factor, offset = 0;
};
constexpr std::array<Known, 44> kKnown{{
    {"m", {0, 1}, 1},
    {"mm", {0, 1}, 1e-3},
    {"cm", {0, 1}, 1e-2},
    {"km", {0, 1}, 1e3},
    {"rad", {0, 0, 0, 0, 0, 0, 0, 1}, 1},
    {"deg", {0, 0, 0, 0, 0, 0, 0, 1}, kDeg},
    {"s", {0, 0, 1}, 1},
    {"ms", {0, 0, 1}, 1e-3},
    {"min", {0, 0, 1}, 60},
    {"h", {0, 0, 1}, 3600},
    {"m/s", {0, 1, -1}, 1},
    {"mm/s", {0, 1, -1}, 1e-3},
    {"km/h", {0, 1, -1}, 1 / 3.6},
    {"rad/s", {0, 0, -1, 0, 0, 0, 0, 1}, 1},
    {"deg/s", {0, 0, -1, 0, 0, 0, 0, 1}, kDeg},
    {"rpm", {0, 0, -1, 0, 0, 0, 0, 1}, 2 * std::numbers::pi / 60},
    {"m/s2", {0, 1, -2}, 1},
    {"m/s²", {0, 1, -2}, 1},
    {"g", {1}, 1e-3},
    {"kg", {1}, 1},
    {"t", {1}, 1e3},
    {"N", {1, 1, -2}, 1},
    {"kN", {1, 1, -2}, 1e3},
    {"N.m", {1, 2, -2}, 1},
    {"Nm", {1, 2, -2}, 1},
    {"J", {1, 2, -2}, 1},
    {"kJ", {1, 2, -2}, 1e3},
    {"W", {1, 2, -3}, 1},
    {"kW", {1, 2, -3}, 1e3},
    {"Pa", {1, -1, -2}, 1},
    {"kPa", {1, -1, -2}, 1e3},
    {"bar", {1, -1, -2}, 1e5},
    {"K", {0, 0, 0, 0, 1}, 1},
    {"degC", {0, 0, 0, 0, 1}, 1, 273.15},
    {"°C", {0, 0, 0, 0, 1}, 1, 273.15},
    {"A", {0, 0, 0, 1}, 1},
    {"mA", {0, 0, 0, 1}, 1e-3},
    {"V", {1, 2, -3, -1}, 1},
    {"mV", {1, 2, -3, -1}, 1e-3},
    {"Hz", {0, 0, -1}, 1},
    {"1/s", {0, 0, -1}, 1},
    {"%", {}, 1e-2},
    {"1", {}, 1},
    {"-", {}, 1},
}};

std::optional<Unit> find(const ModelDescription& description, std::string_view name) {
  if (const Unit* u = description.unit(name); u && u->has_base && u->factor != 0) return *u;
  for (const Known& k : kKnown)
    if (k.name == name) return Unit{std::string(name), k.exponents, k.factor, k.offset, true};
  return std::nullopt;
}

}  // namespace

std::optional<Conversion> conversion(const ModelDescription& description, std::string_view own,
                                     std::string_view asked, std::string& why) {
  if (own == asked) return Conversion{};
  const auto from = find(description, own), to = find(description, asked);
  if (!from || !to) {
    why = "no conversion is known from " + std::string(own) + " to " + std::string(asked);
    return std::nullopt;
  }
  if (from->exponents != to->exponents) {
    why = std::string(own) + " and " + std::string(asked) + " measure different quantities";
    return std::nullopt;
  }
  return Conversion{from->factor / to->factor, (from->offset - to->offset) / to->factor};
}

}  // namespace rigor::fmu
