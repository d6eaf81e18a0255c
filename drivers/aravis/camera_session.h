// One connection to a camera: from opening it to its loss. A new connection is a new session.
//
//   auto s = CameraSession::open(settings, config, cancelled);   // found, in our hands, set
//   s->queue(buffer) …  s->start()
//   while (auto f = s->wait_frame(milliseconds(50))) …           // frame thread
//   s->latch(), s->trigger(), s->alive()                         // control thread
//   retire(std::move(s), dead);
//
// Calls to a camera that is gone wait for several seconds inside Aravis; so whoever suspects that asks
// alive() first, which takes a tenth of a second, and hands a dead session to retire(), which lets go of it
// in the background.
//
// Internal to this driver.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "drivers/aravis/aravis_features.h"
#include "drivers/aravis/gige_discovery.h"

typedef struct _ArvStream ArvStream;
typedef struct _ArvBuffer ArvBuffer;
typedef struct _ArvChunkParser ArvChunkParser;

namespace rigor {

/// A device timestamp that was taken at some instant within [before, after].
struct LatchPair {
  DeviceTime device;
  BenchTime before, after;
};

/// A picture within a frame's payload.
struct FramePart {
  std::size_t offset = 0, bytes = 0;
  std::uint32_t pfnc = 0;       ///< pixel format
  std::uint32_t component = 0;  ///< of the SFNC; 0: not said
  std::uint32_t data_type = 0;
  gige::Region region;
};

struct ReceivedFrame {
  enum class State : std::uint8_t { complete, incomplete, unusable, aborted } state = State::aborted;
  std::size_t slot = 0;
  std::uint64_t block_id = 0;
  std::optional<DeviceTime> timestamp;  ///< empty where the frame's leader never came
  bool as_expected = true;              ///< geometry and format are those that were set
  std::optional<Duration> exposure;     ///< of this picture, where its chunks say so
  std::optional<double> gain_db;
  /// Of frames that are made of parts: the picture or the range; and the amplitude of a range image.
  std::optional<FramePart> picture, amplitude;
  std::string strange;  ///< what is not as expected
};

/// How far a camera's clock is from its PTP master.
struct PtpState {
  std::string status;  ///< Slave, Master, Listening, …
  Duration offset;     ///< from the master
};

struct StreamCounters {
  std::uint64_t underruns = 0, resent_packets = 0, resend_requests = 0;
};

class CameraSession {
 public:
  /// `camera` empty: found by its selector. not_found names those that are there. Blocks up to some seconds.
  [[nodiscard]] static Result<std::unique_ptr<CameraSession>> open(const AravisSettings& settings,
                                                                   const ChannelConfig& config,
                                                                   const std::function<bool()>& cancelled);
  CameraSession(const CameraSession&) = delete;
  CameraSession& operator=(const CameraSession&) = delete;
  ~CameraSession();

  [[nodiscard]] const CameraFacts& facts() const { return facts_; }
  /// GigE cameras with a timestamp counter that can be latched.
  [[nodiscard]] bool can_latch() const { return can_latch_; }
  [[nodiscard]] Result<LatchPair> latch();
  /// What the camera's counter shows at `t` of its clock.
  [[nodiscard]] std::uint64_t ticks(DeviceTime t) const;
  /// Of a GigE camera.
  [[nodiscard]] const std::string& address() const { return address_; }
  /// Of a camera whose settings say `ptp`.
  [[nodiscard]] Result<PtpState> ptp();
  [[nodiscard]] Status start();
  [[nodiscard]] Status trigger();
  /// Whether anything answers at the camera's address; about `wait` at most.
  [[nodiscard]] bool alive(Duration wait) const;
  /// Whether the camera still takes us for its controller. Ask only an alive one.
  [[nodiscard]] bool in_control() const;
  /// Aravis' own heartbeat found that control is gone.
  [[nodiscard]] bool control_lost() const { return control_lost_.load(std::memory_order_relaxed); }
  [[nodiscard]] StreamCounters stream_counters() const;

  /// Memory that frames may be written to, by slot. Before queue(); it stays the caller's.
  void set_slots(const std::vector<std::byte*>& memory);
  /// Hands a slot to the receiver. Frame thread, or setup before start().
  void queue(std::size_t slot);
  /// The next frame in the order of arrival; empty after `wait`. Frame thread.
  [[nodiscard]] std::optional<ReceivedFrame> wait_frame(Duration wait);
  /// Ends reception: from here on nobody writes to the slots. The frame thread is gone by then.
  void close_stream();

 private:
  friend void retire(std::unique_ptr<CameraSession> session, bool dead);
  CameraSession() = default;
  [[nodiscard]] Status open_stream(const AravisSettings& settings, const std::string& name);

  ArvCamera* camera_ = nullptr;
  ArvStream* stream_ = nullptr;
  unsigned long lost_handler_ = 0;
  std::string address_;  // of a GigE camera
  std::uint64_t tick_frequency_ = 0;
  bool can_latch_ = false, receiving_ = false, started_ = false, dead_ = false;
  std::atomic<bool> control_lost_{false};
  CameraFacts facts_;
  PixelFormat format_ = PixelFormat::mono8;
  std::vector<ArvBuffer*> buffers_;
  ArvChunkParser* chunk_parser_ = nullptr;
  void read_chunks(ArvBuffer* buffer, ReceivedFrame& frame);
  void read_parts(ArvBuffer* buffer, ReceivedFrame& frame);
  std::vector<FramePart> layout_;  ///< of the last whole frame
  std::string part_;
  bool range_ = false;
  int realtime_priority_ = 0;
};

/// Lets go of a session: at once where the camera is there, in the background where it is dead (the process
/// waits for that at its end, some seconds at most).
void retire(std::unique_ptr<CameraSession> session, bool dead);

/// Cameras of every kind that this machine sees: GigE Vision by gige_discovery.h, USB3 Vision through Aravis.
struct SeenCamera {
  std::string id, description, address;
};
[[nodiscard]] std::vector<SeenCamera> see_cameras(const std::string& interface, Duration wait);

}  // namespace rigor
