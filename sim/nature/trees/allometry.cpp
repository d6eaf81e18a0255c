#include "sim/nature/trees/allometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <utility>

namespace rigor::nature {
namespace {

using F = TreeForm;
using B = BarkStyle;
constexpr HeightCurve curtis(double a, double b, double c) { return {HeightCurve::Kind::curtis, a, b, c}; }
constexpr HeightCurve chapman(double a, double b, double c) { return {HeightCurve::Kind::chapman, a, b, c}; }

// FVS: USDA Forest Service, Forest Vegetation Simulator, West Cascades variant, default height-diameter
// curves of the Gifford Pinchot (GP) or Mt Baker-Snoqualmie (MBS) National Forest, on either side of Mount
// Rainier.
constexpr std::string_view kGp =
    "height: FVS West Cascades, Gifford Pinchot NF; crown: approximate, after Bechtold 2004";
constexpr std::string_view kMbs =
    "height: FVS West Cascades, Mt Baker-Snoqualmie NF; crown: approximate, after Bechtold 2004";
constexpr std::string_view kEurope =
    "height: approximate, middle site classes of Central European yield tables; crown: approximate, after "
    "Pretzsch et al. 2015";
constexpr std::string_view kGuess = "approximate throughout";

// Sorted by code.
// clang-format off
constexpr Species kTable[] = {
    {"ABAM", "Pacific silver fir", F::fir, B::smooth, curtis(407.9956, 6.7834, -0.5225), 72, 2.5, 0.55, 0.92,
     0.55, {0.85F, 0.95F, 0.95F}, {1.35F, 1.35F, 1.35F}, kGp},
    {"ABCO", "white fir", F::fir, B::ridged, curtis(475.1698, 6.2472, -0.4812), 70, 2.8, 0.55, 0.92, 0.6,
     {0.9F, 1.0F, 1.15F}, {1.1F, 1.1F, 1.1F}, kGp},
    {"ABGR", "grand fir", F::fir, B::ridged, curtis(686.4831, 6.5393, -0.3740), 78, 2.8, 0.55, 0.92, 0.55,
     {0.95F, 1.0F, 0.9F}, {1, 1, 1}, kGp},
    {"ABLA", "subalpine fir", F::fir, B::smooth, curtis(216.3998, 6.1700, -0.6017), 45, 1.9, 0.5, 0.97, 0.8,
     {0.9F, 1.0F, 1.1F}, {1.3F, 1.3F, 1.3F}, kGp},
    {"ABPR", "noble fir", F::fir, B::scaly, curtis(561.9589, 6.5507, -0.4460), 85, 2.7, 0.55, 0.9, 0.45,
     {0.85F, 1.0F, 1.2F}, {1.1F, 1.05F, 1.05F}, kGp},
    {"ACCI", "vine maple", F::shrub, B::smooth, chapman(8, 0.16, 1.0), 9, 4.5, 0.6, 0.95, 0.85, {1.1F, 1.1F,
     0.9F}, {1, 1, 1}, kGuess},
    {"ACMA", "bigleaf maple", F::oak, B::ridged, curtis(179.0706, 3.6238, -0.5730), 45, 5.2, 0.6, 0.85, 0.55,
     {1.05F, 1.05F, 0.9F}, {1, 1, 1}, kGp},
    {"ALRU", "red alder", F::beech, B::smooth, curtis(182.3045, 3.6676, -0.4735), 40, 4.4, 0.6, 0.8, 0.45,
     {1.0F, 1.0F, 1.0F}, {1.5F, 1.5F, 1.5F}, kGp},
    {"ALSI", "Sitka alder", F::shrub, B::smooth, chapman(6, 0.22, 1.0), 7, 4.5, 0.6, 0.95, 0.9, {1, 1, 1},
     {1.2F, 1.2F, 1.2F}, kGuess},
    {"ALVI", "green alder", F::shrub, B::smooth, chapman(6, 0.22, 1.0), 7, 4.5, 0.6, 0.95, 0.9, {1, 1, 1},
     {1.2F, 1.2F, 1.2F}, kGuess},
    {"Abies", "silver fir (Abies alba)", F::fir, B::smooth, chapman(44, 0.028, 1.15), 60, 3.1, 0.55, 0.92,
     0.55, {0.85F, 0.95F, 0.95F}, {1.3F, 1.3F, 1.3F}, kEurope},
    {"Acer", "maple (Acer pseudoplatanus)", F::beech, B::scaly, chapman(31, 0.045, 1.0), 38, 4.9, 0.62, 0.85,
     0.55, {1.05F, 1.05F, 0.95F}, {1.1F, 1.1F, 1.1F}, kEurope},
    {"Alnus", "alder (Alnus glutinosa)", F::beech, B::ridged, chapman(27, 0.05, 1.0), 33, 4.2, 0.6, 0.8, 0.5,
     {0.9F, 0.95F, 0.9F}, {0.9F, 0.9F, 0.9F}, kEurope},
    {"BEPA", "paper birch", F::birch, B::birch, curtis(1709.7229, 5.8887, -0.2286), 30, 4.0, 0.6, 0.85, 0.5,
     {1.1F, 1.1F, 0.95F}, {1, 1, 1}, kGp},
    {"Betula", "birch (Betula pendula)", F::birch, B::birch, chapman(28, 0.055, 1.0), 33, 4.0, 0.62, 0.85,
     0.5, {1.1F, 1.1F, 0.95F}, {1, 1, 1}, kEurope},
    {"CANO", "Alaska yellow-cedar", F::cedar, B::fibrous, curtis(505.2707, 6.4743, -0.4324), 45, 2.5, 0.55,
     0.95, 0.65, {0.85F, 0.95F, 0.95F}, {1.25F, 1.2F, 1.15F}, kGp},
    {"CHNO", "Alaska yellow-cedar", F::cedar, B::fibrous, curtis(505.2707, 6.4743, -0.4324), 45, 2.5, 0.55,
     0.95, 0.65, {0.85F, 0.95F, 0.95F}, {1.25F, 1.2F, 1.15F}, kGp},
    {"CONU", "Pacific dogwood", F::beech, B::scaly, curtis(444.5618, 3.9205, -0.2397), 20, 4.5, 0.6, 0.9,
     0.6, {1.1F, 1.1F, 1.0F}, {1, 1, 1}, kGp},
    {"Carpinus", "hornbeam (Carpinus betulus)", F::beech, B::smooth, chapman(25, 0.05, 1.0), 30, 4.9, 0.6,
     0.9, 0.65, {1, 1.05F, 0.95F}, {1.2F, 1.2F, 1.2F}, kEurope},
    {"Fagus", "beech (Fagus sylvatica)", F::beech, B::smooth, chapman(38, 0.035, 1.0), 46, 5.2, 0.65, 0.9,
     0.55, {0.95F, 1.05F, 0.9F}, {1.5F, 1.5F, 1.5F}, kEurope},
    {"Fraxinus", "ash (Fraxinus excelsior)", F::beech, B::ridged, chapman(34, 0.042, 1.0), 42, 4.7, 0.62,
     0.8, 0.45, {1.05F, 1.1F, 0.95F}, {1.2F, 1.2F, 1.15F}, kEurope},
    {"LALY", "subalpine larch", F::larch, B::scaly, curtis(503.6619, 4.9544, -0.2085), 30, 2.6, 0.55, 0.9,
     0.65, {1, 1, 1}, {1, 1, 1}, kGp},
    {"LAOC", "western larch", F::larch, B::ridged, curtis(505.2707, 6.4743, -0.4324), 65, 2.4, 0.55, 0.85,
     0.4, {1.1F, 1.1F, 0.9F}, {1.2F, 1.0F, 0.9F}, kGp},
    {"Larix", "larch (Larix decidua)", F::larch, B::ridged, chapman(38, 0.035, 1.0), 48, 3.2, 0.6, 0.85,
     0.45, {1.1F, 1.1F, 0.95F}, {1.15F, 1.0F, 0.95F}, kEurope},
    {"PIAL", "whitebark pine", F::pine, B::scaly, curtis(89.5535, 4.2281, -0.6438), 25, 3.2, 0.6, 0.9, 0.7,
     {0.95F, 1.0F, 0.95F}, {1.3F, 1.3F, 1.3F}, kGp},
    {"PICO", "lodgepole pine", F::pine, B::scaly, curtis(133.6603, 4.8456, -0.6971), 35, 2.3, 0.6, 0.85, 0.4,
     {1.05F, 1.05F, 0.85F}, {1, 1, 1}, kGp},
    {"PIEN", "Engelmann spruce", F::spruce, B::scaly, curtis(211.7962, 6.7015, -0.6739), 55, 2.3, 0.55, 0.95,
     0.7, {0.85F, 1.0F, 1.15F}, {1, 1, 1}, kMbs},
    {"PIMO", "western white pine", F::pine, B::scaly, curtis(1548.4147, 6.5503, -0.2700), 65, 2.9, 0.6, 0.85,
     0.5, {0.95F, 1.05F, 1.1F}, {0.95F, 0.95F, 1}, kGp},
    {"PIPO", "ponderosa pine", F::pine, B::ridged, curtis(1181.7244, 6.6981, -0.3151), 68, 3.2, 0.6, 0.8,
     0.45, {1.05F, 1.05F, 0.85F}, {1.5F, 1.15F, 0.9F}, kMbs},
    {"PISI", "Sitka spruce", F::spruce, B::scaly, curtis(27357.5212, 8.7211, -0.1407), 88, 3.4, 0.6, 0.9,
     0.55, {0.85F, 1.0F, 1.15F}, {1, 1, 1}, kGp},
    {"POBA", "black cottonwood", F::beech, B::ridged, curtis(178.6441, 4.5852, -0.6746), 50, 4.6, 0.6, 0.8,
     0.5, {1.05F, 1.05F, 0.9F}, {1.1F, 1.1F, 1.05F}, kGp},
    {"POTR", "quaking aspen", F::birch, B::birch, curtis(1709.7229, 5.8887, -0.2286), 30, 3.4, 0.6, 0.8,
     0.45, {1.1F, 1.1F, 1.0F}, {0.9F, 0.95F, 0.85F}, kGp},
    {"PREM", "bitter cherry", F::beech, B::smooth, curtis(73.3348, 2.6548, -1.2460), 20, 4.0, 0.6, 0.85, 0.6,
     {1.05F, 1.05F, 0.9F}, {0.9F, 0.8F, 0.8F}, kGp},
    {"PSME", "Douglas-fir", F::douglas_fir, B::ridged, curtis(452.3985, 5.9690, -0.4910), 95, 3.3, 0.58, 0.9,
     0.45, {0.95F, 1.0F, 0.9F}, {0.9F, 0.82F, 0.78F}, kGp},
    {"Picea", "Norway spruce (Picea abies)", F::spruce, B::scaly, chapman(42, 0.030, 1.1), 58, 2.9, 0.55,
     0.95, 0.6, {0.9F, 0.95F, 0.9F}, {1.05F, 0.95F, 0.9F}, kEurope},
    {"Pinus", "Scots pine (Pinus sylvestris)", F::pine, B::ridged, chapman(30, 0.040, 1.0), 40, 3.1, 0.62,
     0.8, 0.4, {0.95F, 1.05F, 1.1F}, {1.35F, 1.05F, 0.85F}, kEurope},
    {"Populus", "poplar (Populus tremula, P. nigra)", F::beech, B::ridged, chapman(35, 0.040, 1.0), 42, 4.4,
     0.6, 0.8, 0.5, {1.05F, 1.05F, 0.95F}, {1.1F, 1.1F, 1.05F}, kEurope},
    {"Pseudotsuga", "Douglas-fir", F::douglas_fir, B::ridged, curtis(452.3985, 5.9690, -0.4910), 95, 3.4,
     0.58, 0.9, 0.5, {0.95F, 1.0F, 0.9F}, {0.9F, 0.82F, 0.78F}, kGp},
    {"QUGA", "Oregon white oak", F::oak, B::ridged, chapman(24, 0.040, 1.0), 30, 5.0, 0.65, 0.85, 0.6, {1.0F,
     1.0F, 0.9F}, {1.2F, 1.2F, 1.2F}, kGuess},
    {"Quercus", "oak (Quercus robur, Q. petraea)", F::oak, B::ridged, chapman(33, 0.032, 1.0), 42, 5.0, 0.65,
     0.85, 0.55, {0.95F, 1.0F, 0.85F}, {1.1F, 1.1F, 1.05F}, kEurope},
    {"SASC", "Scouler's willow", F::shrub, B::smooth, curtis(149.5861, 2.4231, -0.1800), 14, 4.0, 0.6, 0.95,
     0.8, {1.0F, 1.05F, 1.05F}, {1, 1, 1}, kGp},
    {"Salix", "willow", F::shrub, B::ridged, chapman(18, 0.05, 1.0), 25, 4.6, 0.6, 0.95, 0.75, {1.05F, 1.1F,
     1.05F}, {1, 1, 1}, kEurope},
    {"Sorbus", "rowan (Sorbus aucuparia)", F::beech, B::smooth, chapman(15, 0.08, 1.0), 20, 4.0, 0.6, 0.9,
     0.65, {1.05F, 1.05F, 0.9F}, {1.2F, 1.2F, 1.2F}, kEurope},
    {"TABR", "Pacific yew", F::yew, B::fibrous, curtis(1221.9183, 5.8166, -0.2096), 20, 4.6, 0.5, 0.97, 0.8,
     {0.8F, 0.85F, 0.8F}, {1.1F, 0.85F, 0.8F}, kGp},
    {"THPL", "western redcedar", F::cedar, B::fibrous, curtis(531.0073, 5.9643, -0.4083), 72, 3.4, 0.5, 0.95,
     0.6, {1.05F, 1.1F, 0.85F}, {1.2F, 0.95F, 0.85F}, kGp},
    {"TSHE", "western hemlock", F::hemlock, B::scaly, curtis(465.0811, 6.4772, -0.4941), 75, 3.3, 0.55, 0.95,
     0.6, {1.05F, 1.05F, 0.9F}, {1, 0.97F, 0.95F}, kGp},
    {"TSME", "mountain hemlock", F::hemlock, B::ridged, curtis(368.3722, 6.8267, -0.5070), 48, 2.6, 0.52,
     0.97, 0.7, {0.85F, 0.97F, 1.05F}, {1.05F, 1, 1}, kGp},
    {"Taxus", "yew (Taxus baccata)", F::yew, B::fibrous, chapman(16, 0.035, 1.0), 22, 4.4, 0.55, 0.97, 0.8,
     {0.75F, 0.85F, 0.8F}, {1.1F, 0.85F, 0.8F}, kEurope},
    {"Thuja", "western redcedar", F::cedar, B::fibrous, curtis(531.0073, 5.9643, -0.4083), 72, 3.4, 0.5,
     0.95, 0.6, {1.05F, 1.1F, 0.85F}, {1.2F, 0.95F, 0.85F}, kGp},
    {"Tilia", "lime (Tilia cordata)", F::beech, B::ridged, chapman(32, 0.040, 1.0), 38, 4.9, 0.62, 0.9, 0.6,
     {1.05F, 1.1F, 0.9F}, {1, 1, 1}, kEurope},
    {"Tsuga", "hemlock", F::hemlock, B::scaly, curtis(465.0811, 6.4772, -0.4941), 75, 3.3, 0.55, 0.95, 0.6,
     {1.05F, 1.05F, 0.9F}, {1, 0.97F, 0.95F}, kGp},
    {"Ulmus", "elm", F::oak, B::ridged, chapman(32, 0.040, 1.0), 40, 4.8, 0.62, 0.85, 0.55, {0.95F, 1.0F,
     0.85F}, {1, 1, 1}, kEurope},
};
// clang-format on

constexpr Species kGenericConifer = {"conifer", "a conifer", F::fir, B::scaly, chapman(42, 0.030, 1.1),
                                     70,        2.9,         0.55,   0.93,     0.58,
                                     {1, 1, 1}, {1, 1, 1},   kGuess};
constexpr Species kGenericBroadleaf = {"broadleaf",
                                       "a broadleaved tree",
                                       F::beech,
                                       B::ridged,
                                       chapman(30, 0.042, 1.0),
                                       40,
                                       4.7,
                                       0.62,
                                       0.85,
                                       0.55,
                                       {1, 1, 1},
                                       {1, 1, 1},
                                       kGuess};

constexpr char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }
bool same_word(std::string_view a, std::string_view b) {
  return a.size() == b.size() &&
         std::equal(a.begin(), a.end(), b.begin(), [](char x, char y) { return lower(x) == lower(y); });
}
const Species* look_up(std::string_view word) {
  for (const Species& s : kTable)
    if (same_word(s.code, word)) return &s;
  return nullptr;
}
/// First two letters of broadleaved genera in USDA codes: maple, alder, serviceberry, madrone, birch,
/// hornbeam, chestnut, dogwood, hazel, beech, ash, walnut, poplar, cherry, oak, willow, rowan, lime, elm.
constexpr std::string_view kBroadleafPairs[] = {"ac", "al", "am", "ar", "be", "co", "cr", "fa", "fr", "ju",
                                                "po", "pr", "qu", "sa", "so", "ti", "ul", "ae", "ro"};

bool given(double v) { return std::isfinite(v) && v > 0; }

}  // namespace

