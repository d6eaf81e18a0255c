// Dark current. Subset and inclusion: see opencv_lens.glsl.h. Draws are arguments.

// Dark current doubles with every `doubling` kelvin (EMVA 1288: the doubling temperature).
FN REAL dark_current_at(REAL reference_rate, REAL temperature, REAL reference_temperature, REAL doubling) {
  return reference_rate * exp2((temperature - reference_temperature) / doubling);
}

// What a pixel has more than the others: `share` of the pixels are hot, with exponentially distributed rates of the
// given mean. pick_u and size_u are uniform draws.
FN REAL hot_pixel_rate(REAL share, REAL mean_rate, REAL pick_u, REAL size_u) {
  if (pick_u >= share) {
    return REAL(0.0);
  }
  return -mean_rate * log(size_u);
}
