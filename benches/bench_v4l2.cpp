// A video device read by the channel and by the plainest C program (a thread with poll, DQBUF, a copy and a
// timestamp), one after the other in one run: time from the kernel's stamp to the frame in hand, CPU per
// frame, frames lost. With --emulate the device is a loop-back node that an emulated camera writes to, which
// is then also stopped and started again: time until the channel gives samples again, and how many it
// reported lost.
//
//   bench_v4l2 --device /dev/video0 [--width 640] [--height 480] [--rate 30] [--format GREY] [--seconds 10]
//              [--emulate] [--json FILE]
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include "drivers/v4l2/v4l2_emulator.h"
#include "drivers/v4l2/v4l2_source.h"

namespace {

using namespace rigor;
using namespace rigor::v4l2;

struct Options {
  std::string device, format = "GREY", json;
  std::uint32_t width = 640, height = 480;
  double rate_hz = 30, seconds = 10;
  bool emulate = false;
};
struct Figures {
  std::uint64_t frames = 0, lost = 0;
  double p50_us = 0, p99_us = 0, cpu_us_per_frame = 0;
};

double cpu_us(int who) {
  rusage u{};
  getrusage(who, &u);
  const auto us = [](timeval t) {
    return static_cast<double>(t.tv_sec) * 1e6 + static_cast<double>(t.tv_usec);
  };
  return us(u.ru_utime) + us(u.ru_stime);
}
double quantile(std::vector<double>& v, double q) {
  if (v.empty()) return 0;
  std::sort(v.begin(), v.end());
  return v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1))];
}
std::int64_t now_ns() { return monotonic_now().ns(); }

/// The plainest reader: what a page of C does.
bool read_plainly(const Options& o, Figures& f) {
  auto fd = open_node(o.device);
  if (!fd) return std::fprintf(stderr, "%s\n", fd.error().text().c_str()), false;
  const FormatChoice choice{fourcc_from(o.format).value_or(kGrey),
                            o.width,
                            o.height,
                            {1000, static_cast<std::uint32_t>(o.rate_hz * 1000)}};
  if (auto a = set_node_format(fd->get(), o.device, choice, false, true); !a)
    return std::fprintf(stderr, "%s\n", a.error().text().c_str()), false;
  v4l2_requestbuffers r{};
  r.count = 4, r.type = V4L2_BUF_TYPE_VIDEO_CAPTURE, r.memory = V4L2_MEMORY_MMAP;
  if (call(fd->get(), VIDIOC_REQBUFS, &r) != 0) return false;
  std::vector<std::pair<void*, std::size_t>> memory;
  for (std::uint32_t i = 0; i < r.count; ++i) {
    v4l2_buffer b{};
    b.index = i, b.type = r.type, b.memory = r.memory;
    if (call(fd->get(), VIDIOC_QUERYBUF, &b) != 0) return false;
    memory.emplace_back(mmap(nullptr, b.length, PROT_READ, MAP_SHARED, fd->get(), b.m.offset), b.length);
    if (memory.back().first == MAP_FAILED || call(fd->get(), VIDIOC_QBUF, &b) != 0) return false;
  }
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (call(fd->get(), VIDIOC_STREAMON, &type) != 0) return false;
  std::vector<double> latency_us;
  std::vector<std::byte> copy(std::size_t{o.width} * o.height * 4);
  double cpu = 0;
  std::thread reader([&] {
    const double before = cpu_us(RUSAGE_THREAD);
    const std::int64_t end = now_ns() + static_cast<std::int64_t>(o.seconds * 1e9);
    std::uint32_t last = 0;
    while (now_ns() < end) {
      pollfd p{fd->get(), POLLIN, 0};
      if (poll(&p, 1, 200) <= 0) continue;
      v4l2_buffer b{};
      b.type = r.type, b.memory = r.memory;
      if (call(fd->get(), VIDIOC_DQBUF, &b) != 0) continue;
      std::memcpy(copy.data(), memory[b.index].first, std::min<std::size_t>(b.bytesused, copy.size()));
      const std::int64_t stamp =
          std::int64_t{b.timestamp.tv_sec} * 1'000'000'000 + std::int64_t{b.timestamp.tv_usec} * 1000;
      latency_us.push_back(static_cast<double>(now_ns() - stamp) * 1e-3);
      if (f.frames++ > 0 && b.sequence > last + 1) f.lost += b.sequence - last - 1;
      last = b.sequence;
      (void)call(fd->get(), VIDIOC_QBUF, &b);
    }
    cpu = cpu_us(RUSAGE_THREAD) - before;
  });
  reader.join();
  (void)call(fd->get(), VIDIOC_STREAMOFF, &type);
  for (const auto& [at, size] : memory) munmap(at, size);
  f.p50_us = quantile(latency_us, 0.5), f.p99_us = quantile(latency_us, 0.99);
  f.cpu_us_per_frame = f.frames == 0 ? 0 : cpu / static_cast<double>(f.frames);
  return true;
}

