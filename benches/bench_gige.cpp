// GigE Vision over loopback, from an emulated camera in a process of its own to the channel's ring: frames
// lost, time from the camera's first packet to the sample's arrival, CPU of the receiving side for each
// frame; without loss, and through a relay that loses 2 % of the packets, resent ones included. Every picture
// is checked byte for byte against the one that was sent.
//
// Beside it, in the same run, the plainest reader: a loop of arv_stream_pop_buffer and a timestamp, checking
// as much. And the camera is killed for 1.5 s: time to recover, and whether what is missing is accounted for.
//
// With the defaults it takes some 50 s. A camera that skipped frames, or a plain reader that is late, says
// that the machine was busy: the load is in the JSON file.
//
//   bench_gige [--seconds 14] [--width 1280] [--height 1024] [--rate 60] [--loss 0.02] [--json FILE]
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/gige_emulator.h"
#include "rt-core/histogram.h"
#include "tests/drivers/aravis/stamped_picture.h"

#include <arv.h>

namespace {

using namespace rigor;

constexpr const char* kCamera = "127.0.0.71";
constexpr const char* kRelay = "127.0.0.72";

struct Options {
  double seconds = 14, rate_hz = 60, loss = 0.02;
  int width = 1280, height = 1024;
  std::string json;
};

struct Figures {
  std::uint64_t sent = 0, whole = 0, marked = 0, lost = 0, torn = 0, zero_unmarked = 0, reconnects = 0;
  std::uint64_t resent_packets = 0, packets = 0, packets_lost = 0, skipped = 0;
  Histogram latency, clock_error;
  double cpu_ms_per_frame = 0, sigma_us = 0, rate_hz = 0;
};

/// What the camera's process says at its end.
struct CameraSays {
  std::uint64_t sent = 0, skipped = 0, packets = 0, packets_lost = 0;
};

/// The camera, and the relay where there is one, until a byte comes on `until`; then its counters go to
/// `report`.
[[noreturn]] void be_camera(const Options& o, double loss, int until, int report) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  gige::GigeEmulatorOptions e;
  e.address = kCamera;
  e.camera.serial = "BENCH";
  e.camera.sensor_width_px = static_cast<std::uint32_t>(o.width);
  e.camera.sensor_height_px = static_cast<std::uint32_t>(o.height);
  auto camera = gige::GigeEmulator::start(e, gige::testing::fill_stamped);
  if (!camera) {
    std::fprintf(stderr, "%s\n", camera.error().text().c_str());
    _exit(1);
  }
  std::unique_ptr<gige::testing::LossRelay> relay;
  if (loss > 0)
    relay = std::make_unique<gige::testing::LossRelay>(
        gige::Endpoint{*gige::parse_ipv4(kRelay), gige::kGvcpPort},
        gige::Endpoint{*gige::parse_ipv4(kCamera), gige::kGvcpPort}, loss, 20240611);
  char c = 0;
  if (write(report, "r", 1) != 1 || read(until, &c, 1) < 0) _exit(1);
  const auto h = (*camera)->health();
  CameraSays says{h.frames_sent, h.exposures_skipped + h.blocks_dropped + h.pictures_missing, h.packets_sent,
                  0};
  if (relay) says.packets = relay->passed() + relay->lost(), says.packets_lost = relay->lost();
  _exit(write(report, &says, sizeof says) == sizeof says ? 0 : 1);
}

double cpu_s() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  const auto s = [](timeval t) {
    return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_usec) * 1e-6;
  };
  return s(u.ru_utime) + s(u.ru_stime);
}

/// Of the calling thread: what judging the pictures costs is not the reader's.
double thread_cpu_s() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec) * 1e-9;
}

bool check(const Status& s) {
  if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str());
  return s.has_value();
}

