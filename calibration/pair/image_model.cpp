#include "calibration/pair/image_model.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>

#include "calibration/pair/clustered_fit.h"
#include "sensor-hal/models/philox.h"

namespace rigor::calibration {
namespace {

using pair_watch::ImageChange;

enum Column : std::size_t { kGain, kOffset, kFocal, kTurn, kCx = kTurn + 3, kCy, kK1, kA2, kColumns };
constexpr std::size_t kLattice = 8;     // px between the places at which the lens is asked
constexpr std::size_t kPlaceCells = 4;  // side of a place, cells
constexpr std::size_t kNoiseLevels = 16;

/// The values that ImageChange looks at, one by one: green of RGB, luma of YUV.
struct Plane {
  ImageInfo shape;  ///< of a format with one value per pixel
  std::vector<std::uint16_t> value;
};

PixelFormat plane_format(PixelFormat f) {
  if (is_bayer(f)) return f;
  switch (significant_bits(f)) {
    case 8:
      return PixelFormat::mono8;
    case 10:
      return PixelFormat::mono10;
    case 12:
      return PixelFormat::mono12;
    default:
      return PixelFormat::mono16;
  }
}

bool alike(const ImageInfo& a, const ImageInfo& b) {
  return a.format == b.format && a.width_px == b.width_px && a.height_px == b.height_px &&
         a.offset_x_px == b.offset_x_px && a.offset_y_px == b.offset_y_px;
}

bool take_plane(const Sample& s, Plane& plane) {
  const auto* info = s.as<ImageInfo>();
  if (!info || is_depth(info->format) || (s.stamp.validity & (kIncomplete | kCorrupt)) != 0) return false;
  const std::size_t n = std::size_t{info->width_px} * info->height_px;
  if (s.size_bytes != image_bytes(info->format, info->width_px, info->height_px)) return false;
  plane.shape = *info;
  plane.shape.format = plane_format(info->format);
  plane.value.resize(n);
  const std::byte* data = s.bytes().data();
  const auto bytes = [&](std::size_t stride, std::size_t offset) {
    for (std::size_t i = 0; i < n; ++i)
      plane.value[i] = static_cast<std::uint16_t>(data[i * stride + offset]);
  };
  switch (info->format) {
    case PixelFormat::rgb8:
      bytes(3, 1);
      break;
    case PixelFormat::yuv422_8:
      bytes(2, 0);
      break;
    case PixelFormat::mono8:
    case PixelFormat::bayer_rg8:
    case PixelFormat::yuv420_sp:
      bytes(1, 0);
      break;
    case PixelFormat::mono12p:
      for (std::size_t i = 0; i < n; ++i) {
        const std::byte* at = data + i * 12 / 8;
        const auto low = static_cast<unsigned>(at[0]), high = static_cast<unsigned>(at[1]);
        plane.value[i] =
            static_cast<std::uint16_t>(i % 2 == 0 ? (low | (high & 0x0f) << 8) : (low >> 4 | high << 4));
      }
      break;
    default:
      std::memcpy(plane.value.data(), data, 2 * n);
  }
  return true;
}

void put_plane(const Plane& plane, Sample& s) {
  const std::size_t n = plane.value.size(),
                    bytes = image_bytes(plane.shape.format, plane.shape.width_px, plane.shape.height_px);
  if (s.memory().size() < bytes) s.reserve(bytes);
  s.info = plane.shape, s.size_bytes = bytes;
  if (bytes == n)
    for (std::size_t i = 0; i < n; ++i) s.memory()[i] = static_cast<std::byte>(plane.value[i]);
  else
    std::memcpy(s.memory().data(), plane.value.data(), bytes);
}

double fall_off(const Vignetting& v, const OpticalRay& d) {
  if (d.z <= 0) return 1;
  const double r2 = (d.x * d.x + d.y * d.y) / (d.z * d.z), cos2 = 1 / (1 + r2);
  return std::max(
      1e-3, (1 - v.cos4_weight + v.cos4_weight * cos2 * cos2) * (1 + r2 * (v.a2 + r2 * (v.a4 + r2 * v.a6))));
}

/// What is solved for, as it stands after some passes.
struct State {
  CameraModel camera;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  double gain = 1, offset = 0;
};

/// Where each pixel of the device lies in the simulated side's picture, and the light it gets there.
class Carrier {
 public:
  Carrier(const CameraModel& simulated, const State& state, const ImageInfo& shape, double black,
          double highest)
      : state_(state), shape_(shape), black_(black), highest_(highest) {
    across_ = shape.width_px / kLattice + 2, down_ = shape.height_px / kLattice + 2;
    for (std::size_t j = 0; j < down_; ++j)
      for (std::size_t i = 0; i < across_; ++i) {
        const PixelPosition p{double(shape.offset_x_px + i * kLattice),
                              double(shape.offset_y_px + j * kLattice)};
        Node node;
        if (const auto real = unproject_ray(state.camera, p)) {
          const Eigen::Vector3d d = state.R * Eigen::Vector3d(real->x, real->y, real->z);
          const OpticalRay ray{d.x(), d.y(), d.z()};
          if (const auto q = project_ray(simulated, ray)) {
            node.u = q->u_px - p.u_px, node.v = q->v_px - p.v_px;
            node.light = fall_off(state.camera.vignetting, *real) / fall_off(simulated.vignetting, ray);
            node.seen = true;
          }
        }
        nodes_.push_back(node);
      }
  }

