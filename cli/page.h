// What the HTML reports share: one style, no script, no network.
#pragma once

#include <filesystem>
#include <string>

#include "rt-core/result.h"

namespace rigor {

extern const char* const kPageStyle;
/// Text as HTML shows it.
[[nodiscard]] std::string html_text(const std::string& text);
/// Checks before the work that a report can be written there, and makes the folder. not_writable.
[[nodiscard]] Status prepare_report(const std::filesystem::path& dir);
/// disk_full or not_writable with the reason.
[[nodiscard]] Status write_text_file(const std::filesystem::path& file, const std::string& text);

}  // namespace rigor
