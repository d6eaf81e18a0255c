#include "sim/render/models/model_file.h"

#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include <assimp/Importer.hpp>
#include <cmath>
#include <exception>
#include <system_error>
#include <utility>

#include "sim/render/models/mesh_builder.h"
#include "sim/render/models/model_material.h"

namespace rigor::render {
namespace {

namespace fs = std::filesystem;
using Eigen::Matrix4d;
using Eigen::Vector3d;

constexpr unsigned kSteps = aiProcess_Triangulate | aiProcess_SortByPType | aiProcess_GenSmoothNormals |
                            aiProcess_JoinIdenticalVertices | aiProcess_FindInvalidData | aiProcess_FlipUVs |
                            aiProcess_TransformUVCoords | aiProcess_ValidateDataStructure;

Matrix4d matrix_of(const aiMatrix4x4& m) {
  Matrix4d out;
  for (unsigned r = 0; r < 4; ++r)
    for (unsigned c = 0; c < 4; ++c) out(r, c) = static_cast<double>(m[r][c]);
  return out;
}

// Counts what the hierarchy will make: a mesh that many nodes show counts for each.
std::uint64_t count_vertices(const aiScene& scene, const aiNode& node) {
  std::uint64_t n = 0;
  for (unsigned i = 0; i < node.mNumMeshes; ++i) n += scene.mMeshes[node.mMeshes[i]]->mNumVertices;
  for (unsigned i = 0; i < node.mNumChildren && n <= kMostModelVertices; ++i)
    n += count_vertices(scene, *node.mChildren[i]);
  return n;
}

class Baker {
 public:
  Baker(const aiScene& scene, ModelMaterials& materials) : scene_(scene), materials_(materials) {}

  void bake(const aiNode& node, const Matrix4d& T_file_parent) {
    const Matrix4d T = T_file_parent * matrix_of(node.mTransformation);
    for (unsigned i = 0; i < node.mNumMeshes; ++i) add(*scene_.mMeshes[node.mMeshes[i]], T);
    for (unsigned i = 0; i < node.mNumChildren; ++i) bake(*node.mChildren[i], T);
  }

  MeshBuilder builder;
  std::uint64_t not_finite = 0;
  bool vertex_colours = false;

 private:
  void add(const aiMesh& mesh, const Matrix4d& T) {
    if (!(mesh.mPrimitiveTypes & aiPrimitiveType_TRIANGLE) || !mesh.HasFaces() || !mesh.HasPositions())
      return;
    const Eigen::Matrix3d linear = T.topLeftCorner<3, 3>();
    // Normals go by the cofactors, which are the inverse transpose without its division, and keep its sign.
    const bool mirrored = linear.determinant() < 0;
    Eigen::Matrix3d cofactors;
    for (int c = 0; c < 3; ++c) cofactors.col(c) = linear.col((c + 1) % 3).cross(linear.col((c + 2) % 3));
    if (mirrored) cofactors = -cofactors;
    std::vector<Vertex> vertices(mesh.mNumVertices);
    std::vector<bool> good(mesh.mNumVertices);
    for (unsigned i = 0; i < mesh.mNumVertices; ++i) {
      const aiVector3D& a = mesh.mVertices[i];
      const Vector3d p = (T * Eigen::Vector4d(a.x, a.y, a.z, 1)).head<3>();
      Vector3d n = Vector3d::UnitZ();
      if (mesh.HasNormals())
        n = cofactors * Vector3d(mesh.mNormals[i].x, mesh.mNormals[i].y, mesh.mNormals[i].z);
      n = n.allFinite() && n.norm() > 0 ? Vector3d(n.normalized()) : Vector3d(Vector3d::UnitZ());
      good[i] = p.allFinite() && p.cwiseAbs().maxCoeff() < 1e9;
      for (int k = 0; k < 3; ++k) {
        vertices[i].position[k] = good[i] ? static_cast<float>(p[k]) : 0.0F;
        vertices[i].normal[k] = static_cast<float>(n[k]);
      }
      if (mesh.HasTextureCoords(0)) {
        const aiVector3D& uv = mesh.mTextureCoords[0][i];
        vertices[i].uv[0] = std::isfinite(uv.x) ? uv.x : 0.0F;
        vertices[i].uv[1] = std::isfinite(uv.y) ? uv.y : 0.0F;
      }
    }
    vertex_colours = vertex_colours || mesh.HasVertexColors(0);
    std::vector<std::uint32_t> indices;
    indices.reserve(static_cast<std::size_t>(mesh.mNumFaces) * 3);
    for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
      const aiFace& face = mesh.mFaces[f];
      if (face.mNumIndices != 3) continue;
      std::uint32_t v[] = {face.mIndices[0], face.mIndices[1], face.mIndices[2]};
      if (v[0] >= mesh.mNumVertices || v[1] >= mesh.mNumVertices || v[2] >= mesh.mNumVertices) continue;
      if (!good[v[0]] || !good[v[1]] || !good[v[2]]) {
        ++not_finite;
        continue;
      }
      if (mirrored) std::swap(v[1], v[2]);
      indices.insert(indices.end(), std::begin(v), std::end(v));
    }
    if (!indices.empty()) builder.append(materials_.surface(mesh.mMaterialIndex), vertices, indices);
  }

  const aiScene& scene_;
  ModelMaterials& materials_;
};

}  // namespace

Result<ModelMesh> load_model(const fs::path& file, const std::shared_ptr<const Surface>& infrared) {
  const std::string where = file.string();
  std::error_code ec;
  if (!fs::is_regular_file(file, ec))
    return fail(ErrorCode::not_found, where, "expected a model file (glTF, OBJ …); there is none");
  try {
    Assimp::Importer importer;
    importer.SetPropertyInteger(AI_CONFIG_PP_SBP_REMOVE, aiPrimitiveType_POINT | aiPrimitiveType_LINE);
    // Where a file has no normals: edges sharper than this stay sharp.
    importer.SetPropertyFloat(AI_CONFIG_PP_GSN_MAX_SMOOTHING_ANGLE, 45.0F);
    const aiScene* scene = importer.ReadFile(where, kSteps);
    if (!scene || !scene->mRootNode)
      return fail(ErrorCode::bad_input, where, std::string("assimp: ") + importer.GetErrorString());
    if (count_vertices(*scene, *scene->mRootNode) > kMostModelVertices)
      return fail(ErrorCode::bad_input, where,
                  "more than " + std::to_string(kMostModelVertices) +
                      " vertices; expected fewer: simplify the model");
    ModelMaterials materials(*scene, file.parent_path(), infrared);
    Baker baker(*scene, materials);
    baker.bake(*scene->mRootNode, Matrix4d::Identity());
    if (baker.builder.empty()) return fail(ErrorCode::bad_input, where, "expected faces, got none");
    ModelMesh out{.mesh = baker.builder.finish(), .warnings = materials.warnings()};
    if (baker.not_finite > 0)
      out.warnings.push_back(std::to_string(baker.not_finite) +
                             " faces with corners that are not finite were left out");
    if (baker.vertex_colours) out.warnings.emplace_back("colours of vertices are not used");
    return out;
  } catch (const std::exception& e) {
    return fail(ErrorCode::bad_input, where, std::string("assimp: ") + e.what());
  }
}

}  // namespace rigor::render
