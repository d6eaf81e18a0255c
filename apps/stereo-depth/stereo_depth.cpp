#include "apps/stereo-depth/stereo_depth.h"

#include <Eigen/Geometry>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <thread>

#include "apps/stereo-depth/evaluation.h"
#include "apps/stereo-depth/matcher.h"
#include "apps/stereo-depth/picture.h"
#include "apps/stereo-depth/rectifier.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor {
namespace {

using namespace stereo;

Eigen::Isometry3d mount_of(const ConfigNode& n) {
  const auto at = n.numbers("position_m", 3);
  const auto rpy = n.numbers("roll_pitch_yaw_deg", 3);
  n.finish();
  const auto turn = [](double deg, const Eigen::Vector3d& axis) {
    return Eigen::AngleAxisd(deg * std::numbers::pi / 180, axis);
  };
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = (turn(rpy[2], Eigen::Vector3d::UnitZ()) * turn(rpy[1], Eigen::Vector3d::UnitY()) *
                turn(rpy[0], Eigen::Vector3d::UnitX()))
                   .toRotationMatrix();
  T.translation() = Eigen::Vector3d(at[0], at[1], at[2]);
  return T;
}

Pose pose_of(const Eigen::Isometry3d& T) {
  const Eigen::Quaterniond q(T.linear());
  return {{T.translation().x(), T.translation().y(), T.translation().z()}, {q.w(), q.x(), q.y(), q.z()}};
}

class StereoDepth final : public Application {
 public:
  ~StereoDepth() override { end_worker(); }

  Status configure(ConfigNode params, const ApplicationPorts& ports, Period /*loop_period*/) override {
    end_worker();
    auto read = catch_config([&]() -> Status {
      const bool pinholes = params.flag_or("pinholes", false);
      CameraModel left, right;
      const Eigen::Isometry3d T_base_left = read_camera(params.map("left"), ports, pinholes, left_, left);
      const Eigen::Isometry3d T_base_right = read_camera(params.map("right"), ports, pinholes, right_, right);
      auto rectifier = Rectifier::make(left, right, pose_of(T_base_left.inverse() * T_base_right));
      if (!rectifier) return tl::unexpected<Error>(params.error("right", rectifier.error().message).error());
      rectifier_.emplace(std::move(*rectifier));
      if (params.has("truth")) read_truth(params.map("truth"), ports);
      read_matcher(params.map_or_absent("matcher"));
      within_ = seconds_from(params.number_or("within_ms", 1, {.min = 0, .max = 1e4}) / 1e3);
      wait_ = params.flag_or("wait", false);
      pictures_ = static_cast<std::uint64_t>(params.integer_or("pictures", 1, {.min = 0, .max = 10000}));
      picture_width_px_ = static_cast<int>(
          params.integer_or("picture_width_px", rectifier_->camera().width_px, {.min = 16, .max = 10000}));
      output_ = params.text("output");
      params.finish();
      return {};
    });
    if (!read) return tl::unexpected<Error>(read.error());
    if (!*read) return *read;
    std::error_code failed;
    std::filesystem::create_directories(output_, failed);
    if (failed)
      return fail(ErrorCode::not_writable, output_.string(),
                  "output: expected a folder that can be made and written, got: " + failed.message());
    evaluation_.emplace();
    problem_.clear();
    queued_ = 0;
    skipped_ = 0;
    done_ = 0;
    end_ = false;
    worker_ = std::thread([this] { work(); });
    return {};
  }

  void step(std::uint64_t /*cycle*/, BenchTime /*t_cycle*/) noexcept override {
    bool fresh = false;
    for (const SamplePort* port : {left_, right_, truth_})
      fresh |= port != nullptr && port->status() == PortStatus::fresh;
    if (!fresh || !left_->sample() || !right_->sample() || (truth_ && !truth_->sample())) return;
    Job job{left_->sample(), right_->sample(), truth_ ? truth_->sample() : SampleLease()};
    const BenchTime t = job.left->stamp.t_capture;
    const auto apart = [&](const SampleLease& s) {
      const Duration d = s->stamp.t_capture - t;
      return d > within_ || -d > within_;
    };
    if (apart(job.right) || (job.truth && apart(job.truth)) || (seen_ && t == t_last_)) return;
    seen_ = true;
    t_last_ = t;
    if (queued_ - done_.load(std::memory_order_acquire) >= kWaiting || !jobs_.try_push(std::move(job))) {
      ++skipped_;
      return;
    }
    ++queued_;
    while (wait_ && done_.load(std::memory_order_acquire) < queued_)
      std::this_thread::sleep_for(std::chrono::microseconds(200));
  }

