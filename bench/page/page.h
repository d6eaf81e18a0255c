// What the HTML reports share: the frame of the page with its style and the script of its plots. One file, no
// network.
#pragma once

#include <string>

namespace rigor {

/// Text as HTML shows it.
[[nodiscard]] std::string html_text(const std::string& text);
/// A whole page. `title` is text; `subtitle` and `body` are HTML.
[[nodiscard]] std::string html_page(const std::string& title, const std::string& subtitle,
                                    const std::string& body);

}  // namespace rigor
