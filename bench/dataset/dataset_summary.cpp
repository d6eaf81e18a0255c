#include "bench/dataset/dataset_summary.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <fstream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "bench/files/output_file.h"

namespace rigor::dataset {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kSplits[] = {"train", "val", "test"};

Result<json> read_sample(const fs::path& file) {
  std::ifstream in(file);
  json j = json::parse(in, nullptr, false);
  const bool whole = j.is_object() && j.contains("sample") && j.contains("split") && j.contains("channels") &&
                     j["channels"].is_object() && j.contains("rejected");
  if (!whole)
    return fail(ErrorCode::bad_input, file.string(),
                "expected a sample of a dataset, got something else; remove the file, and start again: it is "
                "made anew");
  return j;
}

struct Known {
  fs::path file;
  std::string split;
};

/// Text into a file, as it comes.
class TextFile {
 public:
  explicit TextFile(fs::path file) : path_(std::move(file)), file_(std::fopen(path_.c_str(), "we")) {
    if (!file_) error_ = errno;
  }
  ~TextFile() {
    if (file_) std::fclose(file_);
  }
  TextFile(const TextFile&) = delete;
  TextFile& operator=(const TextFile&) = delete;
  void put(std::string_view text) {
    if (error_ == 0 && std::fwrite(text.data(), 1, text.size(), file_) != text.size()) error_ = errno;
  }
  Status close() {
    if (file_ && error_ == 0 && (std::fflush(file_) != 0 || ::fdatasync(::fileno(file_)) != 0))
      error_ = errno;
    if (file_ && std::fclose(std::exchange(file_, nullptr)) != 0 && error_ == 0) error_ = errno;
    if (error_ != 0) return tl::unexpected<Error>(output_error(path_, error_));
    return {};
  }

 private:
  fs::path path_;
  std::FILE* file_;
  int error_ = 0;
};

json coco_categories(const std::vector<DatasetCategory>& categories) {
  json out = json::array();
  for (const DatasetCategory& c : categories)
    if (c.thing) out.push_back({{"id", c.id}, {"name", c.name}, {"supercategory", c.base}});
  return out;
}

/// The picture of a channel, and its boxes behind `before`.
struct CocoImage {
  json image;
  std::vector<json> annotations;
};
CocoImage coco_of(const json& sample, const json& view, std::uint32_t min_area_px) {
  const auto index = sample["sample"].get<std::uint64_t>();
  const json& files = view["files"];
  const json& lens = view["intrinsics"];
  CocoImage out;
  out.image = {{"id", index},
               {"file_name", files.contains("image") ? files["image"] : files["range"]},
               {"width", lens["width_px"]},
               {"height", lens["height_px"]},
               {"sample", fmt::format("samples/{:06}.json", index)}};
  for (const json& i : view["instances"]) {
    if (i["area"].get<std::uint32_t>() < min_area_px) continue;
    json a{{"id", index << 16 | i["id"].get<std::uint64_t>()},
           {"image_id", index},
           {"category_id", i["category_id"]},
           {"bbox", i["bbox"]},
           {"area", i["area"]},
           {"iscrowd", 0},
           {"segmentation", {{"size", {lens["height_px"], lens["width_px"]}}, {"counts", i["counts"]}}},
           {"node", i["node"]},
           {"cut_off", i["cut_off"]}};
    for (const char* key : {"name", "depth_m"})
      if (i.contains(key)) a[key] = i[key];
    out.annotations.push_back(std::move(a));
  }
  return out;
}

Result<std::uint64_t> write_annotations(const fs::path& file, const std::string& channel,
                                        const std::string& split, const std::vector<Known>& samples,
                                        const json& categories, std::uint32_t min_area_px) {
  std::uint64_t count = 0;
  auto written = write_output(file, [&](const fs::path& part) -> Status {
    TextFile out(part);
    out.put("{\"info\":{\"description\":\"rigor dataset\"},\n\"categories\":" + categories.dump() +
            ",\n\"annotations\":[");
    std::string images;
    for (const Known& known : samples) {
      if (known.split != split) continue;
      const auto sample = read_sample(known.file);
      if (!sample) return tl::unexpected<Error>(sample.error());
      if (!(*sample)["channels"].contains(channel)) continue;
      const CocoImage coco = coco_of(*sample, (*sample)["channels"][channel], min_area_px);
      images += (images.empty() ? "\n" : ",\n") + coco.image.dump();
      for (const json& a : coco.annotations) {
        out.put(count == 0 ? "\n" : ",\n");
        out.put(a.dump());
        ++count;
      }
    }
    out.put("],\n\"images\":[" + images + "]}\n");
    return out.close();
  });
  if (!written) return tl::unexpected<Error>(written.error());
  return count;
}

}  // namespace

Result<DatasetSummary> summarize(const fs::path& dir, const json& manifest, const Dataset& dataset,
                                 std::uint32_t min_area_px) {
  DatasetSummary summary;
  std::vector<fs::path> files;
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(dir / "samples", ec))
    if (entry.path().extension() == ".json" && !entry.path().filename().string().starts_with("."))
      files.push_back(entry.path());
  // By number: names with more digits come last.
  std::sort(files.begin(), files.end(), [](const fs::path& a, const fs::path& b) {
    const auto &x = a.native(), &y = b.native();
    return x.size() != y.size() ? x.size() < y.size() : x < y;
  });
  std::vector<Known> samples;
  std::map<std::string, std::uint64_t> rejected;
  std::map<std::string, std::string> lists;
  for (const fs::path& file : files) {
    const auto sample = read_sample(file);
    if (!sample) return tl::unexpected<Error>(sample.error());
    for (const json& r : (*sample)["rejected"]) ++rejected[r.value("reason", "")];
    if ((*sample)["channels"].empty()) {
      ++summary.left_out;
      continue;
    }
    ++summary.samples;
    samples.push_back({file, (*sample)["split"].get<std::string>()});
    lists[samples.back().split] += file.stem().string() + "\n";
  }
  summary.rejected.assign(rejected.begin(), rejected.end());
  for (const char* split : kSplits)
    if (auto s = write_output(dir / "splits" / (std::string(split) + ".txt"), lists[split]); !s)
      return tl::unexpected<Error>(s.error());
  if (dataset.options().truth) {
    const json categories = coco_categories(dataset.categories());
    for (const Dataset::Channel& channel : dataset.channels()) {
      if (channel.kind == SampleKind::point_cloud) continue;
      for (const char* split : kSplits) {
        const auto count =
            write_annotations(dir / "annotations" / fmt::format("{}_{}.json", channel.name, split),
                              channel.name, split, samples, categories, min_area_px);
        if (!count) return tl::unexpected<Error>(count.error());
        summary.annotations += *count;
      }
    }
  }
  if (auto s = write_output(dir / "README.md", readme(manifest, dataset, summary)); !s)
    return tl::unexpected<Error>(s.error());
  return summary;
}

}  // namespace rigor::dataset
