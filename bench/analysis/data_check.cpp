#include "bench/analysis/data_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <optional>
#include <set>

#include "bench/analysis/data_messages.h"
#include "bench/analysis/data_statistics.h"
#include "bench/analysis/frame_check.h"
#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/message_header.h"
#include "sensor-hal/record/ros2_time.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {
namespace {

using record::MessageView;
using Content = MessageForm::Content;

constexpr double kOtherClock_s = 60;  ///< further apart, stamps and log times are of different clocks
constexpr double kAhead_s = 0.05;     ///< a stamp may lie so far after its log time
constexpr double kSameMultiple = 4;   ///< intervals of one multiple in a row that are a lower rate
constexpr double kFewerPoints = 0.95, kSuddenly = 0.9, kIntensityJump = 0.25;

double seconds_of(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }

/// What is usual on one topic: learnt in the first pass.
struct Usual {
  LogHistogram period_s{1e-6}, delay_s{1e-6}, points{1}, columns{1}, intensity{1e-6}, change{1e-9};
  std::map<std::uint64_t, std::uint64_t> exact_points;  ///< up to kMostExact different ones
  std::uint64_t messages = 0, unset = 0;
  std::uint64_t first_ns = 0, last_ns = 0;

  // Of the message before.
  std::optional<std::int64_t> stamp_ns;
  std::optional<double> mean_intensity;

  static constexpr std::size_t kMostExact = 8192;

  /// 0: the topic has no period.
  [[nodiscard]] double period() const {
    if (period_s.total() + 1 < kEnoughMessages) return 0;
    const double p = period_s.median();
    const auto near = static_cast<double>(period_s.near(p, kPeriodTolerance));
    return near >= kPeriodicShare * static_cast<double>(period_s.total()) ? p : 0;
  }
  /// The number that most clouds have; 0: there is none.
  [[nodiscard]] double most_have() const {
    if (points.total() >= kEnoughClouds)
      for (const auto& [count, times] : exact_points)
        if (2 * times > points.total()) return static_cast<double>(count);
    return 0;
  }
  /// Fewer are incomplete.
  [[nodiscard]] double least_points() const {
    if (points.total() < kEnoughClouds) return 0;
    return most_have() > 0 ? kFewerPoints * most_have() : least(points);
  }
  [[nodiscard]] double least_columns() const { return columns.total() < kEnoughClouds ? 0 : least(columns); }

 private:
  /// Tukey's outer fence, and not next to the usual.
  static double least(const LogHistogram& h) {
    const double q1 = h.quantile(0.25), q3 = h.quantile(0.75);
    return std::min(q1 - 3 * (q3 - q1), kFewerPoints * h.median());
  }
};

class Checker {
 public:
  explicit Checker(record::McapReader& reader) : reader_(reader) {}

  Status run(DataReport& report) {
    report_ = &report;
    std::set<std::string> topics;
    for (const auto& [id, channel] : reader_.channels()) {
      topics.insert(channel.topic);
      const auto schema = reader_.schemas().find(channel.schema);
      Topic& topic = topics_[id];
      topic.form = form_of(channel, schema == reader_.schemas().end() ? nullptr : &schema->second);
      topic.companion = is_companion(channel.topic);
      if (channel.message_encoding == "cdr") any_cdr_ = true;
    }
    report.topics = topics.size();
    if (!topics_.empty() && !any_cdr_)
      return fail(ErrorCode::bad_input, reader_.name(),
                  "expected messages of ROS 2, encoded as cdr, found other encodings only");
    if (auto s = go([this](const MessageView& m, Topic& t) { learn(m, t); }); !s) return s;
    begin_ns_ = first_ns_;
    if (auto s = go([this](const MessageView& m, Topic& t) { judge(m, t); }); !s) return s;
    finish();
    return {};
  }

 private:
  struct Topic {
    MessageForm form;
    bool companion = false;
    Usual usual;

    // The second pass.
    double period_s = 0, least_points = 0, least_columns = 0, delay_s = 0, level = 0, change = 0;
    bool known = false;
    std::optional<std::int64_t> stamp_ns;
    std::optional<double> mean_intensity;
    double points = 0, columns = 0;  ///< of the cloud before
    std::uint64_t last_log_ns = 0;
    /// A stretch of intervals of one multiple of the period.
    struct Stretch {
      double multiple = 0;
      std::uint64_t intervals = 0;
      std::int64_t from_ns = 0, to_ns = 0;
      std::deque<std::pair<std::uint64_t, double>> each;  ///< log time, seconds; a few
    } stretch;
    std::map<std::string, std::int64_t> frame_stamp_ns;  ///< of `/tf`, by child
    std::map<std::string, std::uint64_t> told;           ///< by kind
  };

