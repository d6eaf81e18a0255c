#include "sim/fmu/unpacked_fmu.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <set>
#include <sstream>

#include "sensor-hal/config/did_you_mean.h"
#include "sim/fmu/fmu_archive.h"

namespace rigor::fmu {
namespace {

namespace fs = std::filesystem;

constexpr const char* kDescription = "modelDescription.xml";
constexpr const char* kTerminals = "terminalsAndIcons/terminalsAndIcons.xml";

#if defined(__x86_64__)
constexpr const char* kPlatforms2[] = {"linux64", "x86_64-linux"};
constexpr const char* kPlatforms3[] = {"x86_64-linux", "linux64"};
#elif defined(__aarch64__)
constexpr const char* kPlatforms2[] = {"aarch64-linux"};
constexpr const char* kPlatforms3[] = {"aarch64-linux"};
#else
#error "which folder of an FMU has the binaries for this machine?"
#endif

Result<ModelDescription> describe(const FmuArchive& archive, const std::string& file) {
  const auto xml = archive.read(kDescription, kMaxDescriptionBytes);
  if (!xml) return tl::unexpected<Error>(xml.error());
  auto description = parse_model_description(*xml, file + "/" + kDescription);
  if (!description || !archive.has(kTerminals)) return description;
  const auto terminals = archive.read(kTerminals, kMaxDescriptionBytes);
  if (!terminals) return tl::unexpected<Error>(terminals.error());
  if (auto s = parse_terminals(*terminals, file + "/" + kTerminals, *description); !s)
    return tl::unexpected<Error>(s.error());
  return description;
}

std::vector<std::string> platforms_of(const FmuArchive& archive) {
  std::set<std::string> found;
  constexpr std::string_view kBinaries = "binaries/";
  for (const std::string& name : archive.names()) {
    if (!name.starts_with(kBinaries)) continue;
    const std::string rest = name.substr(kBinaries.size());
    if (const std::size_t slash = rest.find('/'); slash != std::string::npos && slash + 1 < rest.size())
      found.insert(rest.substr(0, slash));
  }
  return {found.begin(), found.end()};
}

}  // namespace

Result<FmuFile> read_fmu(const fs::path& file) {
  const auto archive = FmuArchive::open(file);
  if (!archive) return tl::unexpected<Error>(archive.error());
  auto description = describe(*archive, file.string());
  if (!description) return tl::unexpected<Error>(description.error());
  return FmuFile{std::move(*description), platforms_of(*archive)};
}

Result<std::unique_ptr<UnpackedFmu>> UnpackedFmu::open(const fs::path& file) {
  const auto archive = FmuArchive::open(file);
  if (!archive) return tl::unexpected<Error>(archive.error());
  auto description = describe(*archive, file.string());
  if (!description) return tl::unexpected<Error>(description.error());
  if (!description->co_simulation)
    return fail(ErrorCode::bad_input, file.string(),
                std::string("expected an FMU for co-simulation, got one for ") +
                    (description->model_exchange        ? "model exchange alone; export it for co-simulation"
                     : description->scheduled_execution ? "scheduled execution alone"
                                                        : "nothing at all"));
  if (description->co_simulation->needs_execution_tool)
    return fail(ErrorCode::bad_input, file.string(),
                "expected an FMU that runs by itself, got one that needs its tool (needsExecutionTool)");
  std::unique_ptr<UnpackedFmu> out(new UnpackedFmu);
  std::string folder = (fs::temp_directory_path() / "rigor-fmu-XXXXXX").string();
  if (!mkdtemp(folder.data()))
    return fail(ErrorCode::io, folder, std::string("mkdtemp: ") + std::strerror(errno));
  out->folder_ = folder;
  out->description_ = std::move(*description);
  std::vector<std::string> wanted{kDescription, "resources/", kTerminals};
  for (const char* p : out->description_.version == FmiVersion::v2 ? kPlatforms2 : kPlatforms3)
    wanted.push_back(std::string("binaries/") + p + "/");
  if (auto s = archive->extract(out->folder_, wanted); !s) return tl::unexpected<Error>(s.error());
  std::error_code none;
  fs::create_directories(out->folder_ / "resources", none);
  if (const auto binary = binary_of(out->folder_, out->description_); !binary)
    return fail(ErrorCode::bad_input, file.string(),
                fmt::format("expected a binary of {} for this machine ({}), found those for {}",
                            out->description_.co_simulation->model_identifier, kPlatforms3[0],
                            joined_or_none(platforms_of(*archive))));
  return out;
}

UnpackedFmu::~UnpackedFmu() {
  std::error_code none;
  if (!folder_.empty()) fs::remove_all(folder_, none);
}

Result<ModelDescription> read_description(const fs::path& folder) {
  const auto text_of = [](const fs::path& file) {
    std::ostringstream text;
    text << std::ifstream(file, std::ios::binary).rdbuf();
    return text.str();
  };
  auto description =
      parse_model_description(text_of(folder / kDescription), (folder / kDescription).string());
  std::error_code none;
  if (!description || !fs::exists(folder / kTerminals, none)) return description;
  if (auto s = parse_terminals(text_of(folder / kTerminals), (folder / kTerminals).string(), *description);
      !s)
    return tl::unexpected<Error>(s.error());
  return description;
}

Result<fs::path> binary_of(const fs::path& folder, const ModelDescription& description) {
  std::error_code none;
  for (const char* p : description.version == FmiVersion::v2 ? kPlatforms2 : kPlatforms3) {
    fs::path file = folder / "binaries" / p / (description.co_simulation->model_identifier + ".so");
    if (fs::is_regular_file(file, none)) return file;
  }
  return fail(ErrorCode::not_found, folder.string(), "no binary for this machine");
}

Status apply_start_values(ModelDescription& description, const StartValues& values,
                          const std::string& where) {
  for (const auto& [name, value] : values) {
    const auto found = description.find(name);
    if (!found) {
      const auto names =
          description.names_of({Causality::parameter, Causality::structural_parameter, Causality::input});
      return fail(ErrorCode::bad_input, where,
                  fmt::format("expected a variable of the FMU, got \"{}\"{}; parameters and inputs are: {}",
                              name, did_you_mean(name, description.names_of({})), joined_or_none(names)));
    }
    const Variable& v = description.variables[found->variable];
    if (v.name != name)
      return fail(
          ErrorCode::bad_input, where,
          fmt::format("expected the name of a whole variable, got \"{}\"; give all values of {} with spaces "
                      "between them",
                      name, v.name));
    const bool settable = v.causality == Causality::parameter ||
                          v.causality == Causality::structural_parameter || v.causality == Causality::input ||
                          !v.start.empty();
    if (!settable || v.variability == Variability::constant || v.type == VariableType::binary ||
        v.type == VariableType::clock)
      return fail(
          ErrorCode::bad_input, where,
          fmt::format("expected a parameter, an input or a variable with a start value, got {}, which is of "
                      "causality {}, variability {} and type {}",
                      name, name_of(v.causality), name_of(v.variability), name_of(v.type)));
    if (v.causality != Causality::structural_parameter) continue;
    std::uint32_t size = 0;
    const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), size);
    if (error != std::errc() || end != value.data() + value.size())
      return fail(
          ErrorCode::bad_input, where,
          fmt::format("expected a whole number for the structural parameter {}, got \"{}\"", name, value));
    if (auto s = set_structural_parameter(description, v.value_reference, size, where); !s) return s;
  }
  return {};
}

}  // namespace rigor::fmu