ChannelConfig config_of(const Options& o, const std::string& keys) {
  ChannelConfig c;
  c.name = "bench";
  c.kind = SampleKind::image;
  c.period = seconds_from(1.0 / o.rate_hz);
  c.latency = milliseconds(100);
  c.params = *ConfigDocument::parse(keys, "bench");
  return c;
}
bool check(const Status& s) {
  if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str());
  return s.has_value();
}

std::string source_keys(const Options& o) {
  const auto format = same_bytes(fourcc_from(o.format).value_or(kGrey)).value_or(PixelFormat::mono8);
  return "{device: " + o.device + ", device_format: " + o.format +
         ", pixel_format: " + std::string(pfnc_name(format)) + ", width_px: " + std::to_string(o.width) +
         ", height_px: " + std::to_string(o.height) + ", exposure_us: 0, silence_ms: 300, buffers: 16}";
}

/// Polls as the loop does, from one thread. CPU is that of all other threads: the I/O thread's, less the
/// emulator's.
bool read_by_channel(const Options& o, Figures& f, const std::atomic<double>& other_cpu_us) {
  V4l2Source s;
  if (!check(s.configure(config_of(o, source_keys(o)))) || !check(s.arm({})) ||
      !check(s.start(BenchTime(now_ns()))))
    return false;
  std::vector<double> latency_us;
  const double all_before = cpu_us(RUSAGE_SELF), own_before = cpu_us(RUSAGE_THREAD),
               other_before = other_cpu_us.load();
  const std::int64_t end = now_ns() + static_cast<std::int64_t>(o.seconds * 1e9);
  while (now_ns() < end) {
    while (const SampleLease sample = s.poll(BenchTime(now_ns())))
      latency_us.push_back(static_cast<double>((sample->stamp.t_arrival - sample->stamp.t_capture).ns()) *
                           1e-3);
    usleep(1000);
  }
  const double cpu = cpu_us(RUSAGE_SELF) - all_before - (cpu_us(RUSAGE_THREAD) - own_before) -
                     (other_cpu_us.load() - other_before);
  f.frames = s.health().received, f.lost = s.health().lost;
  f.p50_us = quantile(latency_us, 0.5), f.p99_us = quantile(latency_us, 0.99);
  f.cpu_us_per_frame = f.frames == 0 ? 0 : cpu / static_cast<double>(f.frames);
  return check(s.stop());
}

/// A picture that costs nothing.
class Still final : public ImageProvider {
 public:
  explicit Still(const Options& o) : width_(o.width), height_(o.height) {}
  Geometry geometry() const override {
    return {width_, height_, PixelFormat::mono8, milliseconds(1), "bench"};
  }
  Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
    if (!pixels.empty()) pixels[0] = static_cast<std::byte>(r.index);
    return {};
  }

 private:
  std::uint32_t width_, height_;
};

