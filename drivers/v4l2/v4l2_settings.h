// What a rig says of a video device, as plain values. The same keys describe the channel when it runs in
// virtual time with the emulator's model in the device's place.
//
//   backend: v4l2
//   device: /dev/video0          # or a name: of the card ("HD Webcam C525"), or of a link in /dev/v4l/by-id
//   pixel_format: Mono8          # of the samples: Mono8 Mono10 Mono12 Mono16 BayerRG8 … RGB8 YUV422_8
//                                # YCbCr420_8_YY_CbCr_Semiplanar Coord3D_C16
//   device_format: auto          # or the device's own: YUYV, MJPG, GREY …
//   width_px: 640                # without them, as the device is set
//   height_px: 480
//   controls: { brightness: 128, auto_exposure: manual_mode, exposure_time_absolute: 50 }
//   exposure_us: 5000            # where the device has no exposure_time_absolute: what it is set to
//   readout_us: 15000            # from the first row's end of exposure to the last's (rolling), or of all
//   (global) shutter: rolling             # or global memory: mmap                 # or dmabuf queue: 4 #
//   frames that the kernel can fill buffers: 8                   # samples that the channel can hold, those
//   in the application's hands included incomplete: mark             # hand on what is not whole, marked; or
//   drop silence_ms: 2000             # no frame for that long: the device is opened anew
#pragma once

#include "drivers/v4l2/frame_instant.h"
#include "sensor-hal/channel/channel.h"

namespace rigor::v4l2 {

struct Settings {
  std::string device, frame_id;
  FormatRequest format;
  ConfigNode controls;
  std::optional<Duration> exposure;
  Duration readout;
  bool global_shutter = false;
  bool dmabuf = false, drop_incomplete = false;
  std::uint32_t queue = 4;
  std::size_t buffers = 8;
  Duration silence;
};

/// Throws ConfigError. Setup context.
[[nodiscard]] Settings read_settings(const ChannelConfig& config);

/// The channel's name without the side of a pair, plus `_optical`: "left.real" → "left_optical".
[[nodiscard]] std::string default_frame_id(const std::string& channel_name);

/// A list of format names, as emulators offer them; `fallback` where the key is missing. Throws ConfigError.
[[nodiscard]] std::vector<std::uint32_t> read_codes(const ConfigNode& n, std::string_view key,
                                                    std::uint32_t fallback);

}  // namespace rigor::v4l2
