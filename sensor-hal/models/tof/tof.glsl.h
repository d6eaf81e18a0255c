// A time-of-flight camera's pixel, from light to range. Subset and inclusion: see opencv_lens.glsl.h; needs
// random_draws.glsl.h before it. Draws are arguments.
//
// Phases are counted in turns (1 = 2 pi): range R and modulation frequency f give 2 f R / c turns, and a turn
// is reduced to [-1/2, 1/2) without loss, which 2 pi R in float would not be. sin, cos and atan2 are our own:
// Vulkan promises 2^-11 rad for the built-in ones, 0.4 mm at 30 MHz.
//
// Tap k = 0 .. 3 collects  D_k = E/2 (1 + C g(phi + k pi/2)) + B  electrons: E is the active light of one
// tap's integration, of which the shutter of duty 1/2 lets half into the tap, C the demodulation contrast, B
// the background. The correlation g holds odd harmonics only (even ones cancel in the differences), so that
// all that reaches the taps is a phasor (x, y):
//
//   D0 = E/2 (1 + C x) + B,  D2 = E/2 (1 - C x) + B,  D1 = E/2 (1 - C y) + B,  D3 = E/2 (1 + C y) + B
//   sine       x + iy = e^(i phi)
//   harmonics  x + iy = e^(i phi) + a3 e^(-3 i phi) + a5 e^(5 i phi) + a7 e^(-7 i phi) + a9 e^(9 i phi)
//   triangle   a_k = 1/k^2 for all odd k: both light and shutter ideal square waves
//
// Light from several surfaces in one pixel adds up as E times the phasor: never as ranges.

// (sin, cos) of 2 pi turns, to 1e-12. Reduced to an eighth of a turn about the nearest quarter.
FN void tof_sincos_turns(REAL turns, OUT(REAL) s, OUT(REAL) c) {
  REAL r = turns - floor(turns + REAL(0.5));
  REAL quarter = floor(r * REAL(4.0) + REAL(0.5));
  REAL t = (r - quarter * REAL(0.25)) * REAL(6.283185307179586);
  REAL t2 = t * t;
  REAL st = t * (REAL(1.0) +
                 t2 * (REAL(-1.6666666666666667e-1) +
                       t2 * (REAL(8.333333333333333e-3) +
                             t2 * (REAL(-1.984126984126984e-4) +
                                   t2 * (REAL(2.7557319223985893e-6) - t2 * REAL(2.505210838544172e-8))))));
  REAL ct = REAL(1.0) +
            t2 * (REAL(-0.5) +
                  t2 * (REAL(4.1666666666666664e-2) +
                        t2 * (REAL(-1.388888888888889e-3) +
                              t2 * (REAL(2.48015873015873e-5) +
                                    t2 * (REAL(-2.7557319223985888e-7) + t2 * REAL(2.08767569878681e-9))))));
  REAL odd = quarter * quarter == REAL(1.0) ? REAL(1.0) : REAL(0.0);
  REAL sign =
      quarter < REAL(0.0) ? REAL(-1.0) : REAL(1.0);  // of the quarters -1 and 1; -2 and 2 turn both about
  REAL flip = quarter * quarter > REAL(2.0) ? REAL(-1.0) : REAL(1.0);
  s = odd > REAL(0.5) ? sign * ct : flip * st;
  c = odd > REAL(0.5) ? -sign * st : flip * ct;
}

// Angle of (x, y) in turns, 0 <= result < 1; 0 where both are 0. The arc tangent is Moshier's (Cephes,
// atan.c), relative accuracy 2e-16 in double.
FN REAL tof_angle_turns(REAL x, REAL y) {
  REAL ax = x < REAL(0.0) ? -x : x;
  REAL ay = y < REAL(0.0) ? -y : y;
  bool steep = ay > ax;
  REAL low = steep ? ax : ay;
  REAL high = steep ? ay : ax;
  if (!(high > REAL(0.0))) {
    return REAL(0.0);
  }
  // Above tan(pi/8): atan(q) = pi/4 + atan((q - 1) / (q + 1)).
  bool far = low > REAL(0.41421356237309503) * high;
  REAL q = far ? (low - high) / (low + high) : low / high;
  REAL z = q * q;
  REAL p = (((REAL(-8.750608600031904122785e-1) * z - REAL(1.615753718733365076637e1)) * z -
             REAL(7.500855792314704667340e1)) *
                z -
            REAL(1.228866684490136173410e2)) *
               z -
           REAL(6.485021904942025371773e1);
  REAL d = ((((z + REAL(2.485846490142306297962e1)) * z + REAL(1.650270098316988542046e2)) * z +
             REAL(4.328810604912902668951e2)) *
                z +
            REAL(4.853903996359136964868e2)) *
               z +
           REAL(1.945506571482613964425e2);
  REAL turns = (q + q * z * p / d) * REAL(0.15915494309189535);
  turns = far ? turns + REAL(0.125) : turns;
  turns = steep ? REAL(0.25) - turns : turns;
  turns = x < REAL(0.0) ? REAL(0.5) - turns : turns;
  turns = y < REAL(0.0) ? REAL(1.0) - turns : turns;
  return turns < REAL(1.0) ? turns : REAL(0.0);
}

