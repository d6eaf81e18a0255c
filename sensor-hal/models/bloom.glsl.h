// Light that the lens and the sensor's cover spread. Subset and inclusion: see opencv_lens.glsl.h.
//
// The kernel is 1 / (1 + (r / radius)^2)^exponent: a core as wide as `radius` and the long tail of scattered light
// (exponent 1.5: the light beyond r falls as 1/r). It is a mixture of Gaussians,
//
//   (1 + q)^-p = 1 / Gamma(p) * Integral t^(p-1) e^-t e^(-t q) dt,   q = (r / radius)^2,
//
// and the trapezoid rule in ln t with step h errs by 2 |Gamma(p + 2 pi i / h)| / Gamma(p) relative: 3e-5 for p = 1.5
// and h = ln 2, the same at every r. So a sum of Gaussians, two to an octave of width, is the kernel.

FN REAL bloom_kernel(REAL r_squared, REAL radius, REAL exponent) {
  return exp(-exponent * log(REAL(1.0) + r_squared / (radius * radius)));
}

// The Gaussian of t: standard deviation in pixels, and its height (for the step h in ln t, without 1 / Gamma(p)).
FN REAL bloom_gaussian_sigma(REAL t, REAL radius) { return radius / sqrt(REAL(2.0) * t); }
FN REAL bloom_gaussian_height(REAL t, REAL exponent, REAL step) { return step * exp(exponent * log(t) - t); }

// What a pixel has at the end: its own light, light spread by the kernel, light spread evenly.
FN REAL bloom_mix(REAL own, REAL spread, REAL mean, REAL fraction, REAL veiling_glare) {
  return (REAL(1.0) - fraction - veiling_glare) * own + fraction * spread + veiling_glare * mean;
}
