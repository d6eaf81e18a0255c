#include "bench/tune/lock_file.h"

#include <fmt/format.h>
#include <openssl/evp.h>

#include <algorithm>
#include <cstring>
#include <fstream>
#include <sstream>

#include "bench/files/output_file.h"

namespace rigor {
namespace {

class Digest {
 public:
  Digest() : context_(EVP_MD_CTX_new(), &EVP_MD_CTX_free) {
    EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr);
  }
  void bytes(const void* data, std::size_t size) { EVP_DigestUpdate(context_.get(), data, size); }
  /// Its length goes first, so that no two texts run into each other.
  void text(std::string_view s) {
    number(s.size());
    bytes(s.data(), s.size());
  }
  template <class T>
  void number(T v) {
    bytes(&v, sizeof v);
  }
  std::string hex() {
    std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
    EVP_DigestFinal_ex(context_.get(), digest.data(), nullptr);
    std::string s;
    for (std::size_t i = 0; i < 16; ++i) s += fmt::format("{:02x}", digest[i]);
    return s;
  }

 private:
  std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context_;
};

struct DigestValue {
  Digest& digest;
  void operator()(bool v) const { digest.number(v); }
  void operator()(std::int64_t v) const { digest.number(v); }
  void operator()(double v) const { digest.number(v); }
  void operator()(const std::string& v) const { digest.text(v); }
  void operator()(const world::Vector3& v) const { digest.bytes(v.data(), 3 * sizeof(double)); }
  void operator()(const world::Pose& v) const {
    const Eigen::Matrix4d m = v.matrix();
    digest.bytes(m.data(), 16 * sizeof(double));
  }
  void operator()(const world::Motion& v) const {
    digest.number(v.t_ref.ns());
    (*this)(v.T_parent_node);
    (*this)(v.velocity_m_per_s);
    (*this)(v.angular_velocity_rad_per_s);
  }
  void operator()(const world::Numbers& v) const {
    digest.number(v.size());
    digest.bytes(v.span().data(), v.size() * sizeof(double));
  }
  void operator()(const world::Blob& v) const {
    digest.number(v.size());
    digest.bytes(v.span().data(), v.size());
  }
};

}  // namespace

std::filesystem::path lock_path(const std::filesystem::path& rig) {
  return rig.parent_path() / (rig.stem().string() + ".lock.yaml");
}

std::string world_digest(const world::Snapshot& world) {
  Digest digest;
  const world::Schema& schema = world.schema();
  for (std::uint32_t t = 0; t < schema.type_count(); ++t) {
    const world::TypeId type{t};
    std::vector<world::NodeId> nodes;
    for (const world::NodeId node : world.nodes(type))
      if (world.type_of(node) == type) nodes.push_back(node);  // those of subtypes come with theirs
    if (nodes.empty()) continue;
    std::sort(nodes.begin(), nodes.end());
    digest.text(schema.type(type).name);
    for (const auto attribute : schema.attributes(type)) {
      const auto& spec = schema.attribute(attribute).spec;
      if (spec.transient) continue;
      digest.text(spec.name);
      for (const world::NodeId node : nodes)
        if (const auto value = world.get(node, attribute)) std::visit(DigestValue{digest}, *value);
    }
    for (const world::NodeId node : nodes) {
      digest.number(node.value);
      for (std::uint32_t e = 0; e < schema.edge_type_count(); ++e)
        for (const world::NodeId target : world.targets(node, world::EdgeTypeId{e})) {
          digest.number(e);
          digest.number(target.value);
        }
    }
  }
  return digest.hex();
}

Result<std::string> channel_digest(const std::string& world, const ConfigNode& params) {
  return catch_config([&] {
    const std::filesystem::path sensor = params.base_dir() / params.text("sensor");
    std::ifstream in(sensor, std::ios::binary);
    std::stringstream text;
    text << in.rdbuf();
    if (!in)
      throw ConfigError({ErrorCode::not_found, sensor.string(), "expected a sensor's file, found none"});
    Digest digest;
    digest.text(world);
    digest.text(params.dump());
    digest.text(text.str());
    return digest.hex();
  });
}

std::string cpu_name() {
  std::ifstream in("/proc/cpuinfo");
  for (std::string line; std::getline(in, line);)
    if (line.starts_with("model name")) return line.substr(std::min(line.size(), line.find(':') + 2));
  return "unknown";
}

Result<std::optional<LockFile>> load_lock(const std::filesystem::path& file) {
  std::error_code ec;
  if (!std::filesystem::exists(file, ec)) return std::optional<LockFile>{};
  auto root = ConfigDocument::load(file);
  if (!root) return tl::unexpected<Error>(root.error());
  return catch_config([&] {
    LockFile lock;
    if (root->integer("rigor_lock") != 1)
      throw root->error("rigor_lock", "expected 1, which this version reads; type `rigor tune` again");
    lock.cpu = root->text_or("cpu", "");
    lock.gpu = root->text_or("gpu", "");
    const ConfigNode channels = root->map_or_absent("channels");
    for (const std::string& name : channels.keys()) {
      const ConfigNode n = channels.map(name);
      LockedChannel c;
      c.choice = read_locked_choice(n.map("choice"));
      c.p50_ms = n.number_or("p50_ms", 0);
      c.max_ms = n.number_or("max_ms", 0);
      c.range_rmse_m = n.number_or("range_rmse_m", 0);
      c.outliers = n.number_or("outliers", 0);
      c.radiance = n.number_or("radiance", 0);
      c.digest = n.text("digest");
      n.finish();
      lock.channels[name] = std::move(c);
    }
    root->finish();
    return std::optional<LockFile>(std::move(lock));
  });
}

Status save_lock(const std::filesystem::path& file, const LockFile& lock) {
  const auto quoted = [](std::string s) {
    std::erase_if(s, [](char c) { return c == '"' || c == '\\' || static_cast<unsigned char>(c) < 32; });
    return "\"" + s + "\"";
  };
  std::string text =
      "# Written by `rigor tune`: the cheapest engine and quality that meet each channel's tolerance, as "
      "measured "
      "on\n# this machine in this world. Times are those of one sample.\nrigor_lock: 1\n";
  text += fmt::format("cpu: {}\ngpu: {}\nchannels:\n", quoted(lock.cpu), quoted(lock.gpu));
  for (const auto& [name, c] : lock.channels) {
    text += fmt::format("  {}:\n    choice: {}\n    p50_ms: {:.3f}\n    max_ms: {:.3f}\n", name,
                        c.choice.yaml(), c.p50_ms, c.max_ms);
    if (c.radiance > 0)
      text += fmt::format("    radiance: {:.6f}\n", c.radiance);
    else
      text += fmt::format("    range_rmse_m: {:.6f}\n    outliers: {:.6f}\n", c.range_rmse_m, c.outliers);
    text += fmt::format("    digest: {}\n", quoted(c.digest));
  }
  return write_output(file, text);
}

}  // namespace rigor