  /// What Rigor writes beside a sample: its faults are the sample's own.
  [[nodiscard]] bool is_companion(const std::string& topic) const {
    for (const std::string_view rest : record::kCompanionTopics)
      if (topic.ends_with(rest))
        for (const auto& [id, channel] : reader_.channels())
          if (channel.topic == topic.substr(0, topic.size() - rest.size())) return true;
    return false;
  }

  template <class Each>
  Status go(Each&& each) {
    auto cursor = reader_.messages({.order = record::MessageOrder::file});
    MessageView m;
    while (true) {
      const auto more = cursor.next(m);
      if (!more) return tl::unexpected<Error>(more.error());
      if (!*more) {
        damaged_ = std::max(cursor.skipped_segments(), reader_.health().damaged_chunks);
        return {};
      }
      each(m, topics_.at(m.channel->id));
    }
  }

  static std::optional<ScanContent> content_of(const MessageView& m, const Topic& t) {
    if (t.form.content != Content::cloud && t.form.content != Content::scan) return std::nullopt;
    const auto content = t.form.content == Content::cloud ? read_cloud(m.data) : read_scan(m.data);
    return content ? std::optional(*content) : std::nullopt;
  }

  void learn(const MessageView& m, Topic& t) {
    first_ns_ = std::min(first_ns_, m.log_time_ns);
    last_ns_ = std::max(last_ns_, m.log_time_ns);
    ++report_->messages;
    Usual& u = t.usual;
    ++u.messages;
    if (!t.form.header || t.companion) return;
    if (const auto header = record::read_header(m.data)) {
      const std::int64_t stamp = record::to_ns(header->stamp);
      if (stamp == 0) {
        ++u.unset;
      } else {
        if (u.stamp_ns && stamp > *u.stamp_ns) u.period_s.add(seconds_of(stamp - *u.stamp_ns));
        u.stamp_ns = stamp;
        u.delay_s.add(seconds_of(static_cast<std::int64_t>(m.log_time_ns) - stamp));
      }
    }
    if (const auto content = content_of(m, t)) {
      u.points.add(static_cast<double>(content->points));
      u.columns.add(static_cast<double>(content->columns));
      if (u.exact_points.size() < Usual::kMostExact || u.exact_points.contains(content->points))
        ++u.exact_points[content->points];
      if (std::isfinite(content->mean_intensity)) {
        u.intensity.add(content->mean_intensity);
        if (u.mean_intensity) u.change.add(std::abs(content->mean_intensity - *u.mean_intensity));
        u.mean_intensity = content->mean_intensity;
      }
    }
  }

  void tell(const std::string& kind, const std::string& topic, std::uint64_t log_ns, double value,
            const char* unit, std::string text) {
    ++report_->counts[kind];
    if (++told_[{kind, topic}] > kListed) {
      ++report_->not_listed;
      return;
    }
    report_->findings.push_back({kind, topic, log_ns,
                                 seconds_of(static_cast<std::int64_t>(log_ns - std::min(log_ns, begin_ns_))),
                                 value, unit, std::move(text)});
  }

  void know(const MessageView& m, Topic& t) {
    const Usual& u = t.usual;
    t.known = true;
    t.period_s = u.period();
    t.least_points = u.least_points();
    t.least_columns = u.least_columns();
    t.delay_s = u.delay_s.median();
    t.level = u.intensity.median();
    t.change = u.change.median();
    if (t.form.header || t.form.content == Content::frames) ++report_->judged;
    if (u.unset > 0)
      tell("stamp_unset", m.channel->topic, m.log_time_ns, static_cast<double>(u.unset), "messages",
           fmt::format("{} of {} headers have no stamp (0)", u.unset, u.messages));
    if (std::abs(t.delay_s) > kOtherClock_s)
      tell("clock", m.channel->topic, m.log_time_ns, t.delay_s, "s",
           fmt::format("stamps lie {:.3f} s {} log times: they are of different clocks", std::abs(t.delay_s),
                       t.delay_s > 0 ? "before" : "after"));
  }

  void judge(const MessageView& m, Topic& t) {
    if (!t.known) know(m, t);
    t.last_log_ns = std::max(t.last_log_ns, m.log_time_ns);
    const std::string& topic = m.channel->topic;
    if (t.form.content == Content::frames) return judge_frames(m, t);
    if (!t.form.header || t.companion) return;
    const auto header = record::read_header(m.data);
    if (!header)
      return tell(
          "malformed", topic, m.log_time_ns, static_cast<double>(m.data.size()), "bytes",
          fmt::format("a message of {} bytes does not begin with a header, as its type says", m.data.size()));
    if (t.form.spatial) frames_.used(topic, m.log_time_ns, header->frame_id);
    if (const std::int64_t stamp = record::to_ns(header->stamp); stamp != 0) judge_stamp(m, t, stamp);
    judge_content(m, t);
  }

