#include "bench/files/installed_configs.h"

#include <dlfcn.h>

#include <algorithm>
#include <fstream>

namespace rigor {
namespace {

namespace fs = std::filesystem;

/// The comment at the head of a file, up to its first full stop.
std::string first_sentence(const fs::path& file) {
  std::ifstream in(file);
  std::string text, line;
  while (std::getline(in, line) && line.starts_with('#')) {
    const auto begin = line.find_first_not_of("# ");
    if (begin == std::string::npos) break;
    text += (text.empty() ? "" : " ") + line.substr(begin);
    for (std::size_t stop = text.find('.'); stop != std::string::npos; stop = text.find('.', stop + 1))
      if (stop + 1 == text.size() || text[stop + 1] == ' ') return text.substr(0, stop);
  }
  return text;
}

/// Of the program or library that this code is part of, the nearest first: PREFIX/bin, PREFIX; PREFIX/lib/…,
/// PREFIX; SOURCE/build/PRESET, SOURCE/build, SOURCE.
std::vector<fs::path> folders_above() {
  std::vector<fs::path> folders;
  Dl_info object{};
  if (dladdr(reinterpret_cast<void*>(&first_sentence), &object) == 0 || !object.dli_fname) return folders;
  std::error_code error;
  // Of the program itself, the name is as it was typed.
  fs::path file = fs::read_symlink("/proc/self/exe", error);
  if (const fs::path library = fs::canonical(object.dli_fname, error);
      !error && library.extension() != file.extension())
    file = library;
  for (int i = 0; i < 4 && file.has_relative_path(); ++i) folders.push_back(file = file.parent_path());
  return folders;
}

}  // namespace

fs::path installed_configs() {
  std::error_code error;
  for (const fs::path& above : folders_above())
    for (const char* folder : {"share/rigor/configs", "configs"})
      if (fs::is_regular_file(above / folder / "demo.yaml", error)) return above / folder;
  return {};
}

fs::path installed_program() {
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  if (program.filename() == "rigor") return program;
  for (const fs::path& above : folders_above())
    for (const char* file : {"bin/rigor", "rigor"})
      if (fs::is_regular_file(above / file, error)) return above / file;
  return {};
}

fs::path installed_clients() {
  std::error_code error;
  const fs::path configs = installed_configs();
  const fs::path folder = configs.parent_path() / "clients";
  return !configs.empty() && fs::is_directory(folder, error) ? folder : fs::path();
}

fs::path find_config(const fs::path& name) {
  std::error_code error;
  if (name.empty() || name.is_absolute() || fs::exists(name, error)) return name;
  const fs::path folder = installed_configs();
  if (folder.empty()) return name;
  fs::path tail = name.lexically_normal();
  if (*tail.begin() == "..") return name;
  if (*tail.begin() == "configs") tail = tail.lexically_relative("configs");
  for (const char* sub : {"", "rigs"})
    for (const char* ending : {"", ".yaml"}) {
      fs::path file = folder / sub / tail;
      file += ending;
      if (fs::is_regular_file(file, error)) return file;
    }
  return name;
}

std::vector<InstalledRig> installed_rigs() {
  std::vector<InstalledRig> all;
  const fs::path folder = installed_configs();
  std::error_code error;
  for (const fs::path& sub : {folder, folder / "rigs"})
    for (const auto& entry : fs::directory_iterator(sub, error)) {
      const fs::path& file = entry.path();
      if (folder.empty() || file.extension() != ".yaml" || file.stem().extension() == ".lock") continue;
      all.push_back({file.stem().string(), first_sentence(file), file});
    }
  std::sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return all;
}

}  // namespace rigor
