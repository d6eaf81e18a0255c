// An application of a Rigor rig in C++, as a program of its own or as a shared object: sees the rig's
// channels, gives commands. One header; needs C++20, Linux and nlohmann/json (Debian: nlohmann-json3-dev).
//
//   #include "rigor_client.h"
//   struct Detector : rigor_client::Application {
//     void start(const rigor_client::Rig& rig) override { limit = rig.params.value("limit", 200); }
//     void step(rigor_client::Turn& turn) override {
//       const rigor_client::Port& camera = turn["left"];
//       if (!camera.fresh()) return;
//       for (const auto pixel : camera.sample().pixels<std::uint8_t>())
//         if (pixel > limit) return turn.command("table_command", {1, 10.0});
//     }
//     int limit = 0;
//   };
//   RIGOR_APPLICATION(Detector)   // once: `main` of a program, and the entry of a shared object
//
// The rig names the program, `application: { command: [./detector] }`, or the shared object,
// `application: { library: ./libdetector.so }`, which is called by the loop's own thread: there it has to be
// as quick as the loop needs. Bytes of samples lie in the bench's memory and are valid until the next turn
// begins. What is thrown in `start`, `step` or `finish` ends the run, with its what() as the reason. The
// protocol is that of docs/application-protocol.md, version 1.
#pragma once

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace rigor_client {

inline constexpr std::uint32_t kProtocol = 1;

enum class Kind : std::uint32_t {
  none,
  image,
  range_image,
  point_cloud,
  can_frame,
  registers,
  pose,
  event,
  imu,
  nav_fix,
  odometry
};
enum class Status : std::uint32_t { never, fresh, held, overdue, disconnected };

// What `info` of a sample holds, by its kind; a register block is a count (8 bytes) and its values.
struct ImageInfo {
  std::uint32_t width_px, height_px, offset_x_px, offset_y_px;
  std::int64_t exposure_ns;
  double gain_db;
  char format[32];
};
struct RangeImageInfo {
  std::uint32_t width_px, height_px;
};
struct PointCloudInfo {
  std::uint32_t count, point_bytes;
};
struct CanFrame {
  std::uint32_t id;
  std::uint8_t flags;  // extended, remote, error, fd, bit_rate_switch
  std::uint8_t length;
  std::uint16_t unused;
  std::uint8_t data[64];
};
struct Pose {
  double position_m[3], orientation_wxyz[4];
};
struct Event {
  std::uint32_t code, unused;
  double value;
  char text[440];
};
struct Imu {
  double specific_force_mps2[3], angular_rate_radps[3], temperature_c;
};
struct NavFix {
  std::uint32_t status, satellites;  // none, fix, sbas, rtk_float, rtk_fixed
  double latitude_deg, longitude_deg, height_m, covariance_enu_m2[9];
};
struct Odometry {
  Pose T_odom_base;
  double velocity_mps[3], turn_rate_radps[3], pose_variance[6], twist_variance[6], wheel_angle_rad[2],
      wheel_rate_radps[2];
};
/// One point of a cloud, in the sensor's frame (x forward, y left, z up).
struct Point {
  float x_m, y_m, z_m, remission;
  std::int32_t t_offset_ns;
  std::uint16_t ring;
  std::uint8_t return_index, flags;
};

class Sample {
 public:
  Kind kind = Kind::none;
  std::uint64_t sequence = 0;
  std::int64_t t_capture_ns = 0, t_release_ns = 0, t_arrival_ns = 0, sigma_capture_ns = 0;  ///< bench clock
  std::uint32_t lost_before = 0, validity = 0;  ///< validity 0: a good one
  std::span<const std::byte> bytes;             ///< of pictures, range images and clouds

  /// ImageInfo, …, of its kind; throws where the sample is shorter.
  template <class T>
  [[nodiscard]] T info() const {
    if (info_bytes_ < sizeof(T)) throw std::runtime_error("the sample is of another kind");
    T out;
    std::memcpy(&out, info_.data(), sizeof out);
    return out;
  }
  /// The bytes as numbers: pixels, the two planes of a range image (range [m], amplitude), points.
  template <class T>
  [[nodiscard]] std::span<const T> pixels() const {
    return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
  }
  [[nodiscard]] std::span<const Point> points() const { return pixels<Point>(); }
  /// Of a register block, in the order of the port's `names`.
  [[nodiscard]] std::vector<double> values() const {
    std::uint32_t count = 0;
    if (kind != Kind::registers || info_bytes_ < 8)
      throw std::runtime_error("the sample is no register block");
    std::memcpy(&count, info_.data(), 4);
    if (info_bytes_ < 8 + count * sizeof(double)) throw std::runtime_error("a register block was cut off");
    std::vector<double> out(count);
    std::memcpy(out.data(), info_.data() + 8, count * sizeof(double));
    return out;
  }

 private:
  friend class Exchange;
  std::array<std::byte, 520> info_{};
  std::size_t info_bytes_ = 0;
};

/// A channel as the application sees it.
class Port {
 public:
  std::string name, kind, frame_id, format;
  double rate_hz = 0, latency_ms = 0;  ///< rate 0: aperiodic
  std::uint32_t width_px = 0, height_px = 0;
  std::vector<std::string> names, units;  ///< of a register block's values
  Status status = Status::never;
  std::vector<Sample> samples;  ///< since the turn before; of pictures and clouds the newest alone

  [[nodiscard]] bool fresh() const { return !samples.empty(); }
  [[nodiscard]] bool has_sample() const { return newest_.kind != Kind::none; }
  [[nodiscard]] const Sample& sample() const { return newest_; }  ///< kind none before the first

 private:
  friend class Exchange;
  Sample newest_;
};

struct Output {
  std::string name;
  double latency_ms = 0;
  std::vector<std::string> names, units;
};

/// What is known before the first turn.
struct Rig {
  std::string rig, clock;  ///< `wall` or `virtual`
  std::uint64_t seed = 0;
  double loop_rate_hz = 0, duration_s = 0;  ///< duration 0: no end
  nlohmann::json params;
  std::vector<Port> inputs;
  std::vector<Output> outputs;
};

/// One call of the application.
class Turn {
 public:
  std::uint64_t cycle = 0;  ///< of the loop
  std::int64_t t_ns = 0;    ///< bench clock

  [[nodiscard]] const Port& operator[](std::string_view name) const {
    for (const Port& p : rig_.inputs)
      if (p.name == name) return p;
    throw std::runtime_error("the rig has no input " + std::string(name));
  }
  /// Gives a command: all values of the output, in their order.
  void command(std::string_view output, std::span<const double> values) {
    for (std::uint32_t i = 0; i < rig_.outputs.size(); ++i) {
      const Output& o = rig_.outputs[i];
      if (o.name != output) continue;
      if (values.size() != o.names.size())
        throw std::runtime_error(o.name + " takes " + std::to_string(o.names.size()) + " values, not " +
                                 std::to_string(values.size()));
      const std::array<std::uint32_t, 2> head{i, static_cast<std::uint32_t>(values.size())};
      append(head.data(), sizeof head);
      append(values.data(), values.size_bytes());
      ++count_;
      return;
    }
    throw std::runtime_error("the rig has no output " + std::string(output));
  }
  void command(std::string_view output, std::initializer_list<double> values) {
    command(output, std::span(values.begin(), values.size()));
  }

 private:
  friend class Exchange;
  explicit Turn(const Rig& rig) : rig_(rig) {}
  void append(const void* data, std::size_t n) {
    const auto* b = static_cast<const char*>(data);
    commands_.insert(commands_.end(), b, b + n);
  }
  const Rig& rig_;
  std::vector<char> commands_;
  std::uint32_t count_ = 0;
};

class Application {
 public:
  virtual ~Application() = default;
  /// Turns in a second; 0: every cycle of the loop. A rig's own `rate_hz` goes before.
  [[nodiscard]] virtual double rate_hz() const { return 0; }
  virtual void start(const Rig& rig) { (void)rig; }  ///< before the first turn
  virtual void step(Turn& turn) = 0;                 ///< each turn
  virtual void finish() {}                           ///< after the last
};

/// What a program and a shared object have in common: messages in, messages out.
class Exchange {
 public:
  /// Where bytes of samples are; throws where they are not.
  using BytesAt = std::span<const std::byte> (*)(void* context, std::uint64_t place, std::uint64_t size);
  Exchange(Application& application, BytesAt bytes_at, void* context)
      : application_(application), bytes_at_(bytes_at), context_(context) {}

  /// Body of `setup` to body of `ready`.
  std::string start(std::string_view setup) {
    const auto j = nlohmann::json::parse(setup);
    j.at("rig").get_to(rig_.rig), j.at("clock").get_to(rig_.clock), j.at("seed").get_to(rig_.seed);
    j.at("loop_rate_hz").get_to(rig_.loop_rate_hz), j.at("duration_s").get_to(rig_.duration_s);
    rig_.params = j.at("params");
    for (const auto& d : j.at("inputs")) {
      Port p;
      d.at("name").get_to(p.name), d.at("kind").get_to(p.kind), d.at("frame_id").get_to(p.frame_id);
      d.at("names").get_to(p.names), d.at("units").get_to(p.units);
      d.at("width_px").get_to(p.width_px), d.at("height_px").get_to(p.height_px);
      p.format = d.value("format", ""), p.rate_hz = d.value("rate_hz", 0.0),
      p.latency_ms = d.value("latency_ms", 0.0);
      rig_.inputs.push_back(std::move(p));
    }
    for (const auto& d : j.at("outputs"))
      rig_.outputs.push_back({d.at("name"), d.value("latency_ms", 0.0), d.at("names"), d.at("units")});
    application_.start(rig_);
    const double rate_hz = application_.rate_hz();
    return rate_hz > 0 ? nlohmann::json{{"rate_hz", rate_hz}}.dump() : "{}";
  }
  /// Body of `turn` to body of `commands`, which is valid until the next.
  std::span<const char> turn(std::span<const char> body) {
    body_ = body;
    now_.cycle = take<std::uint64_t>(), now_.t_ns = take<std::int64_t>();
    const auto ports = take<std::uint32_t>(), samples = take<std::uint32_t>();
    if (ports != rig_.inputs.size()) throw std::runtime_error("the bench counts other inputs");
    for (Port& p : rig_.inputs) p.status = static_cast<Status>(take<std::uint32_t>()), p.samples.clear();
    if (ports % 2 != 0) (void)take<std::uint32_t>();
    for (std::uint32_t i = 0; i < samples; ++i) take_sample();
    now_.commands_.resize(16);
    now_.count_ = 0;
    application_.step(now_);
    std::memcpy(now_.commands_.data(), &now_.cycle, 8);
    std::memcpy(now_.commands_.data() + 8, &now_.count_, 4);
    return now_.commands_;
  }
  void finish() { application_.finish(); }

 private:
  template <class T>
  T take() {
    if (body_.size() < sizeof(T)) throw std::runtime_error("a message of the bench was cut off");
    T v;
    std::memcpy(&v, body_.data(), sizeof v);
    body_ = body_.subspan(sizeof v);
    return v;
  }
  void take_sample() {
    const auto input = take<std::uint32_t>();
    if (input >= rig_.inputs.size()) throw std::runtime_error("the bench names an input that does not exist");
    Port& port = rig_.inputs[input];
    Sample& s = port.newest_;
    s.kind = static_cast<Kind>(take<std::uint32_t>());
    s.sequence = take<std::uint64_t>(), s.t_capture_ns = take<std::int64_t>(),
    s.t_release_ns = take<std::int64_t>();
    s.t_arrival_ns = take<std::int64_t>(), s.sigma_capture_ns = take<std::int64_t>();
    s.lost_before = take<std::uint32_t>(), s.validity = take<std::uint32_t>();
    const auto place = take<std::uint64_t>(), size = take<std::uint64_t>();
    s.info_bytes_ = take<std::uint32_t>();
    (void)take<std::uint32_t>();
    const std::size_t padded = (s.info_bytes_ + 7) / 8 * 8;
    if (body_.size() < padded || padded > s.info_.size())
      throw std::runtime_error("a message of the bench was cut off");
    std::memcpy(s.info_.data(), body_.data(), padded);
    body_ = body_.subspan(padded);
    s.bytes = size > 0 ? bytes_at_(context_, place, size) : std::span<const std::byte>();
    port.samples.push_back(s);
  }

  Application& application_;
  BytesAt bytes_at_;
  void* context_;
  Rig rig_;
  Turn now_{rig_};
  std::span<const char> body_;
};

/// The connection to the bench that started this program.
class Connection {
 public:
  explicit Connection(const char* path) : socket_(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    if (std::strlen(path) >= sizeof address.sun_path) throw std::runtime_error("RIGOR_SOCKET is too long");
    std::strcpy(address.sun_path, path);
    if (socket_ < 0 || connect(socket_, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0)
      throw std::runtime_error(std::string("RIGOR_SOCKET: ") + std::strerror(errno));
  }
  Connection(const Connection&) = delete;
  ~Connection() {
    for (const auto& [map, size] : maps_) munmap(map, size);
    if (memory_ >= 0) close(memory_);
    close(socket_);
  }

  void serve(Application& application) {
    Exchange exchange(application, &Connection::bytes_at, this);
    send(hello, nlohmann::json{{"protocol", kProtocol}, {"client", "c++"}}.dump());
    try {
      if (receive() != setup) throw std::runtime_error("expected the setup from the bench");
      const std::string text(body_.begin(), body_.end());
      memory_ =
          open(nlohmann::json::parse(text).at("memory").get<std::string>().c_str(), O_RDONLY | O_CLOEXEC);
      if (memory_ < 0) throw std::runtime_error(std::string("the bench's memory: ") + std::strerror(errno));
      send(ready, exchange.start(text));
      while (receive() != finish) {
        if (type_ != turn) throw std::runtime_error("the bench sent message " + std::to_string(type_));
        send(commands, exchange.turn(body_));
      }
      exchange.finish();
      send(done, std::string_view("{}"));
    } catch (const std::exception& e) {
      const auto replace = nlohmann::json::error_handler_t::replace;
      send(failed,
           nlohmann::json{{"error", std::string(e.what()).substr(0, 32768)}}.dump(-1, ' ', false, replace));
      throw;
    }
  }

 private:
  enum Type : std::uint32_t { hello = 1, setup, ready, turn, commands, finish, done, failed };

  void read(void* to, std::size_t n) {
    for (auto* at = static_cast<char*>(to); n > 0;) {
      const ssize_t got = recv(socket_, at, n, 0);
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) throw std::runtime_error("the bench has closed the connection");
      at += got, n -= static_cast<std::size_t>(got);
    }
  }
  std::uint32_t receive() {
    std::array<std::uint32_t, 2> head;
    read(head.data(), sizeof head);
    if (head[0] > 16u << 20) throw std::runtime_error("the bench sent a message that is too long");
    body_.resize(head[0]);
    read(body_.data(), body_.size());
    return type_ = head[1];
  }
  void send(Type type, std::span<const char> body) {
    const std::array<std::uint32_t, 2> head{static_cast<std::uint32_t>(body.size()), type};
    out_.resize(sizeof head + body.size());
    std::memcpy(out_.data(), head.data(), sizeof head);
    if (!body.empty()) std::memcpy(out_.data() + sizeof head, body.data(), body.size());
    for (std::size_t sent = 0; sent < out_.size();) {
      const ssize_t k = ::send(socket_, out_.data() + sent, out_.size() - sent, MSG_NOSIGNAL);
      if (k < 0 && errno == EINTR) continue;
      if (k <= 0) throw std::runtime_error("the bench has closed the connection");
      sent += static_cast<std::size_t>(k);
    }
  }
  /// Mapped as far as it is needed; earlier maps stay, for what is shown of them.
  static std::span<const std::byte> bytes_at(void* context, std::uint64_t offset, std::uint64_t size) {
    auto& self = *static_cast<Connection*>(context);
    if (self.maps_.empty() || offset + size > self.maps_.back().second) {
      const std::size_t wanted = (offset + size + (1u << 28) - 1) >> 28 << 28;
      void* map = mmap(nullptr, wanted, PROT_READ, MAP_SHARED, self.memory_, 0);
      if (map == MAP_FAILED) throw std::runtime_error(std::string("mmap: ") + std::strerror(errno));
      self.maps_.emplace_back(map, wanted);
    }
    return {static_cast<const std::byte*>(self.maps_.back().first) + offset, size};
  }

  int socket_ = -1, memory_ = -1;
  std::vector<std::pair<void*, std::size_t>> maps_;
  std::uint32_t type_ = 0;
  std::vector<char> body_, out_;
};

/// Connects to the bench that started this program, and serves it until the run is over. For `return` of
/// main.
inline int run(Application& application) {
  const char* path = std::getenv("RIGOR_SOCKET");
  if (!path) {
    std::fputs(
        "RIGOR_SOCKET is not set: this program is started by a rig, with application: { command: [./PROGRAM] "
        "}\n",
        stderr);
    return 2;
  }
  try {
    Connection(path).serve(application);
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return 1;
  }
}

/// What a shared object offers the bench: plain C, so that the compilers and libraries of both need not be
/// the same. Each call: bytes in, bytes out; 0, or 1 with the error's text in place of the answer. `out_size`
/// is never above `capacity`. The loop's thread calls `turn`; the setup thread all others.
struct PluginEntry {
  std::uint32_t size = sizeof(PluginEntry);
  std::uint32_t protocol = kProtocol;
  void* (*create)();  ///< null: failed
  int (*start)(void* self, const char* in, std::size_t in_size, char* out, std::size_t capacity,
               std::size_t* out_size);
  int (*turn)(void* self, const char* in, std::size_t in_size, char* out, std::size_t capacity,
              std::size_t* out_size);
  int (*finish)(void* self, char* out, std::size_t capacity, std::size_t* out_size);
  void (*destroy)(void* self);
};

/// The functions of an entry for an application of type T.
template <class T>
class Plugin {
 public:
  static const PluginEntry* entry() {
    static const PluginEntry e{.create = &Plugin::create,
                               .start = &Plugin::start,
                               .turn = &Plugin::turn,
                               .finish = &Plugin::finish,
                               .destroy = &Plugin::destroy};
    return &e;
  }

 private:
  static std::span<const std::byte> bytes_at(void*, std::uint64_t place, std::uint64_t size) {
    return {reinterpret_cast<const std::byte*>(place), size};
  }
  template <class F>
  static int guarded(char* out, std::size_t capacity, std::size_t* out_size, F&& f) {
    const auto put = [&](std::span<const char> bytes) {
      *out_size = std::min(capacity, bytes.size());
      std::memcpy(out, bytes.data(), *out_size);
      return bytes.size() <= capacity;
    };
    *out_size = 0;
    try {
      if (put(f())) return 0;
      put(std::string_view("more commands in a turn than the protocol has room for"));
    } catch (const std::exception& e) {
      put(std::string_view(e.what()));
    } catch (...) {
      put(std::string_view("an exception that is no std::exception"));
    }
    return 1;
  }
  static void* create() {
    try {
      return new Plugin;
    } catch (...) {
      return nullptr;
    }
  }
  static int start(void* self, const char* in, std::size_t n, char* out, std::size_t capacity,
                   std::size_t* size) {
    std::string ready;
    return guarded(out, capacity, size, [&]() -> std::span<const char> {
      return ready = static_cast<Plugin*>(self)->exchange_.start({in, n});
    });
  }
  static int turn(void* self, const char* in, std::size_t n, char* out, std::size_t capacity,
                  std::size_t* size) {
    return guarded(out, capacity, size, [&] { return static_cast<Plugin*>(self)->exchange_.turn({in, n}); });
  }
  static int finish(void* self, char* out, std::size_t capacity, std::size_t* size) {
    return guarded(out, capacity, size, [&]() -> std::span<const char> {
      static_cast<Plugin*>(self)->exchange_.finish();
      return {};
    });
  }
  static void destroy(void* self) { delete static_cast<Plugin*>(self); }

  T application_;
  Exchange exchange_{application_, &Plugin::bytes_at, nullptr};
};

}  // namespace rigor_client

#define RIGOR_APPLICATION(Type)                                                                            \
  extern "C" __attribute__((visibility("default"))) const rigor_client::PluginEntry* rigor_application() { \
    return rigor_client::Plugin<Type>::entry();                                                            \
  }                                                                                                        \
  int main() {                                                                                             \
    Type application;                                                                                      \
    return rigor_client::run(application);                                                                 \
  }