std::span<const Species> all_species() noexcept { return kTable; }

namespace {
constexpr std::pair<std::string_view, std::string_view> kEuropeanCodes[] = {
    {"PIAB", "Picea"}, {"ABAL", "Abies"},   {"PISY", "Pinus"},   {"LADE", "Larix"},
    {"FASY", "Fagus"}, {"QURO", "Quercus"}, {"QUPE", "Quercus"}, {"BEPE", "Betula"},
    {"ACPS", "Acer"},  {"ACPL", "Acer"},    {"FREX", "Fraxinus"}};
}

SpeciesMatch find_species(std::string_view code) noexcept {
  while (!code.empty() && code.front() == ' ') code.remove_prefix(1);
  const std::string_view word = code.substr(0, code.find(' '));
  if (!word.empty()) {
    if (const Species* s = look_up(word)) return {s, true};
    // USDA codes carry a number where two species share four letters (CANO9, ALRU2).
    if (word.size() == 5 && word[4] >= '0' && word[4] <= '9')
      if (const Species* s = look_up(word.substr(0, 4))) return {s, true};
    // European lists shorten genus and species to two letters each.
    for (const auto& [four, genus] : kEuropeanCodes)
      if (same_word(word, four))
        if (const Species* s = look_up(genus)) return {s, true};
    for (const std::string_view pair : kBroadleafPairs)
      if (word.size() == 4 && same_word(word.substr(0, 2), pair)) return {&kGenericBroadleaf, false};
  }
  return {&kGenericConifer, false};
}

