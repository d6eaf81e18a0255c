// Prototypes of what grows too densely to be nodes: grass, fern, shrub, flower, litter. Made of real blades
// and of cards with drawn alpha textures; at least three levels of detail each.
#pragma once

#include <memory>
#include <string_view>

#include "sim/render/content/content.h"

namespace rigor::nature {

enum class Plant : std::uint8_t { grass, fern, shrub, flower, litter };
/// Null word: not one of the five.
[[nodiscard]] bool plant_from_word(std::string_view word, Plant& plant);

/// A plant of this height [m] on z = 0 (litter: leaves of this length), about the z axis. `variant` 0 or 1:
/// two individuals. The same arguments give the same mesh.
[[nodiscard]] std::shared_ptr<const render::Prototype> plant_prototype(Plant plant, double height_m,
                                                                       int variant);

/// Pictures on cards. `mean` is the mean of red, green and blue over what is covered, in linear light: the
/// surface's reflectance is divided by it.
struct CardPicture {
  std::shared_ptr<const render::Texture> texture;
  std::array<float, 3> mean{1, 1, 1};
  float coverage = 1;  ///< share of the card that is there
};
enum class Card : std::uint8_t { blade, tuft, frond, fern_side, leaves, leaf, head };
[[nodiscard]] const CardPicture& card_picture(Card card);

}  // namespace rigor::nature
