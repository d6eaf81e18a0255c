// The recorder beside a loop: two 1280x1024 cameras at 30 Hz and ten channels at 1 kHz, for half a minute,
// without a drop.
//
//   bench_record_load [--seconds 30] [--dir FOLDER] [--compression none|lz4|zstd] [--sync SECONDS]
//                     [--budget PICTURES] [--json FILE]
//
// A 1 kHz loop records what a rig would: samples as they come, what each port showed, a command every 10 ms.
// Reported: what the recorder's calls cost the loop per cycle, what it could not keep up with, and the most
// pictures of a camera that were held at a time; a budget of 32 bridges a second in which the disk or the
// machine does something else. Exit status 1 when something was dropped or is not in the file.
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>
#include <string>

#include "rt-core/executive.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/recorder.h"

namespace {

using namespace rigor;

constexpr std::uint32_t kWidth = 1280, kHeight = 1024;
constexpr std::size_t kBytes = std::size_t{kWidth} * kHeight;
constexpr int kRegisters = 10;

/// A camera's pool, every slot with its own noise, so that compression has its usual work.
std::unique_ptr<SamplePool> camera_pool(std::size_t slots) {
  auto pool = make_sample_pool(slots, kBytes);
  std::minstd_rand random(7);
  pool->for_each([&](Sample& s) {
    for (std::size_t i = 0; i < kBytes; ++i)
      s.memory()[i] = static_cast<std::byte>(90 + (i / kWidth) / 16 + (random() >> 20) % 7);
  });
  return pool;
}

void stamp(Sample& s, std::uint64_t sequence, BenchTime t) {
  s.stamp = Stamp{};
  s.stamp.sequence = sequence;
  s.stamp.t_capture = t - milliseconds(2);
  s.stamp.t_release = s.stamp.t_arrival = t;
}

}  // namespace

