// Fall-off of the light towards the corners, relative to the axis. Subset and inclusion: see opencv_lens.glsl.h.
//
//   V = (1 - G + G cos^4 theta) (1 + a2 r^2 + a4 r^4 + a6 r^6),  r = tan theta of the ideal ray
//
// G = 1 is the natural fall-off of a thin lens, G = 0 with the polynomial fits real modules.
//
// Its first factor, of cos2 = cos^2 theta:
FN REAL natural_vignetting(REAL cos2, REAL cos4_weight) {
  return REAL(1.0) - cos4_weight + cos4_weight * cos2 * cos2;
}

FN REAL vignetting_factor(REAL x, REAL y, REAL cos4_weight, REAL a2, REAL a4, REAL a6) {
  REAL r2 = x * x + y * y;
  REAL cos2 = REAL(1.0) / (REAL(1.0) + r2);
  REAL v = natural_vignetting(cos2, cos4_weight) * (REAL(1.0) + r2 * (a2 + r2 * (a4 + r2 * a6)));
  return v > REAL(0.0) ? v : REAL(0.0);
}