bool run(const Options& o, double loss, Figures& f) {
  int until[2], report[2];
  if (pipe(until) != 0 || pipe(report) != 0) return false;
  const pid_t pid = fork();
  if (pid == 0) {
    close(until[1]);
    close(report[0]);
    be_camera(o, loss, until[0], report[1]);
  }
  close(until[0]);
  close(report[1]);
  char ready = 0;
  if (read(report[0], &ready, 1) != 1) return false;

  const std::string keys = loss > 0 ? "{address: 127.0.0.72, packet_size: 1400, exposure_us: 2000}"
                                    : "{address: 127.0.0.71, exposure_us: 2000}";
  ChannelConfig config;
  config.name = "bench";
  config.kind = SampleKind::image;
  config.period = seconds_from(1.0 / o.rate_hz);
  config.latency = milliseconds(100);
  config.params = *ConfigDocument::parse(keys, "bench");
  AravisSource source;
  if (!check(source.configure(config)) || !check(source.arm({}))) return false;
  const auto now = [] { return bench_now(); };
  if (!check(source.start(now()))) return false;
  const Duration first_packet = microseconds(2000) + milliseconds(1);  // exposure and the camera's readout
  double judging_s = 0, sigma_sum = 0;
  const double cpu_before = cpu_s();
  const BenchTime end = now() + seconds_from(o.seconds);
  while (now() < end) {
    const BenchTime t = now();
    source.begin_cycle(t);
    while (SampleLease lease = source.poll(t)) {
      const double j = thread_cpu_s();
      const Stamp& s = lease->stamp;
      const auto* b = reinterpret_cast<const std::uint8_t*>(lease->bytes().data());
      const bool marked = (s.validity & kIncomplete) != 0;
      (marked ? f.marked : f.whole) += 1;
      if (!marked) {
        const auto v = gige::testing::judge_stamped({b, lease->bytes().size()});
        f.torn += v.wrong != 0;
        f.zero_unmarked += v.zero != 0;
        const BenchTime truth(static_cast<std::int64_t>(v.exposure_start_ns));
        f.latency.record(s.t_arrival - (truth + first_packet));
        const Duration off = s.t_capture - (truth + microseconds(1000));
        f.clock_error.record(off.ns() < 0 ? -off : off);
        sigma_sum += static_cast<double>(s.sigma_capture.ns()) * 1e-3;
      }
      judging_s += thread_cpu_s() - j;
    }
    usleep(1000);
  }
  const double used_s = cpu_s() - cpu_before - judging_s;
  f.rate_hz = static_cast<double>(f.whole) / o.seconds;
  if (!check(source.stop())) return false;
  f.lost = source.health().lost;
  f.reconnects = source.health().reconnects;
  f.resent_packets = source.counters().resent_packets;
  f.cpu_ms_per_frame = used_s * 1e3 / static_cast<double>(std::max<std::uint64_t>(1, f.whole + f.marked));
  f.sigma_us = sigma_sum / static_cast<double>(std::max<std::uint64_t>(1, f.whole));
  CameraSays says;
  if (write(until[1], "e", 1) != 1 || read(report[0], &says, sizeof says) != sizeof says) return false;
  waitpid(pid, nullptr, 0);
  close(until[1]);
  close(report[0]);
  f.sent = says.sent, f.packets = says.packets, f.packets_lost = says.packets_lost;
  f.skipped = says.skipped;
  if (f.reconnects != 0)
    std::printf("the camera was silent for so long that it was opened anew %llu times\n",
                static_cast<unsigned long long>(f.reconnects));
  if (says.skipped != 0)
    std::printf("the camera itself skipped %llu frames\n", static_cast<unsigned long long>(says.skipped));
  return true;
}

/// A camera in a process of its own, until `says` or a kill.
struct CameraProcess {
  pid_t pid = -1;
  int until[2]{-1, -1}, report[2]{-1, -1};
  bool start(const Options& o) {
    if (pipe(until) != 0 || pipe(report) != 0) return false;
    pid = fork();
    if (pid == 0) {
      close(until[1]);
      close(report[0]);
      be_camera(o, 0, until[0], report[1]);
    }
    close(until[0]);
    close(report[1]);
    char ready = 0;
    return read(report[0], &ready, 1) == 1;
  }
  void kill_now() {
    kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
    close(until[1]);
    close(report[0]);
  }
};