  Status finish() override {
    end_worker();
    if (!evaluation_) return {};
    if (!problem_.empty()) return fail(ErrorCode::bad_input, "stereo-depth", problem_);
    nlohmann::json told{{"pairs", done_.load()}, {"skipped", skipped_}};
    const RectifiedCamera& c = rectifier_->camera();
    told["rectified"] = {{"width_px", c.width_px}, {"height_px", c.height_px}, {"focal_px", c.focal_px},
                         {"cx_px", c.cx_px},       {"cy_px", c.cy_px},         {"baseline_m", c.baseline_m}};
    told["match_ms"] = done_ > 0 ? match_s_ * 1e3 / static_cast<double>(done_) : 0;
    if (truth_) told["evaluation"] = evaluation_->json();
    const auto file = output_ / "result.json";
    std::ofstream out(file);
    out << told.dump(1) << '\n';
    if (!out.flush()) return fail(ErrorCode::not_writable, file.string(), "could not be written");
    return {};
  }

 private:
  struct Job {
    SampleLease left, right, truth;
  };
  static constexpr std::uint64_t kWaiting = 2;

  // ---- setup ----
  static const InputPort& input(const ConfigNode& n, const ApplicationPorts& ports, SampleKind kind,
                                const char* expected) {
    const std::string name = n.text("channel");
    const auto it = ports.inputs.find(name);
    std::string names;
    for (const auto& [known, port] : ports.inputs) names += (names.empty() ? "" : ", ") + known;
    if (it == ports.inputs.end())
      throw n.error("channel", "expected the name of a channel (" + names + "), got \"" + name + "\"");
    if (it->second.description->kind != kind)
      throw n.error("channel", std::string("expected a channel of kind ") + expected + "; \"" + name +
                                   "\" is of another");
    return it->second;
  }

  static void expect_size(const ConfigNode& n, const InputPort& in, const CameraModel& m) {
    const auto& is = *in.description;
    // A recording of a run in which nothing was seen does not know.
    if (is.width_px == 0 && is.height_px == 0) return;
    if (is.width_px == static_cast<std::uint32_t>(m.width_px) &&
        is.height_px == static_cast<std::uint32_t>(m.height_px))
      return;
    throw n.error(
        "model", "expected the sensor model of a camera of " + std::to_string(in.description->width_px) +
                     " x " + std::to_string(in.description->height_px) + " px, as the channel \"" + in.name +
                     "\" is, got one of " + std::to_string(m.width_px) + " x " + std::to_string(m.height_px));
  }

  static Eigen::Isometry3d read_camera(const ConfigNode& n, const ApplicationPorts& ports, bool pinhole,
                                       const SamplePort*& port, CameraModel& model) {
    const InputPort& in = input(n, ports, SampleKind::image, "image");
    if (in.description->format != PixelFormat::mono8)
      throw n.error("channel",
                    "expected a channel of pictures in Mono8; \"" + in.name + "\" has another format");
    port = in.port;
    const auto sensor_model = load_camera(n.base_dir() / n.text("model"));
    if (!sensor_model) throw ConfigError(sensor_model.error());
    model = sensor_model->model;
    if (pinhole) model.lens = {};
    expect_size(n, in, model);
    const Eigen::Isometry3d T = mount_of(n.map("T_base_sensor"));
    n.finish();
    return T;
  }

  void read_truth(const ConfigNode& n, const ApplicationPorts& ports) {
    const InputPort& in = input(n, ports, SampleKind::range_image, "range_image");
    const auto sensor_model = load_tof_model(n.base_dir() / n.text("model"));
    if (!sensor_model) throw ConfigError(sensor_model.error());
    truth_model_ = sensor_model->camera();
    if (!(truth_model_.lens == OpenCvLens{}))
      throw n.error("model",
                    "expected a camera without distortion: true ranges are looked up between its pixels");
    expect_size(n, in, truth_model_);
    truth_ = in.port;
    n.finish();
  }

  void read_matcher(const ConfigNode& n) {
    const auto whole = [&](const char* key, int fallback, double min, double max) {
      return static_cast<int>(n.integer_or(key, fallback, {.min = min, .max = max}));
    };
    MatcherConfig c;
    c.disparities = whole("disparities", c.disparities, 16, 1024);
    if (c.disparities % 16 != 0) throw n.error("disparities", "expected a multiple of 16");
    c.block_px = whole("block_px", c.block_px, 1, 21);
    if (c.block_px % 2 == 0) throw n.error("block_px", "expected an odd number");
    c.uniqueness_percent = whole("uniqueness_percent", c.uniqueness_percent, 0, 100);
    c.left_right_px = whole("left_right_px", c.left_right_px, -1, 1000);
    c.speckle_px = whole("speckle_px", c.speckle_px, 0, 1e6);
    c.full = n.flag_or("full", c.full);
    n.finish();
    matcher_config_ = c;
  }

