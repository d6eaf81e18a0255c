// How fast a recording is written, against a bare write() of as many bytes from the same memory to the same
// filesystem.
//
//   bench_record [--dir FOLDER] [--seconds S] [--rounds N] [--json FILE]
//
// The load is that of a bench: two cameras of 1280x1024 pixels (8 bit, a smooth scene with photon noise) at
// 30 Hz, and ten channels of eight registers at 1 kHz, S seconds of them, through the sample codec with all
// its companions and checksums. Each round writes it in every way, in an order that rotates; in front of each
// stands a bare write that does not count, so that all find the same memory free. Medians over the rounds are
// reported. None of the ways syncs: what is compared is the cost of the format, not the disk. CPU time is
// given too, which is moved less by what else the machine does.
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <vector>

#include "rt-core/time.h"
#include "sensor-hal/record/crc32.h"
#include "sensor-hal/record/mcap_writer.h"
#include "sensor-hal/record/sample_codec.h"

namespace {

using namespace rigor;
using namespace rigor::record;

constexpr std::uint32_t kWidth = 1280, kHeight = 1024;
constexpr std::size_t kPictures = 24;  // 31 MB: more than the caches hold, as fresh pictures are
constexpr int kRegisterChannels = 10;

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "bench_record: %s\n", what.c_str());
  std::exit(1);
}
template <class T>
T must(Result<T> r) {
  if (!r) give_up(r.error().text());
  return std::move(*r);
}
void must(Status s) {
  if (!s) give_up(s.error().text());
}

std::vector<Sample> make_pictures() {
  std::vector<Sample> all(kPictures);
  std::minstd_rand random(1);
  std::normal_distribution<float> noise(0, 1);
  std::vector<float> draws(1 << 16);
  for (float& d : draws) d = noise(random);
  for (std::size_t k = 0; k < all.size(); ++k) {
    Sample& s = all[k];
    s.reserve(std::size_t{kWidth} * kHeight);
    s.size_bytes = std::size_t{kWidth} * kHeight;
    s.info = ImageInfo{PixelFormat::mono8, kWidth, kHeight, 0, 0, milliseconds(5), 0};
    auto* pixel = reinterpret_cast<std::uint8_t*>(s.memory().data());
    std::size_t draw = random();
    for (std::uint32_t y = 0; y < kHeight; ++y)
      for (std::uint32_t x = 0; x < kWidth; ++x) {
        const float mean = 90 + 60 * std::sin(0.01f * static_cast<float>(x + 7 * k)) *
                                    std::cos(0.013f * static_cast<float>(y));
        const float value = mean + 0.25f * std::sqrt(mean) * draws[draw++ & 0xffff];
        *pixel++ = static_cast<std::uint8_t>(std::clamp(value, 0.0f, 255.0f));
      }
  }
  return all;
}

/// A channel's encoder and its channels in the recording.
struct Stream {
  SampleEncoder encoder;
  std::vector<std::uint16_t> channels;

  Stream(McapWriter& writer, SampleChannel channel) : encoder(std::move(channel)) {
    for (const SampleStream& s : encoder.streams()) {
      const auto schema = must(writer.add_schema(std::string(s.type), "ros2msg", schema_text(s.type)));
      channels.push_back(must(writer.add_channel(
          {.schema = schema, .topic = s.topic, .metadata = {{"offered_qos_profiles", ""}}})));
    }
  }
  void write(McapWriter& writer, const Sample& sample) {
    const auto t = static_cast<std::uint64_t>(sample.stamp.t_release.ns());
    for (const SampleMessage& m : must(encoder.encode(sample)))
      must(writer.write({channels[m.stream], static_cast<std::uint32_t>(sample.stamp.sequence), t, t},
                        m.pieces));
  }
};

struct Run {
  double seconds = 0;
  double cpu_seconds = 0;
  std::uint64_t bytes = 0;  ///< of the file
  std::uint64_t messages = 0;
};

double cpu_now_s() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec) * 1e-9;
}

