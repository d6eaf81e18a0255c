#include "apps/forest-localization/stem_map.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <string>
#include <utility>

#include "sensor-hal/config/yaml.h"

namespace rigor::forest {
namespace {

std::vector<std::string> fields(const std::string& line) {
  std::vector<std::string> out;
  std::string field;
  for (const char c : line + ',') {
    if (c == ',') {
      out.push_back(std::exchange(field, {}));
    } else if (c != '\r' && c != ' ' && c != '\t') {
      field += c;
    }
  }
  return out;
}

Result<std::vector<Stem>> load_csv(const std::filesystem::path& file) {
  std::ifstream in(file);
  if (!in) return fail(ErrorCode::not_found, file.string(), "expected a stem map, found no readable file");
  std::string line;
  std::size_t number = 0;
  std::vector<std::string> header;
  std::vector<Stem> stems;
  const auto where = [&] { return file.string() + ":" + std::to_string(number); };
  while (std::getline(in, line)) {
    ++number;
    if (line.empty() || line[0] == '#' || line == "\r") continue;
    const std::vector<std::string> row = fields(line);
    if (header.empty()) {
      header = row;
      for (const char* name : {"x_m", "y_m", "diameter_m"})
        if (std::find(header.begin(), header.end(), name) == header.end())
          return fail(ErrorCode::bad_input, where(),
                      "expected a header with the columns x_m, y_m, diameter_m and perhaps fell, got \"" +
                          line + "\"");
      continue;
    }
    if (row.size() != header.size())
      return fail(ErrorCode::bad_input, where(),
                  "expected " + std::to_string(header.size()) + " fields as in the header, got " +
                      std::to_string(row.size()));
    Stem s;
    for (std::size_t i = 0; i < row.size(); ++i) {
      const bool is_fell = header[i] == "fell";
      double* target = header[i] == "x_m"          ? &s.x_m
                       : header[i] == "y_m"        ? &s.y_m
                       : header[i] == "diameter_m" ? &s.radius_m
                                                   : nullptr;
      if (is_fell) {
        if (row[i] != "true" && row[i] != "false" && !row[i].empty())
          return fail(ErrorCode::bad_input, where(), "fell: expected true or false, got \"" + row[i] + "\"");
        s.fell = row[i] == "true";
      } else if (target) {
        const auto [end, error] = std::from_chars(row[i].data(), row[i].data() + row[i].size(), *target);
        if (error != std::errc{} || end != row[i].data() + row[i].size() || !std::isfinite(*target))
          return fail(ErrorCode::bad_input, where(),
                      header[i] + ": expected a number, got \"" + row[i] + "\"");
      }
    }
    s.radius_m /= 2;
    stems.push_back(s);
  }
  return stems;
}

Result<std::vector<Stem>> load_yaml(const std::filesystem::path& file) {
  auto root = ConfigDocument::load(file);
  if (!root) return tl::unexpected<Error>(root.error());
  return catch_config([&] {
    std::vector<Stem> stems;
    for (const ConfigNode& n : root->list("stems")) {
      Stem s;
      s.x_m = n.number("x_m");
      s.y_m = n.number("y_m");
      s.radius_m = n.number("diameter_m", {.min = 0, .max = 20, .exclusive_min = true}) / 2;
      s.fell = n.flag_or("fell", false);
      n.finish();
      stems.push_back(s);
    }
    root->finish();
    return stems;
  });
}

}  // namespace

Result<StemMap> StemMap::load(const std::filesystem::path& file) {
  if (file.extension() != ".csv" && file.extension() != ".yaml")
    return fail(ErrorCode::bad_input, file.string(), "expected a stem map named .csv or .yaml");
  auto stems = file.extension() == ".csv" ? load_csv(file) : load_yaml(file);
  if (!stems) return tl::unexpected<Error>(stems.error());
  return from(std::move(*stems), file.string());
}

Result<StemMap> StemMap::from(std::vector<Stem> stems, const std::string& where) {
  if (stems.empty() || stems.size() > kMaxStems)
    return fail(ErrorCode::bad_input, where,
                "expected 1 to " + std::to_string(kMaxStems) + " stems, got " + std::to_string(stems.size()));
  StemMap map;
  double max_x = stems[0].x_m, max_y = stems[0].y_m;
  map.min_x_ = max_x, map.min_y_ = max_y;
  for (std::size_t i = 0; i < stems.size(); ++i) {
    const Stem& s = stems[i];
    if (!std::isfinite(s.x_m) || !std::isfinite(s.y_m) || !(s.radius_m > 0) || s.radius_m > 10)
      return fail(ErrorCode::bad_input, where,
                  "stem " + std::to_string(i + 1) +
                      ": expected a place and a diameter over 0 and up to 20 m, got " +
                      std::to_string(2 * s.radius_m) + " m");
    map.min_x_ = std::min(map.min_x_, s.x_m), max_x = std::max(max_x, s.x_m);
    map.min_y_ = std::min(map.min_y_, s.y_m), max_y = std::max(max_y, s.y_m);
  }
  const double wide = max_x - map.min_x_, high = max_y - map.min_y_;
  map.density_ = static_cast<double>(stems.size()) / ((wide + 10) * (high + 10));
  map.cell_m_ = std::max(2.0, std::max(wide, high) / 1000);
  map.columns_ = static_cast<std::size_t>(wide / map.cell_m_) + 1;
  map.rows_ = static_cast<std::size_t>(high / map.cell_m_) + 1;
  map.stems_ = std::move(stems);

  const auto cell_of = [&](const Stem& s) { return map.row(s.y_m) * map.columns_ + map.column(s.x_m); };
  map.cell_begin_.assign(map.columns_ * map.rows_ + 1, 0);
  for (const Stem& s : map.stems_) ++map.cell_begin_[cell_of(s) + 1];
  for (std::size_t i = 1; i < map.cell_begin_.size(); ++i) map.cell_begin_[i] += map.cell_begin_[i - 1];
  map.order_.resize(map.stems_.size());
  std::vector<std::uint32_t> next(map.cell_begin_.begin(), map.cell_begin_.end() - 1);
  for (std::uint32_t i = 0; i < map.stems_.size(); ++i) map.order_[next[cell_of(map.stems_[i])]++] = i;

  // Pairs: up to 15 m apart, or nearer in a stand so large or dense that they would be too many.
  const auto expected_pairs = [&](double limit) {
    return 0.5 * static_cast<double>(map.stems_.size()) * map.density_ * 3.14 * limit * limit;
  };
  while (map.pair_limit_m_ > 3 && expected_pairs(map.pair_limit_m_) > 0.3 * static_cast<double>(kMaxPairs))
    map.pair_limit_m_ *= 0.9;
  for (std::uint32_t a = 0; a < map.stems_.size(); ++a)
    map.near(map.stems_[a].x_m, map.stems_[a].y_m, map.pair_limit_m_, [&](std::uint32_t b) {
      if (b <= a || map.pairs_.size() == kMaxPairs) return;
      map.pairs_.push_back({static_cast<float>(std::hypot(map.stems_[a].x_m - map.stems_[b].x_m,
                                                          map.stems_[a].y_m - map.stems_[b].y_m)),
                            a, b});
    });
  std::sort(map.pairs_.begin(), map.pairs_.end(), [](const StemPair& p, const StemPair& q) {
    return p.distance_m != q.distance_m ? p.distance_m < q.distance_m
                                        : std::pair(p.a, p.b) < std::pair(q.a, q.b);
  });
  return map;
}

std::uint32_t StemMap::nearest(double x_m, double y_m, double limit_m) const noexcept {
  std::uint32_t best = kNone;
  double best2 = limit_m * limit_m;
  near(x_m, y_m, limit_m, [&](std::uint32_t i) {
    const double dx = stems_[i].x_m - x_m, dy = stems_[i].y_m - y_m, d2 = dx * dx + dy * dy;
    if (d2 <= best2) best = i, best2 = d2;
  });
  return best;
}

std::span<const StemPair> StemMap::pairs_between(double from_m, double to_m) const noexcept {
  const auto begin = std::lower_bound(pairs_.begin(), pairs_.end(), from_m,
                                      [](const StemPair& p, double d) { return p.distance_m < d; });
  const auto end = std::upper_bound(begin, pairs_.end(), to_m,
                                    [](double d, const StemPair& p) { return d < p.distance_m; });
  return {begin, end};
}

}  // namespace rigor::forest
