#include "sim/render/models/model_material.h"

#include <assimp/GltfMaterial.h>
#include <assimp/material.h>
#include <assimp/scene.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <utility>

#include "sim/render/content/surface_library.h"
#include "sim/render/content/texels.h"
#include "sim/render/models/model_file.h"

namespace rigor::render {
namespace {

// The library's name for what a modelling program calls `Glass.001`.
std::string plain_name(std::string name) {
  const auto dot = name.find_last_of('.');
  if (dot != std::string::npos && dot + 1 < name.size() &&
      name.find_first_not_of("0123456789", dot + 1) == std::string::npos)
    name.resize(dot);
  for (char& c : name) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    if (c == ' ' || c == '-') c = '_';
  }
  return name;
}

// Mean of red, green and blue over the texels that are there.
float mean_factor(const Texture& t) {
  const float* const linear = linear_of_bytes(t.srgb);
  double sum = 0, weight = 0;
  for (std::size_t i = 0; i + 3 < t.rgba.size(); i += 4) {
    if (t.rgba[i + 3] < 128) continue;
    sum += (linear[t.rgba[i]] + linear[t.rgba[i + 1]] + linear[t.rgba[i + 2]]) / 3;
    weight += 1;
  }
  return weight > 0 ? static_cast<float>(sum / weight) : 1.0F;
}

bool is_grey(const Texture& t) {
  for (std::size_t i = 0; i + 3 < t.rgba.size(); i += 4)
    if (t.rgba[i] != t.rgba[i + 1] || t.rgba[i] != t.rgba[i + 2]) return false;
  return true;
}

// A bump map holds heights; engines want directions.
std::shared_ptr<const Texture> normals_from_heights(const Texture& bump) {
  auto out = std::make_shared<Texture>(bump);
  out->serial = next_serial();
  out->srgb = false;
  const auto w = static_cast<int>(bump.width), h = static_cast<int>(bump.height);
  const auto height = [&](int x, int y) {
    const auto at =
        static_cast<std::size_t>((y + h) % h) * bump.width + static_cast<std::size_t>((x + w) % w);
    return static_cast<float>(bump.rgba[4 * at]) / 64.0F;
  };
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const float nx = (height(x - 1, y) - height(x + 1, y)) / 2,
                  ny = (height(x, y + 1) - height(x, y - 1)) / 2;
      const float length = std::sqrt(nx * nx + ny * ny + 1);
      const std::size_t at = 4 * (static_cast<std::size_t>(y) * bump.width + static_cast<std::size_t>(x));
      const float n[] = {nx / length, ny / length, 1 / length};
      for (std::size_t k = 0; k < 3; ++k)
        out->rgba[at + k] = static_cast<std::uint8_t>(std::lround(127.5F * (n[k] + 1)));
    }
  return out;
}

struct Slot {
  std::string name;
  bool repeat = true;
};
std::optional<Slot> slot_of(const aiMaterial& m, std::initializer_list<aiTextureType> types) {
  for (const aiTextureType type : types) {
    aiString path;
    if (m.GetTextureCount(type) == 0 || m.GetTexture(type, 0, &path) != aiReturn_SUCCESS || path.length == 0)
      continue;
    int mode = aiTextureMapMode_Wrap;
    m.Get(AI_MATKEY_MAPPINGMODE_U(type, 0), mode);
    return Slot{path.C_Str(), mode != aiTextureMapMode_Clamp};
  }
  return std::nullopt;
}

std::shared_ptr<const Texture> clamped(const std::shared_ptr<const Texture>& t, const Slot& slot) {
  if (!t || slot.repeat) return t;
  auto out = std::make_shared<Texture>(*t);
  out->serial = next_serial();
  out->repeat = false;
  return out;
}

std::optional<float> number(const aiMaterial& m, const char* key, unsigned type, unsigned index) {
  float v = 0;
  if (m.Get(key, type, index, v) != aiReturn_SUCCESS || !std::isfinite(v)) return std::nullopt;
  return v;
}
std::optional<aiColor3D> colour(const aiMaterial& m, const char* key, unsigned type, unsigned index) {
  aiColor3D c;
  if (m.Get(key, type, index, c) != aiReturn_SUCCESS) return std::nullopt;
  return c;
}

