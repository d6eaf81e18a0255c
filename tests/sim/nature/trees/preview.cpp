// Pictures of trees: rigor_tree_preview OUT.png …
//   texture FORM                         the foliage atlas of a form (number)
//   row CODE:DBH,… GAP_M HEIGHT_M [LEVEL]  trees side by side; without a level the n-th at level n
//   near CODE DBH RANGE_M EYE_M TARGET_M   one tree
//   stand TREES.csv STAND X Y HEADING_DEG EYE_M PITCH_DEG [allowed_px]  a mapped stand, as an engine would
//   choose levels
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <sstream>
#include <string>

#include "sim/nature/trees/canvas.h"
#include "sim/nature/trees/tree_textures.h"
#include "sim/render/content/texels.h"
#include "tests/sim/nature/trees/raster.h"
#include "tests/sim/nature/trees/tree_world.h"

using namespace rigor;
using namespace rigor::nature;
using namespace rigor::test;

namespace {
void save(const Picture& p, const std::string& file) {
  cv::Mat image(p.height, p.width, CV_8UC3);
  for (int y = 0; y < p.height; ++y)
    for (int x = 0; x < p.width; ++x)
      for (int k = 0; k < 3; ++k)
        image.at<cv::Vec3b>(y, x)[2 - k] =
            render::srgb_bytes().of(p.rgb[3 * (static_cast<std::size_t>(y) * p.width + x) + k]);
  cv::imwrite(file, image);
}
/// A whole tree of a species at its own size; `CODE!` is a snag.
void plant(std::vector<Placed>& scene, std::string code, double dbh, float x, std::size_t variant,
           std::size_t level) {
  const bool dead = code.back() == '!';
  if (dead) code.pop_back();
  // Trees of one species differ by their node's number.
  TreeWorld w;
  w.ground->slope = 0, w.ground->lift = 0;
  std::vector<TreeWorld::Spec> specs;
  for (std::size_t i = 0; i <= variant; ++i)
    specs.push_back({.x = static_cast<double>(x), .species = code, .dbh_m = dbh, .dead = dead});
  const auto node = w.plant(specs).back();
  std::printf("%s dbh %.2f", code.c_str(), dbh);
  for (const auto& b : w.frame().batches)
    for (std::size_t k = 0; k < b->nodes.size(); ++k) {
      if (b->nodes[k] != node) continue;
      render::Instance i = b->instances[k];
      for (int c = 0; c < 3; ++c) i.position[c] += static_cast<float>(b->origin[c]);
      const auto& levels = b->prototype->levels;
      static std::vector<std::shared_ptr<const render::Prototype>> kept;
      kept.push_back(b->prototype);
      scene.push_back({levels[std::min(level, levels.size() - 1)].mesh.get(), i});
      std::printf("; %s, %.1f m high:", b->prototype->name.c_str(), b->bounds.sizes().z());
      for (const auto& l : levels)
        std::printf(" %zu/%.3f m", l.mesh->indices.size() / 3, static_cast<double>(l.error_m));
    }
  std::printf("\n");
}
render::Mesh ground(float half) {
  static auto surface = [] {
    auto s = std::make_shared<render::Surface>();
    s->reflectance = {0.12F, 0.11F, 0.06F, 0.3F, 0.3F, 0.3F};
    return s;
  }();
  render::Mesh m;
  for (int k = 0; k < 4; ++k)
    m.vertices.push_back({{(k & 1 ? half : -half), (k & 2 ? half : -half), 0}, {0, 0, 1}, {0, 0}, 0});
  m.indices = {0, 1, 3, 0, 3, 2};
  m.parts.push_back({0, 6, surface});
  return m;
}
}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) return 2;
  const std::string file = argv[1], what = argv[2];
  std::vector<Placed> scene;
  if (what == "texture") {
    const auto& t = *foliage_surface(static_cast<TreeForm>(std::atoi(argv[3]))).surface->colour_map;
    cv::Mat image(static_cast<int>(t.height), static_cast<int>(t.width), CV_8UC3);
    for (int y = 0; y < image.rows; ++y)
      for (int x = 0; x < image.cols; ++x) {
        const std::uint8_t* p = &t.rgba[4 * (static_cast<std::size_t>(y) * t.width + x)];
        for (int k = 0; k < 3; ++k) image.at<cv::Vec3b>(y, x)[2 - k] = p[3] >= 90 ? p[k] : 40;
      }
    cv::imwrite(file, image);
    return 0;
  }
  static const render::Mesh floor = ground(120);
  scene.push_back({&floor, {}});
  if (what == "row") {  // code dbh spacing level count…
    const float gap = std::strtof(argv[4], nullptr), height = std::strtof(argv[5], nullptr);
    const std::string codes = argv[3];
    int n = 0;
    std::vector<std::pair<std::string, double>> list;
    for (std::size_t i = 0; i < codes.size();) {
      const std::size_t comma = std::min(codes.find(',', i), codes.size()), colon = codes.find(':', i);
      list.emplace_back(codes.substr(i, colon - i), std::strtod(codes.c_str() + colon + 1, nullptr));
      i = comma + 1;
    }
    const std::size_t level = argc > 6 ? std::strtoul(argv[6], nullptr, 10) : 99;
    for (const auto& [code, dbh] : list) {
      plant(scene, code, dbh, (static_cast<float>(n) - 0.5F * static_cast<float>(list.size() - 1)) * gap,
            level == 99 ? 0 : static_cast<std::size_t>(n), level == 99 ? static_cast<std::size_t>(n) : level);
      ++n;
    }
    const float wide = gap * static_cast<float>(list.size());
    Eye eye{{0, -3.0F * std::max(wide, height), 0.45F * height}, {0, 0, 0.5F * height}, 0};
    eye.focal_px = 3.0F * std::max(wide, height) * 720.0F / (height * 1.12F);
    save(lit_picture(scene, eye, static_cast<int>(720.0F * wide / (1.12F * height)), 720,
                     std::max(wide, height) * 0.75F, {0, 0, 0.5F * height}),
         file);
  } else if (what == "near") {  // code dbh distance eye_height target_height
    plant(scene, argv[3], std::atof(argv[4]), 0, 0, 0);
    const float d = std::strtof(argv[5], nullptr), h = std::strtof(argv[6], nullptr),
                t = std::strtof(argv[7], nullptr);
    save(lit_picture(scene, {{0, -d, h}, {0, 0, t}, 800}, 1000, 760, 26, {0, 0, 14}), file);
  } else if (what == "stand") {
    std::ifstream in(argv[3]);
    std::string line;
    std::getline(in, line);
    TreeWorld w;
    w.ground->slope = 0, w.ground->lift = 0;
    std::vector<TreeWorld::Spec> specs;
    while (std::getline(in, line)) {
      std::istringstream cells(line);
      std::string stand, id, species, dbh, x, y;
      std::getline(cells, stand, ','), std::getline(cells, id, ','), std::getline(cells, species, ',');
      std::getline(cells, dbh, ','), std::getline(cells, x, ','), std::getline(cells, y, ',');
      if (stand == argv[4])
        specs.push_back({.x = std::strtod(x.c_str(), nullptr),
                         .y = std::strtod(y.c_str(), nullptr),
                         .species = species,
                         .dbh_m = 0.01 * std::strtod(dbh.c_str(), nullptr)});
    }
    w.plant(specs);
    const float x = std::strtof(argv[5], nullptr), y = std::strtof(argv[6], nullptr),
                heading = std::strtof(argv[7], nullptr) * 0.0174533F;
    const float eye_m = std::strtof(argv[8], nullptr), pitch = std::strtof(argv[9], nullptr) * 0.0174533F;
    const float allowed = argc > 10 ? std::strtof(argv[10], nullptr) : 1.0F;
    const Eigen::Vector3f position(x, y, eye_m),
        ahead(std::sin(heading) * std::cos(pitch), std::cos(heading) * std::cos(pitch), std::sin(pitch));
    const Eye eye{position, position + ahead, 500};
    std::size_t triangles = 0, instances = 0, per_level[5] = {};
    const auto frame = w.frame();
    for (const auto& b : frame.batches)
      for (render::Instance i : b->instances) {
        for (int k = 0; k < 3; ++k) i.position[k] += static_cast<float>(b->origin[k]);
        const Eigen::Vector3f to(i.position[0] - x, i.position[1] - y, 0);
        const float range = std::max(0.5F, to.norm());
        std::size_t level = 0;
        for (std::size_t l = 1; l < b->prototype->levels.size(); ++l)
          if (b->prototype->levels[l].error_m * std::max(i.scale[0], i.scale[2]) <= allowed * range / 500)
            level = l;
        scene.push_back({b->prototype->levels[level].mesh.get(), i});
        const float across = std::abs(to.x() * std::cos(heading) - to.y() * std::sin(heading)),
                    along = to.x() * std::sin(heading) + to.y() * std::cos(heading);
        if (along < -3 || across > 0.64F * std::max(0.0F, along) + 4) continue;
        triangles += b->prototype->levels[level].mesh->indices.size() / 3, ++instances, ++per_level[level];
      }
    std::printf("%zu trees; in view %zu instances (%zu, %zu, %zu, %zu, %zu by level), %zu triangles\n",
                specs.size(), instances, per_level[0], per_level[1], per_level[2], per_level[3], per_level[4],
                triangles);
    save(lit_picture(scene, eye, 640, 480, 95, {50, 50, 20}), file);
  }
  return 0;
}
