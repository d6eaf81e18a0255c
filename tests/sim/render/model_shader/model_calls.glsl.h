// Calls of the error models, by number: read by the shader and by C++, so that both make the same calls. Twelve
// arguments in, four results out.
#define MODEL_CALLS 32

FN void model_call(int which, REAL a, REAL b, REAL c, REAL d, REAL e, REAL f, REAL g, REAL h, REAL i, REAL j,
                   REAL k, REAL l, OUT(REAL) p, OUT(REAL) q, OUT(REAL) r, OUT(REAL) s) {
  p = REAL(0.0);
  q = REAL(0.0);
  r = REAL(0.0);
  s = l * REAL(0.0);
  if (which == 0) {
    lens_distort(a, b, c, d, e, f, g, h, i, j, p, q);
  } else if (which == 1) {
    lens_undistort(a, b, c, d, e, f, g, h, i, j, REAL(1e-6), p, q, r);
  } else if (which == 2) {
    fisheye_project(a, b, c, d, e, f, g, REAL(3.0), p, q, r);
  } else if (which == 3) {
    fisheye_unproject(a, b, c, d, e, f, REAL(3.0), REAL(1e-6), p, q, r, s);
  } else if (which == 4) {
    p = vignetting_factor(a, b, c, d, e, f);
    q = blur_diameter_px(g, h, i, j, k);
  } else if (which == 5) {
    p = normal_quantile(a);
    q = dark_current_at(b, c, d, e);
  } else if (which == 6) {
    p = poisson_quantile(a, b);
  } else if (which == 7) {
    p = emva_mean_electrons(a, b, c, d);
    q = emva_analogue_dn(emva_collected_electrons(e, f, g, h, i), j, k);
  } else if (which == 8) {
    p = emva_quantise(a, b);
    q = emva_response(c, d, e, f);
  } else if (which == 9) {
    p = bloom_kernel(a, b, c);
    q = bloom_mix(d, e, f, g, h);
    r = bloom_gaussian_sigma(i, b);
    s = bloom_gaussian_height(i, c, j);
  } else if (which == 10) {
    p = processed_dn(balanced_dn(a, b, c), b, d, e, f);
  } else if (which == 11) {
    p = lidar_surface_remission(a, b, c, d, e, f);
    q = lidar_beam_diameter_m(g, h, i);
    r = lidar_received_power(b, i, j, k);
  } else if (which == 12) {
    p = lidar_least_remission(a, b, c, d, e);
    q = lidar_range_sigma_m(f, g, h, i, j);
  } else if (which == 13) {
    p = lidar_remission_units(a, b, c, d, e, f);
    q = lidar_gaussian_share(g);
    r = lidar_drop_remission(h, i, j);
  } else if (which == 14) {
    p = lidar_quantise(a, b);
  } else if (which == 15) {
    p = lidar_expected_drops(a, b, c, d, e);
    q = lidar_soft_remission(f, g, h);
  } else if (which == 16) {
    p = lidar_nearest_drop_m(a, b, c, d, e);
  } else if (which == 17) {
    lidar_refract(a, b, c, d, e, f, g, p, q, r);
  } else if (which == 18) {
    lidar_risley_direction(a, b, c, d, e, f, g, h, p, q, r);
  } else if (which == 19) {
    p = air_fog_extinction_per_m(a, b);
    q = air_rain_extinction_per_m(c);
    r = air_rain_extinction_goodin_per_m(c);
    s = air_snow_extinction_per_m(c);
  } else if (which == 20) {
    p = air_rain_diameter_m(a);
    q = air_snow_diameter_m(a);
    r = air_drops_per_m3(b, c);
    s = air_two_way_transmission(d);
  } else if (which == 21) {
    p = air_way_below_m(a, b, c, d);
  } else if (which == 22) {
    tof_sincos_turns(a, p, q);
  } else if (which == 23) {
    p = tof_angle_turns(a, b);
  } else if (which == 24) {
    tof_phasor(a, REAL(0.0), b, c, d, e, f, g, p, q);
  } else if (which == 25) {
    tof_phasor(a, REAL(1.0), REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0), REAL(1.0), REAL(1.0), p, q);
    r = tof_active_electrons(b, c, d, e);
    s = tof_range_sigma(f, g, h, i, j);
  } else if (which == 26) {
    tof_taps(a, b, c, d, e, p, q, r, s);
  } else if (which == 27) {
    p = tof_read_tap(a, b, c, d, e, f, q);
  } else if (which == 28) {
    p = hot_pixel_rate(a, b, c, d);
  } else if (which == 29) {
    tof_demodulate(a, b, c, d, p, q);
    r = tof_nearest_range(e, f, g);
  } else if (which == 31) {
    p = lidar_range_error_m(a, b, c, d, e, f, g);
  } else {
    REAL t = REAL(0.0);
    tof_spline(a, b, c, d, p, q, r, s, t);
    p = p * REAL(1e-3) + t;
    s = s + tof_range_error(e, f, g);
  }
}
