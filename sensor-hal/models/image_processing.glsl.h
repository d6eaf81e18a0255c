// What a camera's processor does to digital numbers. Subset and inclusion: see opencv_lens.glsl.h.
//
//   x = white_balance (dn - black) / (max_dn - black)
//   y = x^(1/gamma) for gamma other than 1 (x clipped at 0 first)
//   out = pedestal + (max_dn - pedestal) y, clipped to [0, max_dn]; pedestal: black, or 0 where it is subtracted

// The linear part, in DN above black; not clipped below, so that noise about black stays what it is.
FN REAL balanced_dn(REAL dn, REAL black_dn, REAL white_balance) { return white_balance * (dn - black_dn); }

FN REAL processed_dn(REAL above_black_dn, REAL black_dn, REAL max_dn, REAL inverse_gamma, REAL pedestal_dn) {
  REAL x = above_black_dn / (max_dn - black_dn);
  if (inverse_gamma != REAL(1.0)) {
    x = x > REAL(0.0) ? exp(inverse_gamma * log(x)) : REAL(0.0);
  }
  REAL out_dn = pedestal_dn + (max_dn - pedestal_dn) * x;
  out_dn = out_dn > REAL(0.0) ? out_dn : REAL(0.0);
  return out_dn < max_dn ? out_dn : max_dn;
}
