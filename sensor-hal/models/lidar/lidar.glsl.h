// A LiDAR's measurement, written once for shader (float), simulator (double) and calibrator (ceres::Jet).
// Subset and inclusion: see opencv_lens.glsl.h; in C++ through sensor-hal/models/lidar/lidar_math.h. Draws
// are arguments.
//
// The quantity that everything hangs on is the *remission* E of an echo: the light that comes back, relative
// to a white (reflectance 1) matt plate square to the beam that catches all of it at the same range in clear
// air. From the range equation of an extended target, P ~ rho cos(theta) exp(-2 alpha R)/R^2,
//
//   E = sum_i w_i (rho_i cos(theta_i) + highlight + retro gain) exp(-2 tau_i),      sum of the beam's weights
//   w_i = 1 P = E / R^2  up to the device's constant.

// The highlight of a surface: alpha^2 and F0 of GGX. F0 is 0.04, that of a metal rho, and 0 for matt surfaces
// (roughness 1) that are no metal.
FN void lidar_gloss(REAL reflectance, REAL metallic, REAL roughness, OUT(REAL) alpha2, OUT(REAL) f0) {
  REAL alpha = roughness * roughness;
  alpha = alpha > REAL(0.0025) ? alpha : REAL(0.0025);
  alpha2 = alpha * alpha;
  f0 = roughness < REAL(1.0) || metallic > REAL(0.0) ? REAL(0.04) * (REAL(1.0) - metallic) + reflectance * metallic
                                                     : REAL(0.0);
}

// What a highlight sends back along the beam: pi f_s cos(theta) = alpha^2 F0 cos(theta)/(4 f^2),
// f = cos^2 (alpha^2 - 1) + 1.
FN REAL lidar_highlight(REAL cos_incidence, REAL alpha2, REAL f0) {
  REAL f = cos_incidence * cos_incidence * (alpha2 - REAL(1.0)) + REAL(1.0);
  return alpha2 * f0 * cos_incidence / (REAL(4.0) * f * f);
}

// Remission of a surface seen by a beam, per unit of the beam's weight: diffuse rho (1 - metallic)
// cos(theta), the highlight, and a retro-reflecting share times `retro_gain`, how much brighter than a white
// plate a perfect retro-reflector is.
FN REAL lidar_surface_remission(REAL cos_incidence, REAL reflectance, REAL metallic, REAL roughness,
                                REAL retro, REAL retro_gain) {
  REAL alpha2 = REAL(0.0);
  REAL f0 = REAL(0.0);
  lidar_gloss(reflectance, metallic, roughness, alpha2, f0);
  return reflectance * (REAL(1.0) - metallic) * cos_incidence + retro * retro_gain +
         lidar_highlight(cos_incidence, alpha2, f0);
}

// Diameter of the beam: grows evenly from its start.
FN REAL lidar_beam_diameter_m(REAL start_diameter_m, REAL divergence_rad, REAL range_m) {
  return start_diameter_m + divergence_rad * range_m;
}

// Received power relative to remission 1 at `reference_m`. Nearer than `overlap_m`, where the receiver does
// not see all of the beam, it grows no more.
FN REAL lidar_received_power(REAL remission, REAL range_m, REAL reference_m, REAL overlap_m) {
  REAL r = range_m > overlap_m ? range_m : overlap_m;
  return remission * reference_m * reference_m / (r * r);
}

// The least remission that is detected at a range: a floor, and `limit_remission` at `limit_range_m` growing
// with the square of range (a least received power). Without limit (0): the floor alone.
FN REAL lidar_least_remission(REAL range_m, REAL minimum_remission, REAL limit_remission, REAL limit_range_m,
                              REAL overlap_m) {
  REAL least = minimum_remission;
  if (limit_range_m > REAL(0.0)) {
    REAL r = (range_m > overlap_m ? range_m : overlap_m) / limit_range_m;
    REAL by_power = limit_remission * r * r;
    least = by_power > least ? by_power : least;
  }
  return least;
}

// By how much a device errs in the mean at a range: its scale, its bias, `remission_bias_m` for an echo
// without light against a white plate's (a brighter one counts as white), `incidence_bias_m` for a surface
// that is seen along itself against one that is seen square on.
FN REAL lidar_range_error_m(REAL range_m, REAL scale, REAL bias_m, REAL remission_bias_m, REAL remission,
                            REAL incidence_bias_m, REAL cos_incidence) {
  REAL dark = remission < REAL(1.0) ? REAL(1.0) - remission : REAL(0.0);
  return (scale - REAL(1.0)) * range_m + bias_m + remission_bias_m * dark +
         incidence_bias_m * (REAL(1.0) - cos_incidence);
}

// Standard deviation of range, four parameters: sigma^2 = floor^2 + (scale (offset + q)^-exponent)^2, where q
// is the echo's remission or received power. exponent 1/2 with offset 0 is noise by photons (the LISA
// model's), exponent 1 with an offset fits a VLP-16's table; scale 0 is a constant sigma.
FN REAL lidar_range_sigma_m(REAL q, REAL floor_m, REAL scale_m, REAL offset, REAL exponent) {
  REAL s = scale_m * exp(-exponent * log(offset + q));
  return sqrt(floor_m * floor_m + s * s);
}

// What the device calls remission, before noise and rounding: `scale` per unit of E, above E = 1
// (retro-reflectors, highlights) `retro_scale`; times (reference/range)^exponent where range is not
// compensated.
FN REAL lidar_remission_units(REAL remission, REAL range_m, REAL scale, REAL retro_scale, REAL reference_m,
                              REAL range_exponent) {
  REAL over = remission > REAL(1.0) ? remission - REAL(1.0) : REAL(0.0);
  REAL units = scale * (remission - over) + retro_scale * over;
  if (reference_m > REAL(0.0)) {
    units = units * exp(range_exponent * log(reference_m / range_m));
  }
  return units;
}