  /// Of pixel (x, y): the place in the simulated side's picture, in its pixels; false: it is not in it.
  bool place(std::size_t x, std::size_t y, double& u, double& v, double& light) const {
    const std::size_t i = x / kLattice, j = y / kLattice;
    const double s = double(x % kLattice) / kLattice, t = double(y % kLattice) / kLattice;
    const Node &a = nodes_[j * across_ + i], &b = nodes_[j * across_ + i + 1],
               &c = nodes_[(j + 1) * across_ + i], &d = nodes_[(j + 1) * across_ + i + 1];
    if (!a.seen || !b.seen || !c.seen || !d.seen) return false;
    const auto mix = [&](double Node::*m) {
      return (1 - t) * ((1 - s) * a.*m + s * b.*m) + t * ((1 - s) * c.*m + s * d.*m);
    };
    u = double(x) + mix(&Node::u), v = double(y) + mix(&Node::v), light = mix(&Node::light);
    return true;
  }

  /// Values are rounded up or down at random, by a draw for each pixel and `picture`: rounding to the nearest
  /// would hide changes of less than half a DN. This adds at most 1/4 DN² to the variance of a pixel.
  void carry(const Plane& in, std::uint64_t picture, Plane& out) const {
    out.shape = in.shape;
    out.value.assign(in.value.size(), 0);
    const std::size_t w = shape_.width_px, h = shape_.height_px, s = is_bayer(shape_.format) ? 2 : 1;
    const auto top = static_cast<std::uint16_t>(highest_);
    for (std::size_t y = 0; y < h; ++y)
      for (std::size_t x = 0; x < w; ++x) {
        double u = 0, v = 0, light = 1;
        if (!place(x, y, u, v, light)) continue;
        // On the lattice of the pixel's own colour.
        const double a = (u - double(x % s)) / double(s), b = (v - double(y % s)) / double(s);
        const double i = std::floor(a), j = std::floor(b);
        if (i < 1 || j < 1 || (i + 2) * double(s) + double(x % s) >= double(w) ||
            (j + 2) * double(s) + double(y % s) >= double(h))
          continue;
        const auto kernel = [](double t) {  // Catmull and Rom
          return std::array{0.5 * t * (-1 + t * (2 - t)), 0.5 * (2 + t * t * (3 * t - 5)),
                            0.5 * t * (1 + t * (4 - 3 * t)), 0.5 * t * t * (t - 1)};
        };
        const auto ka = kernel(a - i), kb = kernel(b - j);
        double sum = 0;
        bool dark = false, white = false;
        for (std::size_t m = 0; m < 4; ++m)
          for (std::size_t n = 0; n < 4; ++n) {
            const std::size_t at =
                ((std::size_t(j) + m - 1) * s + y % s) * w + (std::size_t(i) + n - 1) * s + x % s;
            const std::uint16_t value = in.value[at];
            if ((m == 1 || m == 2) && (n == 1 || n == 2)) dark |= value == 0, white |= value >= top;
            sum += kb[m] * ka[n] * value;
          }
        const double carried = black_ + state_.gain * light * (sum - black_) + state_.offset;
        out.value[y * w + x] =
            dark ? 0
            : white
                ? top
                : static_cast<std::uint16_t>(std::clamp(carried + draw(y * w + x, picture), 0.0, highest_));
      }
  }

