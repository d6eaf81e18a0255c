// Masks as COCO has them: lengths of runs of pixels that are not in the mask and that are, in turn, column by
// column from the top left, beginning with those that are not (which may be 0); and these lengths as text, as
// pycocotools and its relatives read it.
//
//   { "size": [height, width], "counts": "…" }
//
// The text: each length from the fourth on as its difference to the last but one; five bits a character, the
// lowest first, 0x20 says that more follow, plus 48; the sign is that of the last five bits.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace rigor::coco {

/// Runs of each id from 1 to `count` in a picture of ids, row by row. An id that is not in it has one run.
[[nodiscard]] std::vector<std::vector<std::uint32_t>> runs_of(std::span<const std::uint16_t> ids,
                                                              std::uint32_t width, std::uint32_t height,
                                                              std::size_t count);
[[nodiscard]] std::string compress(std::span<const std::uint32_t> runs);

}  // namespace rigor::coco