double height_from_dbh(const Species& s, double dbh_m) noexcept {
  const double d_cm = 100 * std::min(dbh_m, kLargestDbh_m);
  double h = 0;
  if (s.height.kind == HeightCurve::Kind::curtis) {
    // Below 3 inches FVS goes straight to a seedling.
    constexpr double kSmall_in = 3;
    const auto curve_ft = [&](double d_in) {
      return 4.5 + s.height.a * std::exp(-s.height.b * std::pow(d_in, s.height.c));
    };
    const double d_in = d_cm / 2.54;
    h = d_in >= kSmall_in
            ? curve_ft(d_in) * 0.3048
            : kSeedlingHeight_m + (curve_ft(kSmall_in) * 0.3048 - kSeedlingHeight_m) * d_in / kSmall_in;
  } else {
    h = kSeedlingHeight_m + (1.3 - kSeedlingHeight_m) * std::min(1.0, d_cm / 1.5) +
        s.height.a * std::pow(1 - std::exp(-s.height.b * d_cm), s.height.c);
  }
  // The limit bends the curve from three quarters of it on, so that it stays monotone.
  const double knee = 0.75 * s.height_limit_m, room = s.height_limit_m - knee;
  return h <= knee ? h : knee + room * (1 - std::exp(-(h - knee) / room));
}

