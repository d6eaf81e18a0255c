#include "drivers/aravis/camera_session.h"

#include "drivers/aravis/emulated_camera.h"

#include <fmt/format.h>
#include <linux/capability.h>
#include <pthread.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <list>
#include <mutex>
#include <string_view>
#include <thread>

#include "drivers/aravis/gige_registers.h"
#include "drivers/aravis/u3v_registers.h"
#include "rt-core/device_text.h"

#include <arv.h>

namespace rigor {
namespace {

bool may_use_packet_sockets() {
  __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
  std::array<__user_cap_data_struct, 2> data{};
  return syscall(SYS_capget, &header, data.data()) == 0 && (data[0].effective & (1u << CAP_NET_RAW)) != 0;
}

bool is_loopback(const std::string& address) { return address.rfind("127.", 0) == 0; }

GInetAddress* inet_address(const std::string& text) { return g_inet_address_new_from_string(text.c_str()); }

/// Ticks to nanoseconds as Aravis does it for frames, so that latches and frames are on one scale.
std::int64_t ticks_to_ns(std::uint64_t ticks, std::uint64_t frequency) {
  const std::uint64_t whole = ticks / frequency, rest = ticks % frequency;
  return static_cast<std::int64_t>(whole * 1'000'000'000 + rest * 1'000'000'000 / frequency);
}

/// Of Aravis' complaints, that about a stream whose thread is not there when it is destroyed is left out.
void ignore_that_there_is_no_thread() {
  static const guint handler = g_log_set_handler(
      nullptr, G_LOG_LEVEL_CRITICAL,
      [](const gchar* domain, GLogLevelFlags level, const gchar* message, gpointer) {
        if (std::string_view(message).find("priv->thread != NULL") == std::string_view::npos)
          g_log_default_handler(domain, level, message, nullptr);
      },
      nullptr);
  (void)handler;
}

#if ARAVIS_HAS_USB
ArvInterface* usb_interface() { return arv_uv_interface_get_instance(); }
std::mutex usb_mutex;

std::vector<SeenCamera> see_usb_cameras() {
  const std::lock_guard lock(usb_mutex);
  std::vector<SeenCamera> all;
  ArvInterface* usb = usb_interface();
  arv_interface_update_device_list(usb);
  const auto text = [](const char* t) { return device_text(t == nullptr ? "" : t); };
  for (unsigned i = 0; i < arv_interface_get_n_devices(usb); ++i)
    all.push_back({text(arv_interface_get_device_id(usb, i)),
                   text(arv_interface_get_device_vendor(usb, i)) + " " +
                       text(arv_interface_get_device_model(usb, i)) + ", serial " +
                       text(arv_interface_get_device_serial_nbr(usb, i)) + ", USB3 Vision",
                   text(arv_interface_get_device_address(usb, i))});
  return all;
}

ArvDevice* open_usb(const std::string& selector) {
  const std::lock_guard lock(usb_mutex);
  arv_interface_update_device_list(usb_interface());
  return arv_interface_open_device(usb_interface(), selector.c_str(), nullptr);
}
#else
std::vector<SeenCamera> see_usb_cameras() { return {}; }
ArvDevice* open_usb(const std::string&) { return nullptr; }
#endif

std::string describe(const gige::FoundCamera& c) {
  return c.identity.manufacturer + " " + c.identity.model + ", serial " + c.identity.serial +
         (c.identity.user_name.empty() ? "" : ", named " + c.identity.user_name) + ", GigE Vision";
}

tl::unexpected<Error> no_camera(const AravisSettings& s, const ChannelConfig& config) {
  std::string there;
  for (const SeenCamera& c : see_cameras(s.interface, milliseconds(300)))
    there += (there.empty() ? "" : ", ") + fmt::format("{} at {}", c.id, c.address);
  const char* key = s.address.empty() ? "device" : "address";
  const ConfigError e = config.params.error(
      key,
      fmt::format("expected a camera that is there{}, got \"{}\", which does not answer; {}",
                  s.interface.empty() ? "" : " (asked on " + s.interface + ")", s.selector(),
                  there.empty() ? "no camera answers: is it powered, connected and in this machine's subnet?"
                                : "there are: " + there));
  return fail(ErrorCode::not_found, e.error().where, e.error().message);
}

Result<std::optional<gige::FoundCamera>> find(const AravisSettings& s, const ChannelConfig& config,
                                              const std::function<bool()>& cancelled) {
  if (!s.address.empty()) {
    for (int attempt = 0; attempt < 3; ++attempt)
      if (auto c = gige::ask_gige_camera(s.address, milliseconds(150))) {
        if (!s.device.empty() && !c->answers_to(s.device)) return std::optional<gige::FoundCamera>();
        return c;
      }
    return std::optional<gige::FoundCamera>();
  }
  gige::DiscoveryOptions options;
  options.interface = s.interface;
  options.cancelled = cancelled;
  auto all = gige::find_gige_cameras(options);
  if (!all) {
    const ConfigError e = config.params.error("interface", all.error().message);
    return fail(all.error().code, e.error().where, e.error().message);
  }
  for (gige::FoundCamera& c : *all)
    if (c.answers_to(s.device)) return std::optional(std::move(c));
  return std::optional<gige::FoundCamera>();
}

}  // namespace

std::vector<SeenCamera> see_cameras(const std::string& interface, Duration wait) {
  std::vector<SeenCamera> all;
  gige::DiscoveryOptions options;
  options.interface = interface;
  options.wait = wait;
  if (auto gige_cameras = gige::find_gige_cameras(options))
    for (const gige::FoundCamera& c : *gige_cameras) all.push_back({c.id(), describe(c), c.address});
  for (SeenCamera& c : see_usb_cameras()) all.push_back(std::move(c));
  return all;
}

Result<std::unique_ptr<CameraSession>> CameraSession::open(const AravisSettings& s,
                                                           const ChannelConfig& config,
                                                           const std::function<bool()>& cancelled) {
  auto found = find(s, config, cancelled);
  if (!found) return tl::unexpected<Error>(found.error());
  std::unique_ptr<CameraSession> session(new CameraSession());
  session->format_ = s.format;
  session->part_ = s.part;
  session->range_ = s.range;
  session->realtime_priority_ = s.realtime_priority;
  GLibError e;
  ArvDevice* device = nullptr;
  if (*found) {
    const gige::FoundCamera& c = **found;
    session->address_ = c.address;
    GInetAddress* local = inet_address(c.local_address);
    GInetAddress* remote = inet_address(c.address);
    if (local != nullptr && remote != nullptr) device = arv_gv_device_new(local, remote, e.out());
    g_clear_object(&local);
    g_clear_object(&remote);
    if (e) {
      g_clear_object(&device);
      return e.as_error(config.name, "opening " + c.id() + " at " + c.address);
    }
    if (device != nullptr && arv_gv_device_is_controller(ARV_GV_DEVICE(device)) == FALSE) {
      g_clear_object(&device);
      return fail(
          ErrorCode::unavailable, config.name,
          fmt::format("the camera {} at {} is held by another client: end that one, or wait for some seconds "
                      "if it was killed",
                      c.id(), c.address));
    }
  } else if (s.address.empty()) {
    device = open_usb(s.device);
  }
  if (device == nullptr) return no_camera(s, config);
  session->camera_ = arv_camera_new_with_device(device, e.out());
  g_object_unref(device);  // the camera has its own reference
  if (e || session->camera_ == nullptr) return e.as_error(config.name, "opening the camera");
  device = arv_camera_get_device(session->camera_);
  session->lost_handler_ = g_signal_connect(
      device, "control-lost", G_CALLBACK(+[](ArvDevice*, gpointer self) {
        static_cast<CameraSession*>(self)->control_lost_.store(true, std::memory_order_relaxed);
      }),
      session.get());

  auto facts = apply_settings(session->camera_, s, config);
  if (!facts) return tl::unexpected<Error>(facts.error());
  session->facts_ = std::move(*facts);
  if (session->facts_.chunks) session->chunk_parser_ = arv_camera_create_chunk_parser(session->camera_);
  if (*found) {
    session->facts_.id = (*found)->id();
    session->tick_frequency_ = arv_gv_device_get_timestamp_tick_frequency(ARV_GV_DEVICE(device), e.out());
    if (e) session->tick_frequency_ = 0;
    // Some devices take the latch command and do nothing: two latches must differ by about the time between
    // them.
    if (session->tick_frequency_ != 0) {
      const auto first = session->latch();
      usleep(2000);
      const auto second = first ? session->latch() : first;
      if (second) {
        const double device_s = (second->device - first->device).seconds();
        const double most_s = (second->after - first->before).seconds(),
                     minimum_s = (second->before - first->after).seconds();
        session->can_latch_ = device_s > 0.9 * minimum_s && device_s < 1.1 * most_s;
      }
    }
  }
  if (auto status = session->open_stream(s, config.name); !status)
    return tl::unexpected<Error>(status.error());
  return session;
}

Status CameraSession::open_stream(const AravisSettings& s, const std::string& name) {
  GLibError e;
  const bool gige_camera = arv_camera_is_gv_device(camera_) != FALSE;
  if (gige_camera) {
    // On loopback a packet socket sees each datagram twice and gains nothing.
    const bool packet_socket = s.packet_socket_allowed && !is_loopback(address_) && may_use_packet_sockets();
    arv_camera_gv_set_stream_options(
        camera_, packet_socket ? ARV_GV_STREAM_OPTION_NONE : ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
  }
  const auto callback = [](void* self, ArvStreamCallbackType type, ArvBuffer*) {
    if (type != ARV_STREAM_CALLBACK_TYPE_INIT) return;
    pthread_setname_np(pthread_self(), "aravis-receive");
    const int priority = static_cast<CameraSession*>(self)->realtime_priority_;
    if (priority <= 0) return;
    sched_param p{};
    p.sched_priority = priority;
    (void)pthread_setschedparam(pthread_self(), SCHED_FIFO, &p);  // not allowed: runs as any other thread
  };
  if (arv_camera_is_uv_device(camera_) != FALSE) {
    // Aravis 0.8.26 divides by what it read from the camera, without asking whether the read succeeded.
    guint64 technology_registers = 0;
    arv_device_read_memory(arv_camera_get_device(camera_), u3v::reg::kSbrmAddress,
                           sizeof technology_registers, &technology_registers, e.out());
    if (e) return e.as_error(name, "reading where the camera's USB3 Vision registers are");
  }
  stream_ = arv_camera_create_stream(camera_, callback, this, e.out());
  if (stream_ == nullptr) return e.as_error(name, "opening the camera's stream");
  receiving_ = true;
  if (gige_camera) {
    const auto us = [](Duration d) { return static_cast<guint>(std::max<std::int64_t>(1, d.ns() / 1000)); };
    g_object_set(stream_, "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED, "socket-buffer-size",
                 static_cast<gint>(s.socket_buffer_bytes), "packet-resend",
                 s.resend ? ARV_GV_STREAM_PACKET_RESEND_ALWAYS : ARV_GV_STREAM_PACKET_RESEND_NEVER,
                 "packet-request-ratio", 2.0, "initial-packet-timeout", us(s.first_resend_after),
                 "packet-timeout", us(s.packet_timeout), "frame-retention", us(s.frame_retention), nullptr);
  }
  return {};
}

CameraSession::~CameraSession() {
  close_stream();
  g_clear_object(&stream_);  // tells the camera, which takes seconds where it is dead
  for (ArvBuffer* b : buffers_) g_object_unref(b);
  g_clear_object(&chunk_parser_);
  if (camera_ == nullptr) return;
  if (lost_handler_ != 0) g_signal_handler_disconnect(arv_camera_get_device(camera_), lost_handler_);
  if (started_ && !dead_) arv_camera_stop_acquisition(camera_, nullptr);
  g_object_unref(camera_);
}

void CameraSession::close_stream() {
  if (stream_ == nullptr || !receiving_) return;
  receiving_ = false;
  arv_stream_stop_thread(stream_, TRUE);
  // Aravis 0.8.26 ends its thread once more when the stream is destroyed, and complains where there is none.
  // So there is one, without a buffer that it could write to. Not of a USB camera: starting it divides by
  // what was read from the camera, which is anything where the camera has gone.
  if (arv_camera_is_uv_device(camera_) != FALSE)
    ignore_that_there_is_no_thread();
  else
    arv_stream_start_thread(stream_);
}

Result<LatchPair> CameraSession::latch() {
  ArvDevice* device = arv_camera_get_device(camera_);
  GLibError e;
  LatchPair p;
  guint32 high = 0, low = 0;
  p.before = bench_now();
  arv_device_write_register(device, gige::reg::kTimestampControl, gige::reg::kTimestampLatch, e.out());
  p.after = bench_now();
  if (!e) arv_device_read_register(device, gige::reg::kTimestampHigh, &high, e.out());
  if (!e) arv_device_read_register(device, gige::reg::kTimestampLow, &low, e.out());
  if (e) return e.as_error(facts_.id, "latching the timestamp");
  p.device = DeviceTime(ticks_to_ns((std::uint64_t{high} << 32) | low, tick_frequency_));
  return p;
}

std::uint64_t CameraSession::ticks(DeviceTime t) const {
  const auto ns = static_cast<std::uint64_t>(std::max<std::int64_t>(t.ns(), 0));
  const std::uint64_t whole = ns / 1'000'000'000, rest = ns % 1'000'000'000;
  return whole * tick_frequency_ + rest * tick_frequency_ / 1'000'000'000;
}

Result<PtpState> CameraSession::ptp() {
  struct Names {
    const char *enable, *latch, *status, *offset;
  };
  // Those of SFNC 2.3 and later, and those before.
  constexpr std::array<Names, 2> kNames{
      {{"PtpEnable", "PtpDataSetLatch", "PtpStatus", "PtpOffsetFromMaster"},
       {"GevIEEE1588", "GevIEEE1588DataSetLatch", "GevIEEE1588Status", "GevIEEE1588OffsetFromMaster"}}};
  for (const Names& n : kNames) {
    if (arv_camera_is_feature_available(camera_, n.enable, nullptr) == FALSE) continue;
    GLibError e;
    PtpState p;
    if (arv_camera_is_feature_available(camera_, n.latch, nullptr) != FALSE)
      arv_camera_execute_command(camera_, n.latch, e.out());
    if (!e)
      if (const char* status = arv_camera_get_string(camera_, n.status, e.out()); status != nullptr)
        p.status = status;
    if (!e) p.offset = Duration(arv_camera_get_integer(camera_, n.offset, e.out()));
    if (e) return e.as_error(facts_.id, "asking for the PTP clock");
    return p;
  }
  return fail(ErrorCode::not_found, facts_.id, "the camera has no PTP clock");
}

Status CameraSession::start() {
  GLibError e;
  arv_camera_start_acquisition(camera_, e.out());
  if (e) return e.as_error(facts_.id, "starting the acquisition");
  started_ = true;
  return {};
}

Status CameraSession::trigger() {
  GLibError e;
  arv_camera_software_trigger(camera_, e.out());
  if (e) return e.as_error(facts_.id, "software trigger");
  return {};
}

bool CameraSession::alive(Duration wait) const {
  if (address_.empty()) return !control_lost();
  return gige::ask_gige_camera(address_, wait / 2) || gige::ask_gige_camera(address_, wait / 2);
}

bool CameraSession::in_control() const {
  if (control_lost()) return false;
  if (address_.empty()) return true;
  GLibError e;
  guint32 privilege = 0;
  arv_device_read_register(arv_camera_get_device(camera_), gige::reg::kControlPrivilege, &privilege, e.out());
  return !e && (privilege & (gige::reg::kPrivilegeControl | gige::reg::kPrivilegeExclusive)) != 0;
}

StreamCounters CameraSession::stream_counters() const {
  StreamCounters c;
  guint64 completed = 0, failures = 0, underruns = 0;
  arv_stream_get_statistics(stream_, &completed, &failures, &underruns);
  c.underruns = underruns;
  if (address_.empty()) return c;  // USB carries every packet, or says that it does not: there are no resends
  c.resent_packets = arv_stream_get_info_uint64_by_name(stream_, "n_resent_packets");
  c.resend_requests = arv_stream_get_info_uint64_by_name(stream_, "n_resend_requests");
  return c;
}

void CameraSession::set_slots(const std::vector<std::byte*>& memory) {
  for (std::size_t i = 0; i < memory.size(); ++i)
    buffers_.push_back(arv_buffer_new_full(facts_.payload_bytes, memory[i],
                                           reinterpret_cast<void*>(static_cast<std::uintptr_t>(i)), nullptr));
}

void CameraSession::queue(std::size_t slot) {
  ArvBuffer* b = buffers_[slot];
  arv_buffer_set_timestamp(b, 0);  // stays 0 where the leader gets lost
  g_object_ref(b);                 // the stream takes one
  arv_stream_push_buffer(stream_, b);
}

void CameraSession::read_chunks(ArvBuffer* b, ReceivedFrame& f) {
  if (chunk_parser_ == nullptr || arv_buffer_has_chunks(b) == FALSE) return;
  GLibError e;
  // What the leader says is the same instant as a rule; a camera that sends both means the chunk.
  const gint64 ticks = arv_chunk_parser_get_integer_value(chunk_parser_, b, "ChunkTimestamp", e.out());
  if (!e && ticks > 0 && tick_frequency_ != 0)
    f.timestamp = DeviceTime(ticks_to_ns(static_cast<std::uint64_t>(ticks), tick_frequency_));
  const double exposure_us = arv_chunk_parser_get_float_value(chunk_parser_, b, "ChunkExposureTime", e.out());
  if (!e && exposure_us > 0 && exposure_us < 1e9) f.exposure = seconds_from(exposure_us * 1e-6);
  const double gain_db = arv_chunk_parser_get_float_value(chunk_parser_, b, "ChunkGain", e.out());
  if (!e && gain_db > -1000 && gain_db < 1000) f.gain_db = gain_db;
}

/// Where the pictures that are wanted lie in a frame of several parts.
void CameraSession::read_parts(ArvBuffer* b, ReceivedFrame& f) {
  if (f.state == ReceivedFrame::State::complete) {
    layout_.clear();
    const auto* begin = static_cast<const char*>(arv_buffer_get_data(b, nullptr));
    const guint n =
        arv_buffer_get_payload_type(b) == ARV_BUFFER_PAYLOAD_TYPE_MULTIPART ? arv_buffer_get_n_parts(b) : 0;
    for (guint i = 0; i < n; ++i) {
      FramePart p;
      size_t bytes = 0;
      const auto* data = static_cast<const char*>(arv_buffer_get_part_data(b, i, &bytes));
      if (data == nullptr || data < begin) continue;
      p.offset = static_cast<std::size_t>(data - begin), p.bytes = bytes;
      p.pfnc = arv_buffer_get_part_pixel_format(b, i);
      p.component = arv_buffer_get_part_component_id(b, i);
      p.data_type = static_cast<std::uint32_t>(arv_buffer_get_part_data_type(b, i));
      gint x = 0, y = 0, width = 0, height = 0;
      arv_buffer_get_part_region(b, i, &x, &y, &width, &height);
      p.region = {static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y),
                  static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height)};
      layout_.push_back(p);
    }
  }
  const auto fits = [&](const FramePart& p) {
    const std::uint64_t bytes =
        std::uint64_t{facts_.width_px} * facts_.height_px * ((p.pfnc >> 16) & 0xFF) / 8;
    return p.region.width_px == facts_.width_px && p.region.height_px == facts_.height_px &&
           p.bytes >= bytes && p.offset + p.bytes <= facts_.payload_bytes;
  };
  constexpr auto kC16 = static_cast<std::uint32_t>(gige::PixelFormat::coord3d_c16);
  const auto is_range = [](const FramePart& p) {
    return p.component == gige::kRange || p.data_type == gige::kPart3d || p.pfnc == kC16;
  };
  const auto wanted = [&](const FramePart& p, std::size_t i) {
    if (range_ || part_ == "Range") return is_range(p);
    if (part_.find_first_not_of("0123456789") == std::string::npos) return part_ == std::to_string(i);
    constexpr std::array<const char*, 9> kNames{"Intensity", "Infrared",    "Ultraviolet",
                                                "Range",     "Reflectance", "Confidence",
                                                "Scatter",   "Disparity",   "Multispectral"};
    const auto at = std::find(kNames.begin(), kNames.end(), part_) - kNames.begin() + 1;
    if (p.component != 0) return p.component == static_cast<std::uint32_t>(at);
    return part_ == "Confidence" ? p.data_type == gige::kPartConfidence : p.data_type == gige::kPart2d;
  };
  std::string seen;
  for (std::size_t i = 0; i < layout_.size(); ++i) {
    const FramePart& p = layout_[i];
    seen += fmt::format("{}component {}, {}x{} of format 0x{:08X}", i == 0 ? "" : "; ", p.component,
                        p.region.width_px, p.region.height_px, p.pfnc);
    if (!fits(p)) continue;
    const auto bits = (p.pfnc >> 16) & 0xFF;
    const bool grey = (p.pfnc >> 24) == 1 && (bits == 8 || bits == 16);
    if (!f.picture && wanted(p, i) && p.pfnc == static_cast<std::uint32_t>(to_gige(format_)))
      f.picture = p;
    else if (range_ && !f.amplitude && grey && !is_range(p))
      f.amplitude = p;
  }
  f.as_expected = f.picture.has_value();
  if (!f.as_expected)
    f.strange = fmt::format("expected {} of {}x{} {} in each frame, got {}",
                            range_ ? "a range part" : "the part " + part_, facts_.width_px, facts_.height_px,
                            pfnc_name(format_), seen.empty() ? "no parts" : seen);
}

