// A raster of a file, asked for its value at places on the ellipsoid.
//
// Pixels are read tile by tile when first asked for. A raster that is much finer than what is made of it is
// averaged first (land cover: the most frequent value), so that what comes out does not alias.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "sim/gis/frame.h"
#include "sim/gis/gdal_support.h"

namespace rigor::gis {

class Raster {
 public:
  enum class Use : std::uint8_t { elevation, imagery, land_cover };

  /// `file` is local; `source` gives reference system, heights_above_geoid. Errors: not_found, bad_input
  /// (no place, no reference system, too many bits in a picture …), unavailable (no geoid).
  [[nodiscard]] static Result<std::unique_ptr<Raster>> open(const std::string& file,
                                                            const ImportSource& source, Use use);

  [[nodiscard]] const std::string& file() const noexcept { return file_; }
  [[nodiscard]] Use use() const noexcept { return use_; }
  [[nodiscard]] GeoPoint centre() const noexcept { return centre_; }
  /// Side of a pixel on the ground at the centre: the shorter one.
  [[nodiscard]] double pixel_m() const noexcept { return pixel_m_; }
  /// Places along the border.
  [[nodiscard]] const std::vector<GeoPoint>& border() const noexcept { return border_; }
  /// Names of values that the file itself gives, by value; mostly empty.
  [[nodiscard]] const std::vector<std::string>& categories() const noexcept { return categories_; }
  [[nodiscard]] const std::vector<std::string>& warnings() const noexcept { return warnings_; }

  /// Averages `factor` × `factor` pixels to one. Before the first Probe.
  void reduce(int factor);
  /// What went wrong while reading, if anything: bad_input. After the probes.
  [[nodiscard]] Status status() const;

  /// The way of one thread from places to values.
  class Probe {
   public:
    explicit Probe(Raster& raster);
    /// Elevation: height above the ellipsoid, bilinear; where some of the four neighbours are missing, of
    /// those that are there while the nearest is. NaN: no data. Spans of one length.
    void heights(std::span<const double> latitude_deg, std::span<const double> longitude_deg,
                 std::span<double> out, bool whole);
    /// Imagery: bilinear, r g b of each; land cover: the value of the pixel. NaN: no data.
    void values(std::span<const double> latitude_deg, std::span<const double> longitude_deg,
                std::span<float> out);

   private:
    void to_pixels(std::span<const double> latitude_deg, std::span<const double> longitude_deg);
    Raster& r_;
    TransformationPtr to_raster_, geoid_;
    std::vector<double> x_, y_, z_;
    std::vector<int> ok_;
  };

 private:
  static constexpr int kTile = 128;  // pixels after reduction
  Raster() = default;
  [[nodiscard]] Status set_up_bands(const ImportSource& source);
  [[nodiscard]] Status set_up_place(const ImportSource& source);
  [[nodiscard]] const float* tile(std::int64_t column, std::int64_t row);
  [[nodiscard]] const float* load(std::size_t index);
  void read_strip(int x, int y, int width, int height, std::vector<float>& pixels);
  /// The pixel's channels, or null outside.
  [[nodiscard]] const float* pixel(std::int64_t column, std::int64_t row);
  void bilinear(double column, double row, int channels, bool whole, float* out);

  std::string file_;
  Use use_ = Use::elevation;
  DatasetPtr dataset_;
  int channels_ = 1, factor_ = 1;
  std::int64_t columns_ = 0, rows_ = 0;  // after reduction
  std::int64_t tiles_across_ = 0;
  std::array<double, 6> from_crs_{};  // reference system to pixels
  double wrap_ = 0;                   // a full turn in the reference system's unit; 0: not geographic
  double wrap_centre_ = 0;
  bool around_ = false;  // the columns go all around the earth
  bool same_as_wgs84_ = false, above_geoid_ = false;
  double unit_m_ = 1;
  TransformationPtr to_raster_, geoid_;
  GeoPoint centre_;
  double pixel_m_ = 1;
  std::vector<GeoPoint> border_;
  std::vector<std::string> categories_, warnings_;

  std::vector<std::unique_ptr<float[]>> tiles_;
  std::unique_ptr<std::atomic<const float*>[]> ready_;
  mutable std::mutex reading_;
  Status status_;
};

}  // namespace rigor::gis
