// The files that commands write: one rule for all of them (docs/recording.md, "What is written where").
//
//   InputFiles inputs;                       // what the command reads
//   inputs.add("the world", options.world);
//   Outputs outputs(std::move(inputs));      // before the work: nothing is touched yet
//   if (auto s = outputs.add(options.output, "-o", Existing::refuse); !s) return report_error(…);
//   …
//   write_output(options.output, bytes);     // after it: whole or not at all
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rt-core/result.h"

namespace rigor {

struct RigConfig;

/// What a command reads, known by device and inode, so that links of both kinds are seen through.
class InputFiles {
 public:
  /// `what` names it in the message: "the rig". A file that is not there is no input.
  void add(const std::string& what, const std::filesystem::path& file);
  /// The rig, and the files that it and those files name.
  void add_rig(const RigConfig& rig);
  /// Each once, sorted.
  [[nodiscard]] std::vector<std::string> names() const;

 private:
  friend class Outputs;
  struct File {
    std::string what, name;
    dev_t device;
    ino_t inode;
  };
  void add_named_in(const std::string& text, const std::filesystem::path& base_dir, const std::string& what,
                    int depth);
  std::vector<File> files_;
};

/// What happens to a file that has an output's name.
enum class Existing : std::uint8_t {
  refuse,  ///< an error: tools that make one product
  keep,    ///< it is renamed, NAME.1.mcap: runs and replays, whose names stand in rigs
  replace  ///< --force
};

/// What a command is going to write. Setup context; touches nothing.
class Outputs {
 public:
  explicit Outputs(InputFiles inputs) : inputs_(std::move(inputs)) {}
  /// Refuses an input, another output of the command, a folder, a place that cannot be written, a recording
  /// that another run is writing, and with Existing::refuse any file. bad_input, not_writable. Folders that
  /// are not there are made later. `option` names it in the message.
  [[nodiscard]] Status add(const std::filesystem::path& file, std::string_view option, Existing existing);
  /// A folder that a report goes to: index.html, result.json and pictures.
  [[nodiscard]] Status add_report(const std::filesystem::path& dir);

 private:
  InputFiles inputs_;
  std::vector<std::filesystem::path> outputs_;
};

/// Writes `bytes` to `part`, and has the kernel put them on the medium. disk_full, not_writable, io.
[[nodiscard]] Status write_bytes(const std::filesystem::path& part, std::string_view bytes);
/// Makes the folder, has `write` fill a file beside `file`, and gives that the name; after an error or a
/// signal that ends the process nothing is left. Devices (/dev/null) are written directly.
[[nodiscard]] Status write_output(const std::filesystem::path& file,
                                  const std::function<Status(const std::filesystem::path& part)>& write);
[[nodiscard]] Status write_output(const std::filesystem::path& file, std::string_view bytes);

/// Existing::keep: renames what is there to the next number, and says so on stderr. Its new name; empty where
/// nothing was there.
[[nodiscard]] Result<std::filesystem::path> keep_earlier(const std::filesystem::path& file);

/// Existing::keep, of files that belong together: moves them to a folder with the next number in theirs, and
/// says so on stderr, with the first.
[[nodiscard]] Status keep_earlier_files(const std::filesystem::path& dir,
                                        const std::vector<std::string>& names);

/// A report's files by name into `dir`, all or none; index.html is written last. An earlier report there is
/// moved to a folder with the next number, in which it still works, unless `existing` is replace.
[[nodiscard]] Status write_report_files(const std::filesystem::path& dir,
                                        const std::vector<std::pair<std::string, std::string>>& files,
                                        Existing existing);

/// Where links lead to, also one that leads to nothing yet.
[[nodiscard]] std::filesystem::path resolve_links(const std::filesystem::path& file);
/// A name beside `file` that no other process uses, with the same extension.
[[nodiscard]] std::filesystem::path part_name(const std::filesystem::path& file);
/// NAME.N.EXT with the next number.
[[nodiscard]] std::filesystem::path next_number(const std::filesystem::path& file);
/// The error of a system call that was to write `file`.
[[nodiscard]] Error output_error(const std::filesystem::path& file, int error);

}  // namespace rigor