int main(int argc, char** argv) {
  std::string folder = ".", json_path, compression = "lz4";
  double duration_s = 30, sync_s = 1;
  std::size_t budget = 32;
  for (int i = 1; i < argc; ++i) {
    const std::string option = argv[i];
    if (i + 1 == argc || (option != "--dir" && option != "--json" && option != "--seconds" &&
                          option != "--compression" && option != "--sync" && option != "--budget")) {
      std::fprintf(stderr,
                   "usage: bench_record_load [--seconds S] [--dir FOLDER] [--compression none|lz4|zstd] "
                   "[--sync S] [--budget N] "
                   "[--json FILE]\n");
      return 2;
    }
    const std::string value = argv[++i];
    if (option == "--dir") folder = value;
    if (option == "--json") json_path = value;
    if (option == "--compression") compression = value;
    if (option == "--seconds") duration_s = std::max(0.1, std::atof(value.c_str()));
    if (option == "--budget") budget = std::max<std::size_t>(1, std::strtoul(value.c_str(), nullptr, 10));
    if (option == "--sync") sync_s = std::atof(value.c_str());
  }

  RecorderOptions options;
  options.epoch = read_epoch();
  options.file.sync_period = seconds_from(sync_s);
  options.writer.compression = compression == "none"  ? record::Compression::none
                               : compression == "lz4" ? record::Compression::lz4
                                                      : record::Compression::zstd;
  std::vector<RecordedChannel> channels;
  for (int i = 0; i < 2; ++i) {
    RecordedChannel c;
    c.name = "camera" + std::to_string(i);
    c.description.kind = SampleKind::image;
    c.description.width_px = kWidth;
    c.description.height_px = kHeight;
    c.description.max_bytes = kBytes;
    c.description.frame_id = c.name;
    c.lease_budget = budget;
    channels.push_back(c);
  }
  for (int i = 0; i < kRegisters; ++i) {
    RecordedChannel c;
    c.name = "plc" + std::to_string(i);
    c.description.kind = SampleKind::register_block;
    c.description.names = {"a", "b", "c", "d", "e", "f", "g", "h"};
    c.description.units.assign(8, "");
    channels.push_back(c);
  }
  const std::string path = folder + "/bench_record_load.mcap";
  auto created = Recorder::create(path, options, channels, {{"drive", {"speed"}}}, {});
  if (!created) {
    std::fprintf(stderr, "bench_record_load: %s\n", created.error().text().c_str());
    return created.error().exit_status();
  }
  Recorder& recorder = **created;
  std::unique_ptr<SamplePool> cameras[2] = {camera_pool(budget + 4), camera_pool(budget + 4)};
  auto blocks = make_sample_pool(4, 0);

  const auto cycles = static_cast<std::uint64_t>(duration_s * 1000);
  const BenchTime t0 = bench_now() + milliseconds(50);
  recorder.begin(t0);
  Histogram cost, wake;
  std::uint64_t frames = 0, no_slot = 0, skipped = 0, samples = 0;
  std::size_t most_held = 0;
  for (std::uint64_t k = 0; k < cycles; ++k) {
    const BenchTime now = t0 + milliseconds(static_cast<std::int64_t>(k));
    const timespec until{now.ns() / 1'000'000'000, now.ns() % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
    }
    const BenchTime woke = bench_now();
    wake.record(woke - now);
    if (woke - now > milliseconds(1)) ++skipped;
    Duration spent;
    const auto timed = [&](auto&& call) {
      const auto before = monotonic_now();
      call();
      spent += monotonic_now() - before;
    };
    if (k * 30 >= frames * 1000) {
      for (std::uint32_t i = 0; i < 2; ++i) {
        SampleSlot slot = cameras[i]->try_acquire();
        if (!slot) {
          ++no_slot;
          continue;
        }
        stamp(*slot, frames, now);
        ImageInfo info;
        info.width_px = kWidth;
        info.height_px = kHeight;
        slot->info = info;
        slot->size_bytes = kBytes;
        slot->memory()[frames % kBytes] = static_cast<std::byte>(frames);
        const SampleLease s = std::move(slot);
        timed([&] {
          recorder.record(i, s);
          recorder.record_visibility(i, k, now, PortStatus::fresh, s);
        });
        ++samples;
      }
      ++frames;
    }
    for (std::uint32_t i = 0; i < kRegisters; ++i) {
      SampleSlot slot = blocks->try_acquire();
      stamp(*slot, k, now);
      RegisterBlock b;
      b.count = 8;
      for (std::size_t v = 0; v < 8; ++v) b.value[v] = static_cast<double>(k) * 0.1 + static_cast<double>(v);
      slot->info = b;
      const SampleLease s = std::move(slot);
      timed([&] {
        recorder.record(2 + i, s);
        recorder.record_visibility(2 + i, k, now, PortStatus::fresh, s);
      });
      ++samples;
    }
    Command c;
    c.sequence = k / 10;
    c.t_issue = now;
    c.count = 1;
    timed([&] {
      if (k % 10 == 0) recorder.record_command(0, c);
      recorder.end_cycle(k, now);
    });
    cost.record(spent);
    most_held = std::max({most_held, cameras[0]->in_use(), cameras[1]->in_use()});
  }
  const Status stopped = recorder.stop();
  const auto statistics = recorder.statistics();

  std::uint64_t in_file = 0;
  auto reader = record::McapReader::open(path);
  if (reader)
    for (const auto& [id, n] : (*reader)->message_counts()) {
      const std::string& topic = (*reader)->channels().at(id).topic;
      if (topic.ends_with("/image") || topic.ends_with("/registers")) in_file += n;
    }
  ::unlink(path.c_str());
  const bool good = stopped && statistics.dropped == 0 && no_slot == 0 && in_file == samples;
  const auto us = [](Duration d) { return static_cast<double>(d.ns()) * 1e-3; };
  std::printf("%.0f s at 1 kHz, two %ux%u cameras at 30 Hz and %d channels at 1 kHz, %s\n", duration_s,
              kWidth, kHeight, kRegisters, compression.c_str());
  std::printf("samples %llu, in the file %llu, dropped %llu, no slot %llu, messages %llu, %.1f MB\n",
              static_cast<unsigned long long>(samples), static_cast<unsigned long long>(in_file),
              static_cast<unsigned long long>(statistics.dropped), static_cast<unsigned long long>(no_slot),
              static_cast<unsigned long long>(statistics.messages),
              static_cast<double>(statistics.bytes) * 1e-6);
  std::printf("cost to the loop per cycle: p50 %.1f us, p99 %.1f us, max %.1f us; most pictures held %zu\n",
              us(cost.percentile(0.5)), us(cost.percentile(0.99)), us(cost.max()), most_held);
  std::printf("wake-up error: p50 %.1f us, p99 %.1f us, max %.1f us; %llu later than a cycle\n%s\n",
              us(wake.percentile(0.5)), us(wake.percentile(0.99)), us(wake.max()),
              static_cast<unsigned long long>(skipped),
              good      ? "no drop"
              : stopped ? "NOT ALL WAS RECORDED"
                        : stopped.error().text().c_str());
  if (!json_path.empty()) {
    std::ofstream file(json_path);
    file << nlohmann::json{{"bench", "record_load"},
                           {"seconds", duration_s},
                           {"compression", compression},
                           {"samples", samples},
                           {"in_file", in_file},
                           {"dropped", statistics.dropped},
                           {"no_slot", no_slot},
                           {"messages", statistics.messages},
                           {"bytes", statistics.bytes},
                           {"cost_us",
                            {{"p50", us(cost.percentile(0.5))},
                             {"p99", us(cost.percentile(0.99))},
                             {"max", us(cost.max())}}},
                           {"wake_us",
                            {{"p50", us(wake.percentile(0.5))},
                             {"p99", us(wake.percentile(0.99))},
                             {"max", us(wake.max())}}},
                           {"most_pictures_held", most_held},
                           {"budget", budget},
                           {"no_drop", good}}
                .dump(2)
         << "\n";
  }
  return good ? 0 : 1;
}
