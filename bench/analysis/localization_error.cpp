#include "bench/analysis/localization_error.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <set>

#include "bench/motion/pose_error.h"
#include "bench/page/svg.h"
#include "bench/run/recording.h"
#include "rt-core/numbers.h"
#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor {
namespace {

using record::MessageView;
namespace msg = record::msg;

constexpr double kDegPerRad = 180 / std::numbers::pi;

struct EstimatedPose {
  PlanePose pose;  ///< UTC
  double sigma_x_m, sigma_y_m, state;
};

std::int64_t ns_of(const msg::Time& t) { return std::int64_t{t.sec} * 1'000'000'000 + t.nanosec; }

std::optional<double> named(const std::vector<std::string>& names, const std::vector<double>& values,
                            std::string_view name) {
  const auto it = std::find(names.begin(), names.end(), name);
  const auto i = static_cast<std::size_t>(it - names.begin());
  if (i >= std::min(names.size(), values.size())) return std::nullopt;
  return values[i];
}

template <class F>
Status each(record::McapReader& reader, const std::string& topic, F&& take) {
  auto cursor = reader.messages({.topics = {topic}});
  MessageView view;
  while (true) {
    const auto more = cursor.next(view);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) return {};
    if (auto s = take(view); !s) return s;
  }
}

Result<std::vector<PlanePose>> true_poses(record::McapReader& reader, const std::string& channel) {
  std::vector<PlanePose> poses;
  std::set<std::string> recorded;
  for (const auto& [id, c] : reader.channels()) {
    const auto end = c.topic.find('/', 1);
    if (c.topic.starts_with("/") && end != std::string::npos && !c.topic.starts_with("/rigor/"))
      recorded.insert(c.topic.substr(1, end - 1));
    if (!c.topic.starts_with("/" + channel + "/")) continue;
    const auto schema = reader.schemas().find(c.schema);
    if (schema == reader.schemas().end()) continue;
    if (schema->second.name == msg::RegisterBlock::kType) {
      if (auto s = each(reader, c.topic,
                        [&](const MessageView& view) -> Status {
                          msg::RegisterBlock m;
                          if (auto r = record::CdrReader::read(view.data, m); !r) return r;
                          const auto x = named(m.names, m.values, "x_m"), y = named(m.names, m.values, "y_m");
                          const auto yaw = named(m.names, m.values, "yaw_deg");
                          if (x && y)
                            poses.push_back({ns_of(m.header.stamp), *x, *y, yaw.value_or(kNaN) / kDegPerRad});
                          return {};
                        });
          !s)
        return tl::unexpected<Error>(s.error());
    } else if (schema->second.name == msg::PoseStamped::kType) {
      if (auto s = each(reader, c.topic,
                        [&](const MessageView& view) -> Status {
                          msg::PoseStamped m;
                          if (auto r = record::CdrReader::read(view.data, m); !r) return r;
                          const auto& p = m.pose.position;
                          const auto& q = m.pose.orientation;
                          poses.push_back(
                              {ns_of(m.header.stamp), p.x, p.y,
                               std::atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))});
                          return {};
                        });
          !s)
        return tl::unexpected<Error>(s.error());
    }
    if (!poses.empty()) break;
  }
  if (poses.empty())
    return fail(
        ErrorCode::bad_input, reader.name(),
        fmt::format("expected true poses of a channel \"{}\" (of kind pose, or registers with x_m, y_m and "
                    "yaw_deg), found none; its channels are {}",
                    channel, fmt::join(recorded, ", ")));
  std::stable_sort(poses.begin(), poses.end(),
                   [](const PlanePose& a, const PlanePose& b) { return a.t_ns < b.t_ns; });
  return poses;
}

Result<std::vector<EstimatedPose>> estimated_poses(record::McapReader& reader, const std::string& sink) {
  std::vector<EstimatedPose> estimated;
  std::set<std::string> sinks;
  auto s = each(reader, "/rigor/commands", [&](const MessageView& view) -> Status {
    msg::Command m;
    if (auto r = record::CdrReader::read(view.data, m); !r) return r;
    sinks.insert(m.channel);
    if (m.channel != sink) return {};
    const auto x = named(m.names, m.values, "x"), y = named(m.names, m.values, "y");
    const auto other = [&](const char* name) { return named(m.names, m.values, name).value_or(kNaN); };
    if (x && y)
      estimated.push_back({{ns_of(m.header.stamp), *x, *y, other("yaw")},
                           other("sigma_x"),
                           other("sigma_y"),
                           other("state")});
    return {};
  });
  if (!s) return tl::unexpected<Error>(s.error());
  if (estimated.empty())
    return fail(ErrorCode::bad_input, reader.name(),
                fmt::format("expected a sink \"{}\" that receives x and y, found none; the sinks that "
                            "received commands are {}",
                            sink, sinks.empty() ? "none" : fmt::format("{}", fmt::join(sinks, ", "))));
  return estimated;
}