// glTF keeps roughness in green; our map multiplies 1 − roughness.
void take_roughness_map(Surface& s, const Texture& map, float factor) {
  auto gloss = std::make_shared<Texture>(map);
  gloss->serial = next_serial();
  gloss->srgb = false;
  float most = 0, metal = 0;
  for (std::size_t i = 0; i + 3 < map.rgba.size(); i += 4) {
    most = std::max(most, 1 - factor * static_cast<float>(map.rgba[i + 1]) / 255);
    metal += static_cast<float>(map.rgba[i + 2]) / 255;
  }
  for (std::size_t i = 0; i + 3 < map.rgba.size(); i += 4) {
    const float g = 1 - factor * static_cast<float>(map.rgba[i + 1]) / 255;
    for (std::size_t k = 0; k < 3; ++k)
      gloss->rgba[i + k] = static_cast<std::uint8_t>(std::lround(255 * g / std::max(most, 1e-6F)));
    gloss->rgba[i + 3] = 255;
  }
  s.metallic *= metal / static_cast<float>(map.width * map.height);
  s.roughness = std::clamp(1 - most, 0.01F, 1.0F);
  s.gloss_map = std::move(gloss);
}

}  // namespace

std::shared_ptr<const Texture> ModelMaterials::picture(const std::string& name, bool srgb) {
  const auto [at, fresh] = pictures_.try_emplace({name, srgb});
  if (!fresh) return at->second;
  const auto refuse = [&](const std::string& why) {
    warnings_.push_back(fmt::format("picture {}: {}; left out", name, why));
    return nullptr;
  };
  std::shared_ptr<Texture> out;
  if (const aiTexture* embedded = scene_.GetEmbeddedTexture(name.c_str())) {
    cv::Mat rgba;
    if (embedded->mHeight == 0) {
      const cv::Mat bytes(1, static_cast<int>(embedded->mWidth), CV_8U, embedded->pcData);
      cv::Mat decoded;
      try {
        decoded = cv::imdecode(bytes, cv::IMREAD_COLOR);
        if (const cv::Mat whole = cv::imdecode(bytes, cv::IMREAD_UNCHANGED); whole.type() == CV_8UC4)
          decoded = whole;
      } catch (const cv::Exception& e) {
        return refuse(e.what());
      }
      if (decoded.empty()) return refuse("not a picture that can be read");
      cv::cvtColor(decoded, rgba, decoded.channels() == 4 ? cv::COLOR_BGRA2RGBA : cv::COLOR_BGR2RGBA);
    } else {
      const cv::Mat texels(static_cast<int>(embedded->mHeight), static_cast<int>(embedded->mWidth), CV_8UC4,
                           embedded->pcData);
      cv::cvtColor(texels, rgba, cv::COLOR_BGRA2RGBA);
    }
    out = std::make_shared<Texture>();
    out->width = static_cast<std::uint32_t>(rgba.cols);
    out->height = static_cast<std::uint32_t>(rgba.rows);
    out->rgba.assign(rgba.datastart, rgba.dataend);
    out->srgb = srgb;
  } else {
    std::string relative = name;
    std::replace(relative.begin(), relative.end(), '\\', '/');
    auto loaded = load_texture(folder_ / relative, srgb);
    if (!loaded) return refuse(loaded.error().message);
    out = std::make_shared<Texture>(**loaded);
  }
  if (out->width > kMostTexturePixels || out->height > kMostTexturePixels)
    return refuse(fmt::format("{} x {} pixels, expected at most {} along a side", out->width, out->height,
                              kMostTexturePixels));
  return at->second = std::move(out);
}

std::shared_ptr<const Surface> ModelMaterials::surface(unsigned index) {
  const auto [at, fresh] = made_.try_emplace(index);
  if (fresh)
    at->second =
        index < scene_.mNumMaterials ? make(*scene_.mMaterials[index]) : SurfaceLibrary::builtin().get("");
  return at->second;
}

