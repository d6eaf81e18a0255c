// The settings of a rig on a camera: through Aravis' camera calls, which know the names that devices give to
// one and the same feature (ExposureTime, ExposureTimeAbs, …). What the camera refuses comes back as an error
// at the setting's place in the file, with what the camera offers.
//
// Internal to this driver: Aravis' types are only named here.
#pragma once

#include <string>

#include "drivers/aravis/aravis_settings.h"
#include "drivers/aravis/range_parts.h"
#include "rt-core/result.h"

typedef struct _ArvCamera ArvCamera;
typedef struct _GError GError;

namespace rigor {

/// Takes a GLib error out of a call: `GLibError e; arv_…(camera, e.out()); if (e) return e.as_error(…);`
class GLibError {
 public:
  GLibError() = default;
  GLibError(const GLibError&) = delete;
  GLibError& operator=(const GLibError&) = delete;
  ~GLibError() { clear(); }
  [[nodiscard]] GError** out() {
    clear();
    return &error_;
  }
  [[nodiscard]] explicit operator bool() const { return error_ != nullptr; }
  [[nodiscard]] std::string text() const;
  /// timeout, unavailable (another client has control) or protocol, by what GLib says.
  [[nodiscard]] tl::unexpected<Error> as_error(std::string where, std::string what) const;
  void clear();

 private:
  GError* error_ = nullptr;
};

/// What the camera is really set to.
struct CameraFacts {
  std::string id;
  std::uint32_t width_px = 0, height_px = 0, offset_x_px = 0, offset_y_px = 0;
  Duration exposure;
  double gain_db = 0;
  std::size_t payload_bytes = 0;  ///< the picture and its chunks, or all parts
  std::size_t picture_bytes = 0;  ///< of the sample that becomes of it
  bool multipart = false;         ///< frames come in parts
  RangeScale scale;               ///< of a range image
  bool chunks = false;
  std::uint32_t packet_size = 0;  ///< 0: no GigE camera
};

/// Sets everything and reads it back. `config` gives the places for complaints and the period. Blocks on the
/// camera.
[[nodiscard]] Result<CameraFacts> apply_settings(ArvCamera* camera, const AravisSettings& settings,
                                                 const ChannelConfig& config);

}  // namespace rigor