TreeSize size_of(const Species& s, const TreeMeasure& m) noexcept {
  TreeSize out{};
  const bool have_dbh = given(m.dbh_m), have_height = given(m.height_m);
  out.seedling = !have_dbh && !have_height;
  if (out.seedling) {
    out.dbh_m = kSeedlingDbh_m;
    out.height_m = kSeedlingHeight_m;
  } else if (have_dbh) {
    out.dbh_m = std::min(m.dbh_m, kLargestDbh_m);
    out.height_m = have_height ? m.height_m : height_from_dbh(s, out.dbh_m);
  } else {
    out.height_m = m.height_m;
    double low = kSeedlingDbh_m, high = 3.0;
    for (int i = 0; i < 50; ++i) {
      const double mid = 0.5 * (low + high);
      (height_from_dbh(s, mid) < m.height_m ? low : high) = mid;
    }
    out.dbh_m = 0.5 * (low + high);
  }
  out.height_m = std::clamp(out.height_m, kSeedlingHeight_m / 3, kTallest_m);
  const double most = std::min(18.0, (is_conifer(s.form) && s.form != F::yew ? 0.4 : 0.65) * out.height_m);
  out.crown_radius_m =
      given(m.crown_radius_m)
          ? std::min(m.crown_radius_m, 40.0)
          : std::max(0.1, std::min(most, s.crown_radius_50_m * std::pow(out.dbh_m / 0.5, s.crown_power)));
  const double ratio =
      s.crown_ratio_old + (s.crown_ratio_young - s.crown_ratio_old) * std::exp(-out.height_m / 14.0);
  out.crown_base_m = given(m.crown_base_m) ? m.crown_base_m : out.height_m * (1 - ratio);
  out.crown_base_m = std::clamp(out.crown_base_m, 0.0, 0.95 * out.height_m);
  return out;
}

}  // namespace rigor::nature