 private:
  struct Node {
    double u = 0, v = 0, light = 1;
    bool seen = false;
  };
  /// At least 0, below 1.
  static double draw(std::size_t pixel, std::uint64_t picture) {
    return models::draw_words({}, models::NoiseEffect::calibration_rounding, picture,
                              static_cast<std::uint32_t>(pixel))[0] *
           0x1p-32;
  }
  State state_;
  ImageInfo shape_;
  double black_, highest_;
  std::size_t across_ = 0, down_ = 0;
  std::vector<Node> nodes_;
};

struct Extra {
  std::array<float, 2> cx{}, cy{}, k1{};
  float a2 = 0;
  bool ok = false;
};

/// Pixels for each unit of the parameters that ImageChange does not know, at the cells' middles.
std::vector<Extra> extra_flows(const CameraModel& c, const ImageInfo& shape, const ImageChange& grid) {
  std::vector<Extra> out(grid.cells_across() * grid.cells_down());
  const double side = double(grid.cell_side_px());
  constexpr double kStep = 1e-4;
  CameraModel bent = c;
  if (c.projection == Projection::opencv)
    bent.lens.k1 += kStep;
  else
    bent.fisheye.k1 += kStep;
  for (std::size_t j = 0; j < grid.cells_down(); ++j)
    for (std::size_t i = 0; i < grid.cells_across(); ++i) {
      const PixelPosition p{shape.offset_x_px + double(i) * side + (side - 1) / 2,
                            shape.offset_y_px + double(j) * side + (side - 1) / 2};
      const auto ray = unproject_ray(c, p);
      if (!ray) continue;
      const auto q = project_ray(bent, *ray);
      if (!q || ray->z <= 0) continue;
      Extra& e = out[j * grid.cells_across() + i];
      e.cx = {1, 0}, e.cy = {0, 1};
      e.k1 = {float((q->u_px - p.u_px) / kStep), float((q->v_px - p.v_px) / kStep)};
      const double r2 = (ray->x * ray->x + ray->y * ray->y) / (ray->z * ray->z);
      const Vignetting& v = c.vignetting;
      e.a2 = float(r2 / std::max(1e-3, 1 + r2 * (v.a2 + r2 * (v.a4 + r2 * v.a6))));
      e.ok = true;
    }
  return out;
}

class Fitter {
 public:
  Fitter(const ForEachPair& pairs, const CameraModel& simulated, const ImagePairOptions& options)
      : pairs_(pairs), simulated_camera_(simulated), options_(options) {
    state_.camera = simulated;
    held_.assign(kColumns, false);
    for (std::size_t k = 0; k < 3; ++k) held_[kTurn + k] = !options.mount;
    held_[kCx] = held_[kCy] = !options.principal_point;
    held_[kK1] = !options.distortion;
    held_[kA2] = true;
  }

  Result<ImagePairFit> run() {
    if (auto s = solve(); !s) return tl::unexpected<Error>(s.error());
    if (!fit_.change.interrupted && simulated_camera_.projection == Projection::opencv) {
      // The fall-off of the light is asked about last: where it has not changed it costs certainty of the
      // gain.
      held_[kA2] = false;
      const State before = state_;
      if (auto s = solve(); !s) return tl::unexpected<Error>(s.error());
      const double change = state_.camera.vignetting.a2 - simulated_camera_.vignetting.a2;
      if (!solution_.determined[kA2] || !(std::abs(change) > 4 * std::sqrt(solution_.covariance(kA2, kA2)))) {
        held_[kA2] = true, state_ = before;
        if (auto s = solve(); !s) return tl::unexpected<Error>(s.error());
      }
    }
    finish();
    return std::move(fit_);
  }

