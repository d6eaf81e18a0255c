// What air, fog, rain and snow take from a beam. Subset and inclusion: see opencv_lens.glsl.h; in C++ through
// sensor-hal/models/air/air_math.h. Visibility in metres, wavelength in nanometres, precipitation in millimetres of
// water per hour, extinction per metre: no function here takes kilometres or micrometres.

// Kim's exponent of wavelength (Kim, McArthur & Korevaar, Proc. SPIE 4214, 2001).
FN REAL air_kim_exponent(REAL visibility_m) {
  REAL v = visibility_m * REAL(0.001);  // the paper's unit, km
  if (v >= REAL(50.0)) {
    return REAL(1.6);
  }
  if (v >= REAL(6.0)) {
    return REAL(1.3);
  }
  if (v >= REAL(1.0)) {
    return REAL(0.16) * v + REAL(0.34);
  }
  if (v >= REAL(0.5)) {
    return v - REAL(0.5);
  }
  return REAL(0.0);
}

// Extinction of fog or haze of a meteorological range (2 % contrast at 550 nm): 3.91/V (lambda/550 nm)^-q.
FN REAL air_fog_extinction_per_m(REAL visibility_m, REAL wavelength_nm) {
  return REAL(3.91) / visibility_m * exp(-air_kim_exponent(visibility_m) * log(wavelength_nm / REAL(550.0)));
}

// Rain: drop sizes after Marshall & Palmer (J. Meteor. 5, 1948), extinction efficiency 2: 1.56 per km at 10 mm/h.
FN REAL air_rain_extinction_per_m(REAL rain_mmph) {
  return rain_mmph > REAL(0.0) ? REAL(3.65e-4) * exp(REAL(0.63) * log(rain_mmph)) : REAL(0.0);
}

// The formula that several simulators use (Goodin et al., Electronics 8:89, 2019): some 25 times the above. Not used
// unless it is asked for by its name.
FN REAL air_rain_extinction_goodin_per_m(REAL rain_mmph) {
  return rain_mmph > REAL(0.0) ? REAL(0.01) * exp(REAL(0.6) * log(rain_mmph)) : REAL(0.0);
}

// Snow: sizes of molten flakes after Sekhon & Srivastava (J. Atmos. Sci. 27, 1970), N0 = 2500 R^-0.94 /(m^3 mm),
// Lambda = 2.29 R^-0.45 /mm; efficiency 2; a flake of a tenth of water's density has 10^(2/3) times the cross-section.
FN REAL air_snow_extinction_per_m(REAL snow_mmph) {
  return snow_mmph > REAL(0.0) ? REAL(3.03e-3) * exp(REAL(0.41) * log(snow_mmph)) : REAL(0.0);
}

// Median volume diameter 3.67/Lambda (Atlas 1953) of the drops and, as flakes of 100 kg/m^3, of the snow.
FN REAL air_rain_diameter_m(REAL rain_mmph) {
  return rain_mmph > REAL(0.0) ? REAL(0.001) * REAL(3.67) / REAL(4.1) * exp(REAL(0.21) * log(rain_mmph)) : REAL(0.0);
}
FN REAL air_snow_diameter_m(REAL snow_mmph) {
  return snow_mmph > REAL(0.0)
             ? REAL(0.001) * REAL(3.67) / REAL(2.29) * REAL(2.1544346900318843) * exp(REAL(0.45) * log(snow_mmph))
             : REAL(0.0);
}

// As many drops of one diameter as have this extinction: 2 pi/4 d^2 n = alpha.
FN REAL air_drops_per_m3(REAL extinction_per_m, REAL diameter_m) {
  return REAL(0.6366197723675814) * extinction_per_m / (diameter_m * diameter_m);
}

// Way of a ray of length range below the top of a layer: z of its origin and dz of its direction, up.
FN REAL air_way_below_m(REAL origin_z_m, REAL direction_z, REAL range_m, REAL top_m) {
  REAL above = origin_z_m - top_m;
  if (above < REAL(0.0)) {
    if (direction_z * range_m > -above) {
      return -above / direction_z;
    }
    return range_m;
  }
  if (-direction_z * range_m > above) {
    return range_m - above / -direction_z;
  }
  return REAL(0.0);
}

// There and back through an optical depth (extinction times way).
FN REAL air_two_way_transmission(REAL optical_depth) { return exp(REAL(-2.0) * optical_depth); }
