// FMUs that tests make: compiled by the system's `cc`, zipped with libzip.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace rigor::test {

/// A folder that is gone with the object.
class Folder {
 public:
  Folder();
  ~Folder();
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

std::string text_of(const std::filesystem::path& file);
void write_text(const std::filesystem::path& file, const std::string& text);
/// Entries by name. `links`: names of entries that are made symbolic links.
void write_zip(const std::filesystem::path& file, const std::map<std::string, std::string>& entries,
               const std::vector<std::string>& links = {});

/// The Modelica Association's Reference FMUs among the test data; empty: there is none.
std::optional<std::filesystem::path> reference_fmus();
/// Compiles and zips the reference FMU `model` for FMI 2 or 3. Empty: the sources have none of this version.
std::optional<std::filesystem::path> make_reference_fmu(const Folder& folder, const std::string& model,
                                                        int version);

/// tests/sim/fmu/faulty.c as FMU of FMI 2 or 3: an integrator that fails on demand.
std::filesystem::path make_faulty_fmu(const Folder& folder, int version = 3);
/// `cc` with these words; throws with its messages.
void compile(const std::vector<std::string>& words);
/// Name of the folder of binaries in an FMU for this machine.
std::string platform(int version);

}  // namespace rigor::test