 private:
  Status solve() {
    fit_.converged = false;
    Relaxation relaxation;
    for (int pass = 0; pass < options_.most_passes; ++pass) {
      if (options_.progress) options_.progress(fit_.passes + 1);
      if (auto s = one_pass(); !s) return s;
      const bool first = fit_.passes++ == 0;
      const Eigen::VectorXd& step = solution_.step;
      if (first) fit_.one_step.assign(step.data(), step.data() + step.size());
      const bool small = solution_.is_small(0.05);
      if (fit_.pairs < 2) return {};
      if (small || options_.stop.stop_requested()) {
        fit_.converged = small, fit_.change.interrupted = options_.stop.stop_requested();
        return {};
      }
      Eigen::VectorXd sigmas = Eigen::VectorXd::Zero(step.size());
      for (Eigen::Index i = 0; i < step.size(); ++i)
        if (solution_.determined[static_cast<std::size_t>(i)])
          sigmas[i] = step[i] / std::sqrt(solution_.covariance(i, i));
      take(relaxation.next(sigmas) * step);
    }
    return {};
  }

  void take(const Eigen::VectorXd& step) {
    CameraModel& c = state_.camera;
    state_.gain *= 1 + step[kGain], state_.offset += step[kOffset];
    c.fx_px *= 1 + step[kFocal], c.fy_px *= 1 + step[kFocal];
    const Eigen::Vector3d turn = step.segment<3>(kTurn);
    if (turn.norm() > 0)
      state_.R = state_.R * Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
    c.cx_px += step[kCx], c.cy_px += step[kCy];
    (c.projection == Projection::opencv ? c.lens.k1 : c.fisheye.k1) += step[kK1];
    c.vignetting.a2 += step[kA2];
  }

  [[nodiscard]] bool carried() const {
    return fit_.passes > 0;  // the first pass looks at the pictures as they are
  }

  Status one_pass() {
    const std::uint64_t known = fit_.pairs;
    const std::uint64_t stretch = std::max<std::uint64_t>(1, known / 50);
    fit_.pairs = fit_.unlike = 0;
    fit_.after = {};
    change_.reset(), fit_rows_.reset(), carrier_.reset();
    noise_ = NoiseByLevel(kNoiseLevels);
    Status bad;
    const auto said = pairs_([&](const Sample& a, const Sample& b) {
      if (!bad) return;
      if (!take_plane(a, real_) || !take_plane(b, simulated_)) {
        ++fit_.unlike;
        return;
      }
      if (!change_) {
        if (auto s = prepare(); !s) {
          bad = s;
          return;
        }
      }
      // Where pixels come from is known for the shape of the first pair.
      if (!alike(real_.shape, shape_) || !alike(simulated_.shape, shape_)) {
        ++fit_.unlike;
        return;
      }
      if (carried())
        carrier_->carry(simulated_, fit_.pairs, carried_);
      else
        carried_ = simulated_;
      put_plane(real_, real_sample_), put_plane(carried_, carried_sample_);
      if (!change_->add(real_sample_, carried_sample_)) {
        ++fit_.unlike;
        return;
      }
      ++fit_.pairs;
      take_rows();
      take_noise();
      if (fit_.pairs % stretch == 0) fit_rows_->end_stretch();
    });
    if (!bad) return bad;
    if (!said) return said;
    if (!fit_rows_) {
      solution_ = {Eigen::VectorXd::Zero(kColumns), Eigen::MatrixXd::Zero(kColumns, kColumns),
                   std::vector<bool>(kColumns, false)};
      return {};
    }
    fit_rows_->end_stretch();
    solution_ = fit_rows_->solve(held_);
    if (!scales_.empty()) {
      const auto middle = scales_.begin() + static_cast<std::ptrdiff_t>(scales_.size() / 2);
      std::nth_element(scales_.begin(), middle, scales_.end());
      scale_ = std::max(1e-3, *middle);
      scales_.clear();
    }
    return {};
  }

