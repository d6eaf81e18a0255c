#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>

#include "bench/dataset/dataset_summary.h"
#include "sensor-hal/rig/rig.h"

namespace rigor::dataset {
namespace {

using nlohmann::json;

/// A line of the table of files.
std::string row(const std::string& file, const std::string& what) {
  return fmt::format("| `{}` | {} |\n", file, what);
}

std::string layer_text(const std::string& layer) {
  if (layer == "depth")
    return "float32 (height, width): metres along the optical axis; infinity: nothing there";
  if (layer == "true_range") return "float32 (height, width): metres along the ray; infinity: nothing there";
  if (layer == "normal")
    return "float32 (height, width, 3): unit length, in the sensor's frame; 0: nothing there";
  if (layer == "flow")
    return "float32 (height, width, 2): motion of what is seen there, pixels a second, right and down";
  if (layer == "instance") return "16-bit PNG: `id` of an instance of the sample's file; 0: no thing";
  return "8-bit PNG: the class, as below; 0: nothing";
}

std::string channel_rows(const Dataset::Channel& c, const json& manifest, bool truth) {
  std::string out;
  const std::string ending = manifest["folder"]["arrays"] == "exr" ? ".exr" : ".npy";
  if (c.kind == SampleKind::point_cloud)
    return row(
        c.name + "/points/*.npy",
        fmt::format(
            "structured array: x y z (m, sensor frame: x forward, y left, z up), intensity, t_ns (after "
            "the capture), ring, return{}",
            truth ? "; truth: class (below; 0: none), node, true_range (m)" : ""));
  if (c.kind == SampleKind::image) out += row(c.name + "/image/*.png", "the picture");
  if (c.kind == SampleKind::range_image) {
    out += row(c.name + "/range/*" + ending,
               "float32 (height, width): metres along the ray, as measured; NaN: no return");
    out += row(c.name + "/amplitude/*" + ending, "float32 (height, width), as measured");
  }
  for (const json& layer : manifest["folder"]["layers"]) {
    const auto name = layer.get<std::string>();
    if (name == "flow" && c.kind != SampleKind::image) continue;
    out +=
        row(fmt::format("{}/{}/*{}", c.name, name, name == "instance" || name == "class" ? ".png" : ending),
            "truth: " + layer_text(name));
  }
  return out;
}

}  // namespace

std::string readme(const json& manifest, const Dataset& dataset, const DatasetSummary& summary) {
  const bool truth = dataset.options().truth;
  std::string out = fmt::format(
      "# Dataset from {}\n\nMade by `rigor dataset`, version {}, seed {}. {} samples of {}; `dataset.json` "
      "has all "
      "options and digests of the files that it was made from. The same options give the same bytes.\n\n",
      manifest["options"]["rig"].get<std::string>(), manifest["rigor_version"].get<std::string>(),
      dataset.options().seed, summary.samples, dataset.size());
  if (!summary.rejected.empty() || summary.left_out > 0) {
    out += fmt::format("{} samples were left out, as all of their poses were rejected. Rejected poses:",
                       summary.left_out);
    for (const auto& [reason, count] : summary.rejected) out += fmt::format(" {} {};", count, reason);
    out.back() = '.';
    out += "\n\n";
  }
  out += "## Files\n\n| file | what it is |\n|---|---|\n";
  out += row("samples/*.json",
             "of one sample: `conditions`, `T_world_carrier`, and of each channel `T_world_sensor`, "
             "`intrinsics` (OpenCV's), `device`, `files`, `instances`");
  for (const Dataset::Channel& c : dataset.channels()) out += channel_rows(c, manifest, truth);
  if (truth)
    out +=
        row("annotations/CHANNEL_SPLIT.json",
            fmt::format(
                "COCO: `file_name` is against this folder; `bbox` [x, y, width, height] and `segmentation` "
                "(run-length code) of the visible pixels, {} or more of them; `node`, `name`, `depth_m` "
                "(median), `cut_off` (reaches the picture's edge)",
                manifest["folder"]["min_area_px"].get<int>()));
  out += row("splits/train.txt",
             "numbers of samples; also val, test. A sample's split follows from seed and number");
  out +=
      "\nPoses map the sensor's frame to the world's: x east, y north, z up, metres; quaternions are w x y "
      "z. Sensors' "
      "frames: cameras and range images x right, y down, z forward; point clouds x forward, y left, z up. "
      "Pixel centres "
      "are at whole numbers. Point i of a picture is row i / width, column i % width.\n";
  if (truth) {
    out += "\n## Classes\n\n| id | class | boxes |\n|---|---|---|\n";
    for (const DatasetCategory& c : dataset.categories())
      out +=
          fmt::format("| {} | {} | {} |\n", c.id, c.name, c.thing ? "yes" : "no: ground and what covers it");
  }
  std::string example;
  for (const Dataset::Channel& c : dataset.channels())
    if (c.kind == SampleKind::image && example.empty()) example = c.name;
  if (truth && !example.empty())
    out += fmt::format(
        "\n## In PyTorch\n\n```python\nimport torchvision\ndata = "
        "torchvision.datasets.CocoDetection(root=\".\", "
        "annFile=\"annotations/{}_train.json\")\nimage, boxes = data[0]\n```\n",
        example);
  return out;
}

}  // namespace rigor::dataset
