#include "bench/dataset/poses.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sensor-hal/config/yaml.h"
#include "sim/gis/csv.h"

namespace rigor::dataset {
namespace {

constexpr double kFarthest_m = 1e8, kDegrees = 360000;

const std::vector<std::string>& pose_columns() {
  static const std::vector<std::string> kColumns{"x_m",      "y_m", "z_m", "height_m", "yaw_deg", "pitch_deg",
                                                 "roll_deg", "qw",  "qx",  "qy",       "qz"};
  return kColumns;
}

/// The numbers of a table whose columns are among `known`; x_m and y_m must be there.
class Numbers {
 public:
  static Result<Numbers> read(const std::filesystem::path& file, const std::string& where,
                              const std::vector<std::string>& known) {
    Numbers n;
    auto table = gis::read_csv(file);
    if (!table) {
      Error e = table.error();
      if (e.code == ErrorCode::not_found) e.where = where + ": " + e.where;
      return tl::unexpected<Error>(e);
    }
    n.table_ = std::move(*table);
    for (const std::string& column : n.table_.columns)
      if (std::find(known.begin(), known.end(), column) == known.end()) {
        const std::string near = nearest(column, known);
        return fail(ErrorCode::bad_input, n.table_.file + ":1: " + column,
                    fmt::format("expected columns among {}, got this one{}", fmt::join(known, ", "),
                                near.empty() ? "" : "; did you mean " + near + "?"));
      }
    for (const char* column : {"x_m", "y_m"})
      if (!n.table_.find(column))
        return fail(ErrorCode::bad_input, n.table_.file + ":1",
                    fmt::format("expected the columns x_m and y_m, found no {}", column));
    return n;
  }
  [[nodiscard]] const std::vector<gis::CsvRow>& rows() const { return table_.rows; }
  [[nodiscard]] bool has(const char* column) const { return table_.find(column).has_value(); }
  [[nodiscard]] const std::string& file() const { return table_.file; }
  [[nodiscard]] std::string place(const gis::CsvRow& row) const { return table_.place(row); }

  Result<double> at(const gis::CsvRow& row, const char* column, double limit) const {
    const std::string& text = row.cells[*table_.find(column)];
    const auto value = gis::number_of(text);
    if (!value || !(std::abs(*value) <= limit))
      return fail(ErrorCode::bad_input, fmt::format("{}: {}", table_.place(row), column),
                  fmt::format("expected a number from {:g} to {:g}, got \"{}\"", -limit, limit, text));
    return *value;
  }

