// Scan patterns: tables with their complaints, what scans take of them, and the formula of the Mid-360.
#include "sensor-hal/models/lidar/scan_pattern.h"

#include <gtest/gtest.h>

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <set>

#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/lidar/scan_grid.h"
#include "tests/paths.h"

namespace rigor::models {
namespace {

constexpr double kRad = 180 / std::numbers::pi;

PatternTable table_of(const std::string& text) {
  auto t = parse_scan_pattern(text, "p.csv");
  EXPECT_TRUE(t) << t.error().text();
  return t ? *t : PatternTable{};
}
std::string wrong_pattern(const std::string& text) {
  const auto t = parse_scan_pattern(text, "p.csv");
  EXPECT_FALSE(t) << text;
  return t ? "" : t.error().text();
}
/// Five firings, the first at 2 s, in a period of 10 ms.
PatternTable five(bool periodic) {
  PatternTable t = table_of("2,1,0\n2.001,2,0\n2.002,3,0\n2.004,4,0\n2.009,5,0\n");
  if (periodic) {
    EXPECT_TRUE(set_period(t, 10'000'000));
  }
  return t;
}
std::vector<std::pair<int, int>> scan_of(const PatternTable& t, std::uint64_t index, std::int64_t scan_ns) {
  std::vector<PatternFiring> out;
  t.scan(index, scan_ns, out);
  std::vector<std::pair<int, int>> told;
  for (const PatternFiring& f : out)
    told.emplace_back(std::lround(static_cast<double>(f.azimuth_rad) * kRad), f.time_ns / 1000);
  return told;
}
using Told = std::vector<std::pair<int, int>>;

TEST(ScanPattern, ReadsTablesWithAndWithoutHeader) {
  const PatternTable plain = table_of("0,10,-5\n0.001,20,5\n");
  const PatternTable headed = table_of(
      "\xEF\xBB\xBF# made by hand\r\nelevation_deg, time_s "
      ",divergence_mrad,azimuth_deg\r\n\r\n-5,0.5,3,10\r\n"
      "5,0.501,+4,20\r\n");
  for (const PatternTable& t : {plain, headed}) {
    ASSERT_EQ(t.firings.size(), 2u);
    EXPECT_EQ(t.firings[0].time_ns, 0) << "times count from the first row";
    EXPECT_EQ(t.firings[1].time_ns, 1'000'000);
    EXPECT_NEAR(static_cast<double>(t.firings[1].azimuth_rad) * kRad, 20, 1e-5);
    EXPECT_NEAR(static_cast<double>(t.firings[0].elevation_rad) * kRad, -5, 1e-5);
  }
  EXPECT_FALSE(plain.has_divergence);
  EXPECT_TRUE(headed.has_divergence);
  EXPECT_NEAR(headed.firings[1].divergence_rad, 0.004, 1e-9);
}

TEST(ScanPattern, SaysFileAndLineOfWhatItCannotRead) {
  struct Case {
    const char* text;
    const char* said;
  };
  for (const Case& c :
       {Case{"", "p.csv: expected rows of"},
        Case{"time_s,azimuth_deg,elevation_deg\n", "p.csv: expected rows of"},
        Case{"0,1,2\n0.1,nan,2\n", "p.csv:2: azimuth_deg: expected a number from -360 to 360"},
        Case{"0,1,2\n\n0.1,inf,2\n", "p.csv:3: azimuth_deg"},
        Case{"0,1,2\n0.1,1,\n", "p.csv:2: elevation_deg: expected a number from -90 to 90, got \"\""},
        Case{",1,2\n", "p.csv:1: time_s"},
        Case{"0,1,2\n0.1,1\n", "p.csv:2: expected 3 numbers, got 2 fields"},
        Case{"0,1\n", "p.csv:1: expected 3 numbers, got 2 fields"},
        Case{"0,1,2,3,4\n", "p.csv:1: expected 4 numbers, got 5 fields"},
        Case{"0,361,2\n", "azimuth_deg: expected a number from -360 to 360, got \"361\""},
        Case{"0,1,90.5\n", "elevation_deg"}, Case{"-1,1,2\n", "time_s: expected a number from 0"},
        Case{"0,1,2,501\n", "divergence_mrad: expected a number from 0 to 500"},
        Case{"1,1,2\n0.5,1,2\n", "p.csv:2: time_s: expected a time that is not before"},
        Case{"time_s,azimuth_deg\n", "p.csv:1: expected a column elevation_deg, got none"},
        Case{"time_s,azimuth_deg,zenith_deg\n", "got \"zenith_deg\""},
        Case{"time_s,time_s,azimuth_deg,elevation_deg\n", "got \"time_s\" again"},
        Case{"0,1x,2\n", "got \"1x\""}})
    EXPECT_NE(wrong_pattern(c.text).find(c.said), std::string::npos) << c.text << wrong_pattern(c.text);
  EXPECT_FALSE(load_scan_pattern("/no/such/pattern.csv"));
}

TEST(ScanPattern, RefusesMoreRowsThanItHolds) {
  std::string text;
  text.reserve((kMaxPatternRows + 1) * 6);
  for (std::size_t i = 0; i <= kMaxPatternRows; ++i) text += "0,1,2\n";
  EXPECT_NE(wrong_pattern(text).find(":4194305: expected at most 4194304 rows"), std::string::npos);
}

TEST(ScanPattern, APeriodicOneGoesOnFromScanToScan) {
  const PatternTable t = five(true);
  EXPECT_EQ(scan_of(t, 0, 10'000'000), (Told{{1, 0}, {2, 1000}, {3, 2000}, {4, 4000}, {5, 9000}}));
  EXPECT_EQ(scan_of(t, 0, 4'000'000), (Told{{1, 0}, {2, 1000}, {3, 2000}}));
  EXPECT_EQ(scan_of(t, 1, 4'000'000), (Told{{4, 0}}));
  EXPECT_EQ(scan_of(t, 2, 4'000'000), (Told{{5, 1000}, {1, 2000}, {2, 3000}}));
  EXPECT_EQ(scan_of(t, 3, 4'000'000), (Told{{3, 0}, {4, 2000}}));
  EXPECT_EQ(scan_of(t, 5, 4'000'000), scan_of(t, 0, 4'000'000));
  // More than a period in a scan; every firing is in one scan, however long it runs.
  EXPECT_EQ(scan_of(t, 0, 12'000'000),
            (Told{{1, 0}, {2, 1000}, {3, 2000}, {4, 4000}, {5, 9000}, {1, 10000}, {2, 11000}}));
  const std::uint64_t late = 1'000'000'000'000;
  EXPECT_EQ(scan_of(t, late * 5, 4'000'000), scan_of(t, 0, 4'000'000));
  std::size_t total = 0, most = 0;
  for (std::uint64_t k = 0; k < 50; ++k) {
    const std::size_t n = scan_of(t, k, 7'000'000).size();
    total += n;
    most = std::max(most, n);
  }
  EXPECT_EQ(total, 175u);
  EXPECT_EQ(t.max_firings(7'000'000), most);
  EXPECT_EQ(t.max_firings(20'000'000), 10u);
}

TEST(ScanPattern, OneThatDoesNotRepeatEnds) {
  const PatternTable t = five(false);
  EXPECT_EQ(scan_of(t, 0, 4'000'000).size(), 3u);
  EXPECT_EQ(scan_of(t, 1, 4'000'000), (Told{{4, 0}}));
  EXPECT_EQ(scan_of(t, 2, 4'000'000), (Told{{5, 1000}}));
  EXPECT_EQ(scan_of(t, 3, 4'000'000), Told{});
  EXPECT_EQ(scan_of(t, ~std::uint64_t{0}, 4'000'000), Told{});
  EXPECT_EQ(t.max_firings(4'000'000), 3u);
}

TEST(ScanPattern, DerivesItsPeriodOrRefusesOneThatIsTooShort) {
  PatternTable t = table_of("0,1,0\n0.001,2,0\n0.002,3,0\n0.003,4,0\n");
  ASSERT_TRUE(set_period(t, 0));
  EXPECT_EQ(t.period_ns, 4'000'000);
  EXPECT_EQ(t.step_ns(), 1'000'000);
  EXPECT_FALSE(set_period(t, 3'000'000));
  ASSERT_TRUE(set_period(t, 3'000'001));
  EXPECT_EQ(t.step_ns(), 0);
  PatternTable one = table_of("7,1,2\n");
  EXPECT_FALSE(set_period(one, 0)) << "one row has no step";
  ASSERT_TRUE(set_period(one, 5'000'000));
  EXPECT_EQ(scan_of(one, 1, 12'000'000), (Told{{1, 3000}, {1, 8000}}));
}

TEST(ScanPattern, IsReadFromASensorModel) {
  const auto folder =
      std::filesystem::path(testing::TempDir()) / ("scan-pattern-" + std::to_string(::getpid()));
  std::filesystem::create_directories(folder);
  const auto file = [&](const char* name) { return (folder / name).string(); };
  std::ofstream(file("p.csv")) << "0,1,2\n0.001,2,2\n0.002,3,nan\n";
  const auto load = [&](const std::string& scan, const std::string& more = "") {
    std::ofstream(file("m.yaml")) << "scan: " << scan << "\nrange: { max_m: 10 }\n" << more;
    return load_lidar_model(file("m.yaml"));
  };
  const auto said = [&](const std::string& scan, const std::string& more = "") {
    const auto m = load(scan, more);
    EXPECT_FALSE(m) << scan;
    return m ? std::string() : m.error().text();
  };
  const std::string begin = "{kind: pattern, scan_ms: 2, pattern: ";
  const std::string broken = said(begin + "{file: p.csv, periodic: true}}");
  EXPECT_NE(broken.find("m.yaml:1:"), std::string::npos) << broken;
  EXPECT_NE(broken.find("p.csv:3: elevation_deg"), std::string::npos) << broken;
  EXPECT_NE(said(begin + "{file: q.csv}}").find("found no such file"), std::string::npos);
  EXPECT_NE(said(begin + "{}}").find("either file or formula"), std::string::npos);
  EXPECT_NE(said(begin + "{formula: no}}").find("livox_mid360"), std::string::npos);
  EXPECT_NE(said(begin + "{formula: livox_mid360, periodic: true}}").find("periodic"), std::string::npos);
  EXPECT_NE(said(begin + "{formula: livox_mid360}}", "beams: {elevation_deg: [1]}\n").find("beams"),
            std::string::npos);
  std::ofstream(file("p.csv")) << "0,1,2\n0.001,2,2\n0.0035,3,1\n";
  EXPECT_NE(said(begin + "{file: p.csv, periodic: true, period_ms: 3}}").find("period_ms"),
            std::string::npos);
  EXPECT_NE(said(begin + "{file: p.csv, periodic: true, period_ms: 0}}").find("period_ms"),
            std::string::npos);
  const auto m = load(begin + "{file: p.csv, periodic: true}}");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->scan.kind, LidarScanKind::pattern);
  EXPECT_EQ(m->scan.pattern.table->period_ns, 5'250'000);
  EXPECT_EQ(m->scan.columns, 2u);
  EXPECT_DOUBLE_EQ(m->scan.duration_s(), 0.002);
  std::filesystem::remove_all(folder);
}

TEST(LivoxPattern, FillsItsFieldWithFourLines) {
  double lowest = 90, highest = -90;
  std::set<int> azimuths;
  for (std::uint32_t i = 0; i < 200'000; ++i) {
    const auto d = livox_mid360_direction(i % 4, i * kLivoxFiring_s);
    ASSERT_NEAR(d[0] * d[0] + d[1] * d[1] + d[2] * d[2], 1, 1e-12);
    const double elevation = std::asin(d[2]) * kRad;
    lowest = std::min(lowest, elevation), highest = std::max(highest, elevation);
    azimuths.insert(static_cast<int>(std::floor(std::atan2(d[1], d[0]) * kRad)));
  }
  EXPECT_NEAR(lowest, -7, 0.1);
  EXPECT_NEAR(highest, 52, 0.1);
  EXPECT_EQ(azimuths.size(), 360u);
}

/// Share of cells of half a degree that are met within a time; cells of all rows have the same size.
double coverage(double time_s) {
  constexpr double kCell_deg = 0.5;
  std::set<std::pair<int, int>> met;
  std::size_t all = 0;
  const auto cells = [](int row) {
    return std::lround(360 * std::cos((-7 + (row + 0.5) * kCell_deg) / kRad) / kCell_deg);
  };
  for (int row = 0; row < 118; ++row) all += static_cast<std::size_t>(cells(row));
  for (std::uint32_t i = 0; i < time_s / kLivoxFiring_s; ++i) {
    const auto d = livox_mid360_direction(i % 4, i * kLivoxFiring_s);
    const int row = std::clamp(static_cast<int>((std::asin(d[2]) * kRad + 7) / kCell_deg), 0, 117);
    const double turn = (std::atan2(d[1], d[0]) + std::numbers::pi) / (2 * std::numbers::pi);
    met.insert({row, static_cast<int>(turn * static_cast<double>(cells(row)))});
  }
  return static_cast<double>(met.size()) / static_cast<double>(all);
}

TEST(LivoxPattern, CoversMoreOfItsFieldTheLongerItLooks) {
  EXPECT_NEAR(coverage(0.1), 0.24, 0.02);
  EXPECT_NEAR(coverage(0.5), 0.73, 0.02);
  EXPECT_NEAR(coverage(1.0), 0.90, 0.02);
}

TEST(LivoxPattern, IsNearTheTableThatLivoxPublishes) {
  // Rows of scan_mode/mid360.csv of livox_laser_simulation: number, azimuth and zenith of the four lines.
  struct Row {
    int number;
    double azimuth_deg[4], zenith_deg[4];
  };
  const Row rows[] = {
      {1, {268.99, 269, 269, 269}, {37.838, 40.825, 43.581, 46.152}},
      {501, {112.04, 111.92, 111.83, 111.79}, {46.545, 44.133, 41.564, 38.804}},
      {1001, {313.35, 313.73, 314.14, 314.57}, {41.606, 43.761, 45.81, 47.768}},
      {15041, {341.6, 343.89, 346.1, 348.22}, {71.058, 70.692, 70.334, 69.983}},
      {15441, {214.65, 213.8, 212.92, 212.02}, {66.342, 67.659, 68.967, 70.266}},
      {25857, {82.674, 83.798, 84.974, 86.204}, {76.669, 75.433, 74.296, 73.111}},
      {49597, {190.76, 189.33, 187.9, 186.47}, {93.7197, 93.7576, 93.8104, 93.8777}},
  };
  double squares = 0;
  for (const Row& row : rows)
    for (std::uint32_t line = 0; line < 4; ++line) {
      const double a = row.azimuth_deg[line] / kRad, z = row.zenith_deg[line] / kRad;
      const auto d = livox_mid360_direction(line, (row.number - 1 + static_cast<int>(line)) * kLivoxFiring_s);
      const double cosine =
          d[0] * std::sin(z) * std::cos(a) + d[1] * std::sin(z) * std::sin(a) + d[2] * std::cos(z);
      const double off_deg = std::acos(std::min(1.0, cosine)) * kRad;
      EXPECT_LT(off_deg, 3.5) << "row " << row.number << " line " << line;
      squares += off_deg * off_deg;
    }
  EXPECT_LT(std::sqrt(squares / 28), 2.0);
}

TEST(LivoxPattern, DoesNotRepeat) {
  for (int scan = 1; scan < 600; ++scan) {
    const auto first = livox_mid360_direction(0, 0), later = livox_mid360_direction(0, 0.1 * scan);
    const double off =
        std::acos(std::min(1.0, first[0] * later[0] + first[1] * later[1] + first[2] * later[2]));
    EXPECT_GT(off * kRad, 0.05) << "after " << scan << " scans of 100 ms";
  }
}

TEST(ScanGrid, HasThePlacesOfAPattern) {
  const LidarScan scan = formula_scan(PatternFormula::livox_mid360, 100'000'000);
  ASSERT_EQ(scan.columns, 5000u);
  auto grid = ScanGrid::create_of_pattern(scan);
  ASSERT_TRUE(grid) << grid.error().text();
  std::vector<LidarPoint> points(2);
  points[0] = {1, 2, 2, 9, 4000 * 20'000 + 15'000, 3, 0, 0};
  points[1] = {1, 2, 2, 9, 4000 * 20'000 + 5'000, 3, 0, 0};  // the time of another line
  grid->fill(points);
  EXPECT_EQ(grid->at(4000, 3).range_m, 3);
  EXPECT_EQ(grid->at(4000, 3).remission, 9);
  EXPECT_EQ(grid->place_m(4000, 3), (std::array<float, 3>{1, 2, 2}));
  EXPECT_EQ(grid->at(4000, 1).range_m, 0);
  EXPECT_EQ(grid->strays(), 1u);
  grid->fill({});
  EXPECT_EQ(grid->at(4000, 3).range_m, 0);
  // A table, where its firings are evenly apart and never end.
  PatternTable table = table_of("0,1,0\n0.001,2,0\n0.002,3,0\n");
  EXPECT_FALSE(ScanGrid::create_of_pattern(table_scan(std::make_shared<PatternTable>(table), 2'000'000)));
  ASSERT_TRUE(set_period(table, 0));
  EXPECT_TRUE(ScanGrid::create_of_pattern(table_scan(std::make_shared<PatternTable>(table), 2'000'000)));
  EXPECT_FALSE(ScanGrid::create_of_pattern(table_scan(std::make_shared<PatternTable>(table), 2'500'000)));
  EXPECT_FALSE(ScanGrid::create_of_pattern(LidarScan{}));
}

}  // namespace
}  // namespace rigor::models