  Status prepare() {
    auto change = ImageChange::make(state_.camera, simulated_.shape,
                                    {.cells = options_.cells, .tiles_across = 6, .tiles_down = 4});
    if (!change) return tl::unexpected<Error>(change.error());
    change_ = std::make_unique<ImageChange>(std::move(*change));
    shape_ = simulated_.shape;
    fit_.format_scale =
        std::ldexp(1.0, significant_bits(simulated_.shape.format) - simulated_camera_.noise.adc_bits);
    black_ = simulated_camera_.processing.subtract_black
                 ? 0
                 : simulated_camera_.noise.black_level_dn * fit_.format_scale;
    highest_ = std::ldexp(1.0, significant_bits(simulated_.shape.format)) - 1;
    carrier_ = std::make_unique<Carrier>(simulated_camera_, state_, simulated_.shape, black_, highest_);
    extra_ = extra_flows(state_.camera, simulated_.shape, *change_);
    places_across_ = (change_->cells_across() + kPlaceCells - 1) / kPlaceCells;
    const std::size_t places_down = (change_->cells_down() + kPlaceCells - 1) / kPlaceCells;
    fit_rows_ = std::make_unique<ClusteredFit>(std::size_t{kColumns}, places_across_ * places_down);
    return {};
  }

  void take_rows() {
    const std::size_t across = change_->cells_across();
    real_light_.assign(across * change_->cells_down(), std::nan(""));
    for (const ImageChange::Row& r : change_->rows()) real_light_[r.cell] = r.lit + r.residual;
    for (const ImageChange::Row& r : change_->rows()) {
      if (fit_.passes == 0) fit_.before.add(r.residual);
      fit_.after.add(r.residual);
      std::array<double, kColumns> j{};
      j[kGain] = r.lit - state_.offset, j[kOffset] = 1;
      for (std::size_t k = 0; k < 4; ++k) j[kFocal + k] = r.derivative[2 + k];
      const Extra& e = extra_[r.cell];
      if (!e.ok) continue;
      const auto along = [&](const std::array<float, 2>& flow) {
        return -(double(r.gradient[0]) * flow[0] + double(r.gradient[1]) * flow[1]);
      };
      j[kCx] = along(e.cx), j[kCy] = along(e.cy), j[kK1] = along(e.k1);
      j[kA2] = j[kGain] * e.a2;
      const std::size_t x = r.cell % change_->cells_across(), y = r.cell / change_->cells_across();
      // Light is noisy, and a gain that is regressed on it comes out too small; the device's light in the
      // cells beside, whose noise is in no residual of this cell, is an instrument against that.
      std::array<double, kColumns> z = j;
      double light = 0, around = 0;
      const std::size_t cell = r.cell;
      for (const std::size_t at : {cell - 1, cell + 1, cell - across, cell + across})
        if (std::isfinite(real_light_[at])) light += real_light_[at], ++around;
      if (around == 0) continue;
      z[kGain] = light / around, z[kA2] = z[kGain] * e.a2;
      // The fit of the pair watch has no instruments, so its gain is too small, and Huber's weights about it
      // take more from residuals of one sign. The first pass has nothing better.
      const double far = std::abs(r.residual) * std::sqrt(r.base_weight);
      left_.push_back(far);
      fit_rows_->add(y / kPlaceCells * places_across_ + x / kPlaceCells, z, j, r.residual,
                     carried() ? huber_weight(r.base_weight, far / (kHuberLimit * scale_))
                               : RobustWeight{r.weight, r.weight < r.base_weight ? 0 : r.weight});
    }
    if (left_.empty()) return;
    const auto middle = left_.begin() + static_cast<std::ptrdiff_t>(left_.size() / 2);
    std::nth_element(left_.begin(), middle, left_.end());
    scales_.push_back(1.4826 * *middle);
    left_.clear();
  }

