// Materials of a file that assimp has read. For model_file.cpp alone.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "sim/render/content/content.h"

struct aiMaterial;
struct aiScene;

namespace rigor::render {

class ModelMaterials {
 public:
  ModelMaterials(const aiScene& scene, std::filesystem::path folder, std::shared_ptr<const Surface> infrared)
      : scene_(scene), folder_(std::move(folder)), infrared_(std::move(infrared)) {}
  /// Never null. What cannot be had is told in warnings().
  [[nodiscard]] std::shared_ptr<const Surface> surface(unsigned index);
  [[nodiscard]] const std::vector<std::string>& warnings() const noexcept { return warnings_; }

 private:
  /// A picture by the name that the file gives it, embedded or beside it; empty where it cannot be had.
  std::shared_ptr<const Texture> picture(const std::string& name, bool srgb);
  std::shared_ptr<const Surface> make(const aiMaterial& material);

  const aiScene& scene_;
  std::filesystem::path folder_;
  std::shared_ptr<const Surface> infrared_;
  std::map<unsigned, std::shared_ptr<const Surface>> made_;
  std::map<std::pair<std::string, bool>, std::shared_ptr<const Texture>> pictures_;
  std::vector<std::string> warnings_;
};

}  // namespace rigor::render