 private:
  gis::CsvTable table_;
};

}  // namespace

Eigen::Matrix3d rotation_of(double yaw_deg, double pitch_deg, double roll_deg) {
  constexpr double kRad = std::numbers::pi / 180;
  return (Eigen::AngleAxisd(yaw_deg * kRad, Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(pitch_deg * kRad, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(roll_deg * kRad, Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

Result<PoseSource> PoseSource::create(const PoseChoice& choice) {
  PoseSource source;
  source.choice_ = choice;
  if (choice.kind == PoseChoice::Kind::rig || choice.kind == PoseChoice::Kind::within) return source;
  if (choice.kind == PoseChoice::Kind::along) {
    auto table = Numbers::read(choice.file, choice.where, {"x_m", "y_m"});
    if (!table) return tl::unexpected<Error>(table.error());
    for (const gis::CsvRow& row : table->rows()) {
      const auto x = table->at(row, "x_m", kFarthest_m), y = table->at(row, "y_m", kFarthest_m);
      if (!x) return tl::unexpected<Error>(x.error());
      if (!y) return tl::unexpected<Error>(y.error());
      const Eigen::Vector2d p(*x, *y);
      if (!source.path_.empty() && p == source.path_.back()) continue;
      source.length_m_.push_back(
          source.path_.empty() ? 0 : source.length_m_.back() + (p - source.path_.back()).norm());
      source.path_.push_back(p);
    }
    if (source.path_.size() < 2)
      return fail(ErrorCode::bad_input, table->file(), "expected at least two points of a path, got fewer");
    return source;
  }
  auto table = Numbers::read(choice.file, choice.where, pose_columns());
  if (!table) return tl::unexpected<Error>(table.error());
  const bool quaternion = table->has("qw") || table->has("qx") || table->has("qy") || table->has("qz");
  const bool angles = table->has("yaw_deg") || table->has("pitch_deg") || table->has("roll_deg");
  if (table->has("z_m") && table->has("height_m"))
    return fail(ErrorCode::bad_input, table->file() + ":1", "expected z_m or height_m, got both");
  if (quaternion && angles)
    return fail(ErrorCode::bad_input, table->file() + ":1", "expected angles or qw, qx, qy, qz, got both");
  for (const char* column : {"qw", "qx", "qy", "qz"})
    if (quaternion && !table->has(column))
      return fail(ErrorCode::bad_input, table->file() + ":1",
                  fmt::format("expected qw, qx, qy and qz, found no {}", column));
  for (const gis::CsvRow& row : table->rows()) {
    WantedPose pose;
    // The first of several errors is told.
    std::optional<Error> wrong;
    const auto number = [&](const char* column, double limit, double without) {
      if (!table->has(column)) return without;
      const auto value = table->at(row, column, limit);
      if (!value && !wrong) wrong = value.error();
      return value.value_or(without);
    };
    pose.x_m = number("x_m", kFarthest_m, 0);
    pose.y_m = number("y_m", kFarthest_m, 0);
    if (table->has("z_m")) pose.z_m = number("z_m", kFarthest_m, 0);
    if (table->has("height_m")) pose.height_m = number("height_m", kFarthest_m, 0);
    if (quaternion) {
      const Eigen::Quaterniond q(number("qw", 2, 1), number("qx", 2, 0), number("qy", 2, 0),
                                 number("qz", 2, 0));
      if (!wrong && std::abs(q.norm() - 1) > 1e-3)
        return fail(ErrorCode::bad_input, table->place(row),
                    fmt::format("expected a quaternion of length 1, got length {:.6g}", q.norm()));
      pose.R = q.normalized().toRotationMatrix();
    } else {
      pose.R = rotation_of(number("yaw_deg", kDegrees, 0), number("pitch_deg", kDegrees, 0),
                           number("roll_deg", kDegrees, 0));
    }
    if (wrong) return tl::unexpected<Error>(*wrong);
    source.list_.push_back(pose);
  }
  if (source.list_.empty())
    return fail(ErrorCode::bad_input, table->file(), "expected at least one pose, found none");
  return source;
}

WantedPose PoseSource::at(std::uint64_t seed, std::uint64_t index, std::uint32_t attempt) const {
  const auto a = draw(seed, Draw::pose, index, 2 * attempt),
             b = draw(seed, Draw::pose, index, 2 * attempt + 1);
  if (!list_.empty()) {
    WantedPose pose = list_[index % list_.size()];
    if (!pose.z_m && !pose.height_m && choice_.height_m) pose.height_m = choice_.height_m->at(a[2]);
    return pose;
  }
  WantedPose pose;
  const double pitch_deg = choice_.pitch_deg.at(b[0]), roll_deg = choice_.roll_deg.at(b[1]);
  if (choice_.height_m) pose.height_m = choice_.height_m->at(a[2]);
  if (choice_.kind == PoseChoice::Kind::within) {
    pose.x_m = choice_.within[0] + (choice_.within[2] - choice_.within[0]) * a[0];
    pose.y_m = choice_.within[1] + (choice_.within[3] - choice_.within[1]) * a[1];
    pose.R = rotation_of(choice_.yaw_deg.value_or(Interval{0, 360}).at(a[3]), pitch_deg, roll_deg);
    return pose;
  }
  const double s = length_m_.back() * a[0];
  const auto next = static_cast<std::size_t>(
      std::clamp<std::ptrdiff_t>(std::upper_bound(length_m_.begin(), length_m_.end(), s) - length_m_.begin(),
                                 1, static_cast<std::ptrdiff_t>(path_.size()) - 1));
  const Eigen::Vector2d along = (path_[next] - path_[next - 1]).normalized();
  const Eigen::Vector2d p = path_[next - 1] + (s - length_m_[next - 1]) * along +
                            choice_.lateral_m.at(a[1]) * Eigen::Vector2d(-along.y(), along.x());
  pose.x_m = p.x();
  pose.y_m = p.y();
  pose.R = rotation_of(std::atan2(along.y(), along.x()) * 180 / std::numbers::pi +
                           choice_.yaw_deg.value_or(Interval{}).at(a[3]),
                       pitch_deg, roll_deg);
  return pose;
}

}  // namespace rigor::dataset
