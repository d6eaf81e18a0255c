#include "sensor-hal/channel/pair_watch/image_change.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

namespace rigor::pair_watch {
namespace {

constexpr std::size_t kGlobals = 6;  // gain, offset, focal length, three turns
constexpr std::size_t kMostTiles = 24;
constexpr std::size_t kMaxPixels = std::size_t{1} << 19, kNoisePlaces = std::size_t{1} << 14;

struct Bytes {
  const std::byte* data;
  std::size_t width, stride, offset;
  std::int32_t operator()(std::size_t x, std::size_t y) const noexcept {
    return static_cast<std::int32_t>(data[(y * width + x) * stride + offset]);
  }
};
struct Words {
  const std::byte* data;
  std::size_t width;
  std::int32_t operator()(std::size_t x, std::size_t y) const noexcept {
    std::uint16_t v;
    std::memcpy(&v, data + 2 * (y * width + x), 2);
    return v;
  }
};
struct Packed12 {
  const std::byte* data;
  std::size_t width;
  std::int32_t operator()(std::size_t x, std::size_t y) const noexcept {
    const std::size_t i = y * width + x;
    const std::byte* at = data + i * 12 / 8;
    const auto low = static_cast<unsigned>(at[0]), high = static_cast<unsigned>(at[1]);
    return static_cast<std::int32_t>(i % 2 == 0 ? (low | (high & 0x0f) << 8) : (low >> 4 | high << 4));
  }
};

/// Where a ray falls in a camera that is turned by a small rotation vector.
std::optional<PixelPosition> seen_by_turned(const CameraModel& camera, const OpticalRay& d, double rx,
                                            double ry, double rz) {
  return project_ray(camera,
                     {d.x - (ry * d.z - rz * d.y), d.y - (rz * d.x - rx * d.z), d.z - (rx * d.y - ry * d.x)});
}

}  // namespace

Result<ImageChange> ImageChange::make(const CameraModel& camera, const ImageInfo& shape,
                                      const ImageChangeOptions& options) {
  const auto bad = [](const char* where, std::string message) {
    return fail(ErrorCode::bad_input, where, std::move(message));
  };
  if (is_depth(shape.format)) return bad("format", "expected a format of light, got one of depth");
  if (options.tiles_across < 1 || options.tiles_down < 1 ||
      static_cast<std::size_t>(options.tiles_across) * static_cast<std::size_t>(options.tiles_down) >
          kMostTiles)
    return bad("tiles", "expected 1 to 24 tiles, got " + std::to_string(options.tiles_across) + "x" +
                            std::to_string(options.tiles_down));
  if (options.cells < 64 || options.cells > 65536)
    return bad("cells", "expected 64 to 65536, got " + std::to_string(options.cells));
  if (!(options.misfit_px >= 0)) return bad("misfit_px", "expected 0 or more");
  if (static_cast<int>(shape.offset_x_px + shape.width_px) > camera.width_px ||
      static_cast<int>(shape.offset_y_px + shape.height_px) > camera.height_px)
    return bad("shape", "expected a region within the sensor's " + std::to_string(camera.width_px) + "x" +
                            std::to_string(camera.height_px) + " pixels");
  ImageChange change(camera, shape, options);
  if (change.across_ < 8 || change.down_ < 8)
    return bad("shape", "expected a picture of at least 8x8 cells, got " + std::to_string(shape.width_px) +
                            "x" + std::to_string(shape.height_px) + " pixels");
  return change;
}

ImageChange::ImageChange(const CameraModel& camera, const ImageInfo& shape, const ImageChangeOptions& options)
    : shape_(shape), options_(options), noise_(camera.noise) {
  const std::size_t width = shape.width_px, height = shape.height_px;
  pitch_ = is_bayer(shape.format) ? 2 : 1;
  const double wanted = std::sqrt(static_cast<double>(width * height) / static_cast<double>(options.cells));
  side_ = pitch_ *
          static_cast<std::size_t>(std::max(1.0, std::ceil(wanted / static_cast<double>(pitch_) - 0.01)));
  across_ = width / side_, down_ = height / side_;
  row_step_ =
      std::max<std::size_t>(1, std::min(side_ / pitch_, (width * height + kMaxPixels - 1) / kMaxPixels));
  // Three pixels apart, the operator's places share no pixel.
  noise_step_ = 3 * pitch_;
  while ((width / noise_step_) * (height / noise_step_) > kNoisePlaces) noise_step_ += pitch_;

  scale_ = std::ldexp(1.0, significant_bits(shape.format) - camera.noise.adc_bits);
  max_ = std::ldexp(1.0, significant_bits(shape.format)) - 1;
  base_gain_ = gain_ = camera.system_gain_dn_per_e();
  black_ = camera.processing.subtract_black ? 0 : camera.noise.black_level_dn * scale_;

  flow_.resize(across_ * down_);
  has_flow_.resize(across_ * down_);
  cells_.resize(across_ * down_);
  rows_.reserve(across_ * down_);
  const auto tiles = static_cast<std::size_t>(options.tiles_across * options.tiles_down);
  fit_ = RobustFit(kGlobals + tiles, {kGlobals, tiles}, across_ * down_);
  features_ = FeatureShift(4 * tiles);
  CameraModel longer = camera;
  constexpr double kStep = 1e-4;
  longer.fx_px *= 1 + kStep, longer.fy_px *= 1 + kStep;
  for (std::size_t j = 0; j < down_; ++j)
    for (std::size_t i = 0; i < across_; ++i) {
      const double middle = (static_cast<double>(side_) - 1) / 2;
      const PixelPosition p{shape.offset_x_px + static_cast<double>(i * side_) + middle,
                            shape.offset_y_px + static_cast<double>(j * side_) + middle};
      const auto ray = unproject_ray(camera, p);
      if (!ray) continue;
      bool ok = true;
      const auto set = [&](float* flow, const std::optional<PixelPosition>& q) {
        ok = ok && q;
        if (!q) return;
        flow[0] = static_cast<float>((q->u_px - p.u_px) / kStep);
        flow[1] = static_cast<float>((q->v_px - p.v_px) / kStep);
      };
      Flow& f = flow_[j * across_ + i];
      set(f.focal, project_ray(longer, *ray));
      set(f.turn[0], seen_by_turned(camera, *ray, kStep, 0, 0));
      set(f.turn[1], seen_by_turned(camera, *ray, 0, kStep, 0));
      set(f.turn[2], seen_by_turned(camera, *ray, 0, 0, kStep));
      has_flow_[j * across_ + i] = ok;
    }
  parameters_ = {{"gain", "1", 0},      {"offset", "DN", 0},   {"focal length", "1", 0},
                 {"mount x", "rad", 0}, {"mount y", "rad", 0}, {"mount z", "rad", 0}};
  for (int r = 0; r < options.tiles_down; ++r)
    for (int c = 0; c < options.tiles_across; ++c)
      parameters_.push_back({"tile " + std::to_string(c) + "," + std::to_string(r), "1", 0, 0});
  for (const char* name : {"noise", "noise dark", "noise middle", "noise bright"})
    parameters_.push_back({name, "1", 0});
}

double ImageChange::variance_at(double dn) const noexcept {
  const double k = gain_ * scale_, signal = std::max(0.0, dn - black_);
  const double dark = noise_.read_noise_e * noise_.read_noise_e + noise_.dsnu_e * noise_.dsnu_e;
  const double pattern = noise_.prnu * signal;
  return k * k * dark + 1.0 / 12 + (noise_.shot_noise ? k * signal : 0) + pattern * pattern;
}

template <class Load>
void ImageChange::read(const Load& real, const Load& simulated) noexcept {
  std::fill(cells_.begin(), cells_.end(), Cell{});
  const auto highest = static_cast<std::int32_t>(max_);
  for (std::size_t y = 0; y < down_ * side_; ++y) {
    if (y / pitch_ % row_step_ != 0) continue;
    Cell* row = &cells_[y / side_ * across_];
    for (std::size_t i = 0; i < across_; ++i) {
      Cell& c = row[i];
      for (std::size_t x = i * side_; x < (i + 1) * side_; ++x) {
        const std::int32_t a = real(x, y), b = simulated(x, y);
        c.real += static_cast<std::uint32_t>(a), c.simulated += static_cast<std::uint32_t>(b);
        c.bad = c.bad || a <= 0 || b <= 0 || a >= highest || b >= highest;
      }
      c.count += static_cast<std::uint32_t>(side_);
    }
  }

  const std::size_t s = pitch_;
  const double range = max_ - black_;
  for (std::size_t y = s; y + s < shape_.height_px; y += noise_step_)
    for (std::size_t x = s; x + s < shape_.width_px; x += noise_step_) {
      std::int32_t left = 0, sum = 0, low = highest, high = 0, lowest_real = highest, highest_real = 0;
      for (std::size_t v = 0; v < 3; ++v)
        for (std::size_t u = 0; u < 3; ++u) {
          const std::int32_t a = real(x - s + u * s, y - s + v * s),
                             b = simulated(x - s + u * s, y - s + v * s);
          const std::int32_t weight = (u == 1 ? -2 : 1) * (v == 1 ? -2 : 1);
          left += weight * (a - b);
          sum += b;
          low = std::min(low, b), high = std::max(high, b);
          lowest_real = std::min(lowest_real, a), highest_real = std::max(highest_real, a);
        }
      if (low <= 0 || high >= highest || lowest_real <= 0 || highest_real >= highest) continue;
      const double mean = sum / 9.0, variance = variance_at(mean);
      // Nine draws span some three standard deviations; more than six are an edge.
      if (high - low > 6 * std::sqrt(variance) + 1) continue;
      const double level = (mean - black_) / range;
      noise_sums_.add(left * left / 36.0 / variance, level < 0.125 ? 0 : level < 0.375 ? 1 : 2);
    }
}

bool ImageChange::add(const Sample& real, const Sample& simulated) noexcept {
  const auto *a = real.as<ImageInfo>(), *b = simulated.as<ImageInfo>();
  if (!a || !b || ((real.stamp.validity | simulated.stamp.validity) & (kIncomplete | kCorrupt)) != 0)
    return false;
  for (const ImageInfo* i : {a, b})
    if (i->format != shape_.format || i->width_px != shape_.width_px || i->height_px != shape_.height_px ||
        i->offset_x_px != shape_.offset_x_px || i->offset_y_px != shape_.offset_y_px)
      return false;
  const std::size_t bytes = image_bytes(shape_.format, shape_.width_px, shape_.height_px);
  if (real.size_bytes != bytes || simulated.size_bytes != bytes) return false;
  gain_ = base_gain_ * std::pow(10.0, b->gain_db / 20);
  const std::byte *x = real.bytes().data(), *y = simulated.bytes().data();
  const std::size_t w = shape_.width_px;
  switch (shape_.format) {
    case PixelFormat::rgb8:
      read(Bytes{x, w, 3, 1}, Bytes{y, w, 3, 1});
      break;
    case PixelFormat::yuv422_8:
      read(Bytes{x, w, 2, 0}, Bytes{y, w, 2, 0});
      break;
    case PixelFormat::mono8:
    case PixelFormat::bayer_rg8:
    case PixelFormat::yuv420_sp:
      read(Bytes{x, w, 1, 0}, Bytes{y, w, 1, 0});
      break;
    case PixelFormat::mono12p:
      read(Packed12{x, w}, Packed12{y, w});
      break;
    default:
      read(Words{x, w}, Words{y, w});
  }
  regress();
  return true;
}

void ImageChange::regress() noexcept {
  rows_.clear();
  const auto mean = [](const Cell& c, std::uint64_t sum) {
    return static_cast<double>(sum) / static_cast<double>(c.count);
  };
  const double step = 2 * static_cast<double>(side_);
  for (std::size_t j = 1; j + 1 < down_; ++j)
    for (std::size_t i = 1; i + 1 < across_; ++i) {
      const std::size_t at = j * across_ + i;
      const Cell &c = cells_[at], &l = cells_[at - 1], &r = cells_[at + 1], &u = cells_[at - across_],
                 &d = cells_[at + across_];
      if (!has_flow_[at] || c.bad || l.bad || r.bad || u.bad || d.bad) continue;
      const auto both = [&](const Cell& k) { return mean(k, k.real + k.simulated) / 2; };
      const double gx = (both(r) - both(l)) / step, gy = (both(d) - both(u)) / step;
      const double lit = mean(c, c.simulated), edge = options_.misfit_px * std::hypot(gx, gy);
      Row row;
      row.residual = mean(c, c.real) - lit;
      // By the light of both: a weight that knows one side's noise favours residuals of one sign.
      row.base_weight = row.weight = 1 / (2 * variance_at(both(c)) / c.count + edge * edge);
      row.lit = lit - black_;
      const auto place = [&](std::size_t fine) {
        const std::size_t wide = fine * static_cast<std::size_t>(options_.tiles_across);
        return static_cast<std::uint32_t>(
            (j * fine * static_cast<std::size_t>(options_.tiles_down) / down_) * wide + i * wide / across_);
      };
      row.tile = place(1), row.field = place(2);
      row.gradient[0] = static_cast<float>(gx), row.gradient[1] = static_cast<float>(gy);
      row.cell = static_cast<std::uint32_t>(at);
      const Flow& f = flow_[at];
      row.derivative[0] = row.lit;
      row.derivative[1] = 1;
      row.derivative[2] = -(gx * f.focal[0] + gy * f.focal[1]);
      for (std::size_t k = 0; k < 3; ++k) row.derivative[3 + k] = -(gx * f.turn[k][0] + gy * f.turn[k][1]);
      rows_.push_back(row);
    }
  if (rows_.size() < 4 * kGlobals) return;

  const bool tiles = parameters_.size() - kGlobals - 4 > 1;
  const auto terms_of = [tiles](const Row& r, RobustFit::Terms& terms) {
    for (std::size_t k = 0; k < kGlobals; ++k) terms[k] = {k, r.derivative[k]};
    if (tiles) terms[kGlobals] = {kGlobals + r.tile, r.lit};
    return tiles ? kGlobals + 1 : kGlobals;
  };
  fit_.add(std::span(rows_), terms_of);
  RobustFit::Terms terms;
  for (const Row& r : rows_) {
    const std::size_t n = terms_of(r, terms);
    features_.add(r.field, double{r.gradient[0]}, double{r.gradient[1]}, r.weight, r.residual,
                  {terms.data(), n});
  }
}

double ImageChange::shift_px(const Estimate& e) const noexcept {
  double squares = 0, count = 0;
  for (std::size_t i = 0; i < flow_.size(); ++i) {
    if (!has_flow_[i]) continue;
    const Flow& f = flow_[i];
    double u = f.focal[0] * e.value[2], v = f.focal[1] * e.value[2];
    for (std::size_t k = 0; k < 3; ++k)
      u += f.turn[k][0] * e.value[3 + k], v += f.turn[k][1] * e.value[3 + k];
    squares += u * u + v * v, ++count;
  }
  return count > 0 ? std::sqrt(squares / count) : kNaN;
}

void ImageChange::finish(Estimate& e) noexcept {
  e.value.fill(kNaN), e.sigma.fill(kNaN);
  fit_.finish(e);
  e.shift_px = shift_px(e);
  e.features_px = features_.finish(e);
  noise_sums_.finish(e, parameters_.size() - 4);
}

}  // namespace rigor::pair_watch