  void judge_stamp(const MessageView& m, Topic& t, std::int64_t stamp) {
    const std::string& topic = m.channel->topic;
    const double delay_s = seconds_of(static_cast<std::int64_t>(m.log_time_ns) - stamp);
    const double allowed_s = std::max(1.0, 10 * t.period_s);
    if (std::abs(delay_s - t.delay_s) > allowed_s)
      tell("clock", topic, m.log_time_ns, delay_s, "s",
           fmt::format("the stamp lies {:.3f} s before the log time, that of others {:.3f} s", delay_s,
                       t.delay_s));
    else if (delay_s < -kAhead_s && t.delay_s >= -kAhead_s)
      tell("clock", topic, m.log_time_ns, delay_s, "s",
           fmt::format("the stamp lies {:.3f} s after the log time", -delay_s));
    if (!t.stamp_ns) {
      t.stamp_ns = stamp;
      return;
    }
    const std::int64_t step = stamp - *t.stamp_ns;
    if (step == 0)
      return tell("stamp_repeated", topic, m.log_time_ns, 0, "s",
                  fmt::format("the stamp {}.{:09} is that of the message before", stamp / 1'000'000'000,
                              stamp % 1'000'000'000));
    if (step < 0)
      tell("stamp_back", topic, m.log_time_ns, seconds_of(step), "s",
           fmt::format("the stamp lies {:.6f} s before that of the message before", -seconds_of(step)));
    else if (t.period_s > 0)
      judge_interval(m, t, stamp, seconds_of(step));
    t.stamp_ns = stamp;
  }

  void judge_interval(const MessageView& m, Topic& t, std::int64_t stamp, double step_s) {
    const double multiple = std::round(step_s / t.period_s);
    const bool longer = step_s > 1.5 * t.period_s;
    Topic::Stretch& s = t.stretch;
    if (!longer || multiple != s.multiple) end_stretch(m.channel->topic, t);
    if (!longer) return;
    if (s.intervals == 0) {
      s.multiple = multiple;
      s.from_ns = stamp - static_cast<std::int64_t>(step_s * 1e9);
    }
    ++s.intervals;
    s.to_ns = stamp;
    if (static_cast<double>(s.each.size()) < kSameMultiple) s.each.emplace_back(m.log_time_ns, step_s);
  }

  void end_stretch(const std::string& topic, Topic& t) {
    Topic::Stretch& s = t.stretch;
    if (static_cast<double>(s.intervals) >= kSameMultiple) {
      tell("half_rate", topic, s.each.front().first, 1 / (s.multiple * t.period_s), "Hz",
           fmt::format("{:.3f} s at {:.4g} Hz in place of {:.4g} Hz", seconds_of(s.to_ns - s.from_ns),
                       1 / (s.multiple * t.period_s), 1 / t.period_s));
    } else {
      for (const auto& [log_ns, step_s] : s.each)
        tell("gap", topic, log_ns, step_s, "s",
             fmt::format("{:.6f} s between two messages at {:.4g} Hz: {:.0f} missing", step_s, 1 / t.period_s,
                         std::max(1.0, std::round(step_s / t.period_s) - 1)));
    }
    s = {};
  }

  void judge_content(const MessageView& m, Topic& t) {
    if (t.form.content != Content::cloud && t.form.content != Content::scan) return;
    const std::string& topic = m.channel->topic;
    const auto content = t.form.content == Content::cloud ? read_cloud(m.data) : read_scan(m.data);
    if (!content)
      return tell("malformed", topic, m.log_time_ns, static_cast<double>(m.data.size()), "bytes",
                  content.error().message);
    const auto points = static_cast<double>(content->points), columns = static_cast<double>(content->columns);
    const bool rays = t.form.content == Content::scan;
    // What a scene brings back changes from cloud to cloud by little; what is lost is missing at once.
    const auto drops = [&](double now, double before) {
      return t.usual.most_have() > 0 || (before > 0 && now < kSuddenly * before);
    };
    if (points < t.least_points && drops(points, t.points))
      tell("incomplete", topic, m.log_time_ns, points, "points",
           fmt::format("{} points, usual are {:.0f}; {} {} of usually {:.0f}", content->points,
                       t.usual.points.median(), content->columns, rays ? "rays" : "degrees of azimuth",
                       t.usual.columns.median()));
    else if (columns < t.least_columns && drops(columns, t.columns))
      tell("incomplete", topic, m.log_time_ns, columns, rays ? "rays" : "degrees",
           fmt::format("{} {}, usual are {:.0f}", content->columns, rays ? "rays" : "degrees of azimuth",
                       t.usual.columns.median()));
    t.points = points;
    t.columns = columns;
    if (!std::isfinite(content->mean_intensity)) return;
    if (t.mean_intensity && t.usual.intensity.total() >= kEnoughClouds) {
      const double jump = content->mean_intensity - *t.mean_intensity;
      if (std::abs(jump) > std::max(8 * t.change, kIntensityJump * std::abs(t.level)))
        tell("intensity", topic, m.log_time_ns, jump, "",
             fmt::format("the mean intensity jumps from {:.4g} to {:.4g}; usual changes are {:.2g}",
                         *t.mean_intensity, content->mean_intensity, t.change));
    }
    t.mean_intensity = content->mean_intensity;
  }

  void judge_frames(const MessageView& m, Topic& t) {
    const std::string& topic = m.channel->topic;
    record::msg::TFMessage frames;
    if (auto s = record::CdrReader::read(m.data, frames); !s)
      return tell("malformed", topic, m.log_time_ns, static_cast<double>(m.data.size()), "bytes",
                  s.error().message);
    const bool is_static = topic.ends_with("tf_static");
    for (const record::msg::TransformStamped& f : frames.transforms) {
      frames_.transform(topic, m.log_time_ns, f, tell_frame());
      if (is_static) continue;  // a latched topic may be told again
      const std::int64_t stamp = record::to_ns(f.header.stamp);
      if (t.frame_stamp_ns.size() >= FrameCheck::kMostFrames && !t.frame_stamp_ns.contains(f.child_frame_id))
        continue;
      const auto [at, first] = t.frame_stamp_ns.emplace(f.child_frame_id, stamp);
      if (first) continue;
      const std::int64_t step = stamp - at->second;
      if (step == 0)
        tell("stamp_repeated", topic, m.log_time_ns, 0, "s",
             fmt::format("the transform of {} has the stamp of the one before",
                         f.child_frame_id.substr(0, 60)));
      if (step < 0)
        tell("stamp_back", topic, m.log_time_ns, seconds_of(step), "s",
             fmt::format("the stamp of {} lies {:.6f} s before that of the one before",
                         f.child_frame_id.substr(0, 60), -seconds_of(step)));
      at->second = stamp;
    }
  }

  [[nodiscard]] FrameCheck::Tell tell_frame() {
    return [this](const std::string& topic, std::uint64_t log_ns, std::string text) {
      tell("frame", topic, log_ns, 0, "", std::move(text));
    };
  }

  void finish() {
    for (auto& [id, t] : topics_) {
      const std::string& topic = reader_.channels().at(id).topic;
      end_stretch(topic, t);
      const double silent_s =
          seconds_of(static_cast<std::int64_t>(last_ns_ - std::min(last_ns_, t.last_log_ns)));
      if (t.period_s > 0 && silent_s > std::max(0.5, 5 * t.period_s))
        tell("gap", topic, t.last_log_ns, silent_s, "s",
             fmt::format("nothing comes any more at {:.4g} Hz: the recording goes on for {:.3f} s",
                         1 / t.period_s, silent_s));
    }
    frames_.finish(tell_frame());
    const record::Health& health = reader_.health();
    if (damaged_ > 0)
      tell("damage", "", last_ns_, static_cast<double>(damaged_), "chunks",
           fmt::format("{} damaged chunk{} passed over; `rigor inspect` says where", damaged_,
                       damaged_ == 1 ? " was" : "s were"));
    if (health.truncated)
      tell("damage", "", last_ns_, static_cast<double>(health.lost_bytes), "bytes",
           fmt::format("the file ends before its end was written; its last {} bytes cannot be read",
                       health.lost_bytes));
    else if (damaged_ == 0)
      for (const std::string& note : health.notes) tell("damage", "", last_ns_, 0, "", note);
    std::stable_sort(report_->findings.begin(), report_->findings.end(),
                     [](const DataFinding& a, const DataFinding& b) { return a.log_ns < b.log_ns; });
    if (report_->messages > 0)
      report_->duration_s = seconds_of(static_cast<std::int64_t>(last_ns_ - first_ns_));
  }

  record::McapReader& reader_;
  DataReport* report_ = nullptr;
  bool any_cdr_ = false;
  std::uint64_t damaged_ = 0;  ///< chunks
  std::map<std::uint16_t, Topic> topics_;
  FrameCheck frames_;
  std::map<std::pair<std::string, std::string>, std::uint64_t> told_;
  std::uint64_t first_ns_ = ~std::uint64_t{0}, last_ns_ = 0, begin_ns_ = 0;
};

}  // namespace

Result<DataReport> check_data(const std::filesystem::path& recording) {
  auto reader = record::McapReader::open(recording.string(), {.skip_damaged = true});
  if (!reader) return tl::unexpected<Error>(reader.error());
  DataReport report;
  if (auto s = Checker(**reader).run(report); !s) return tl::unexpected<Error>(s.error());
  return report;
}

}  // namespace rigor
