#include "sim/gis/cover.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/gis/csv.h"
#include "sim/gis/shapes.h"
#include "sim/world/semantic_types.h"

namespace rigor::gis {
namespace {

struct Class {
  int value;
  const char* word;
};

// https://esa-worldcover.org, product user manual, table 3
constexpr Class kWorldCover[] = {{10, "forest_floor"}, {20, "shrub"},   {30, "meadow"}, {40, "crop"},
                                 {50, "built_up"},     {60, "soil"},    {70, "snow"},   {80, "water"},
                                 {90, "wetland"},      {95, "wetland"}, {100, "meadow"}};
// https://land.copernicus.eu, CORINE Land Cover nomenclature; rasters number the classes from 1 in this
// order.
constexpr Class kCorine[] = {
    {111, "built_up"}, {112, "built_up"}, {121, "built_up"},     {122, "asphalt"},      {123, "concrete"},
    {124, "asphalt"},  {131, "gravel"},   {132, "soil"},         {133, "soil"},         {141, "grass"},
    {142, "grass"},    {211, "crop"},     {212, "crop"},         {213, "crop"},         {221, "crop"},
    {222, "crop"},     {223, "crop"},     {231, "meadow"},       {241, "crop"},         {242, "crop"},
    {243, "crop"},     {244, "crop"},     {311, "forest_floor"}, {312, "forest_floor"}, {313, "forest_floor"},
    {321, "meadow"},   {322, "shrub"},    {323, "shrub"},        {324, "shrub"},        {331, "sand"},
    {332, "rock"},     {333, "soil"},     {334, "soil"},         {335, "snow"},         {411, "wetland"},
    {412, "wetland"},  {421, "wetland"},  {422, "wetland"},      {423, "sand"},         {511, "water"},
    {512, "water"},    {521, "water"},    {522, "water"},        {523, "water"}};

struct Growth {
  const char *cover, *plant;
  double per_m2, height_m, height_spread;
};
constexpr Growth kGrowth[] = {{"grass", "grass", 120, 0.08, 0.3}, {"meadow", "grass", 150, 0.45, 0.35},
                              {"shrub", "shrub", 0.5, 1.2, 0.4},  {"forest_floor", "litter", 60, 0.03, 0.4},
                              {"fern", "fern", 3, 0.7, 0.3},      {"crop", "grass", 200, 0.7, 0.1},
                              {"wetland", "grass", 90, 0.9, 0.3}};

}  // namespace

Result<std::vector<std::pair<std::string, std::string>>> class_set(std::string_view name) {
  std::vector<std::pair<std::string, std::string>> set;
  if (name == "worldcover") {
    for (const Class& c : kWorldCover) set.emplace_back(std::to_string(c.value), c.word);
  } else if (name == "corine") {
    int number = 0;
    for (const Class& c : kCorine) set.emplace_back(std::to_string(++number), c.word);
    for (const Class& c : kCorine) set.emplace_back(std::to_string(c.value), c.word);
  } else if (name == "words") {
    int number = 0;
    for (const auto word : world::types::kCoverWords)
      set.emplace_back(std::to_string(number++), std::string(word));
  } else {
    return fail(
        ErrorCode::bad_input, "classes",
        fmt::format("expected worldcover, corine, words or a map of value: cover word, got '{}'", name));
  }
  return set;
}

Result<CoverClasses> CoverClasses::make(const ImportSource& source,
                                        const std::vector<std::string>& categories,
                                        const std::string& where) {
  CoverClasses classes;
  for (const auto& [value, word] : source.classes) {
    const auto v = number_of(value);
    const auto w = word == "unknown" ? std::optional(kUnknownCover) : cover_word(word);
    if (!v || std::isnan(*v))
      return fail(ErrorCode::bad_input, where,
                  fmt::format("classes: expected a raster value, got '{}'", value));
    if (!w) {
      const std::vector<std::string> words(std::begin(world::types::kCoverWords),
                                           std::end(world::types::kCoverWords));
      std::string all;
      for (const auto& x : words) all += x + ", ";
      const std::string near = nearest(word, words);
      return fail(ErrorCode::bad_input, where,
                  fmt::format("classes: {}: expected one of {}unknown, got '{}'{}", value, all, word,
                              near.empty() ? "" : "; did you mean " + near + "?"));
    }
    classes.words_.emplace_back(*v, *w);
  }
  if (source.classes.empty())
    for (std::size_t i = 0; i < categories.size(); ++i)
      if (const auto w = cover_word(categories[i])) classes.words_.emplace_back(static_cast<double>(i), *w);
  if (classes.words_.empty())
    return fail(
        ErrorCode::bad_input, where,
        "expected classes: a map of raster value: cover word, or worldcover, corine, words; got none");
  std::sort(classes.words_.begin(), classes.words_.end());
  for (std::size_t i = 1; i < classes.words_.size(); ++i)
    if (classes.words_[i].first == classes.words_[i - 1].first)
      return fail(ErrorCode::bad_input, where,
                  fmt::format("classes: expected each value once, got {} twice", classes.words_[i].first));
  return classes;
}

bool CoverClasses::knows(double value) const {
  const auto it = std::lower_bound(words_.begin(), words_.end(), std::pair<double, std::uint8_t>(value, 0));
  return it != words_.end() && it->first == value;
}

std::uint8_t CoverClasses::word(double value) const {
  const auto it = std::lower_bound(words_.begin(), words_.end(), std::pair<double, std::uint8_t>(value, 0));
  return it != words_.end() && it->first == value ? it->second : kUnknownCover;
}

std::optional<DraftNode> vegetation_of(std::uint8_t word) {
  for (const Growth& g : kGrowth)
    if (world::types::kCoverWords[word] == g.cover)
      return DraftNode{"GroundVegetation",
                       {{"cover", std::string(g.cover)},
                        {"plant", std::string(g.plant)},
                        {"per_m2", g.per_m2},
                        {"height_m", g.height_m},
                        {"height_spread", g.height_spread},
                        {"seed", std::int64_t{word} + 1}}};
  return std::nullopt;
}

void burn(std::vector<CoverArea> areas, const Grid& grid, std::vector<std::uint8_t>& cells,
          std::vector<int>& source_of_cell) {
  std::stable_sort(areas.begin(), areas.end(),
                   [](const CoverArea& a, const CoverArea& b) { return a.area_m2 > b.area_m2; });
  std::vector<double> crossings;
  for (const CoverArea& area : areas) {
    double south = 1e300, north = -1e300;
    for (const auto& ring : area.rings)
      for (std::size_t i = 1; i < ring.size(); i += 2)
        south = std::min(south, ring[i]), north = std::max(north, ring[i]);
    const double first = std::max(0.0, std::ceil((grid.y_m - north) / grid.spacing_m));
    const double last =
        std::min(static_cast<double>(grid.rows - 1), std::floor((grid.y_m - south) / grid.spacing_m));
    if (!(first <= last)) continue;
    for (auto row = static_cast<std::int64_t>(first); row <= static_cast<std::int64_t>(last); ++row) {
      const double y = grid.y_m - static_cast<double>(row) * grid.spacing_m;
      crossings.clear();
      for (const auto& ring : area.rings)
        for (std::size_t i = 0; i < ring.size(); i += 2) {
          const std::size_t j = (i + 2) % ring.size();
          const double ya = ring[i + 1], yb = ring[j + 1];
          if ((ya <= y) == (yb <= y)) continue;  // half open: a vertex on the line counts once
          crossings.push_back(ring[i] + (y - ya) / (yb - ya) * (ring[j] - ring[i]));
        }
      std::sort(crossings.begin(), crossings.end());
      for (std::size_t k = 0; k + 1 < crossings.size(); k += 2) {
        const double from = std::max(0.0, std::ceil((crossings[k] - grid.x_m) / grid.spacing_m));
        const double to = std::min(static_cast<double>(grid.columns - 1),
                                   std::floor((crossings[k + 1] - grid.x_m) / grid.spacing_m));
        if (!(from <= to)) continue;
        for (auto c = static_cast<std::int64_t>(from); c <= static_cast<std::int64_t>(to); ++c) {
          const auto cell = static_cast<std::size_t>(row * grid.columns + c);
          if (area.source > source_of_cell[cell]) continue;
          cells[cell] = area.word;
          source_of_cell[cell] = area.source;
        }
      }
    }
  }
}

}  // namespace rigor::gis
