// A pixel after the EMVA 1288 linear model, from electrons to digital numbers (DN). Subset and inclusion: see
// opencv_lens.glsl.h; needs random_draws.glsl.h before it. Draws are arguments.
//
//   mean   = rate * exposure * gain_pattern + dark_rate * exposure        [e-], gain_pattern = V (1 + PRNU z)
//   n      = min(Poisson(mean), full well) + offset_pattern + read z      [e-], offset_pattern = DSNU z
//   y      = clamp(round(black + R(K n)), 0, 2^bits - 1)                  [DN]
//
// with the response R(x) = x, or x (1 + c2 s + c3 s^2) of s = x/(full scale above black), so that for c2 = c3 = 0 var(y) = K^2 var_d + 1/12 + K (mean(y) - mean(y_dark)), EMVA 1288 equation 15 of release 4.0.

// Photo-electrons that a pixel collects on average, dark current included. Rates in e-/s, exposure in s.
FN REAL emva_mean_electrons(REAL rate_e_per_s, REAL dark_e_per_s, REAL gain_pattern, REAL exposure_s) {
  REAL mean = (rate_e_per_s * gain_pattern + dark_e_per_s) * exposure_s;
  return mean > REAL(0.0) ? mean : REAL(0.0);
}

// Electrons after the well and the read-out. shot_e: what arrived, a draw of poisson_quantile or the mean itself.
FN REAL emva_collected_electrons(REAL shot_e, REAL full_well_e, REAL offset_pattern_e, REAL read_noise_e,
                                 REAL read_draw) {
  REAL kept = shot_e < full_well_e ? shot_e : full_well_e;
  return kept + offset_pattern_e + read_noise_e * read_draw;
}

// Analogue DN before rounding.
FN REAL emva_analogue_dn(REAL electrons, REAL gain_dn_per_e, REAL black_dn) {
  return black_dn + gain_dn_per_e * electrons;
}

// Response that bends: amplifiers and wells that are not quite linear. K is the slope at black; beyond the ends of
// the converter's range it goes on straight.
FN REAL emva_response(REAL above_black_dn, REAL full_scale_dn, REAL c2, REAL c3) {
  REAL s = above_black_dn / full_scale_dn;
  s = s > REAL(0.0) ? s : REAL(0.0);
  s = s < REAL(1.0) ? s : REAL(1.0);
  return above_black_dn * (REAL(1.0) + s * (c2 + s * c3));
}

// What the converter gives: rounded half up, clipped to [0, max_dn].
FN REAL emva_quantise(REAL analogue_dn, REAL max_dn) {
  REAL dn = floor(analogue_dn + REAL(0.5));
  dn = dn > REAL(0.0) ? dn : REAL(0.0);
  return dn < max_dn ? dn : max_dn;
}
