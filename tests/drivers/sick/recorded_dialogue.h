// Recordings of SICK's own driver talking to real devices: one TCP payload after the other, both directions.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "drivers/sick/telegram.h"
#include "tests/paths.h"

namespace rigor::sick::test {

inline std::vector<Buffer> read_payloads(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::stringstream all;
  all << in.rdbuf();
  const std::string text = all.str();
  const std::string key = "\"tcp.payload\": \"";
  std::vector<Buffer> out;
  for (std::size_t at = 0; (at = text.find(key, at)) != std::string::npos;) {
    at += key.size();
    Buffer& payload = out.emplace_back();
    while (at + 1 < text.size() && text[at] != '"') {
      if (text[at] == ':') {
        ++at;
        continue;
      }
      payload.push_back(static_cast<std::uint8_t>(std::stoi(text.substr(at, 2), nullptr, 16)));
      at += 2;
    }
  }
  return out;
}

struct Recording {
  const char* file;
  std::size_t scans, beams;
  bool wide_rssi;
  double start_deg, stop_deg, frequency_hz;  ///< device's frame
  std::uint32_t serial_number;
};
inline std::ostream& operator<<(std::ostream& out, const Recording& r) { return out << r.file; }
inline constexpr Recording kLms511{"20210301_lms511.json", 136, 1141, false, -5, 185, 25, 0x01145856};
inline constexpr Recording kTim781{
    "20210125-tim781s-scandata.json", 140, 811, true, -45, 225, 15, 0x0119fd06};

inline std::filesystem::path recording_path(const Recording& r) {
  return rigor::test::test_data("sick_lidar") / r.file;
}

}  // namespace rigor::sick::test

#define RIGOR_SKIP_WITHOUT_RECORDING(r)                               \
  if (!std::filesystem::exists(rigor::sick::test::recording_path(r))) \
  GTEST_SKIP() << "no test data: sick_lidar/" << (r).file