  void take_noise() {
    const std::size_t w = simulated_.shape.width_px, h = simulated_.shape.height_px,
                      s = is_bayer(simulated_.shape.format) ? 2 : 1;
    std::size_t step = 3 * s;
    while ((w / step) * (h / step) > (std::size_t{1} << 14)) step += s;
    const double range = highest_ - black_;
    for (std::size_t y = s; y + s < h; y += step)
      for (std::size_t x = s; x + s < w; x += step) {
        double u = double(x), v = double(y), light = 1;
        if (carried() && !carrier_->place(x, y, u, v, light)) continue;
        const double du = std::round((u - double(x)) / double(s)) * double(s),
                     dv = std::round((v - double(y)) / double(s)) * double(s);
        const double px = double(x) + du, py = double(y) + dv;
        if (px < double(s) || py < double(s) || px + double(s) >= double(w) || py + double(s) >= double(h))
          continue;
        const auto qx = std::size_t(px), qy = std::size_t(py);
        int left[2] = {0, 0}, low[2] = {1 << 16, 1 << 16}, high[2] = {0, 0}, sum = 0;
        for (std::size_t m = 0; m < 3; ++m)
          for (std::size_t n = 0; n < 3; ++n) {
            const int weight = (n == 1 ? -2 : 1) * (m == 1 ? -2 : 1);
            const int a = real_.value[(y - s + m * s) * w + x - s + n * s],
                      b = simulated_.value[(qy - s + m * s) * w + qx - s + n * s];
            left[0] += weight * a, left[1] += weight * b, sum += b;
            low[0] = std::min(low[0], a), high[0] = std::max(high[0], a);
            low[1] = std::min(low[1], b), high[1] = std::max(high[1], b);
          }
        if (low[0] <= 0 || low[1] <= 0 || high[0] >= highest_ || high[1] >= highest_) continue;
        const double mean = sum / 9.0, variance = change_->variance_at(mean), lit = mean - black_;
        if (lit <= 0 || high[1] - low[1] > 6 * std::sqrt(variance) + 1) continue;
        const double g = state_.gain * light;
        const auto level = std::min<std::size_t>(
            kNoiseLevels - 1, static_cast<std::size_t>(kNoiseLevels * std::sqrt(lit / range)));
        noise_.add(level, lit, std::min(left[0] * left[0] / 36.0, 100 * variance),
                   g * g * left[1] * left[1] / 36.0);
      }
  }

  void finish() {
    fit_.camera = state_.camera, fit_.R_simulated_real = state_.R;
    fit_.gain = state_.gain, fit_.offset_dn = state_.offset;
    fit_.noise = noise_.levels();
    fit_.change.residuals.unit = "DN";
    fit_.change.model = std::string("gain, focal length") + (options_.mount ? ", mount" : "") +
                        (options_.principal_point ? ", principal point" : "") +
                        (options_.distortion ? ", k1" : "") + (held_[kA2] ? "" : ", vignetting");
    const double reach = std::max(1.0, 0.5 * simulated_camera_.width_px);
    const std::vector<Parameter> names{
        {.name = "gain", .resolution = 0.1},
        {.name = "offset_dn", .resolution = 20},
        {.name = "focal_length", .resolution = 0.1},
        {.name = "mount_x_rad", .resolution = 0.05},
        {.name = "mount_y_rad", .resolution = 0.05},
        {.name = "mount_z_rad", .resolution = 0.05},
        {.name = "cx_px", .resolution = 0.1 * reach},
        {.name = "cy_px", .resolution = 0.1 * reach},
        {.name = "k1", .resolution = 0.5},
        {.name = "a2", .resolution = 0.5},
    };
    const Eigen::AngleAxisd turned(state_.R);
    const Eigen::Vector3d turn = turned.angle() * turned.axis();
    const CameraModel& c = state_.camera;
    Eigen::VectorXd value(kColumns);
    value << state_.gain - 1, state_.offset, c.fx_px / simulated_camera_.fx_px - 1, turn.x(), turn.y(),
        turn.z(), c.cx_px - simulated_camera_.cx_px, c.cy_px - simulated_camera_.cy_px,
        c.projection == Projection::opencv ? c.lens.k1 - simulated_camera_.lens.k1
                                           : c.fisheye.k1 - simulated_camera_.fisheye.k1,
        c.vignetting.a2 - simulated_camera_.vignetting.a2;
    // Steps are in units of the state that they were taken at.
    Eigen::VectorXd unit = Eigen::VectorXd::Ones(kColumns);
    unit[kGain] = state_.gain, unit[kFocal] = 1 + value[kFocal];
    const Eigen::MatrixXd covariance = unit.asDiagonal() * solution_.covariance * unit.asDiagonal();
    static constexpr const char* kTexture =
        "the pictures have too little structure, or too little of them is lit between black and white; "
        "record "
        "a scene with edges over the whole picture";
    keep_solution(fit_, names, value, covariance, held_, std::vector<std::string>(kColumns, kTexture));
    // What is left in parts of the picture.
    if (!change_) return;
    pair_watch::Estimate e;
    change_->finish(e);
    for (std::size_t k = 0; k < change_->parameters().size(); ++k)
      if (change_->parameters()[k].name.starts_with("tile ") && std::isfinite(e.sigma[k]))
        fit_.tiles.push_back({change_->parameters()[k].name, e.value[k], e.sigma[k]});
  }

