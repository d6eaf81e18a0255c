#include "sim/render/content/surface_library.h"

#include <algorithm>
#include <cctype>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <span>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "sensor-hal/config/yaml.h"

namespace rigor::render {

/// The files of configs/materials/, name and text, made by the build.
extern const std::pair<std::string_view, std::string_view> kBuiltinMaterials[];
extern const std::size_t kBuiltinMaterialFiles;

namespace {

namespace fs = std::filesystem;

constexpr const char* kBandKeys[kBandCount] = {"620_nm", "550_nm", "460_nm", "850_nm", "905_nm", "1550_nm"};

Spectrum read_spectrum(const ConfigNode& n) {
  Spectrum s{};
  for (std::size_t b = 0; b < s.size(); ++b)
    s[b] = static_cast<float>(n.number(kBandKeys[b], {.min = 0, .max = 1}));
  n.finish();
  return s;
}

std::shared_ptr<const Surface> read_surface(const ConfigNode& n, const std::string& name) {
  auto s = std::make_shared<Surface>();
  s->name = name;
  if (n.text("source").empty()) throw n.error("source", "expected where the numbers come from, got nothing");
  s->reflectance = read_spectrum(n.map("reflectance"));
  const auto transmittance = n.map_or_absent("transmittance");
  if (transmittance.present()) s->transmittance = read_spectrum(transmittance);
  s->two_sided = transmittance.present();
  s->roughness = static_cast<float>(n.number("roughness", {.min = 0.01, .max = 1}));
  s->metallic = static_cast<float>(n.number_or("metallic", 0, {.min = 0, .max = 1}));
  s->retro_reflection = static_cast<float>(n.number_or("retro_reflection", 0, {.min = 0, .max = 1}));
  s->porosity = static_cast<float>(n.number("porosity", {.min = 0, .max = 1}));
  s->takes_snow = n.flag_or("takes_snow", true);
  s->water = n.flag_or("water", false);
  n.finish();
  for (std::size_t b = 0; b < s->reflectance.size(); ++b)
    if (s->reflectance[b] + s->transmittance[b] + s->retro_reflection > 1.0001F)
      throw n.error("reflectance",
                    std::string("expected reflectance + transmittance + retro_reflection of at "
                                "most 1 in each band, got more at ") +
                        kBandKeys[b]);
  return s;
}

bool is_material_name(std::string_view name) {
  return !name.empty() && std::islower(static_cast<unsigned char>(name.front())) &&
         std::all_of(name.begin(), name.end(), [](unsigned char c) {
           return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
         });
}

void read_file(const ConfigNode& root, SurfaceLibrary& into) {
  for (const auto& name : root.keys()) {
    if (!is_material_name(name))
      throw root.error(name, "expected a material's name in lower case with underscores");
    if (name == "unknown") throw root.error(name, "`unknown` is what materials without an entry look like");
    if (into.find(name)) throw root.error(name, "this material is already in another file of the folder");
    into.put(read_surface(root.map(name), name));
  }
  root.finish();
}

Result<Spectrum> spectrum_of(const world::Numbers& n, const std::string& where, std::string_view what) {
  Spectrum s{};
  if (n.size() != s.size())
    return fail(ErrorCode::bad_input, where,
                std::string(what) + ": expected " + std::to_string(kBandCount) +
                    " numbers (620, 550, 460, 850, 905, 1550 nm), got " + std::to_string(n.size()));
  for (std::size_t b = 0; b < s.size(); ++b) s[b] = static_cast<float>(n[b]);
  return s;
}

constexpr std::uintmax_t kMaxTextureBytes = 256u << 20;
constexpr int kMaxTextureSide = 16384;

/// 8 bits a channel, red first, as the file has its channels: 1, 3 or 4.
Result<cv::Mat> decode(std::vector<unsigned char>& bytes, const std::string& where) {
  cv::Mat m;
  try {
    m = cv::imdecode(bytes, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception& e) {
    return fail(ErrorCode::bad_input, where, "the picture cannot be read: " + std::string(e.err));
  }
  if (m.empty())
    return fail(ErrorCode::bad_input, where,
                "expected a whole picture file (PNG, JPEG, TIFF, BMP, WebP), got something else or a part");
  if (m.cols > kMaxTextureSide || m.rows > kMaxTextureSide)
    return fail(ErrorCode::bad_input, where,
                "expected at most " + std::to_string(kMaxTextureSide) + " texels a side, got " +
                    std::to_string(m.cols) + "x" + std::to_string(m.rows) + "; make it smaller");
  if (m.depth() == CV_16U)
    m.convertTo(m, CV_8U, 1.0 / 257.0);
  else if (m.depth() != CV_8U)
    return fail(ErrorCode::bad_input, where,
                "expected 8 or 16 bit whole numbers a channel, got another kind; store it as PNG");
  return m;
}

}  // namespace

const SurfaceLibrary& SurfaceLibrary::builtin() {
  static const SurfaceLibrary library = [] {
    SurfaceLibrary l;
    for (const auto& [name, text] : std::span(kBuiltinMaterials, kBuiltinMaterialFiles)) {
      const auto root = ConfigDocument::parse(text, name);
      if (!root) throw std::logic_error(root.error().text());
      if (auto read = catch_config([&] { return read_file(*root, l), true; }); !read)
        throw std::logic_error(read.error().text());
    }
    return l;
  }();
  return library;
}

Result<SurfaceLibrary> SurfaceLibrary::load(const fs::path& folder) {
  std::error_code ec;
  if (!fs::is_directory(folder, ec))
    return fail(ErrorCode::not_found, folder.string(), "expected a folder with material files (*.yaml)");
  std::vector<fs::path> files;
  for (fs::directory_iterator it(folder, ec), end; !ec && it != end; it.increment(ec))
    if (it->path().extension() == ".yaml") files.push_back(it->path());
  if (ec) return fail(ErrorCode::io, folder.string(), "the folder cannot be read: " + ec.message());
  std::sort(files.begin(), files.end());
  SurfaceLibrary library;
  for (const auto& file : files) {
    const auto root = ConfigDocument::load(file);
    if (!root) return tl::unexpected(root.error());
    if (auto read = catch_config([&] { return read_file(*root, library), true; }); !read)
      return tl::unexpected(read.error());
  }
  return library;
}

std::shared_ptr<const Surface> SurfaceLibrary::find(std::string_view name) const {
  const auto it = surfaces_.find(name);
  return it == surfaces_.end() ? nullptr : it->second;
}

std::shared_ptr<const Surface> SurfaceLibrary::get(std::string_view name) const {
  static const std::shared_ptr<const Surface> unknown = [] {
    auto s = std::make_shared<Surface>();
    s->name = "unknown";
    return s;
  }();
  auto s = find(name);
  return s ? s : unknown;
}

std::vector<std::string> SurfaceLibrary::names() const {
  std::vector<std::string> all;
  for (const auto& [name, surface] : surfaces_) all.push_back(name);
  return all;
}

void SurfaceLibrary::put(std::shared_ptr<const Surface> surface) {
  if (surface) surfaces_[surface->name] = std::move(surface);
}

Result<std::shared_ptr<const Surface>> surface_of(const world::Snapshot& world, NodeId material,
                                                  const fs::path& base_dir) {
  const std::string id = "material node " + std::to_string(material.value);
  if (!world.contains(material)) return fail(ErrorCode::not_found, id, "there is no such node in this world");
  const world::types::Material t(world.schema());
  if (!world.is_a(material, t.type))
    return fail(ErrorCode::bad_input, id,
                "expected a Material, got a " + world.schema().type(*world.type_of(material)).name);
  auto s = std::make_shared<Surface>();
  s->name = world.get_or_default(material, t.name);
  const std::string where = s->name.empty() ? id : id + " (" + s->name + ")";
  if (const auto like = SurfaceLibrary::builtin().find(s->name)) {
    s->takes_snow = like->takes_snow;
    s->porosity = like->porosity;
    s->water = like->water;
    s->two_sided = like->two_sided;
  }
  auto reflectance = spectrum_of(world.get_or_default(material, t.reflectance), where, "reflectance");
  if (!reflectance) return tl::unexpected(reflectance.error());
  auto transmittance = spectrum_of(world.get_or_default(material, t.transmittance), where, "transmittance");
  if (!transmittance) return tl::unexpected(transmittance.error());
  s->reflectance = *reflectance;
  s->transmittance = *transmittance;
  for (std::size_t b = 0; b < s->reflectance.size(); ++b) {
    if (s->reflectance[b] + s->transmittance[b] > 1.0001F)
      return fail(
          ErrorCode::bad_input, where,
          std::string("expected reflectance + transmittance of at most 1 in each band, got more at ") +
              kBandKeys[b]);
    if (s->transmittance[b] > 0) s->two_sided = true;
  }
  s->roughness = static_cast<float>(world.get_or_default(material, t.roughness));
  s->retro_reflection = static_cast<float>(world.get_or_default(material, t.retro_reflection));
  s->metallic = static_cast<float>(world.get_or_default(material, t.metallic));
  const auto map = [&](world::Attribute<std::string> a, bool srgb,
                       std::shared_ptr<const Texture>& out) -> Status {
    const std::string& file = world.get_or_default(material, a);
    if (file.empty()) return {};
    auto texture = load_texture(base_dir / file, srgb);
    if (!texture)
      return fail(texture.error().code, where + ", " + texture.error().where, texture.error().message);
    out = std::move(*texture);
    return {};
  };
  if (auto m = map(t.colour_map, true, s->colour_map); !m) return tl::unexpected(m.error());
  if (auto m = map(t.normal_map, false, s->normal_map); !m) return tl::unexpected(m.error());
  if (auto m = map(t.gloss_map, false, s->gloss_map); !m) return tl::unexpected(m.error());
  return std::shared_ptr<const Surface>(std::move(s));
}

Result<std::shared_ptr<const Texture>> load_texture(const fs::path& file, bool srgb) {
  const std::string where = file.string();
  std::error_code ec;
  if (!fs::is_regular_file(file, ec))
    return fail(ErrorCode::not_found, where, "expected a picture file; there is none");
  const auto size = fs::file_size(file, ec);
  if (ec || size > kMaxTextureBytes)
    return fail(ErrorCode::bad_input, where, "expected a picture file of at most 256 MiB");
  std::vector<unsigned char> bytes(size);
  std::ifstream in(file, std::ios::binary);
  if (size == 0 || !in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(size)))
    return fail(ErrorCode::bad_input, where, "expected a picture file, got an empty or unreadable one");
  auto m = decode(bytes, where);
  if (!m) return tl::unexpected(m.error());
  cv::Mat rgba;
  switch (m->channels()) {
    case 1:
      cv::cvtColor(*m, rgba, cv::COLOR_GRAY2RGBA);
      break;
    case 3:
      cv::cvtColor(*m, rgba, cv::COLOR_BGR2RGBA);
      break;
    case 4:
      cv::cvtColor(*m, rgba, cv::COLOR_BGRA2RGBA);
      break;
    default:
      return fail(ErrorCode::bad_input, where,
                  "expected grey, RGB or RGBA, got " + std::to_string(m->channels()) + " channels");
  }
  auto texture = std::make_shared<Texture>();
  texture->width = static_cast<std::uint32_t>(rgba.cols);
  texture->height = static_cast<std::uint32_t>(rgba.rows);
  texture->srgb = srgb;
  texture->rgba.assign(rgba.datastart, rgba.dataend);
  return std::shared_ptr<const Texture>(std::move(texture));
}

}  // namespace rigor::render
