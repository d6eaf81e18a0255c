#include <fmt/format.h>

#include <cmath>
#include <map>
#include <set>
#include <system_error>
#include <utility>

#include "sim/render/content/surface_library.h"
#include "sim/render/models/model_file.h"
#include "sim/render/models/posed_items.h"
#include "sim/render/models/providers.h"
#include "sim/world/semantic_types.h"

namespace rigor::render {
namespace {

namespace fs = std::filesystem;
using world::Snapshot;

struct Types {
  explicit Types(const world::Schema& s) : model(s), material(s) {}
  world::types::Model model;
  world::types::Material material;
};

// The node's frame is x right, y forward, z up; a y-up file's is x right, y up, z back.
const Eigen::Quaterniond kFromYUp(Eigen::AngleAxisd(std::acos(0.0), Eigen::Vector3d::UnitX()));

class ModelProvider final : public ContentProvider {
 public:
  explicit ModelProvider(fs::path base_dir) : base_dir_(std::move(base_dir)) {}

  [[nodiscard]] std::string_view name() const override { return "models"; }

  void rebuild(const Snapshot& world) override {
    items_.clear();
    surfaces_.clear();
    world_ = world;
    const Types t(world.schema());
    std::set<Key> used;
    for (const NodeId node : world.nodes(t.model.type)) make(t, node, &used);
    std::erase_if(files_, [&](const auto& f) { return !used.contains(f.first); });
  }

  void apply(const world::ChangeSet& changes) override {
    world_ = changes.after;
    const auto& schema = world_.schema();
    const Types t(schema);
    std::set<NodeId> dirty;
    for (const world::Change& c : changes.changes) {
      if (schema.is_a(c.type, t.material.type)) {
        surfaces_.erase(c.node);
        std::erase_if(files_, [&](const auto& f) { return f.first.second == c.node; });
        for (const NodeId n : items_.made_with(c.node)) dirty.insert(n);
      } else if (schema.is_a(c.type, t.model.type) && changes_shape(schema, c)) {
        dirty.insert(c.node);
      }
    }
    for (const NodeId node : dirty) {
      items_.erase(node);
      if (world_.contains(node)) make(t, node, nullptr);
    }
  }

  void collect(const ContentQuery& query, ContentFrame& frame) override {
    items_.collect(world_, query, frame);
  }
  [[nodiscard]] std::vector<std::string> warnings() const override { return items_.warnings(); }

 private:
  using SurfacePtr = std::shared_ptr<const Surface>;
  using Key = std::pair<std::string, NodeId>;  // a file, and the Material that tells its near infrared
  struct Loaded {
    fs::file_time_type written{};
    std::uintmax_t size = 0;
    std::shared_ptr<const Prototype> prototype;
    std::vector<std::string> warnings;
  };

  // As it was read before, where the file has not been written since.
  const Loaded& load(const Key& key, const SurfacePtr& infrared) {
    std::error_code ec;
    const auto written = fs::last_write_time(key.first, ec);
    const auto size = fs::file_size(key.first, ec);
    const auto found = files_.find(key);
    if (found != files_.end() && !ec && found->second.written == written && found->second.size == size &&
        found->second.prototype)
      return found->second;
    Loaded loaded{.written = written, .size = size, .prototype = {}, .warnings = {}};
    auto model = load_model(key.first, infrared);
    if (!model) {
      loaded.warnings.push_back(model.error().text());
    } else {
      auto prototype = std::make_shared<Prototype>();
      prototype->name = fs::path(key.first).filename().string();
      prototype->levels.push_back({std::move(model->mesh), 0.0F});
      loaded.prototype = std::move(prototype);
      loaded.warnings = std::move(model->warnings);
    }
    return files_[key] = std::move(loaded);
  }

  void make(const Types& t, NodeId node, std::set<Key>* used) {
    PosedItem item;
    const std::string& file = world_.get_or_default(node, t.model.file);
    const auto say = [&](const std::string& what) {
      const std::string& called = world_.get_or_default(node, t.model.name);
      item.warnings.push_back(called.empty() ? fmt::format("Model {}: {}", node.value, what)
                                             : fmt::format("Model {} ({}): {}", node.value, called, what));
    };
    if (file.empty()) {
      say("it names no file; not shown");
      items_.put(node, std::move(item));
      return;
    }
    const NodeId material = world_.target(node, t.model.made_of);
    SurfacePtr infrared;
    if (material) {
      item.materials.push_back(material);
      auto found = surfaces_.find(material);
      if (found == surfaces_.end()) {
        auto surface = surface_of(world_, material, base_dir_);
        if (!surface) say(surface.error().text());
        found = surfaces_.emplace(material, surface ? *surface : nullptr).first;
      }
      infrared = found->second;
    }
    const Key key{(base_dir_ / file).lexically_normal().string(), material};
    const Loaded& loaded = load(key, infrared);
    if (used) used->insert(key);
    for (const std::string& w : loaded.warnings) say(w);
    item.prototype = loaded.prototype;
    item.scale = static_cast<float>(world_.get_or_default(node, t.model.scale));
    if (world_.get_or_default(node, t.model.y_up)) item.q_node_mesh = kFromYUp;
    items_.put(node, std::move(item));
  }

  fs::path base_dir_;
  Snapshot world_;
  PosedItems items_;
  std::map<Key, Loaded> files_;
  std::map<NodeId, SurfacePtr> surfaces_;
};

}  // namespace

std::unique_ptr<ContentProvider> make_model_provider(fs::path base_dir) {
  return std::make_unique<ModelProvider>(std::move(base_dir));
}

}  // namespace rigor::render
