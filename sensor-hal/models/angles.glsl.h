// Angles to the full accuracy of REAL: Vulkan promises 4096 ulp for atan and 2^-11 for sin and cos, a fifth of a pixel
// on a fisheye. Subset and inclusion: see opencv_lens.glsl.h.

// The angle between the z axis and the direction (r, z), r >= 0, in [0, pi]: half the angle is atan(r / (|d| + |z|));
// three more halvings, atan t = 2 atan(t / (1 + sqrt(1 + t^2))), leave t <= 0.0985, where eight terms of the series
// err by less than 1e-18.
FN REAL angle_from_axis(REAL r, REAL z) {
  REAL length = sqrt(r * r + z * z);
  REAL t = r / (length + (z < REAL(0.0) ? -z : z));
  for (int i = 0; i < 3; ++i) {
    t = t / (REAL(1.0) + sqrt(REAL(1.0) + t * t));
  }
  REAL t2 = t * t;
  REAL series =
      REAL(1.0) -
      t2 * (REAL(0.33333333333333333) -
            t2 * (REAL(0.2) -
                  t2 * (REAL(0.14285714285714286) -
                        t2 * (REAL(0.11111111111111111) -
                              t2 * (REAL(0.090909090909090909) -
                                    t2 * (REAL(0.076923076923076923) - t2 * REAL(0.066666666666666667)))))));
  REAL angle = REAL(16.0) * t * series;
  return z < REAL(0.0) ? REAL(3.14159265358979323846) - angle : angle;
}

// Sine and cosine for |angle| <= pi: series of a quarter of it, doubled twice.
FN void angle_sine_cosine(REAL angle, OUT(REAL) sine, OUT(REAL) cosine) {
  REAL a = REAL(0.25) * angle;
  REAL a2 = a * a;
  REAL s = REAL(1.0) - a2 * REAL(0.00367647058823529);
  s = REAL(1.0) - a2 * REAL(0.00476190476190476) * s;
  s = REAL(1.0) - a2 * REAL(0.00641025641025641) * s;
  s = REAL(1.0) - a2 * REAL(0.00909090909090909) * s;
  s = REAL(1.0) - a2 * REAL(0.01388888888888889) * s;
  s = REAL(1.0) - a2 * REAL(0.02380952380952381) * s;
  s = REAL(1.0) - a2 * REAL(0.05000000000000000) * s;
  s = REAL(1.0) - a2 * REAL(0.16666666666666666) * s;
  s = a * s;
  // 1 - cos a by its own series, which keeps small angles exact.
  REAL c1 = REAL(1.0) - a2 * REAL(0.00416666666666667);
  c1 = REAL(1.0) - a2 * REAL(0.00549450549450549) * c1;
  c1 = REAL(1.0) - a2 * REAL(0.00757575757575758) * c1;
  c1 = REAL(1.0) - a2 * REAL(0.01111111111111111) * c1;
  c1 = REAL(1.0) - a2 * REAL(0.01785714285714286) * c1;
  c1 = REAL(1.0) - a2 * REAL(0.03333333333333333) * c1;
  c1 = REAL(1.0) - a2 * REAL(0.08333333333333333) * c1;
  c1 = REAL(0.5) * a2 * c1;
  // With c1 = 1 - cos: sin 2a = 2 s (1 - c1), 1 - cos 2a = 2 s^2.
  REAL s2 = REAL(2.0) * s * (REAL(1.0) - c1);
  REAL c2 = REAL(2.0) * s * s;
  sine = REAL(2.0) * s2 * (REAL(1.0) - c2);
  cosine = REAL(1.0) - REAL(2.0) * s2 * s2;
}