/// What anybody would write with Aravis.
bool plain(const Options& o, Figures& f) {
  CameraProcess process;
  if (!process.start(o)) return false;
  ArvCamera* camera = arv_camera_new(kCamera, nullptr);
  if (camera == nullptr) return false;
  arv_camera_set_exposure_time(camera, 2000, nullptr);
  arv_camera_set_frame_rate(camera, o.rate_hz, nullptr);
  arv_camera_gv_auto_packet_size(camera, nullptr);
  arv_camera_gv_set_stream_options(camera, ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
  ArvStream* stream = arv_camera_create_stream(camera, nullptr, nullptr, nullptr);
  if (stream == nullptr) return false;
  g_object_set(stream, "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED, "socket-buffer-size", 4 << 20,
               nullptr);
  const auto payload = arv_camera_get_payload(camera, nullptr);
  for (int i = 0; i < 8; ++i) arv_stream_push_buffer(stream, arv_buffer_new_allocate(payload));
  arv_camera_start_acquisition(camera, nullptr);
  double judging_s = 0;
  const double cpu_before = cpu_s();
  std::uint64_t last_id = 0;
  for (const auto end = monotonic_now() + seconds_from(o.seconds); monotonic_now() < end;) {
    ArvBuffer* b = arv_stream_timeout_pop_buffer(stream, 100'000);
    if (b == nullptr) continue;
    const auto arrival = monotonic_now().ns();
    const double j = thread_cpu_s();
    const auto id = arv_buffer_get_frame_id(b);
    if (last_id != 0 && id > last_id + 1) f.lost += id - last_id - 1;
    last_id = id;
    if (arv_buffer_get_status(b) == ARV_BUFFER_STATUS_SUCCESS) {
      size_t size = 0;
      const auto* data = static_cast<const std::uint8_t*>(arv_buffer_get_data(b, &size));
      const auto v = gige::testing::judge_stamped({data, static_cast<std::size_t>(o.width) * o.height});
      f.torn += v.wrong != 0;
      ++f.whole;
      const auto first = static_cast<std::int64_t>(v.exposure_start_ns) + 3'000'000;  // exposure and readout
      f.latency.record(Duration(arrival - first));
    } else {
      ++f.marked;
    }
    arv_stream_push_buffer(stream, b);
    judging_s += thread_cpu_s() - j;
  }
  f.rate_hz = static_cast<double>(f.whole) / o.seconds;
  f.cpu_ms_per_frame = (cpu_s() - cpu_before - judging_s) * 1e3 /
                       static_cast<double>(std::max<std::uint64_t>(1, f.whole + f.marked));
  arv_camera_stop_acquisition(camera, nullptr);
  g_object_unref(stream);
  g_object_unref(camera);
  CameraSays says;
  if (write(process.until[1], "e", 1) != 1 || read(process.report[0], &says, sizeof says) != sizeof says)
    return false;
  waitpid(process.pid, nullptr, 0);
  f.sent = says.sent, f.packets = says.packets, f.skipped = says.skipped;
  return true;
}

struct Recovery {
  double gone_s = 0, back_ms = 0;
  std::uint64_t missing = 0, counted = 0;
};

bool recover(const Options& o, Recovery& r) {
  CameraProcess process;
  if (!process.start(o)) return false;
  ChannelConfig config;
  config.name = "bench";
  config.kind = SampleKind::image;
  config.period = seconds_from(1.0 / o.rate_hz);
  config.latency = milliseconds(100);
  config.params = *ConfigDocument::parse("{address: 127.0.0.71, exposure_us: 2000}", "bench");
  AravisSource source;
  const auto now = [] { return bench_now(); };
  if (!check(source.configure(config)) || !check(source.arm({})) || !check(source.start(now()))) return false;
  std::uint64_t last = 0;
  bool any = false;
  const auto take = [&] {
    bool came = false;
    source.begin_cycle(now());
    while (const SampleLease lease = source.poll(now())) {
      if (any) r.missing += lease->stamp.sequence - last - 1, r.counted += lease->stamp.lost_before;
      last = lease->stamp.sequence;
      came = any = true;
    }
    usleep(500);
    return came;
  };
  for (const auto end = now() + seconds(2); now() < end;) (void)take();
  process.kill_now();
  const auto killed = now();
  for (const auto end = killed + milliseconds(1500); now() < end;) (void)take();
  if (!process.start(o)) return false;
  const auto there = now();
  r.gone_s = (there - killed).seconds();
  while (!take() && now() < there + seconds(30)) {
  }
  r.back_ms = (now() - there).seconds() * 1e3;
  for (const auto end = now() + seconds(1); now() < end;) (void)take();
  const bool good = check(source.stop());
  process.kill_now();
  return good;
}

double ms(Duration d) { return d.seconds() * 1e3; }

void print(const char* name, const Figures& f) {
  std::printf(
      "%-10s %.1f Hz, sent %llu whole %llu marked %llu lost %llu torn %llu | packets %llu lost %llu resent "
      "%llu | "
      "first packet to ring p50 %.2f p99 %.2f max %.2f ms | CPU %.2f ms/frame | clock error p50 %.1f p99 "
      "%.1f us, "
      "stated sigma %.1f us\n",
      name, f.rate_hz, static_cast<unsigned long long>(f.sent), static_cast<unsigned long long>(f.whole),
      static_cast<unsigned long long>(f.marked), static_cast<unsigned long long>(f.lost),
      static_cast<unsigned long long>(f.torn + f.zero_unmarked), static_cast<unsigned long long>(f.packets),
      static_cast<unsigned long long>(f.packets_lost), static_cast<unsigned long long>(f.resent_packets),
      ms(f.latency.percentile(0.50)), ms(f.latency.percentile(0.99)), ms(f.latency.max()), f.cpu_ms_per_frame,
      f.clock_error.percentile(0.50).seconds() * 1e6, f.clock_error.percentile(0.99).seconds() * 1e6,
      f.sigma_us);
}

void to_json(std::ofstream& out, const char* name, double loss, const Figures& f) {
  out << "\"" << name << "\": {\"loss\": " << loss << ", \"sent\": " << f.sent << ", \"whole\": " << f.whole
      << ", \"rate_hz\": " << f.rate_hz << ", \"camera_skipped\": " << f.skipped
      << ", \"marked\": " << f.marked << ", \"lost\": " << f.lost
      << ", \"torn\": " << f.torn + f.zero_unmarked << ", \"reconnects\": " << f.reconnects
      << ", \"packets\": " << f.packets << ", \"packets_lost\": " << f.packets_lost
      << ", \"packets_resent\": " << f.resent_packets
      << ", \"latency_p50_ms\": " << ms(f.latency.percentile(0.50))
      << ", \"latency_p99_ms\": " << ms(f.latency.percentile(0.99))
      << ", \"latency_max_ms\": " << ms(f.latency.max()) << ", \"cpu_ms_per_frame\": " << f.cpu_ms_per_frame
      << ", \"clock_error_p99_us\": " << f.clock_error.percentile(0.99).seconds() * 1e6
      << ", \"clock_sigma_us\": " << f.sigma_us << "}";
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  for (int i = 1; i < argc; ++i) {
    const std::string key = argv[i];
    if (i + 1 >= argc) {
      std::fprintf(
          stderr,
          "usage: bench_gige [--seconds S] [--width W] [--height H] [--rate HZ] [--loss L] [--json FILE]\n");
      return 2;
    }
    const char* value = argv[++i];
    if (key == "--seconds")
      o.seconds = std::atof(value);
    else if (key == "--width")
      o.width = std::atoi(value);
    else if (key == "--height")
      o.height = std::atoi(value);
    else if (key == "--rate")
      o.rate_hz = std::atof(value);
    else if (key == "--loss")
      o.loss = std::atof(value);
    else if (key == "--json")
      o.json = value;
    else {
      std::fprintf(stderr, "unknown option %s\n", key.c_str());
      return 2;
    }
  }
  std::printf(
      "%dx%d Mono8 at %g Hz over loopback, %g s each; the link is paced at 1 Gbit/s: %.2f ms a frame\n",
      o.width, o.height, o.rate_hz, o.seconds, o.width * o.height * 8e-6);
  Figures simple, clean, lossy;
  Recovery r;
  if (!plain(o, simple)) return 1;
  print("plain C", simple);
  if (!run(o, 0, clean)) return 1;
  print("no loss", clean);
  if (o.loss > 0) {
    if (!run(o, o.loss, lossy)) return 1;
    print("with loss", lossy);
  }
  const double added50 = ms(clean.latency.percentile(0.5)) - ms(simple.latency.percentile(0.5)),
               added99 = ms(clean.latency.percentile(0.99)) - ms(simple.latency.percentile(0.99));
  std::printf("added: p50 %.3f ms, p99 %.3f ms\n", added50, added99);
  if (!recover(o, r)) return 1;
  std::printf(
      "killed: gone for %.2f s, back %.0f ms after the camera; %llu frames missing, %llu accounted for\n",
      r.gone_s, r.back_ms, static_cast<unsigned long long>(r.missing),
      static_cast<unsigned long long>(r.counted));
  if (!o.json.empty()) {
    std::ofstream out(o.json);
    double load[1] = {0};
    (void)getloadavg(load, 1);
    out << "{\"width_px\": " << o.width << ", \"height_px\": " << o.height << ", \"wanted_hz\": " << o.rate_hz
        << ", \"load\": " << load[0] << ", \"cpus\": " << sysconf(_SC_NPROCESSORS_ONLN)
        << ", \"added_p50_ms\": " << added50 << ", \"added_p99_ms\": " << added99 << ", ";
    to_json(out, "plain", 0, simple);
    out << ", \"gone_s\": " << r.gone_s << ", \"recovery_ms\": " << r.back_ms
        << ", \"missing\": " << r.missing << ", \"accounted\": " << r.counted << ", ";
    to_json(out, "no_loss", 0, clean);
    if (o.loss > 0) out << ", ", to_json(out, "with_loss", o.loss, lossy);
    out << "}\n";
    if (!out.good()) return 1;
  }
  const bool good =
      clean.lost + clean.marked + clean.torn + clean.zero_unmarked + lossy.torn + lossy.zero_unmarked == 0;
  return good ? 0 : 1;
}