  // ---- the application's own thread ----
  void work() {
    Matcher matcher(matcher_config_);
    Job job;
    while (true) {
      // Read before the ring: what was queued before the end is still done.
      const bool end = end_.load(std::memory_order_acquire);
      if (!jobs_.try_pop(job)) {
        if (end) return;
        std::this_thread::sleep_for(std::chrono::microseconds(500));
        continue;
      }
      try {
        measure(matcher, job);
      } catch (const std::exception& e) {  // OpenCV's
        if (problem_.empty()) problem_ = e.what();
      }
      job = {};
      done_.fetch_add(1, std::memory_order_release);
    }
  }

  static cv::Mat picture_of(const Sample& s) {
    const auto* info = s.as<ImageInfo>();
    if (!info || info->format != PixelFormat::mono8 ||
        s.size_bytes < std::size_t{info->width_px} * info->height_px)
      return {};
    // The lease keeps it, and nobody writes to it.
    return {static_cast<int>(info->height_px), static_cast<int>(info->width_px), CV_8U,
            const_cast<std::byte*>(s.bytes().data())};
  }

  void measure(Matcher& matcher, const Job& job) {
    const cv::Mat left = picture_of(*job.left), right = picture_of(*job.right);
    if (left.empty() || right.empty()) {
      problem_ = "expected pictures in Mono8, got another format";
      return;
    }
    const auto before = std::chrono::steady_clock::now();
    const RectifiedPair pair = rectifier_->rectify(left, right);
    cv::Mat disparity = matcher.match(pair.left, pair.right);
    match_s_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - before).count();
    disparity.setTo(cv::Scalar(kNoDisparity), rectifier_->left_mask() == 0);
    cv::Mat truth, judged;
    if (job.truth) {
      const auto* info = job.truth->as<RangeImageInfo>();
      if (!info || info->width_px != static_cast<std::uint32_t>(truth_model_.width_px) ||
          info->height_px != static_cast<std::uint32_t>(truth_model_.height_px)) {
        problem_ = "expected true ranges of the size that the sensor model says, got another";
        return;
      }
      const cv::Mat depth_m = true_depth(rectifier_->camera(), truth_model_,
                                         reinterpret_cast<const float*>(job.truth->bytes().data()));
      evaluation_->add(*rectifier_, disparity, depth_m, matcher_config_.disparities);
      truth = true_disparity(rectifier_->camera(), depth_m);
      judged = judged_pixels(*rectifier_, truth, matcher_config_.disparities);
    }
    const std::uint64_t index = done_.load(std::memory_order_relaxed);
    if (index >= pictures_) return;
    std::array<char, 32> name{};
    std::snprintf(name.data(), name.size(), "view-%03llu.png", static_cast<unsigned long long>(index));
    const auto file = output_ / name.data();
    cv::Mat shown = side_by_side(pair.left, disparity, truth, judged, matcher_config_.disparities / 2.0);
    if (const double scale = static_cast<double>(picture_width_px_) / pair.left.cols; scale != 1)
      cv::resize(shown, shown, {}, scale, scale, cv::INTER_AREA);
    if (!cv::imwrite(file.string(), shown)) problem_ = file.string() + " could not be written";
  }

  void end_worker() {
    end_.store(true, std::memory_order_release);
    if (worker_.joinable()) worker_.join();
  }

  const SamplePort *left_ = nullptr, *right_ = nullptr, *truth_ = nullptr;
  std::optional<Rectifier> rectifier_;
  CameraModel truth_model_;
  MatcherConfig matcher_config_;
  Duration within_;
  bool wait_ = false;
  std::uint64_t pictures_ = 1;
  int picture_width_px_ = 0;
  std::filesystem::path output_;

  // The loop's.
  bool seen_ = false;
  BenchTime t_last_;
  std::uint64_t queued_ = 0, skipped_ = 0;
  SpscRing<Job> jobs_{kWaiting};

  // The worker's; after its end the setup thread's.
  std::thread worker_;
  std::atomic<bool> end_{false};
  std::atomic<std::uint64_t> done_{0};
  std::optional<Evaluation> evaluation_;
  double match_s_ = 0;
  std::string problem_;
};

/// The result, and the pictures that are there.
std::vector<std::filesystem::path> files_of(const ConfigNode& params) {
  const std::filesystem::path dir = params.text("output");
  std::vector<std::filesystem::path> files{dir / "result.json"};
  std::error_code ec;
  for (const auto& entry : std::filesystem::directory_iterator(dir, ec)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with("view-") && name.ends_with(".png")) files.push_back(dir / name);
  }
  std::sort(files.begin() + 1, files.end());
  return files;
}

}  // namespace

NamedApplication stereo_depth_application() {
  return {"stereo-depth", [] { return std::make_unique<StereoDepth>(); }, files_of};
}

}  // namespace rigor