std::optional<ReceivedFrame> CameraSession::wait_frame(Duration wait) {
  ArvBuffer* b = arv_stream_timeout_pop_buffer(stream_, static_cast<guint64>(wait.ns() / 1000));
  if (b == nullptr) return std::nullopt;
  ReceivedFrame f;
  f.slot = static_cast<std::size_t>(reinterpret_cast<std::uintptr_t>(arv_buffer_get_user_data(b)));
  f.block_id = arv_buffer_get_frame_id(b);
  switch (arv_buffer_get_status(b)) {
    case ARV_BUFFER_STATUS_SUCCESS:
      f.state = ReceivedFrame::State::complete;
      break;
    case ARV_BUFFER_STATUS_TIMEOUT:
    case ARV_BUFFER_STATUS_MISSING_PACKETS:
    case ARV_BUFFER_STATUS_FILLING:
      f.state = ReceivedFrame::State::incomplete;
      break;
    case ARV_BUFFER_STATUS_ABORTED:
    case ARV_BUFFER_STATUS_CLEARED:
      f.state = ReceivedFrame::State::aborted;
      break;
    default:
      f.state = ReceivedFrame::State::unusable;
      break;
  }
  if (const guint64 ns = arv_buffer_get_timestamp(b); ns != 0)
    f.timestamp = DeviceTime(static_cast<std::int64_t>(ns));
  if (facts_.multipart) {
    if (f.state == ReceivedFrame::State::complete || f.state == ReceivedFrame::State::incomplete)
      read_parts(b, f);
  } else if (f.state == ReceivedFrame::State::complete) {
    gint x = 0, y = 0, width = 0, height = 0;
    arv_buffer_get_image_region(b, &x, &y, &width, &height);
    const auto same = [](gint is, std::uint32_t set) {
      return is >= 0 && static_cast<std::uint32_t>(is) == set;
    };
    f.as_expected = arv_buffer_get_payload_type(b) == ARV_BUFFER_PAYLOAD_TYPE_IMAGE &&
                    same(x, facts_.offset_x_px) && same(y, facts_.offset_y_px) &&
                    same(width, facts_.width_px) && same(height, facts_.height_px) &&
                    ((arv_buffer_get_image_pixel_format(b) >> 16) & 0xFF) == bits_per_pixel(format_);
    read_chunks(b, f);
  }
  g_object_unref(b);
  return f;
}

void retire(std::unique_ptr<CameraSession> session, bool dead) {
  if (!session) return;
  session->close_stream();
  session->dead_ = dead;
  if (!dead) return;  // destroyed on return
  struct Farewell {
    std::atomic<bool> done{false};
    std::jthread
        thread;  // joined at the end of the process, or when the next one begins and this one is done
  };
  static std::mutex mutex;
  static std::list<Farewell> farewells;
  const std::lock_guard lock(mutex);
  farewells.remove_if([](const Farewell& f) { return f.done.load(std::memory_order_acquire); });
  Farewell& f = farewells.emplace_back();
  f.thread = std::jthread([&f, s = std::move(session)]() mutable {
    s.reset();
    f.done.store(true, std::memory_order_release);
  });
}

}  // namespace rigor
