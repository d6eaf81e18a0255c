// Beehives: a node type, a rule that keeps their mass, one that refuses honey without frames, and an importer
// for tables.
#include <charconv>
#include <fstream>
#include <map>
#include <sstream>
#include <string>

#include "sim/world/plugin/plugin.h"

namespace {

using namespace rigor;
using namespace rigor::world;

constexpr double kTare_kg = 18, kFrame_kg = 0.3;

struct Beehive {
  explicit Beehive(const Schema& s)
      : type(s.require_type("Beehive")),
        label(s.require<std::string>("Beehive", "label")),
        position(s.require<Vector3>("Beehive", "position")),
        frames(s.require<std::int64_t>("Beehive", "frames")),
        honey_kg(s.require<double>("Beehive", "honey_kg")),
        mass_kg(s.require<double>("Beehive", "mass_kg")) {}
  TypeId type;
  Attribute<std::string> label;
  Attribute<Vector3> position;
  Attribute<std::int64_t> frames;
  Attribute<double> honey_kg, mass_kg;
};

Status keep_mass(const Beehive& hive, Transaction& tx, std::span<const Change> mine) {
  for (const auto& change : mine) {
    const auto* honey_kg = tx.get(change.node, hive.honey_kg);
    if (honey_kg == nullptr) continue;  // removed
    const auto mass_kg =
        kTare_kg + kFrame_kg * static_cast<double>(*tx.get(change.node, hive.frames)) + *honey_kg;
    if (auto s = tx.set(change.node, hive.mass_kg, mass_kg); !s) return s;
  }
  return {};
}

Status refuse_honey_without_frames(const Beehive& hive, Transaction& tx, std::span<const Change> mine) {
  for (const auto& change : mine)
    if (const auto* honey_kg = tx.get(change.node, hive.honey_kg);
        honey_kg != nullptr && *honey_kg > 0 && *tx.get(change.node, hive.frames) == 0)
      return fail(ErrorCode::bad_input, "", "a hive without frames holds no honey; give it frames first");
  return {};
}

/// `label,x_m,y_m,frames,honey_kg` in any order, one hive a line.
Status import_csv(const Beehive& hive, const std::filesystem::path& file, Transaction& tx) {
  std::ifstream in(file);
  std::string line;
  int number = 0;
  const auto refuse = [&](const std::string& message) {
    return fail(ErrorCode::bad_input, file.string() + ":" + std::to_string(number), message);
  };
  const auto cells = [](const std::string& text) {
    std::vector<std::string> out;
    std::istringstream stream(text);
    for (std::string cell; std::getline(stream, cell, ',');) out.push_back(cell);
    return out;
  };
  std::vector<std::string> columns;
  while (std::getline(in, line)) {
    ++number;
    if (number == 1) {
      columns = cells(line);
      continue;
    }
    const auto row = cells(line);
    if (row.size() != columns.size())
      return refuse("expected " + std::to_string(columns.size()) + " cells, got " +
                    std::to_string(row.size()));
    std::string label;
    std::map<std::string, double> numbers;
    for (std::size_t i = 0; i < row.size(); ++i) {
      if (columns[i] == "label") {
        label = row[i];
        continue;
      }
      double x = 0;
      const auto [end, error] = std::from_chars(row[i].data(), row[i].data() + row[i].size(), x);
      if (error != std::errc{} || end != row[i].data() + row[i].size())
        return refuse(columns[i] + ": expected a number, got '" + row[i] + "'");
      numbers[columns[i]] = x;
    }
    const auto node = tx.create(hive.type);
    if (!node) return tl::unexpected(node.error());
    for (const auto& s : {tx.set(*node, hive.label, label),
                          tx.set(*node, hive.position, Vector3(numbers["x_m"], numbers["y_m"], 0)),
                          tx.set(*node, hive.frames, static_cast<std::int64_t>(numbers["frames"])),
                          tx.set(*node, hive.honey_kg, numbers["honey_kg"])})
      if (!s) return refuse(s.error().message);
  }
  return {};
}

Status define(PluginHost& host) {
  const auto type = host.define(
      TypeSpec{.name = "Beehive",
               .meaning = "A hive and its colony.",
               .attributes = {{.name = "label",
                               .default_value = std::string(),
                               .meaning = "What its keeper calls it."},
                              {.name = "position", .default_value = Vector3(0, 0, 0), .unit = "m"},
                              {.name = "frames", .default_value = std::int64_t{0}, .min = 0, .max = 40},
                              {.name = "honey_kg", .default_value = 0.0, .unit = "kg", .min = 0},
                              {.name = "mass_kg",
                               .default_value = kTare_kg,
                               .unit = "kg",
                               .meaning = "Of all: box, frames, honey. Kept by a rule."}},
               .place_attribute = "position"});
  if (!type) return tl::unexpected(type.error());
  const Beehive hive(host.schema());
  if (auto s = host.add_rule({.name = "beehives.no_honey_without_frames",
                              .when = {.type = hive.type},
                              .run =
                                  [hive](Transaction& tx, std::span<const Change> mine) {
                                    return refuse_honey_without_frames(hive, tx, mine);
                                  }});
      !s)
    return s;
  if (auto s =
          host.add_rule({.name = "beehives.mass",
                         .when = {.type = hive.type},
                         .writes = {hive.mass_kg.id},
                         .run = [hive](Transaction& tx,
                                       std::span<const Change> mine) { return keep_mass(hive, tx, mine); }});
      !s)
    return s;
  return host.add_importer({.name = "beehives",
                            .suffixes = {".csv"},
                            .meaning = "Tables of beehives.",
                            .run = [hive](const std::filesystem::path& file, Transaction& tx) {
                              return import_csv(hive, file, tx);
                            }});
}

}  // namespace

RIGOR_WORLD_PLUGIN("beehives", "1.0", "Beehives, their mass, and tables of them.", define)
