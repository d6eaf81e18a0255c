// What the HTML reports share: one style, no script, no network.
#pragma once

#include <string>

namespace rigor {

extern const char* const kPageStyle;
/// Text as HTML shows it.
[[nodiscard]] std::string html_text(const std::string& text);

}  // namespace rigor
