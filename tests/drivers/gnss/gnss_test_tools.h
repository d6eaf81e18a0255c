// What tests of the receivers' codecs share: logs that are test data, and a whole log decoded.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "drivers/gnss/epoch_assembler.h"
#include "tests/paths.h"

namespace rigor::gnss::test {

/// Folder of u-blox logs and gpsd's expectations; it may not exist.
inline std::filesystem::path logs() { return rigor::test::test_data("gnss_ublox"); }
#define RIGOR_NEEDS_GNSS_LOGS()                              \
  if (!std::filesystem::exists(::rigor::gnss::test::logs())) \
  GTEST_SKIP() << "the test data gnss_ublox are not there (RIGOR_TEST_DATA)"

inline Buffer read_file(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  EXPECT_TRUE(in.good()) << file;
  return Buffer(std::istreambuf_iterator<char>(in), {});
}
inline Bytes bytes_of(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}
inline std::string text_of(Bytes bytes) { return {bytes.begin(), bytes.end()}; }

struct Decoded {
  struct Instant {
    Solution solution;
    std::optional<Sky> sky;  ///< of the same instant
  };
  std::vector<Instant> instants;
  std::vector<TimePulse> pulses;
  std::vector<Buffer> raw;
  MessageStream::Counters counters;
  EpochAssembler::Counters assembled;
  int leap_seconds = 0;
};

/// `piece`: how many bytes come in one read.
inline Decoded decode(Bytes log, std::size_t piece = 4096) {
  Decoded d;
  std::vector<Sky> skies;
  MessageStream stream;
  EpochAssembler assembler(
      {}, {.solution =
               [&](const Solution& s, BenchTime) {
                 d.instants.push_back({s, std::nullopt});
               },
           .sky = [&](const Sky& s) { skies.push_back(s); },
           .pulse = [&](const TimePulse& p) { d.pulses.push_back(p); },
           .raw = [&](Bytes payload) { d.raw.emplace_back(payload.begin(), payload.end()); }});
  const auto drain = [&] {
    while (const auto m = stream.next()) assembler.take(*m, BenchTime(0));
  };
  for (std::size_t at = 0; at < log.size(); at += piece) {
    stream.add(log.subspan(at, std::min(piece, log.size() - at)));
    drain();
  }
  if (stream.finish()) drain();
  assembler.flush();
  for (const Sky& sky : skies)
    for (auto& i : d.instants)
      if (sky.t_device && i.solution.t_device == *sky.t_device) i.sky = sky;
  d.counters = stream.counters();
  d.assembled = assembler.counters();
  d.leap_seconds = assembler.leap_seconds().value_or(0);
  return d;
}

}  // namespace rigor::gnss::test
