#include "bench/dataset/dataset_folder.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <utility>

#include "bench/dataset/dataset_json.h"
#include "bench/dataset/dataset_summary.h"
#include "bench/dataset/npy.h"
#include "bench/files/manifest.h"
#include "bench/files/output_file.h"
#include "bench/files/picture.h"
#include "bench/files/picture_file.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kManifest = "dataset.json";

std::string read_whole(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// Fields of a point as NumPy names them, packed. Labels stand there where there is truth.
std::string points_npy(const DatasetView& view) {
  const bool truth = !view.truth.node.empty();
  std::string descr =
      "[('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'), ('t_ns', '<i4'), ('ring', '<u2'), "
      "('return', '|u1')";
  if (truth) descr += ", ('class', '|u1'), ('node', '<u8'), ('true_range', '<f4')";
  descr += "]";
  std::string bytes;
  const auto append = [&](const auto& value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  for (std::size_t i = 0; i < view.points.size(); ++i) {
    const LidarPoint& p = view.points[i];
    for (const float v : {p.x_m, p.y_m, p.z_m, p.remission}) append(v);
    append(p.t_offset_ns);
    append(p.ring);
    append(p.return_index);
    if (!truth) continue;
    append(view.labels.category[i]);
    append(view.truth.node[i]);
    append(view.truth.range_m[i]);
  }
  return npy::file_of(descr, {view.points.size()}, bytes);
}

}  // namespace

struct DatasetFolder::Impl {
  fs::path dir;
  const Dataset& dataset;
  DatasetOutputOptions options;
  int lock = -1;
  json manifest;

  [[nodiscard]] std::string number(std::uint64_t index) const { return fmt::format("{:06}", index); }
  [[nodiscard]] fs::path sample_file(std::uint64_t index) const {
    return dir / "samples" / (number(index) + ".json");
  }
  Status take();
  Status check_manifest();
  void remove_parts() const;
  Status write_view(const DatasetSample& sample, const DatasetView& view, json& described);
  Status write_layers(const std::string& name, const DatasetView& view, json& files);
};

DatasetFolder::DatasetFolder(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
DatasetFolder::~DatasetFolder() {
  if (impl_->lock >= 0) ::close(impl_->lock);
}

/// Holds the folder: the lock goes with the process, however that ends.
Status DatasetFolder::Impl::take() {
  std::error_code ec;
  fs::create_directories(dir, ec);
  if (ec) return tl::unexpected<Error>(output_error(dir, ec.value()));
  lock = ::open(dir.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (lock < 0) return tl::unexpected<Error>(output_error(dir, errno));
  if (::flock(lock, LOCK_EX | LOCK_NB) != 0) {
    if (errno == EWOULDBLOCK)
      return fail(ErrorCode::bad_input, dir.string(),
                  "another process is writing this dataset; wait for it, or give another folder with -o");
    return tl::unexpected<Error>(output_error(dir, errno));
  }
  return {};
}

Status DatasetFolder::Impl::check_manifest() {
  const fs::path file = dir / kManifest;
  std::error_code ec;
  if (fs::exists(file, ec)) {
    const json there = json::parse(read_whole(file), nullptr, false);
    if (there.is_discarded() || !there.is_object())
      return fail(
          ErrorCode::bad_input, file.string(),
          "expected what an earlier `rigor dataset` wrote, got something else; give another folder with -o");
    const std::string d = manifest_difference(there, manifest);
    if (!d.empty())
      return fail(
          ErrorCode::bad_input, file.string(),
          "expected a folder of the same dataset, to be continued; " + d + "; give another folder with -o");
    return {};
  }
  for (const auto& entry : fs::directory_iterator(dir, ec)) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with(".dataset."))
      return fail(
          ErrorCode::bad_input, dir.string(),
          fmt::format("expected an empty folder or a dataset, got one with {} in it; give another with -o",
                      name));
  }
  return write_output(file, manifest.dump(2) + "\n");
}

/// Files that another process began.
void DatasetFolder::Impl::remove_parts() const {
  std::error_code ec;
  std::vector<fs::path> parts;
  for (auto it = fs::recursive_directory_iterator(dir, ec); !ec && it != fs::recursive_directory_iterator();
       it.increment(ec)) {
    const std::string name = it->path().filename().string();
    if (name.starts_with(".") && name.find(".part") != std::string::npos) parts.push_back(it->path());
  }
  for (const fs::path& part : parts) fs::remove(part, ec);
}

Result<std::unique_ptr<DatasetFolder>> DatasetFolder::open(const fs::path& dir, const Dataset& dataset,
                                                           const DatasetOutputOptions& given) {
  auto options = checked_output_options(given, dataset);
  if (!options) return tl::unexpected<Error>(options.error());
  std::unique_ptr<DatasetFolder> folder(
      new DatasetFolder(std::unique_ptr<Impl>(new Impl{dir, dataset, std::move(*options), -1, {}})));
  Impl& f = *folder->impl_;
  f.manifest = dataset.manifest();
  f.manifest["folder"] = {{"layers", f.options.layers},
                          {"arrays", f.options.exr ? "exr" : "npy"},
                          {"min_area_px", f.options.min_area_px}};
  if (auto s = f.take(); !s) return tl::unexpected<Error>(s.error());
  if (auto s = f.check_manifest(); !s) return tl::unexpected<Error>(s.error());
  f.remove_parts();
  return folder;
}

bool DatasetFolder::has(std::uint64_t index) const {
  std::error_code ec;
  return fs::exists(impl_->sample_file(index), ec);
}

Status DatasetFolder::Impl::write_layers(const std::string& name, const DatasetView& view, json& files) {
  const std::size_t w = view.width, h = view.height;
  const auto wanted = [&](const char* layer) {
    return std::find(options.layers.begin(), options.layers.end(), layer) != options.layers.end();
  };
  const auto put = [&](const char* layer, const char* ending, const std::string& bytes) -> Status {
    const fs::path file = fs::path(view.channel) / layer / (name + ending);
    files[layer] = file.generic_string();
    return write_output(dir / file, bytes);
  };
  const auto numbers = [&](const char* layer, std::span<const float> values, std::size_t depth,
                           const std::vector<std::string>& planes) -> Status {
    if (!options.exr) {
      std::vector<std::size_t> shape{h, w};
      if (depth > 1) shape.push_back(depth);
      return put(layer, ".npy", npy::floats(values, shape));
    }
    std::vector<ExrPlane> exr;
    for (std::size_t k = 0; k < depth; ++k)
      exr.push_back({planes[k], false, values.data() + k, depth * sizeof(float)});
    const auto bytes = exr_bytes(view.width, view.height, exr);
    if (!bytes) return tl::unexpected<Error>(bytes.error());
    return put(layer, ".exr", *bytes);
  };
  if (view.kind == SampleKind::range_image) {
    if (auto s = numbers("range", view.range_m, 1, {"range"}); !s) return s;
    if (auto s = numbers("amplitude", view.amplitude, 1, {"amplitude"}); !s) return s;
  }
  if (view.truth.node.empty()) return {};
  if (wanted("depth"))
    if (auto s = numbers("depth", view.depth_m, 1, {"depth"}); !s) return s;
  if (wanted("true_range"))
    if (auto s = numbers("true_range", view.truth.range_m, 1, {"range"}); !s) return s;
  if (wanted("normal"))
    if (auto s = numbers("normal", view.truth.normal, 3, {"normal.X", "normal.Y", "normal.Z"}); !s) return s;
  if (wanted("flow") && view.truth.flow_px.size() == 2 * w * h)
    if (auto s = numbers("flow", view.truth.flow_px, 2, {"flow.X", "flow.Y"}); !s) return s;
  const auto text = [](const std::vector<std::uint8_t>& bytes) {
    return std::string(bytes.begin(), bytes.end());
  };
  if (wanted("instance"))
    if (auto s = put("instance", ".png",
                     text(png16_of(view.labels.instance, static_cast<int>(w), static_cast<int>(h))));
        !s)
      return s;
  if (wanted("class"))
    return put("class", ".png",
               text(png_of(view.labels.category, static_cast<int>(w), static_cast<int>(h), 1)));
  return {};
}

Status DatasetFolder::Impl::write_view(const DatasetSample& sample, const DatasetView& view,
                                       json& described) {
  const std::string name = number(sample.index);
  json files = json::object();
  described = dataset::described(view, dataset.options().truth, options.min_area_px);
  if (view.kind == SampleKind::point_cloud) {
    const fs::path file = fs::path(view.channel) / "points" / (name + ".npy");
    files["points"] = file.generic_string();
    if (auto s = write_output(dir / file, points_npy(view)); !s) return s;
  } else {
    if (view.kind == SampleKind::image) {
      const auto png = picture_bytes(".png", view.image, view.pixels);
      if (!png) return tl::unexpected<Error>(png.error());
      const fs::path file = fs::path(view.channel) / "image" / (name + ".png");
      files["image"] = file.generic_string();
      if (auto s = write_output(dir / file, *png); !s) return s;
    }
    if (auto s = write_layers(name, view, files); !s) return s;
  }
  described["files"] = std::move(files);
  return {};
}

Status DatasetFolder::write(const DatasetSample& sample) {
  Impl& f = *impl_;
  json j = dataset::described(sample);
  json channels = json::object();
  for (const DatasetView& view : sample.views)
    if (auto s = f.write_view(sample, view, channels[view.channel]); !s) return s;
  j["channels"] = std::move(channels);
  return write_output(f.sample_file(sample.index), j.dump() + "\n");
}

Result<DatasetSummary> DatasetFolder::finish() {
  return dataset::summarize(impl_->dir, impl_->manifest, impl_->dataset, impl_->options.min_area_px);
}

}  // namespace rigor
