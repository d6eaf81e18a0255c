// What the classes of land cover products mean here, and what grows on a cover where nobody says.
#pragma once

#include <string_view>
#include <utility>
#include <vector>

#include "sim/gis/draft.h"

namespace rigor::gis {

/// From a raster's value to the index of its word in kCoverWords; kUnknownCover where it has none.
inline constexpr std::uint8_t kUnknownCover = 255;
class CoverClasses {
 public:
  /// From the source's classes, else from the file's category names. bad_input: neither, a word that is none,
  /// a value that is no number or stands there twice.
  [[nodiscard]] static Result<CoverClasses> make(const ImportSource& source,
                                                 const std::vector<std::string>& categories,
                                                 const std::string& where);
  [[nodiscard]] bool knows(double value) const;
  [[nodiscard]] std::uint8_t word(double value) const;

 private:
  std::vector<std::pair<double, std::uint8_t>> words_;  // by value
};

/// The GroundVegetation of a cover; null: nothing grows there.
[[nodiscard]] std::optional<DraftNode> vegetation_of(std::uint8_t word);

/// Fills what lies in the areas: an area wins over what comes from a later source, and over a larger area of
/// its own.
void burn(std::vector<CoverArea> areas, const Grid& grid, std::vector<std::uint8_t>& cells,
          std::vector<int>& source_of_cell);

}  // namespace rigor::gis
