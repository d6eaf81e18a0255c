#include "tests/sim/fmu/made_fmu.h"

#include <sys/stat.h>
#include <zip.h>

#include <cstdlib>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "tests/paths.h"

namespace rigor::test {

namespace fs = std::filesystem;

Folder::Folder() {
  std::string name = (fs::temp_directory_path() / "rigor-test-fmu-XXXXXX").string();
  if (!mkdtemp(name.data())) throw std::runtime_error("mkdtemp " + name);
  path_ = name;
}
Folder::~Folder() {
  std::error_code none;
  fs::remove_all(path_, none);
}

std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw std::runtime_error("cannot read " + file.string());
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}
void write_text(const fs::path& file, const std::string& text) {
  std::ofstream(file, std::ios::binary) << text;
}

void write_zip(const fs::path& file, const std::map<std::string, std::string>& entries,
               const std::vector<std::string>& links) {
  int error = 0;
  zip_t* const zip = zip_open(file.c_str(), ZIP_CREATE | ZIP_TRUNCATE, &error);
  if (!zip) throw std::runtime_error("zip_open " + file.string());
  for (const auto& [name, bytes] : entries) {
    zip_source_t* const source = zip_source_buffer(zip, bytes.data(), bytes.size(), 0);
    const zip_int64_t index = zip_file_add(zip, name.c_str(), source, ZIP_FL_ENC_UTF_8);
    if (index < 0) throw std::runtime_error(std::string("zip_file_add: ") + zip_strerror(zip));
    for (const std::string& link : links)
      if (link == name)
        zip_file_set_external_attributes(zip, static_cast<zip_uint64_t>(index), 0, ZIP_OPSYS_UNIX,
                                         static_cast<zip_uint32_t>(S_IFLNK | 0777) << 16);
  }
  if (zip_close(zip) != 0) throw std::runtime_error(std::string("zip_close: ") + zip_strerror(zip));
}

std::optional<fs::path> reference_fmus() {
  fs::path folder = test_data("reference_fmus");
  if (!fs::exists(folder / "include")) return std::nullopt;
  return folder;
}

void compile(const std::vector<std::string>& words) {
  std::string command = "cc";
  for (const std::string& w : words) command += " '" + w + "'";
  const Folder folder;
  const fs::path said = folder / "said";
  if (std::system((command + " 2>'" + said.string() + "'").c_str()) != 0)
    throw std::runtime_error(command + ": " + text_of(said));
}

std::string platform(int version) {
#if defined(__aarch64__)
  (void)version;
  return "aarch64-linux";
#else
  return version == 2 ? "linux64" : "x86_64-linux";
#endif
}

std::optional<fs::path> make_reference_fmu(const Folder& folder, const std::string& model, int version) {
  const auto sources = reference_fmus();
  const std::string v = std::to_string(version);
  if (!sources || !fs::exists(*sources / model / ("FMI" + v + ".xml"))) return std::nullopt;
  const fs::path library = folder / (model + v + ".so"), file = folder / (model + v + ".fmu");
  compile({"-shared", "-fPIC", "-O1", "-w", "-fvisibility=hidden", "-DDISABLE_PREFIX", "-DFMI_VERSION=" + v,
           "-I" + (*sources / "include").string(), "-I" + (*sources / model).string(),
           (*sources / model / "model.c").string(), (*sources / "src" / ("fmi" + v + "Functions.c")).string(),
           (*sources / "src" / "cosimulation.c").string(), "-o", library.string(), "-lm"});
  std::map<std::string, std::string> entries{
      {"modelDescription.xml", text_of(*sources / model / ("FMI" + v + ".xml"))},
      {"binaries/" + platform(version) + "/" + model + ".so", text_of(library)}};
  if (model == "Resource") entries["resources/y.txt"] = text_of(*sources / model / "y.txt");
  write_zip(file, entries);
  return file;
}

fs::path make_faulty_fmu(const Folder& folder, int version) {
  const std::string v = std::to_string(version);
  const fs::path here = fs::path(source_dir()) / "tests/sim/fmu";
  const fs::path library = folder / ("faulty" + v + ".so"), file = folder / ("faulty" + v + ".fmu");
  if (fs::exists(file)) return file;
  compile({"-shared", "-fPIC", "-O1", "-Wall", "-DFMI_VERSION=" + v, (here / "faulty.c").string(), "-o",
           library.string()});
  write_zip(file, {{"modelDescription.xml", text_of(here / ("faulty" + v + ".xml"))},
                   {"terminalsAndIcons/terminalsAndIcons.xml", text_of(here / "faulty_terminals.xml")},
                   {"binaries/" + platform(version) + "/faulty.so", text_of(library)}});
  return file;
}

}  // namespace rigor::test
