// What is in a recording, and how well it was taken: per topic rates, gaps, lateness and losses. `rigor
// inspect` prints it; a test or a CI job reads the JSON.
#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/recording_schema.h"

namespace rigor::record {

struct TopicReport {
  std::string topic;
  std::string type;
  std::uint64_t messages = 0;
  std::uint64_t bytes = 0;     ///< of messages, uncompressed
  std::uint64_t first_ns = 0;  ///< log time
  std::uint64_t last_ns = 0;
  double rate_hz = 0;  ///< messages less one, over the time between first and last; 0 for fewer than two
  double period_s =
      0;  ///< median time between messages: of captures where stamps say so, of log times where not
  std::uint64_t gaps = 0;  ///< longer than 1.5 such periods
  double longest_gap_s = 0;
  std::uint64_t sequence_gaps = 0;     ///< jumps of the sequence by more than one
  std::uint64_t sequence_missing = 0;  ///< sequence numbers passed over in them

  /// From the companion `<topic>/stamp`, where there is one.
  struct Stamps {
    std::string channel;
    std::uint64_t count = 0;
    std::uint64_t lost_before = 0;                          ///< sum: losses that the channel itself knew of
    std::uint64_t not_valid = 0;                            ///< samples with a validity bit set
    std::uint64_t late = 0;                                 ///< arrived after their release instant
    double late_p50_s = 0, late_p99_s = 0, late_max_s = 0;  ///< of those that were late: arrival less release
    double latency_p50_s = 0, latency_p99_s = 0;            ///< arrival less capture, of all
  };
  std::optional<Stamps> stamps;
};

struct RecordingReport {
  std::string path;
  std::string profile;
  std::string library;
  RecordingWriter writer;
  std::uint64_t file_bytes = 0;
  std::uint64_t messages = 0;
  std::uint64_t first_ns = 0;
  std::uint64_t last_ns = 0;
  std::uint64_t chunks = 0;
  std::string compression;  ///< "none", "lz4", "zstd", or several joined by "+"
  std::uint64_t chunk_bytes_stored = 0;
  std::uint64_t chunk_bytes = 0;  ///< uncompressed
  std::vector<Metadata> metadata;
  std::uint64_t attachments = 0;
  Health health;
  std::vector<TopicReport> topics;  ///< by name; companions (`<topic>/stamp`) too
};

/// Reads the whole file. Setup context. Errors: those of McapReader::open; damage within an openable file is
/// in `health`. `scan`: as in ReaderOptions, also checks the checksum over the whole file.
[[nodiscard]] Result<RecordingReport> inspect(const std::string& path, bool scan = false);
[[nodiscard]] Result<RecordingReport> inspect(std::unique_ptr<ByteSource> source, bool scan = false);

/// For machines. Times in nanoseconds as decimal strings where a double would not hold them.
[[nodiscard]] nlohmann::json to_json(const RecordingReport& report);
/// For people: a few lines of summary and one line per topic.
[[nodiscard]] std::string to_text(const RecordingReport& report);

}  // namespace rigor::record