Run write_recording(const std::string& path, std::vector<Sample>& pictures, Compression compression,
                    double duration_s) {
  const MonotonicTime start = monotonic_now();
  const double cpu_start_s = cpu_now_s();
  auto writer = must(McapWriter::open(must(open_file_sink(path)), {.compression = compression}));
  std::vector<Stream> cameras;
  std::vector<Stream> registers;
  for (int i = 0; i < 2; ++i)
    cameras.emplace_back(*writer, SampleChannel{.name = "camera" + std::to_string(i),
                                                .topic = "/camera" + std::to_string(i),
                                                .frame_id = "camera",
                                                .kind = SampleKind::image});
  for (int i = 0; i < kRegisterChannels; ++i)
    registers.emplace_back(*writer,
                           SampleChannel{.name = "plc" + std::to_string(i),
                                         .topic = "/plc" + std::to_string(i),
                                         .frame_id = "plc",
                                         .kind = SampleKind::register_block,
                                         .register_names = {"a", "b", "c", "d", "e", "f", "g", "h"}});
  Sample block;
  RegisterBlock values;
  values.count = 8;
  std::size_t picture = 0;
  std::int64_t frame = 0;
  const auto cycles = static_cast<std::int64_t>(duration_s * 1000);
  for (std::int64_t k = 0; k < cycles; ++k) {
    const BenchTime t(1'000'000'000 + k * 1'000'000);
    if (k * 30 >= frame * 1000) {
      for (Stream& camera : cameras) {
        Sample& s = pictures[picture++ % pictures.size()];
        s.stamp.sequence = static_cast<std::uint64_t>(frame);
        s.stamp.t_capture = s.stamp.t_release = s.stamp.t_arrival = t;
        camera.write(*writer, s);
      }
      ++frame;
    }
    block.stamp.sequence = static_cast<std::uint64_t>(k);
    block.stamp.t_capture = block.stamp.t_release = block.stamp.t_arrival = t;
    values.value[static_cast<std::size_t>(k) & 7] = static_cast<double>(k) * 0.1;
    block.info = values;
    for (Stream& plc : registers) plc.write(*writer, block);
  }
  must(writer->close());
  const WriterStatistics statistics = writer->statistics();
  writer.reset();
  return {(monotonic_now() - start).seconds(), cpu_now_s() - cpu_start_s, statistics.file_bytes,
          statistics.messages};
}

/// As many bytes, picture by picture.
Run write_bare(const std::string& path, const std::vector<Sample>& pictures, std::uint64_t bytes) {
  const MonotonicTime start = monotonic_now();
  const double cpu_start_s = cpu_now_s();
  const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (fd < 0) give_up("cannot create " + path);
  std::uint64_t left = bytes;
  for (std::size_t i = 0; left > 0; ++i) {
    const auto block = pictures[i % pictures.size()].bytes();
    const std::size_t n = static_cast<std::size_t>(std::min<std::uint64_t>(left, block.size()));
    if (::write(fd, block.data(), n) != static_cast<ssize_t>(n)) give_up("write failed, is the disk full?");
    left -= n;
  }
  ::close(fd);
  return {(monotonic_now() - start).seconds(), cpu_now_s() - cpu_start_s, bytes, 0};
}

double median(std::vector<double> v) {
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
  return v[v.size() / 2];
}

double crc_gb_per_s(const std::vector<Sample>& pictures) {
  std::uint32_t crc = 0;
  std::uint64_t bytes = 0;
  const MonotonicTime start = monotonic_now();
  for (int round = 0; round < 20; ++round)
    for (const Sample& s : pictures) crc = crc32(s.bytes(), crc), bytes += s.size_bytes;
  const double seconds = (monotonic_now() - start).seconds();
  return crc == 1 ? 0
                  : static_cast<double>(bytes) / seconds * 1e-9;  // the value is used, so the work is done
}

}  // namespace