  const ForEachPair& pairs_;
  CameraModel simulated_camera_;
  ImagePairOptions options_;
  State state_;
  std::vector<bool> held_;
  ImagePairFit fit_;
  ClusteredFit::Solution solution_;
  std::unique_ptr<ImageChange> change_;
  std::unique_ptr<ClusteredFit> fit_rows_;
  std::unique_ptr<Carrier> carrier_;
  std::vector<Extra> extra_;
  NoiseByLevel noise_{kNoiseLevels};
  std::size_t places_across_ = 1;
  std::vector<double> real_light_;  ///< by cell, above black; NaN: not compared
  std::vector<double> left_;        ///< of one picture: |residual| over its expected standard deviation
  std::vector<double> scales_;      ///< of each picture of this pass: 1.4826 · median of that
  double scale_ = 1;                ///< median of `scales_` of the pass before
  ImageInfo shape_;                 ///< of the first pair
  double black_ = 0, highest_ = 255;
  Plane real_, simulated_, carried_;
  Sample real_sample_, carried_sample_;
};

}  // namespace

Result<ImagePairFit> fit_image_pair(const ForEachPair& pairs, const CameraModel& simulated,
                                    const ImagePairOptions& options) {
  return Fitter(pairs, simulated, options).run();
}

ImageNoiseFit fit_image_noise(const ImagePairFit& fit, const CameraModel& simulated, double gain_sigma) {
  ImageNoiseFit out;
  out.levels = static_cast<int>(fit.noise.size());
  if (out.levels < 2) {
    out.levels = 0;
    return out;
  }
  const double k = simulated.system_gain_dn_per_e() * fit.format_scale, g = fit.gain;
  const EmvaNoise& n = simulated.noise;
  const auto solve = [&](bool electronics, double& read, double& sigma) {
    // y = known + coefficient · read²
    const double coefficient = k * k * (electronics ? g * g : 1);
    double weights = 0, sum = 0;
    std::vector<double> left, of;
    for (const NoiseLevel& l : fit.noise) {
      const double s = l.level, pattern = n.prnu * s, shot = n.shot_noise ? k * s : 0;
      const double modelled = k * k * (n.read_noise_e * n.read_noise_e + n.dsnu_e * n.dsnu_e) + shot +
                              pattern * pattern + 1.0 / 12;
      const double y = g * g * modelled + l.difference;
      const double known =
          1.0 / 12 +
          (electronics ? g * g * (shot + pattern * pattern) : g * shot + g * g * pattern * pattern) +
          coefficient * n.dsnu_e * n.dsnu_e;
      const double w = 1 / (l.sigma * l.sigma);
      left.push_back(y - known), of.push_back(l.sigma);
      weights += w, sum += w * (y - known);
    }
    const double mean = sum / weights;
    double chi2 = 0;
    for (std::size_t i = 0; i < left.size(); ++i) chi2 += std::pow((left[i] - mean) / of[i], 2);
    const double square = mean / coefficient, sigma_square = 1 / std::sqrt(weights) / coefficient;
    read = std::sqrt(std::max(0.0, square));
    sigma = read > 0 ? std::min(sigma_square / (2 * read), std::sqrt(sigma_square)) : std::sqrt(sigma_square);
    return chi2;
  };
  double read[2], sigma[2];
  out.chi2_light = solve(false, read[0], sigma[0]);
  out.chi2_electronics = solve(true, read[1], sigma[1]);
  const bool electronics = out.chi2_electronics < out.chi2_light;
  if (std::abs(g - 1) > 3 * gain_sigma)
    out.gain = electronics ? ImageNoiseFit::Gain::electronics : ImageNoiseFit::Gain::light;
  out.read_noise_e = read[electronics], out.sigma_e = sigma[electronics];
  out.chi2 = electronics ? out.chi2_electronics : out.chi2_light;
  out.at_bound = read[electronics] == 0;
  return out;
}

}  // namespace rigor::calibration
