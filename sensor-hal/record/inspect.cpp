#include "sensor-hal/record/inspect.h"

#include <algorithm>
#include <cstdio>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "sensor-hal/record/ros2_messages.h"

namespace rigor::record {
namespace {

constexpr std::string_view kStampSuffix = "/stamp";

/// What is gathered of a topic while its messages pass by: 8 bytes a message.
struct Gathered {
  TopicReport report;
  std::vector<std::int64_t> times_ns;  ///< log times
  std::optional<std::uint32_t> sequence;

  struct Stamped {
    TopicReport::Stamps report;
    std::vector<std::int64_t> captures_ns;
    std::vector<std::int64_t> latenesses_ns;
    std::vector<std::int64_t> latencies_ns;
  };
  std::optional<Stamped> stamped;
};

double seconds_of(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }

/// The value below which a fraction lies, by nearest rank; reorders.
std::int64_t quantile(std::vector<std::int64_t>& values, double fraction) {
  if (values.empty()) return 0;
  const auto rank = static_cast<std::size_t>(fraction * static_cast<double>(values.size() - 1) + 0.5);
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// a - b, or the nearest that there is: recorded times may be anything.
std::int64_t difference(std::int64_t a, std::int64_t b) {
  std::int64_t d = 0;
  if (!__builtin_sub_overflow(a, b, &d)) return d;
  return a > b ? std::numeric_limits<std::int64_t>::max() : std::numeric_limits<std::int64_t>::min();
}

void add_stamp(Gathered& of, const msg::SampleStamp& stamp) {
  if (!of.stamped) of.stamped.emplace();
  auto& s = *of.stamped;
  s.report.channel = stamp.channel;
  ++s.report.count;
  s.report.lost_before += stamp.lost_before;
  if (stamp.validity != 0) ++s.report.not_valid;
  s.captures_ns.push_back(stamp.t_capture_ns);
  s.latencies_ns.push_back(difference(stamp.t_arrival_ns, stamp.t_capture_ns));
  const std::int64_t late_ns = difference(stamp.t_arrival_ns, stamp.t_release_ns);
  if (late_ns > 0) s.latenesses_ns.push_back(late_ns);
}

void add(Gathered& to, const MessageView& m) {
  TopicReport& r = to.report;
  if (r.messages == 0) r.first_ns = m.log_time_ns;
  r.first_ns = std::min(r.first_ns, m.log_time_ns);
  r.last_ns = std::max(r.last_ns, m.log_time_ns);
  ++r.messages;
  r.bytes += m.data.size();
  to.times_ns.push_back(static_cast<std::int64_t>(m.log_time_ns));
  // A sequence that goes back or stays has begun anew, or is not kept at all.
  if (to.sequence && m.sequence > *to.sequence && m.sequence - *to.sequence > 1) {
    ++r.sequence_gaps;
    r.sequence_missing += m.sequence - *to.sequence - 1;
  }
  to.sequence = m.sequence;
}

void conclude(Gathered& g) {
  TopicReport& r = g.report;
  if (r.messages > 1 && r.last_ns > r.first_ns)
    r.rate_hz = static_cast<double>(r.messages - 1) / (static_cast<double>(r.last_ns - r.first_ns) * 1e-9);
  std::vector<std::int64_t>& times =
      g.stamped && g.stamped->captures_ns.size() == r.messages ? g.stamped->captures_ns : g.times_ns;
  std::sort(times.begin(), times.end());
  std::vector<std::int64_t> periods;
  for (std::size_t i = 1; i < times.size(); ++i) periods.push_back(difference(times[i], times[i - 1]));
  if (!periods.empty()) {
    const std::int64_t longest = *std::max_element(periods.begin(), periods.end());
    const std::int64_t median = quantile(periods, 0.5);
    r.period_s = seconds_of(median);
    r.longest_gap_s = seconds_of(longest);
    r.gaps = static_cast<std::uint64_t>(std::count_if(periods.begin(), periods.end(), [&](std::int64_t p) {
      return median > 0 && p - median > median / 2;
    }));
  }
  if (g.stamped) {
    auto& s = *g.stamped;
    s.report.late = s.latenesses_ns.size();
    s.report.late_p50_s = seconds_of(quantile(s.latenesses_ns, 0.5));
    s.report.late_p99_s = seconds_of(quantile(s.latenesses_ns, 0.99));
    s.report.late_max_s = seconds_of(quantile(s.latenesses_ns, 1));
    s.report.latency_p50_s = seconds_of(quantile(s.latencies_ns, 0.5));
    s.report.latency_p99_s = seconds_of(quantile(s.latencies_ns, 0.99));
    r.stamps = s.report;
  }
}

std::string bytes_text(std::uint64_t bytes) {
  char text[32];
  if (bytes < 10'000) {
    std::snprintf(text, sizeof text, "%llu B", static_cast<unsigned long long>(bytes));
  } else if (bytes < 10'000'000) {
    std::snprintf(text, sizeof text, "%.1f kB", static_cast<double>(bytes) * 1e-3);
  } else {
    std::snprintf(text, sizeof text, "%.1f MB", static_cast<double>(bytes) * 1e-6);
  }
  return text;
}

}  // namespace

Result<RecordingReport> inspect(const std::string& path, bool scan) {
  auto source = open_file_source(path);
  if (!source) return tl::unexpected(source.error());
  return inspect(std::move(*source), scan);
}

Result<RecordingReport> inspect(std::unique_ptr<ByteSource> source, bool scan) {
  auto opened = McapReader::open(std::move(source), {.scan = scan, .skip_damaged = true, .any_schema = true});
  if (!opened) return tl::unexpected(opened.error());
  McapReader& reader = **opened;
  RecordingReport report;
  report.path = reader.name();
  report.profile = reader.profile();
  report.library = reader.library();
  report.file_bytes = reader.file_bytes();
  report.metadata = reader.readable_metadata();
  report.writer = writer_of(report.metadata);
  report.attachments = reader.attachment_count();
  std::set<std::string> compressions;
  for (const Segment& segment : reader.segments()) {
    if (!segment.chunk) continue;
    ++report.chunks;
    report.chunk_bytes_stored += segment.stored;
    report.chunk_bytes += segment.uncompressed;
    compressions.insert(segment.compression.empty() ? "none" : segment.compression);
  }
  for (const std::string& c : compressions) report.compression += (report.compression.empty() ? "" : "+") + c;

  std::map<std::string, Gathered> topics;
  for (const auto& [id, channel] : reader.channels()) {
    TopicReport& topic = topics[channel.topic].report;
    topic.topic = channel.topic;
    const auto schema = reader.schemas().find(channel.schema);
    topic.type = schema == reader.schemas().end() ? channel.message_encoding : schema->second.name;
  }
  std::uint64_t unreadable_stamps = 0;
  MessageCursor cursor = reader.messages({.order = MessageOrder::file});
  MessageView m;
  while (true) {
    const Result<bool> more = cursor.next(m);
    if (!more) return tl::unexpected(more.error());
    if (!*more) break;
    const std::string& topic = m.channel->topic;
    add(topics[topic], m);
    if (report.messages++ == 0) report.first_ns = m.log_time_ns;
    report.first_ns = std::min(report.first_ns, m.log_time_ns);
    report.last_ns = std::max(report.last_ns, m.log_time_ns);
    if (m.schema == nullptr || m.schema->name != msg::SampleStamp::kType || !topic.ends_with(kStampSuffix))
      continue;
    msg::SampleStamp stamp;
    if (CdrReader::read(m.data, stamp)) {
      const auto main = topics.find(topic.substr(0, topic.size() - kStampSuffix.size()));
      if (main != topics.end()) add_stamp(main->second, stamp);
    } else {
      ++unreadable_stamps;
    }
  }
  report.health = reader.health();
  if (reader.health().indexed) report.health.damaged_chunks += cursor.skipped_segments();
  if (reader.health().indexed && cursor.skipped_segments() > 0)
    report.health.notes.push_back(std::to_string(cursor.skipped_segments()) +
                                  " chunks are damaged and were passed over");
  if (unreadable_stamps > 0)
    report.health.notes.push_back(std::to_string(unreadable_stamps) + " stamps cannot be decoded");
  for (auto& [name, gathered] : topics) {
    conclude(gathered);
    report.topics.push_back(std::move(gathered.report));
  }
  return report;
}

nlohmann::json to_json(const RecordingReport& report) {
  using nlohmann::json;
  json topics = json::array();
  for (const TopicReport& t : report.topics) {
    json j{{"topic", t.topic},
           {"type", t.type},
           {"messages", t.messages},
           {"bytes", t.bytes},
           {"first_ns", std::to_string(t.first_ns)},
           {"last_ns", std::to_string(t.last_ns)},
           {"rate_hz", t.rate_hz},
           {"period_s", t.period_s},
           {"gaps", t.gaps},
           {"longest_gap_s", t.longest_gap_s},
           {"sequence_gaps", t.sequence_gaps},
           {"sequence_missing", t.sequence_missing}};
    if (t.stamps)
      j["stamps"] = {{"channel", t.stamps->channel},
                     {"count", t.stamps->count},
                     {"lost_before", t.stamps->lost_before},
                     {"not_valid", t.stamps->not_valid},
                     {"late", t.stamps->late},
                     {"late_p50_s", t.stamps->late_p50_s},
                     {"late_p99_s", t.stamps->late_p99_s},
                     {"late_max_s", t.stamps->late_max_s},
                     {"latency_p50_s", t.stamps->latency_p50_s},
                     {"latency_p99_s", t.stamps->latency_p99_s}};
    topics.push_back(std::move(j));
  }
  json metadata = json::object();
  for (const Metadata& m : report.metadata) metadata[m.name] = m.values;
  const Health& h = report.health;
  return {{"path", report.path},
          {"profile", report.profile},
          {"library", report.library},
          {"schema", report.writer.schema},
          {"version", report.writer.version},
          {"file_bytes", report.file_bytes},
          {"messages", report.messages},
          {"first_ns", std::to_string(report.first_ns)},
          {"last_ns", std::to_string(report.last_ns)},
          {"duration_s", static_cast<double>(report.last_ns - report.first_ns) * 1e-9},
          {"chunks", report.chunks},
          {"compression", report.compression},
          {"chunk_bytes_stored", report.chunk_bytes_stored},
          {"chunk_bytes", report.chunk_bytes},
          {"metadata", std::move(metadata)},
          {"attachments", report.attachments},
          {"health",
           {{"good", h.good()},
            {"indexed", h.indexed},
            {"truncated", h.truncated},
            {"whole_bytes", h.whole_bytes},
            {"lost_bytes", h.lost_bytes},
            {"damaged_chunks", h.damaged_chunks},
            {"unverified_messages", h.unverified_messages},
            {"notes", h.notes}}},
          {"topics", std::move(topics)}};
}

std::string to_text(const RecordingReport& report) {
  std::string out;
  char line[512];
  const auto print = [&](const char* format, auto... values) {
    std::snprintf(line, sizeof line, format, values...);
    out += line;
  };
  out += report.path + "\n";
  print("  %s, %llu messages in %.3f s, %llu chunks, compression %s", bytes_text(report.file_bytes).c_str(),
        static_cast<unsigned long long>(report.messages),
        static_cast<double>(report.last_ns - report.first_ns) * 1e-9,
        static_cast<unsigned long long>(report.chunks),
        report.compression.empty() ? "none" : report.compression.c_str());
  if (report.chunk_bytes_stored < report.chunk_bytes && report.chunk_bytes_stored > 0)
    print(" (%.2f : 1)",
          static_cast<double>(report.chunk_bytes) / static_cast<double>(report.chunk_bytes_stored));
  print(", profile %s, written by %s", report.profile.c_str(), report.library.c_str());
  if (!report.writer.version.empty()) out += " " + report.writer.version;
  if (!report.writer.schema.empty()) out += ", schema " + report.writer.schema;
  out += "\n";
  if (!report.writer.readable())
    print(
        "  ! this version of Rigor reads schema %d: what follows may be misread, and other commands refuse "
        "it\n",
        kRecordingSchema);
  for (const std::string& note : report.health.notes) out += "  ! " + note + "\n";
  if (report.health.truncated) out += "  ! `rigor inspect --repair` makes a complete file of it\n";

  std::size_t width = 5;
  std::size_t type_width = 4;
  for (const TopicReport& t : report.topics) {
    width = std::max(width, t.topic.size());
    type_width = std::max(type_width, t.type.size());
  }
  const auto pad = [&](const std::string& text, std::size_t to) {
    out += text + std::string(to - std::min(to, text.size()) + 2, ' ');
  };
  out += "\n  ";
  pad("topic", width);
  pad("type", type_width);
  out +=
      "messages    rate Hz   gaps  longest s  missing   lost   late  late p99 ms  latency ms        size\n";
  for (const TopicReport& t : report.topics) {
    out += "  ";
    pad(t.topic, width);
    pad(t.type, type_width);
    print("%8llu %10.3f %6llu %10.4f %8llu", static_cast<unsigned long long>(t.messages), t.rate_hz,
          static_cast<unsigned long long>(t.gaps), t.longest_gap_s,
          static_cast<unsigned long long>(t.sequence_missing));
    if (t.stamps) {
      print(" %6llu %6llu %12.3f %11.3f", static_cast<unsigned long long>(t.stamps->lost_before),
            static_cast<unsigned long long>(t.stamps->late), t.stamps->late_p99_s * 1e3,
            t.stamps->latency_p50_s * 1e3);
    } else {
      print(" %6s %6s %12s %11s", "-", "-", "-", "-");
    }
    print(" %11s\n", bytes_text(t.bytes).c_str());
  }
  return out;
}

}  // namespace rigor::record