// A sample's phasor. Harmonics' relative amplitudes a3 .. a9 count where triangle = 0. Of what the harmonics
// do, `bias` (0 or 1) keeps the error of the phase (wiggling bias) and `variation` the change of the
// amplitude with the phase (which makes the noise vary with it).
FN void tof_phasor(REAL turns, REAL triangle, REAL a3, REAL a5, REAL a7, REAL a9, REAL bias, REAL variation,
                   OUT(REAL) x, OUT(REAL) y) {
  REAL s1 = REAL(0.0);
  REAL c1 = REAL(1.0);
  tof_sincos_turns(turns, s1, c1);
  if (triangle > REAL(0.5)) {
    // pi^2/8 (1 - 4 |t|), t in [-1/2, 1/2): the series of cos(k phi)/k^2 over odd k; sine a quarter of a turn
    // later.
    REAL t = turns - floor(turns + REAL(0.5));
    REAL u = t - REAL(0.25);
    u = u - floor(u + REAL(0.5));
    x = REAL(1.2337005501361697) * (REAL(1.0) - REAL(4.0) * (t < REAL(0.0) ? -t : t));
    y = REAL(1.2337005501361697) * (REAL(1.0) - REAL(4.0) * (u < REAL(0.0) ? -u : u));
  } else {
    REAL c2 = c1 * c1 - s1 * s1;
    REAL s2 = REAL(2.0) * c1 * s1;
    REAL c3 = c1 * c2 - s1 * s2;
    REAL s3 = s1 * c2 + c1 * s2;
    REAL c5 = c3 * c2 - s3 * s2;
    REAL s5 = s3 * c2 + c3 * s2;
    REAL c7 = c5 * c2 - s5 * s2;
    REAL s7 = s5 * c2 + c5 * s2;
    REAL c9 = c7 * c2 - s7 * s2;
    REAL s9 = s7 * c2 + c7 * s2;
    x = c1 + a3 * c3 + a5 * c5 + a7 * c7 + a9 * c9;
    y = s1 - a3 * s3 + a5 * s5 - a7 * s7 + a9 * s9;
  }
  if (bias < REAL(0.5)) {
    REAL length = variation < REAL(0.5) ? REAL(1.0) : sqrt(x * x + y * y);
    x = length * c1;
    y = length * s1;
  } else if (variation < REAL(0.5)) {
    REAL length = sqrt(x * x + y * y);
    x = x / length;
    y = y / length;
  }
}

// Electrons E of one tap's integration: radiance I remission / (pi R^2) through the pixel.
//   electrons_per_radiance  e- per W m^-2 sr^-1 in one integration
//   intensity               of the illumination in the pixel's direction, W/sr
//   remission               of the surface: lidar_surface_remission (lidar.glsl.h)
FN REAL tof_active_electrons(REAL electrons_per_radiance, REAL intensity, REAL range_m, REAL remission) {
  return electrons_per_radiance * intensity * remission * REAL(0.3183098861837907) / (range_m * range_m);
}

// Mean electrons of the four taps: sum of E, and of E times the phasor, over all that the pixel sees.
FN void tof_taps(REAL active_e, REAL sum_x_e, REAL sum_y_e, REAL contrast, REAL background_e, OUT(REAL) d0,
                 OUT(REAL) d1, OUT(REAL) d2, OUT(REAL) d3) {
  REAL mean = REAL(0.5) * active_e + background_e;
  REAL x = REAL(0.5) * contrast * sum_x_e;
  REAL y = REAL(0.5) * contrast * sum_y_e;
  d0 = mean + x;
  d1 = mean - y;
  d2 = mean - x;
  d3 = mean + y;
}

