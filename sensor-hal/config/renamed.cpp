#include "sensor-hal/config/renamed.h"

#include <algorithm>
#include <array>
#include <utility>

namespace rigor {
namespace {

using Renamed = std::pair<std::string_view, std::string_view>;

constexpr std::array kWords{// keys
                            Renamed{"hand_on", "active"}, Renamed{"engine", "renderer"},
                            Renamed{"effort", "quality"}, Renamed{"becomes", "model_schedule"},
                            Renamed{"sheet", "model"}, Renamed{"walk_mm", "remission_bias_mm"},
                            Renamed{"oblique_mm", "incidence_bias_mm"},
                            // values
                            Renamed{"vulkan", "raster"}, Renamed{"note", "log"}, Renamed{"late", "overdue"},
                            Renamed{"lost", "disconnected"}};
constexpr std::array kOptions{Renamed{"--engine", "--renderer"}, Renamed{"--camera-sheet", "--camera-model"},
                              Renamed{"--second-sheet", "--second-model"},
                              Renamed{"--left-sheet", "--left-model"},
                              Renamed{"--right-sheet", "--right-model"}};

}  // namespace

std::string renamed(std::string_view word, const std::vector<std::string>& candidates) {
  const auto* const found = std::ranges::find(kWords, word, &Renamed::first);
  if (found == kWords.end() || std::ranges::find(candidates, found->second) == candidates.end()) return {};
  return std::string(found->second);
}

std::string_view renamed_option(std::string_view word) {
  word = word.substr(0, word.find('='));
  const auto* const found = std::ranges::find(kOptions, word, &Renamed::first);
  return found == kOptions.end() ? std::string_view() : found->second;
}

}  // namespace rigor