bool start_camera(V4l2Emulator& e, const Options& o) {
  DeviceParts parts;
  parts.image = std::make_shared<Still>(o);
  e.attach(std::move(parts));
  const std::string keys = "{device: " + o.device + ", formats: [" + o.format +
                           "], io: write, rate_hz: " + std::to_string(o.rate_hz) + "}";
  if (!check(e.configure(config_of(o, keys))) || !check(e.arm({})) || !check(e.start(BenchTime(now_ns()))))
    return false;
  for (int i = 0; i < 500 && e.health().received == 0; ++i) usleep(10'000);
  return true;
}

/// Milliseconds from the writer's return to the first sample, and samples lost.
bool recover(const Options& o, std::unique_ptr<V4l2Emulator>& camera, double& ms, std::uint64_t& lost) {
  V4l2Source s;
  if (!check(s.configure(config_of(o, source_keys(o)))) || !check(s.arm({})) ||
      !check(s.start(BenchTime(now_ns()))))
    return false;
  usleep(500'000);
  camera.reset();
  for (int i = 0; i < 1000 && s.health().connected; ++i) usleep(10'000);
  while (s.poll(BenchTime(now_ns()))) {
  }
  camera = std::make_unique<V4l2Emulator>();
  if (!start_camera(*camera, o)) return false;
  const std::int64_t back = now_ns();
  for (int i = 0; i < 10'000 && !s.poll(BenchTime(now_ns())); ++i) usleep(1000);
  ms = static_cast<double>(now_ns() - back) * 1e-6;
  lost = s.health().lost;
  return check(s.stop());
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  for (int i = 1; i < argc; ++i) {
    const std::string key = argv[i];
    const auto value = [&] { return i + 1 < argc ? std::string(argv[++i]) : std::string(); };
    if (key == "--device")
      o.device = value();
    else if (key == "--format")
      o.format = value();
    else if (key == "--json")
      o.json = value();
    else if (key == "--width")
      o.width = static_cast<std::uint32_t>(std::stoul(value()));
    else if (key == "--height")
      o.height = static_cast<std::uint32_t>(std::stoul(value()));
    else if (key == "--rate")
      o.rate_hz = std::stod(value());
    else if (key == "--seconds")
      o.seconds = std::stod(value());
    else if (key == "--emulate")
      o.emulate = true;
    else
      return std::fprintf(stderr, "bench_v4l2: unknown option %s\n", key.c_str()), 2;
  }
  if (o.device.empty()) {
    for (const DeviceTable& t : list_nodes(false))
      if (o.device.empty() && (o.emulate ? t.driver == "v4l2 loopback" && t.outputs : t.captures))
        o.device = t.path;
    if (o.device.empty()) {
      std::printf("this kernel has no video device%s: nothing to measure\n",
                  o.emulate ? " of v4l2loopback" : "");
      if (!o.json.empty()) std::ofstream(o.json) << "{\"v4l2\": null}\n";
      return 0;
    }
  }
  auto camera = std::make_unique<V4l2Emulator>();
  if (o.emulate && !start_camera(*camera, o)) return 1;
  Figures plain, channel;
  // The emulator writes from this process: what its thread takes in the plain run is taken from the channel's
  // run.
  const double before = cpu_us(RUSAGE_SELF);
  if (!read_plainly(o, plain))
    return std::fprintf(stderr, "%s: cannot be read plainly\n", o.device.c_str()), 1;
  const double others =
      o.emulate ? cpu_us(RUSAGE_SELF) - before - plain.cpu_us_per_frame * static_cast<double>(plain.frames)
                : 0;
  std::atomic<double> other_cpu{0};
  if (!read_by_channel(o, channel, other_cpu)) return 1;
  if (channel.frames != 0) channel.cpu_us_per_frame -= others / static_cast<double>(channel.frames);
  double back_ms = 0;
  std::uint64_t lost_away = 0;
  if (o.emulate && !recover(o, camera, back_ms, lost_away)) return 1;
  std::printf("%s, %s %ux%u at %g Hz, %g s each\n", o.device.c_str(), o.format.c_str(), o.width, o.height,
              o.rate_hz, o.seconds);
  const auto row = [](const char* name, const Figures& f) {
    std::printf(
        "%-10s %6llu frames  %4llu lost  stamp to hand p50 %8.1f µs  p99 %8.1f µs  CPU %7.1f µs/frame\n",
        name, static_cast<unsigned long long>(f.frames), static_cast<unsigned long long>(f.lost), f.p50_us,
        f.p99_us, f.cpu_us_per_frame);
  };
  row("plain C", plain);
  row("channel", channel);
  if (o.emulate)
    std::printf("writer stopped and started: samples again after %.1f ms, %llu reported lost\n", back_ms,
                static_cast<unsigned long long>(lost_away));
  if (!o.json.empty()) {
    const auto text = [](const Figures& f) {
      return "{\"frames\": " + std::to_string(f.frames) + ", \"lost\": " + std::to_string(f.lost) +
             ", \"latency_p50_us\": " + std::to_string(f.p50_us) +
             ", \"latency_p99_us\": " + std::to_string(f.p99_us) +
             ", \"cpu_us_per_frame\": " + std::to_string(f.cpu_us_per_frame) + "}";
    };
    std::ofstream(o.json) << "{\"v4l2\": {\"plain\": " << text(plain) << ", \"channel\": " << text(channel)
                          << ", \"recover_ms\": " << back_ms << ", \"lost_while_away\": " << lost_away
                          << "}}\n";
  }
  return 0;
}
