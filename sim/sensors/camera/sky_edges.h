// Pixels in which surfaces lie beside the sky. How much of such a pixel is sky matters more than anything
// else in a picture, since the sky is a hundred times as bright as the shade: rays that ask for nothing but
// the share of their width that is sky find it for a part of the cost of whole samples. Internal to
// sim/sensors/camera.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "sim/render/rays/light_tracer.h"
#include "sim/sensors/camera/uneven_pixels.h"

namespace rigor {

class SkyEdges {
 public:
  /// Of a picture of this size.
  void reset(int width_px, int height_px);
  /// A whole sample. Any thread, one at a time for a pixel.
  void add(PixelPlace at, const render::LightSample& sample);
  /// One of a query with `sky_only`.
  void add_sky_only(PixelPlace at, const render::LightSample& sample);
  /// Pixels of `inner` that have, with their neighbours, samples of both, and none of add_sky_only(); in the
  /// order of uneven_pixels(). What is added for them may make more of them.
  [[nodiscard]] std::vector<PixelPlace> places(const OpticsRequest::Region& inner,
                                               const std::function<bool(int u, int v)>& lit) const;
  /// What all samples of a pixel say together: its share of sky times the sky's mean, and the rest times the
  /// mean of its surfaces, or of its neighbours' where none of its own has light.
  void resolve(PixelPlace at, float radiance[4]) const;

 private:
  struct Pixel {
    float sky[4]{}, surface[4]{};  ///< sums
    float skies = 0, met = 0;      ///< samples; one that met both counts in both by its shares
    float surfaces = 0;            ///< of those that met one: whole samples
  };
  [[nodiscard]] std::size_t index(PixelPlace at) const {
    return static_cast<std::size_t>(at.v) * static_cast<std::size_t>(width_px_) +
           static_cast<std::size_t>(at.u);
  }
  Pixel& count(PixelPlace at, const render::LightSample& sample, std::uint8_t asked);
  /// f(pixel) for those about a place that have samples, itself too.
  template <class F>
  void about(PixelPlace at, F&& f) const;

  int width_px_ = 0, height_px_ = 0;
  /// What samples of a pixel met, and whether some asked for the sky only; until then its Pixel holds what
  /// was there before.
  enum : std::uint8_t { kSky = 1, kSurface = 2, kBoth = kSky | kSurface, kAsked = 4 };
  std::vector<std::uint8_t> met_;
  std::vector<Pixel> pixels_;
};

}  // namespace rigor
