// The zip file of an FMU, read with care: it comes from anybody.
//
// Refused when it is opened: names that lead out of the folder (`..`, absolute, with a backslash or a colon),
// symbolic links, two entries of one name, more entries or bytes than Limits. The sizes that an archive
// states are not believed: what is unpacked is counted.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::fmu {

/// Setup context; one thread at a time.
class FmuArchive {
 public:
  struct Limits {
    std::size_t entries = 20'000;
    std::size_t name_bytes = 1024;
    std::uint64_t total_bytes = std::uint64_t{2} << 30;  ///< unpacked
  };
  /// not_found; bad_input: no zip file, or one that is refused.
  [[nodiscard]] static Result<FmuArchive> open(const std::filesystem::path& file, const Limits& limits);
  [[nodiscard]] static Result<FmuArchive> open(const std::filesystem::path& file) {
    return open(file, Limits());
  }
  /// `bytes` outlive it; `name` is for errors.
  [[nodiscard]] static Result<FmuArchive> from_memory(std::span<const std::byte> bytes,
                                                      const std::string& name, const Limits& limits);
  FmuArchive(FmuArchive&&) noexcept;
  FmuArchive& operator=(FmuArchive&&) noexcept;
  ~FmuArchive();

  /// Names of all entries; folders end with `/`.
  [[nodiscard]] const std::vector<std::string>& names() const;
  [[nodiscard]] bool has(std::string_view name) const;
  /// The bytes of an entry. not_found; bad_input: damaged, or more than `max_bytes`.
  [[nodiscard]] Result<std::string> read(std::string_view name, std::uint64_t max_bytes) const;
  /// Writes the entries whose names begin with one of `prefixes` under `folder`, which exists and is empty.
  [[nodiscard]] Status extract(const std::filesystem::path& folder,
                               std::span<const std::string> prefixes) const;

 private:
  struct Impl;
  explicit FmuArchive(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Whether an entry may lie under the folder into which an archive is unpacked. Empty: yes; else why not.
[[nodiscard]] std::string refused_name(std::string_view name);

}  // namespace rigor::fmu
