// Keys and values of configurations that earlier versions knew by another name: they are refused, and the
// message says what they are called now.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace rigor {

/// What `word` is called now, where that is one of `candidates`; otherwise empty. Any thread.
[[nodiscard]] std::string renamed(std::string_view word, const std::vector<std::string>& candidates);
/// The same of an option of a command, `--renderer`; empty where it was never one.
[[nodiscard]] std::string_view renamed_option(std::string_view word);

}  // namespace rigor