/// By nearest rank; 0 ≤ share ≤ 1. Not empty.
double quantile(std::vector<double> values, double share) {
  const auto at = values.begin() +
                  static_cast<std::ptrdiff_t>(std::llround(share * static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace

double LocalizationError::At::distance_m() const { return std::hypot(along_m, across_m); }

Result<LocalizationError> localization_error(const std::filesystem::path& recording,
                                             const LocalizationQuestion& question) {
  const auto run = read_recorded_run(recording);
  if (!run) return tl::unexpected<Error>(run.error());
  auto reader = record::McapReader::open(recording.string());
  if (!reader) return tl::unexpected<Error>(reader.error());
  const auto poses = true_poses(**reader, question.truth);
  if (!poses) return tl::unexpected<Error>(poses.error());
  const auto estimated = estimated_poses(**reader, question.estimate);
  if (!estimated) return tl::unexpected<Error>(estimated.error());

  const std::int64_t start_ns = run->epoch.to_utc(run->t0).ns();
  LocalizationError out;
  double squared = 0;
  std::size_t with_sigma = 0;
  std::vector<double> distances, turns;
  for (const EstimatedPose& e : *estimated) {
    const double t_s = static_cast<double>(e.pose.t_ns - start_ns) * 1e-9;
    if (t_s < question.after_s) continue;
    if (e.state == 0) {
      ++out.searching;
      continue;
    }
    const auto p = pose_at(*poses, e.pose.t_ns);
    if (!p) {
      ++out.no_truth;
      continue;
    }
    const PlanePoseError error = pose_error(e.pose, *p);
    LocalizationError::At at;
    at.t_s = t_s, at.x_m = p->x_m, at.y_m = p->y_m;
    at.along_m = error.along_m, at.across_m = error.across_m, at.yaw_rad = error.yaw_rad;
    const double distance_m = at.distance_m();
    const double variance = (e.sigma_x_m * e.sigma_x_m + e.sigma_y_m * e.sigma_y_m) / 2;
    at.sigma_m = std::sqrt(variance);
    if (variance > 0) squared += distance_m * distance_m / (2 * variance), ++with_sigma;
    if (!out.at.empty()) out.way_m += std::hypot(at.x_m - out.at.back().x_m, at.y_m - out.at.back().y_m);
    distances.push_back(distance_m);
    if (std::isfinite(at.yaw_rad)) turns.push_back(std::abs(at.yaw_rad));
    out.at.push_back(at);
  }
  if (out.at.empty())
    return fail(
        ErrorCode::bad_input, recording.string(),
        fmt::format("expected estimates beside true poses from {:g} s on, found none: {} while searching, "
                    "{} without a true pose",
                    question.after_s, out.searching, out.no_truth));
  out.median_m = quantile(distances, 0.5), out.p95_m = quantile(distances, 0.95);
  out.worst_m = *std::max_element(distances.begin(), distances.end());
  out.median_yaw_rad = turns.empty() ? kNaN : quantile(turns, 0.5);
  out.p95_yaw_rad = turns.empty() ? kNaN : quantile(turns, 0.95);
  out.squared_over_variance = with_sigma == 0 ? kNaN : squared / static_cast<double>(with_sigma);
  return out;
}

nlohmann::json to_json(const LocalizationError& e) {
  const auto known = [](double v) { return std::isfinite(v) ? nlohmann::json(v) : nlohmann::json(); };
  return {{"estimates", e.at.size()},
          {"way_m", e.way_m},
          {"median_m", e.median_m},
          {"p95_m", e.p95_m},
          {"worst_m", e.worst_m},
          {"last_m", e.at.back().distance_m()},
          {"median_yaw_deg", known(e.median_yaw_rad * kDegPerRad)},
          {"p95_yaw_deg", known(e.p95_yaw_rad * kDegPerRad)},
          {"squared_over_variance", known(e.squared_over_variance)},
          {"searching", e.searching},
          {"no_truth", e.no_truth}};
}

std::string to_text(const LocalizationError& e) {
  std::string s = fmt::format("{} estimates over {:.1f} m: median {:.1f} mm, p95 {:.1f} mm, worst {:.1f} mm",
                              e.at.size(), e.way_m, e.median_m * 1e3, e.p95_m * 1e3, e.worst_m * 1e3);
  if (std::isfinite(e.p95_yaw_rad))
    s += fmt::format("; yaw median {:.2f}°, p95 {:.2f}°", e.median_yaw_rad * kDegPerRad,
                     e.p95_yaw_rad * kDegPerRad);
  if (std::isfinite(e.squared_over_variance))
    s += fmt::format("; squared over stated variance {:.2f}", e.squared_over_variance);
  if (e.searching > 0) s += fmt::format("; {} sent while searching", e.searching);
  if (e.no_truth > 0) s += fmt::format("; {} without a true pose", e.no_truth);
  return s;
}

namespace {

constexpr std::size_t kPlotted = 700;

/// At most kPlotted stretches, each by its entry of the greatest distance: peaks stay.
std::vector<const LocalizationError::At*> thinned(const LocalizationError& e) {
  std::vector<const LocalizationError::At*> out;
  const std::size_t parts = std::min(kPlotted, e.at.size());
  for (std::size_t k = 0; k < parts; ++k) {
    const std::size_t from = k * e.at.size() / parts, to = (k + 1) * e.at.size() / parts;
    out.push_back(&*std::max_element(
        e.at.begin() + static_cast<std::ptrdiff_t>(from), e.at.begin() + static_cast<std::ptrdiff_t>(to),
        [](const auto& a, const auto& b) { return a.distance_m() < b.distance_m(); }));
  }
  return out;
}

/// Green at 0, yellow at half, red at 1.
std::string colour(double share) {
  const double u = std::clamp(share, 0.0, 1.0);
  const int red = static_cast<int>(std::lround(u < 0.5 ? 40 + 2 * u * 190 : 230));
  const int green = static_cast<int>(std::lround(u < 0.5 ? 150 : 150 - 2 * (u - 0.5) * 120));
  return fmt::format("#{:02x}{:02x}30", red, green);
}

std::string map_svg(const LocalizationError& e, const std::vector<DrawnStem>& stems) {
  constexpr double kSide = 560, kMargin_m = 6, kFoot = 30;
  double x0 = INFINITY, x1 = -INFINITY, y0 = INFINITY, y1 = -INFINITY;
  for (const auto& a : e.at) {
    x0 = std::min(x0, a.x_m), x1 = std::max(x1, a.x_m);
    y0 = std::min(y0, a.y_m), y1 = std::max(y1, a.y_m);
  }
  x0 -= kMargin_m, x1 += kMargin_m, y0 -= kMargin_m, y1 += kMargin_m;
  const double scale = kSide / std::max(x1 - x0, y1 - y0), height = (y1 - y0) * scale;
  const auto px = [&](double x) { return (x - x0) * scale; };
  const auto py = [&](double y) { return height - (y - y0) * scale; };
  std::string s =
      fmt::format(R"(<svg viewBox="0 0 {:.0f} {:.0f}" xmlns="http://www.w3.org/2000/svg" role="img">)", kSide,
                  height + kFoot);
  s += fmt::format(R"(<rect width="{:.0f}" height="{:.0f}" fill="#f3f1ea"/>)", kSide, height);
  for (const DrawnStem& stem : stems)
    if (stem.x_m > x0 && stem.x_m < x1 && stem.y_m > y0 && stem.y_m < y1)
      s += fmt::format(R"(<circle cx="{:.1f}" cy="{:.1f}" r="{:.2f}" fill="#8b6b4a"/>)", px(stem.x_m),
                       py(stem.y_m), std::max(1.2, stem.radius_m * scale));
  // Stretches of one colour are one line.
  const double full_m = std::max(e.p95_m, 1e-6);
  const auto points = thinned(e);
  std::string line, now;
  const auto flush = [&] {
    if (!line.empty())
      s += fmt::format(
          R"(<polyline fill="none" stroke="{}" stroke-width="3" stroke-linejoin="round" points="{}"/>)", now,
          line);
  };
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::string here = fmt::format("{:.1f},{:.1f} ", px(points[i]->x_m), py(points[i]->y_m));
    const std::string c = colour(std::round(points[i]->distance_m() / full_m * 8) / 8);
    if (c != now) {
      if (!now.empty()) line += here;
      flush();
      line.clear();
      now = c;
    }
    line += here;
  }
  flush();
  const auto& first = e.at.front();
  s += fmt::format(R"(<circle cx="{0:.1f}" cy="{1:.1f}" r="5" fill="none" stroke="#222" stroke-width="2"/>)",
                   px(first.x_m), py(first.y_m));
  const double ruler_m = (x1 - x0) > 60 ? 20 : (x1 - x0) > 20 ? 5 : 1;
  s += fmt::format(R"x(<path d="M8 {0:.1f}h{1:.1f}" style="stroke:var(--ink)" stroke-width="2"/>)x",
                   height + 12, ruler_m * scale);
  s +=
      fmt::format(R"(<text x="{:.1f}" y="{:.1f}">{:g} m</text>)", 14 + ruler_m * scale, height + 16, ruler_m);
  for (int k = 0; k <= 8; ++k)
    s += fmt::format(R"(<rect x="{:.1f}" y="{:.1f}" width="14" height="8" fill="{}"/>)", 250 + 14.0 * k,
                     height + 8, colour(k / 8.0));
  s += fmt::format(R"(<text x="380" y="{:.1f}">0 to {:.0f} mm (p95) and more</text>)", height + 16,
                   full_m * 1e3);
  return s + "</svg>";
}

}  // namespace

std::string localization_section(const LocalizationError& e, const std::vector<DrawnStem>& stems) {
  std::string s = "<h2>Where the application thought it was</h2><div class=\"tiles\">";
  const auto tile = [&](const std::string& value, const char* what) {
    s += fmt::format("<div class=\"tile\"><b>{}</b><span>{}</span></div>", value, what);
  };
  tile(fmt::format("{:.1f} mm", e.median_m * 1e3), "from the truth, median");
  tile(fmt::format("{:.1f} mm", e.p95_m * 1e3), "p95");
  tile(fmt::format("{:.1f} mm", e.worst_m * 1e3), "worst");
  if (std::isfinite(e.p95_yaw_rad)) tile(fmt::format("{:.2f}°", e.p95_yaw_rad * kDegPerRad), "yaw p95");
  if (std::isfinite(e.squared_over_variance))
    tile(fmt::format("{:.2f}", e.squared_over_variance), "squared error over stated variance");
  tile(fmt::format("{:.1f} m", e.way_m), "of true path");
  tile(fmt::format("{}", e.at.size()), "estimates");
  if (e.searching > 0) tile(fmt::format("{}", e.searching), "sent while searching, left out");
  s += "</div><div class=\"cards\" style=\"margin-top:14px\"><div class=\"card\"><h3>The true path, coloured "
       "by the "
       "distance of the estimate</h3>" +
       map_svg(e, stems) + "</div><div class=\"card\">";
  SvgSeries distance{"distance", "var(--series-1)", {}, {}},
      sigma{"claimed sigma", "var(--series-5)", {}, {}};
  SvgSeries along{"forward", "var(--series-1)", {}, {}}, across{"left", "var(--series-3)", {}, {}},
      yaw{"yaw", "var(--series-4)", {}, {}};
  for (const auto* a : thinned(e)) {
    const auto add = [&](SvgSeries& series, double y) {
      if (!std::isfinite(y)) return;
      series.x.push_back(a->t_s);
      series.y.push_back(y);
    };
    add(distance, a->distance_m() * 1e3);
    add(sigma, a->sigma_m * 1e3);
    add(along, a->along_m * 1e3);
    add(across, a->across_m * 1e3);
    add(yaw, a->yaw_rad * kDegPerRad);
  }
  std::vector<SvgSeries> first{distance};
  if (!sigma.x.empty()) first.push_back(sigma);
  s += "<h3>Distance to the truth</h3>" + svg_lines(first, "time [s]", "mm");
  s += "<h3>Estimate less truth</h3>" + svg_lines({along, across}, "time [s]", "mm");
  if (!yaw.x.empty()) s += "<h3>Yaw less truth</h3>" + svg_lines({yaw}, "time [s]", "degrees");
  return s + "</div></div>";
}

}  // namespace rigor