// Rounded half up to a whole number of steps.
FN REAL lidar_quantise(REAL value, REAL step) { return floor(value / step + REAL(0.5)) * step; }

// Weight density of a beam at s^2 = (r/radius)^2, radius where the divergence says (1/e^2 of a Gaussian
// beam), integrated over the disc from 0 to s^2; the whole is the value at 1.
FN REAL lidar_gaussian_share(REAL s_squared) { return REAL(1.0) - exp(REAL(-2.0) * s_squared); }

// A drop in the beam: remission of a matt disc of its size and `reflectance` in the even beam, at most that.
FN REAL lidar_drop_remission(REAL diameter_m, REAL beam_diameter_m, REAL reflectance) {
  REAL share = diameter_m / beam_diameter_m;
  return share < REAL(1.0) ? reflectance * share * share : reflectance;
}

// Expected number of drops in the beam between two ranges: n times the volume of a truncated cone,
// n pi/12 (h) (D1^2 + D1 D2 + D2^2). Elliptic beams: divergences' and diameters' geometric means.
FN REAL lidar_expected_drops(REAL near_m, REAL far_m, REAL start_diameter_m, REAL divergence_rad,
                             REAL drops_per_m3) {
  REAL d1 = start_diameter_m + divergence_rad * near_m;
  REAL d2 = start_diameter_m + divergence_rad * far_m;
  return drops_per_m3 * REAL(0.26179938779914944) * (far_m - near_m) * (d1 * d1 + d1 * d2 + d2 * d2);
}

// The range of the nearest drop: where the expected number from `near_m` reaches `expected`, -log of a
// uniform draw (Poisson: no drop within r with probability exp(-expected number)). Closed form for a beam
// that widens; a cylinder's for one that does not. h solves n pi/12 ((d1 + b h)^3 - d1^3)/b = expected.
FN REAL lidar_nearest_drop_m(REAL expected, REAL near_m, REAL start_diameter_m, REAL divergence_rad,
                             REAL drops_per_m3) {
  REAL d1 = start_diameter_m + divergence_rad * near_m;
  REAL volume = expected / (drops_per_m3 * REAL(0.26179938779914944));
  REAL grown = divergence_rad * volume;
  REAL cube = d1 * d1 * d1;
  // Where the beam hardly widens the difference of cubes cancels: the cylinder and the next term of its
  // series.
  if (grown < REAL(1e-4) * cube) {
    REAL h = volume / (REAL(3.0) * d1 * d1);
    return near_m + h * (REAL(1.0) - divergence_rad * h / d1);
  }
  return near_m + (exp(log(cube + grown) / REAL(3.0)) - d1) / divergence_rad;
}

// Fog as a soft target: backscatter alpha/S (S: lidar ratio, sr) over a pulse's length, as remission of a
// white plate (1/pi per sr): E = pi alpha/S length.
FN REAL lidar_soft_remission(REAL extinction_per_m, REAL lidar_ratio_sr, REAL pulse_length_m) {
  return REAL(3.14159265358979323846) * extinction_per_m / lidar_ratio_sr * pulse_length_m;
}

// Refraction of d at a face with normal n (both unit length, d·n > 0), ratio = index before / index behind.
FN void lidar_refract(REAL dx, REAL dy, REAL dz, REAL nx, REAL ny, REAL nz, REAL ratio, OUT(REAL) tx,
                      OUT(REAL) ty, OUT(REAL) tz) {
  REAL c = dx * nx + dy * ny + dz * nz;
  REAL k = REAL(1.0) - ratio * ratio * (REAL(1.0) - c * c);
  REAL along = sqrt(k > REAL(0.0) ? k : REAL(0.0)) - ratio * c;
  tx = ratio * dx + along * nx;
  ty = ratio * dy + along * ny;
  tz = ratio * dz + along * nz;
}

// Two turning wedges (Risley prisms) on the x axis: plane face, wedge; wedge, plane face. The laser's
// direction d goes in, the beam's comes out. Thin wedges bend by (index - 1) wedge each, opposite to (cos
// angle, sin angle) in the y z plane. Exact by Snell's law at the four faces.
FN void lidar_risley_direction(REAL dx, REAL dy, REAL dz, REAL wedge1_rad, REAL angle1_rad, REAL wedge2_rad,
                               REAL angle2_rad, REAL index, OUT(REAL) ox, OUT(REAL) oy, OUT(REAL) oz) {
  REAL ax = dx;
  REAL ay = dy;
  REAL az = dz;
  REAL bx = dx;
  REAL by = dy;
  REAL bz = dz;
  lidar_refract(ax, ay, az, REAL(1.0), REAL(0.0), REAL(0.0), REAL(1.0) / index, bx, by, bz);
  lidar_refract(bx, by, bz, cos(wedge1_rad), sin(wedge1_rad) * cos(angle1_rad),
                sin(wedge1_rad) * sin(angle1_rad), index, ax, ay, az);
  lidar_refract(ax, ay, az, cos(wedge2_rad), -sin(wedge2_rad) * cos(angle2_rad),
                -sin(wedge2_rad) * sin(angle2_rad), REAL(1.0) / index, bx, by, bz);
  lidar_refract(bx, by, bz, REAL(1.0), REAL(0.0), REAL(0.0), index, ox, oy, oz);
}
