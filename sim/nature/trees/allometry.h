// What is known of a tree from its species and its diameter: height, crown.
//
//   const Species& s = find_species("TSHE").species;
//   TreeSize size = size_of(s, {.dbh_m = 0.5});        // height 35 m, crown from 13 m up …
//
// Heights follow published curves where there are some; what is a judgement says "approximate" in `source`.
// All functions: any thread, pure.
#pragma once

#include <span>
#include <string_view>

namespace rigor::nature {

/// What a tree looks like: which generator makes it.
enum class TreeForm : unsigned char {
  spruce,       ///< whorls, hanging combs of twigs, tips that rise
  fir,          ///< narrow spire of stiff level fans
  hemlock,      ///< drooping leader and tips, lacy
  douglas_fir,  ///< irregular, bushy branches; old crowns flat and broken
  cedar,        ///< hanging flat sprays on J-shaped branches (Thuja, false cypress)
  yew,          ///< low, wide, dense (Taxus)
  pine,         ///< tufts of long needles at the ends of few branches
  larch,        ///< thin crown, soft tufts
  oak,          ///< broad and round, crooked limbs
  beech,        ///< tall ovate crown, also maple and ash
  birch,        ///< slender, hanging twigs
  shrub         ///< many stems from the ground (mountain alder, vine maple)
};
inline constexpr int kTreeFormCount = 12;
[[nodiscard]] constexpr bool is_conifer(TreeForm f) noexcept { return f <= TreeForm::larch; }

enum class BarkStyle : unsigned char { smooth, ridged, scaly, fibrous, birch };
inline constexpr int kBarkStyleCount = 5;

/// Height above dbh. curtis: H_ft = 4.5 + a·exp(−b·D_in^c) (Curtis 1967, as in FVS); chapman: H_m = 1.3 +
/// a·(1 − exp(−b·D_cm))^c.
struct HeightCurve {
  enum class Kind : unsigned char { curtis, chapman } kind = Kind::chapman;
  double a = 0, b = 0, c = 0;
};

struct Species {
  std::string_view code;  ///< four letters (PNW), or a genus
  std::string_view name;
  TreeForm form = TreeForm::fir;
  BarkStyle bark = BarkStyle::scaly;
  HeightCurve height;
  double height_limit_m = 60;
  double crown_radius_50_m = 3;  ///< at 0.5 m dbh; grows with dbh to the power `crown_power`
  double crown_power = 0.6;
  double crown_ratio_young = 0.9, crown_ratio_old = 0.5;  ///< length of the crown / height
  float foliage_tint[3] = {1, 1, 1};                      ///< relative to the mean of its kind
  float bark_tint[3] = {1, 1, 1};
  std::string_view source;
};

/// Every species that is known, sorted by code.
[[nodiscard]] std::span<const Species> all_species() noexcept;

struct SpeciesMatch {
  const Species* species;  ///< never null
  bool known;              ///< false: a generic conifer or broadleaf stands for it
};
/// By code, else by genus ("Picea abies", "picea"); upper and lower case are the same. An unknown code whose
/// first two letters are those of a broadleaved genus (USDA style) becomes a generic broadleaf, any other a
/// generic conifer.
[[nodiscard]] SpeciesMatch find_species(std::string_view code) noexcept;

/// What an inventory says of a tree; 0 or NaN: unknown.
struct TreeMeasure {
  double dbh_m = 0, height_m = 0, crown_radius_m = 0, crown_base_m = 0;
};
/// Finite, all above 0 but crown_base_m ≥ 0; crown_base_m < height_m.
struct TreeSize {
  double dbh_m, height_m, crown_radius_m, crown_base_m;
  bool seedling;  ///< neither dbh nor height was given: the smallest size
};
inline constexpr double kSeedlingHeight_m = 0.6, kSeedlingDbh_m = 0.006, kLargestDbh_m = 12, kTallest_m = 120;

/// Monotone in dbh. Where the height alone is given, dbh follows from it.
[[nodiscard]] TreeSize size_of(const Species& species, const TreeMeasure& measure) noexcept;
/// Height of the curve alone. dbh_m > 0.
[[nodiscard]] double height_from_dbh(const Species& species, double dbh_m) noexcept;

}  // namespace rigor::nature
