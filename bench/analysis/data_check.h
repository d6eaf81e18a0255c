// What is wrong with the data of a recording, anybody's: without a rig, and without knowing what was meant.
//
//   stamp_repeated  a header's stamp is that of the message before on the topic (of `/tf`: of the frame)
//   stamp_back      it is an earlier one
//   stamp_unset     the topic's stamps are zero
//   clock           header stamps and log times are of different clocks (more than a minute apart), or one of
//                   them jumps against the other
//   gap             messages of a periodic topic are missing, between two or at the end
//   half_rate       a stretch of a periodic topic came at half its rate, or another fraction
//   incomplete      a cloud or scan has fewer points, or covers fewer degrees, than its topic's others
//   intensity       the mean intensity of clouds or scans jumps
//   frame           a header's frame has no place in the tree of `/tf` and `/tf_static`, or that tree is none
//   malformed       a message cannot be read by its definition
//   damage          a part of the file cannot be read
//
// What is usual is learnt of each topic in a first pass, and judged in a second: a topic is periodic where
// most of its stamps are one period apart (kPeriodicShare within kPeriodTolerance of the median), the usual
// number of points is that of most clouds, or what lies within Tukey's outer fences and is not a tenth less
// than in the cloud before. Bench topics that tell of many things at one instant (events, faults, commands,
// diagnostics) are not judged by their stamps. Both passes go through
// the file in its order with one chunk at a time; of each topic counters and histograms are kept, of findings
// the first kListed of each kind on each topic and the number of the others.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor {

struct DataFinding {
  std::string kind;          ///< above
  std::string topic;         ///< empty: the file
  std::uint64_t log_ns = 0;  ///< log time of the message
  double t_s = 0;            ///< of it, after the recording's first message
  double value = 0;          ///< in `unit`
  std::string unit;          ///< "s", "points", "", …
  std::string text;          ///< one sentence
};

struct DataReport {
  std::uint64_t messages = 0;  ///< that could be read
  std::uint64_t topics = 0;
  std::uint64_t judged = 0;                     ///< topics whose messages have a header, or tell of frames
  double duration_s = 0;                        ///< of log time
  std::vector<DataFinding> findings;            ///< by time
  std::map<std::string, std::uint64_t> counts;  ///< of all findings, by kind
  std::uint64_t not_listed = 0;                 ///< beyond kListed
  [[nodiscard]] bool good() const { return counts.empty(); }
};

inline constexpr std::size_t kListed = 20;
inline constexpr double kPeriodicShare = 0.6, kPeriodTolerance = 0.25;
/// Fewer messages of a topic say nothing of its period; fewer clouds nothing of their usual size.
inline constexpr std::uint64_t kEnoughMessages = 8, kEnoughClouds = 16;

/// not_found, io; bad_input: no MCAP file, or none with messages of ROS 2 as CDR. Damaged chunks are
/// findings. Setup context; reads the file twice.
[[nodiscard]] Result<DataReport> check_data(const std::filesystem::path& recording);

}  // namespace rigor
