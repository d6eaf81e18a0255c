#include "bench/dataset/instances.h"

#include <algorithm>
#include <limits>
#include <map>
#include <string_view>
#include <unordered_map>

#include "sim/world/semantic_types.h"

namespace rigor {
namespace {

/// Types whose nodes have no surface.
constexpr std::string_view kUnseen[] = {"Object",      "Place",         "Frame",   "Hinge",
                                        "Material",    "LandCover",     "Imagery", "Atmosphere",
                                        "StudioLight", "WeatherSeries", "Lamp"};
constexpr std::string_view kStuff[] = {"Terrain", "GroundPlane", "GroundVegetation", "Road", "Water"};

template <std::size_t N>
bool among(const std::string_view (&names)[N], std::string_view name) {
  return std::find(std::begin(names), std::end(names), name) != std::end(names);
}

}  // namespace

std::vector<DatasetCategory> dataset_categories(const world::Snapshot& world) {
  const world::Schema& schema = world.schema();
  std::vector<DatasetCategory> out;
  for (std::uint32_t i = 0; i < schema.type_count(); ++i) {
    const world::TypeId type{i};
    const world::TypeSpec& spec = schema.type(type);
    if (spec.abstract || among(kUnseen, spec.name) || world.count(type) == 0) continue;
    out.push_back({0, spec.name, spec.base, !among(kStuff, spec.name)});
  }
  std::sort(out.begin(), out.end(),
            [](const DatasetCategory& a, const DatasetCategory& b) { return a.name < b.name; });
  for (std::size_t i = 0; i < out.size(); ++i) out[i].id = static_cast<int>(i + 1);
  return out;
}

DatasetLabels label(const GroundTruth& truth, std::span<const float> depth_m,
                    const std::vector<DatasetCategory>& categories, const world::Snapshot& world) {
  constexpr std::size_t kMost = std::numeric_limits<std::uint16_t>::max();
  DatasetLabels out;
  const std::size_t n = truth.node.size();
  std::vector<const DatasetCategory*> of_class(truth.class_names.size(), nullptr);
  for (std::size_t c = 0; c < of_class.size(); ++c)
    for (const DatasetCategory& category : categories)
      if (category.name == truth.class_names[c]) of_class[c] = &category;

  struct Thing {
    std::uint32_t left, top, right, bottom, area = 0;
    const DatasetCategory* category = nullptr;
    std::vector<float> depth_m;
  };
  std::map<std::uint64_t, Thing> things;
  out.category.assign(n, 0);
  out.instance.assign(n, 0);
  for (std::size_t i = 0; i < n; ++i) {
    const DatasetCategory* category = of_class[truth.class_index[i]];
    if (!category) continue;
    out.category[i] = static_cast<std::uint8_t>(category->id);
    if (!category->thing) continue;
    const auto x = static_cast<std::uint32_t>(i % truth.width),
               y = static_cast<std::uint32_t>(i / truth.width);
    auto [it, fresh] = things.try_emplace(truth.node[i]);
    Thing& t = it->second;
    if (fresh) {
      t.left = t.right = x;
      t.top = t.bottom = y;
      t.category = category;
    }
    t.left = std::min(t.left, x), t.right = std::max(t.right, x);
    t.top = std::min(t.top, y), t.bottom = std::max(t.bottom, y);
    ++t.area;
    if (i < depth_m.size()) t.depth_m.push_back(depth_m[i]);
  }
  const world::types::Object object(world.schema());
  std::unordered_map<std::uint64_t, std::uint16_t> id_of;
  for (auto& [node, t] : things) {
    if (out.instances.size() == kMost) break;
    DatasetInstance d;
    d.id = static_cast<std::uint16_t>(out.instances.size() + 1);
    d.node = node;
    d.category = t.category->id;
    d.name = world.get_or_default(world::NodeId{node}, object.name);
    d.box_px = {t.left, t.top, t.right - t.left + 1, t.bottom - t.top + 1};
    d.area_px = t.area;
    d.cut_off = t.left == 0 || t.top == 0 || t.right + 1 == truth.width || t.bottom + 1 == truth.height;
    if (!t.depth_m.empty()) {
      const auto middle = t.depth_m.begin() + static_cast<std::ptrdiff_t>(t.depth_m.size() / 2);
      std::nth_element(t.depth_m.begin(), middle, t.depth_m.end());
      d.median_depth_m = *middle;
    }
    id_of[node] = d.id;
    out.instances.push_back(std::move(d));
  }
  for (std::size_t i = 0; i < n; ++i) {
    const DatasetCategory* category = of_class[truth.class_index[i]];
    if (!category || !category->thing) continue;
    const auto it = id_of.find(truth.node[i]);
    if (it != id_of.end()) out.instance[i] = it->second;
  }
  return out;
}

}  // namespace rigor
