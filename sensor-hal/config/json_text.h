// JSON that another program wrote: what clients, applications and files say.
//
// Text of 250 KB can nest 125 000 lists. The parser takes that, but whoever copies, compares or writes such a
// value recurses once for each level and overflows the stack. So all JSON that comes from outside this
// process is read here, and what nests deeper than anything of this project is refused before it is parsed:
//
//   const auto request = parse_json(line, "request");    // "request: expected JSON nested at most 64 levels
//   deep, …" if (!request) return answer_with(request.error());
//
// JSON that this process has written itself needs no limits.
#pragma once

#include <cstddef>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "rt-core/result.h"

namespace rigor {

inline constexpr std::size_t kMaxJsonDepth = 64;                     ///< lists and objects within each other
inline constexpr std::size_t kMaxJsonBytes = std::size_t{16} << 20;  ///< of one text

/// bad_input at `where` for text that is too long, nests too deeply or is not JSON; the message gives limit
/// and what came. Any thread; allocates; its own stack does not grow with the text.
[[nodiscard]] Result<nlohmann::json> parse_json(std::string_view text, std::string where = {},
                                                std::size_t max_bytes = kMaxJsonBytes);

}  // namespace rigor