int main(int argc, char** argv) {
  std::string folder = ".";
  std::string json_path;
  double duration_s = 4;
  int rounds = 7;
  for (int i = 1; i < argc; ++i) {
    const std::string option = argv[i];
    if (i + 1 == argc ||
        (option != "--dir" && option != "--json" && option != "--seconds" && option != "--rounds")) {
      std::fprintf(stderr, "usage: bench_record [--dir FOLDER] [--seconds S] [--rounds N] [--json FILE]\n");
      return 2;
    }
    const char* value = argv[++i];
    if (option == "--dir") folder = value;
    if (option == "--json") json_path = value;
    if (option == "--seconds") duration_s = std::max(0.1, std::atof(value));
    if (option == "--rounds") rounds = std::max(1, std::atoi(value));
  }
  auto pictures = make_pictures();
  const std::string path = folder + "/bench_record.tmp";
  const std::vector<std::string> ways{"bare", "none", "lz4", "zstd"};
  const std::map<std::string, Compression> compressions{
      {"none", Compression::none}, {"lz4", Compression::lz4}, {"zstd", Compression::zstd}};
  const std::uint64_t bytes =
      write_recording(path, pictures, Compression::none, duration_s).bytes;  // warms up
  std::map<std::string, std::vector<Run>> runs;
  for (int round = 0; round < rounds; ++round)
    for (std::size_t i = 0; i < ways.size(); ++i) {
      const std::string& way = ways[(i + static_cast<std::size_t>(round)) % ways.size()];
      ::unlink(path.c_str());
      write_bare(path, pictures, bytes);
      ::unlink(path.c_str());
      runs[way].push_back(way == "bare" ? write_bare(path, pictures, bytes)
                                        : write_recording(path, pictures, compressions.at(way), duration_s));
    }
  ::unlink(path.c_str());

  const double crc = crc_gb_per_s(pictures);
  const auto rate = [&](const Run& run) { return static_cast<double>(bytes) / run.seconds; };
  const auto of = [&](const std::string& way, auto value) {
    std::vector<double> values;
    for (std::size_t i = 0; i < runs[way].size(); ++i) values.push_back(value(runs[way][i], runs["bare"][i]));
    std::sort(values.begin(), values.end());
    return values;
  };
  std::printf(
      "%.0f MB of recording: %.1f s of two 1280x1024 cameras at 30 Hz and ten 1 kHz channels; median of %d "
      "rounds\n",
      static_cast<double>(bytes) * 1e-6, duration_s, rounds);
  std::printf("CRC-32 %.1f GB/s\n\n%-6s %10s %22s %18s %17s %10s\n", crc, "way", "MB/s", "of bare write",
              "of its CPU time", "times real time", "file MB");
  nlohmann::json out{{"bench", "record"},
                     {"bytes", bytes},
                     {"rounds", rounds},
                     {"load_s", duration_s},
                     {"crc_gb_per_s", crc}};
  for (const std::string& way : ways) {
    const double mb_per_s = median(of(way, [&](const Run& run, const Run&) { return rate(run) * 1e-6; }));
    const auto ratio = of(way, [&](const Run& run, const Run& bare) { return rate(run) / rate(bare); });
    const double cpu =
        median(of(way, [](const Run& run, const Run& bare) { return bare.cpu_seconds / run.cpu_seconds; }));
    const double real_time = mb_per_s * duration_s / (static_cast<double>(bytes) * 1e-6);
    const Run& last = runs[way].back();
    std::printf("%-6s %10.0f %8.2f (%5.2f-%5.2f) %18.2f %17.1f %10.1f\n", way.c_str(), mb_per_s,
                median(ratio), ratio.front(), ratio.back(), cpu, real_time,
                static_cast<double>(last.bytes) * 1e-6);
    out[way] = {{"mb_per_s", mb_per_s},        {"of_bare", median(ratio)}, {"of_bare_min", ratio.front()},
                {"of_bare_max", ratio.back()}, {"of_bare_cpu", cpu},       {"times_real_time", real_time},
                {"file_bytes", last.bytes},    {"messages", last.messages}};
  }
  if (!json_path.empty()) {
    std::ofstream file(json_path);
    file << out.dump(2) << "\n";
    if (!file) give_up("cannot write " + json_path);
  }
}