std::shared_ptr<const Surface> ModelMaterials::make(const aiMaterial& m) {
  auto s = std::make_shared<Surface>();
  s->name = m.GetName().C_Str();
  aiColor3D base(0.6F, 0.6F, 0.6F);
  if (const auto c = colour(m, AI_MATKEY_BASE_COLOR))
    base = *c;
  else if (const auto d = colour(m, AI_MATKEY_COLOR_DIFFUSE))
    base = *d;
  const float rgb[] = {base.r, base.g, base.b};
  for (std::size_t k = 0; k < 3; ++k)
    s->reflectance[k] = std::isfinite(rgb[k]) ? std::clamp(rgb[k], 0.0F, 1.0F) : 0.5F;
  if (const auto slot = slot_of(m, {aiTextureType_BASE_COLOR, aiTextureType_DIFFUSE}))
    s->colour_map = clamped(picture(slot->name, true), *slot);

  // Beyond what a picture shows. A known reflectance is that of the whole surface, picture included.
  const auto known = infrared_ ? infrared_ : SurfaceLibrary::builtin().find(plain_name(s->name));
  const float mean = (s->reflectance[0] + s->reflectance[1] + s->reflectance[2]) / 3;
  const float factor = s->colour_map && known ? std::max(mean_factor(*s->colour_map), 0.01F) : 1.0F;
  for (std::size_t b = 3; b < s->reflectance.size(); ++b)
    s->reflectance[b] = known ? std::min(1.0F, known->reflectance[b] / factor) : mean;
  if (known) {
    s->retro_reflection = known->retro_reflection;
    s->porosity = known->porosity;
    s->takes_snow = known->takes_snow;
  }

  if (const auto slot = slot_of(m, {aiTextureType_NORMALS, aiTextureType_NORMAL_CAMERA})) {
    s->normal_map = clamped(picture(slot->name, false), *slot);
  } else if (const auto bump = slot_of(m, {aiTextureType_HEIGHT})) {
    if (const auto t = clamped(picture(bump->name, false), *bump))
      s->normal_map = is_grey(*t) ? normals_from_heights(*t) : t;
  }

  const auto roughness = number(m, AI_MATKEY_ROUGHNESS_FACTOR);
  const auto metallic = number(m, AI_MATKEY_METALLIC_FACTOR);
  if (roughness || metallic) {
    const float r = std::clamp(roughness.value_or(1.0F), 0.0F, 1.0F);
    s->roughness = std::max(r, 0.01F);
    s->metallic = std::clamp(metallic.value_or(0.0F), 0.0F, 1.0F);
    const auto slot =
        slot_of(m, {aiTextureType_DIFFUSE_ROUGHNESS, aiTextureType_UNKNOWN, aiTextureType_METALNESS});
    if (const auto t = slot ? picture(slot->name, false) : nullptr) take_roughness_map(*s, *t, r);
  } else {
    const auto specular = colour(m, AI_MATKEY_COLOR_SPECULAR);
    const bool shines = specular && specular->r + specular->g + specular->b > 0.01F;
    const float exponent = number(m, AI_MATKEY_SHININESS).value_or(0.0F);
    if (shines && exponent > 1) s->roughness = std::clamp(std::sqrt(2 / (exponent + 2)), 0.05F, 1.0F);
  }

  bool two_sided = false;
  if (m.Get(AI_MATKEY_TWOSIDED, two_sided) == aiReturn_SUCCESS) s->two_sided = two_sided;
  aiString mode;
  const bool has_mode = m.Get(AI_MATKEY_GLTF_ALPHAMODE, mode) == aiReturn_SUCCESS;
  if (has_mode && s->colour_map && std::string(mode.C_Str()) != "OPAQUE")
    s->alpha_cutoff = number(m, AI_MATKEY_GLTF_ALPHACUTOFF).value_or(0.5F);
  if (const auto slot = slot_of(m, {aiTextureType_OPACITY}); slot && !has_mode) {
    const auto mask = picture(slot->name, false);
    if (mask && s->colour_map && mask->width == s->colour_map->width &&
        mask->height == s->colour_map->height) {
      auto cut = std::make_shared<Texture>(*s->colour_map);
      cut->serial = next_serial();
      const bool own_alpha = std::any_of(mask->rgba.begin(), mask->rgba.end(),
                                         [i = 0](std::uint8_t v) mutable { return i++ % 4 == 3 && v < 255; });
      for (std::size_t i = 0; i + 3 < cut->rgba.size(); i += 4)
        cut->rgba[i + 3] = mask->rgba[i + (own_alpha ? 3 : 0)];
      s->colour_map = std::move(cut);
      s->alpha_cutoff = 0.5F;
    } else if (mask) {
      warnings_.push_back(
          fmt::format("material {}: its opacity map needs a colour map of the same size; left out", s->name));
    }
  }
  return s;
}

}  // namespace rigor::render