// One tap after its well, read-out and converter. `arrived_e`: a draw of poisson_quantile, or the mean
// itself; `drained_e`: background that the pixel takes out before the well fills. The converter rounds to
// `step_e` (0: does not) and, having a pedestal, keeps values below zero. `saturated` is 1 where the well is
// full.
FN REAL tof_read_tap(REAL arrived_e, REAL drained_e, REAL full_well_e, REAL read_noise_e, REAL read_draw,
                     REAL step_e, OUT(REAL) saturated) {
  REAL kept = arrived_e - drained_e;
  saturated = kept < full_well_e ? REAL(0.0) : REAL(1.0);
  kept = kept < full_well_e ? kept : full_well_e;
  kept = kept + read_noise_e * read_draw;
  return step_e > REAL(0.0) ? step_e * floor(kept / step_e + REAL(0.5)) : kept;
}

// Phase in turns, 0 to 1, and amplitude E C / 2 in electrons.
FN void tof_demodulate(REAL d0, REAL d1, REAL d2, REAL d3, OUT(REAL) turns, OUT(REAL) amplitude_e) {
  REAL x = d0 - d2;
  REAL y = d3 - d1;
  turns = tof_angle_turns(x, y);
  amplitude_e = REAL(0.5) * sqrt(x * x + y * y);
}

// Uniform cubic B-spline over [from_m, to_m] in `pieces` pieces, pieces + 3 coefficients: at `range_m` its
// value is b0 c[first] + b1 c[first + 1] + b2 c[first + 2] + b3 c[first + 3]. Beyond the ends it keeps the
// value that it has there (de Boor, "A Practical Guide to Splines", 1978). As an error of the range (Lindner,
// Kolb, "Lateral and depth calibration of PMD-distance sensors", 2006) it is that of light from `range_m`: it
// is added before the light of several surfaces mixes.
FN void tof_spline(REAL range_m, REAL from_m, REAL to_m, REAL pieces, OUT(REAL) first, OUT(REAL) b0,
                   OUT(REAL) b1, OUT(REAL) b2, OUT(REAL) b3) {
  REAL t = (range_m - from_m) / (to_m - from_m) * pieces;
  t = t > REAL(0.0) ? t : REAL(0.0);
  t = t < pieces ? t : pieces;
  first = floor(t);
  first = first < pieces ? first : pieces - REAL(1.0);
  t = t - first;
  REAL u = REAL(1.0) - t;
  b0 = u * u * u * REAL(0.16666666666666666);
  b1 = REAL(0.6666666666666666) - t * t * (REAL(1.0) - REAL(0.5) * t);
  b2 = REAL(0.6666666666666666) - u * u * (REAL(1.0) - REAL(0.5) * u);
  b3 = t * t * t * REAL(0.16666666666666666);
}

// Error of the range that all light of a pixel shares: an offset, and what goes with the amplitude as k/A,
// `amplitude_error_m_e` = k. Without an amplitude there is no range and no such error.
FN REAL tof_range_error(REAL offset_m, REAL amplitude_error_m_e, REAL amplitude_e) {
  return amplitude_e > REAL(0.0) ? offset_m + amplitude_error_m_e / amplitude_e : offset_m;
}

// Range that is nearest to `about_m` among those which this phase allows; `turns_per_m` = 2 f / c.
FN REAL tof_nearest_range(REAL turns, REAL turns_per_m, REAL about_m) {
  return (turns + floor(about_m * turns_per_m - turns + REAL(0.5))) / turns_per_m;
}

// Standard deviation of the range: c/(4 pi f sqrt 2) sqrt(A + B + read^2)/(C A), A = E/2 and B the mean
// electrons per tap of signal and background (Lange, "3D time-of-flight distance measurement", 2000, with A +
// B per tap).
FN REAL tof_range_sigma(REAL turns_per_m, REAL signal_e, REAL background_e, REAL read_noise_e,
                        REAL contrast) {
  return sqrt(signal_e + background_e + read_noise_e * read_noise_e) /
         (REAL(8.885765876316732) * turns_per_m * contrast * signal_e);
}
