// From random bits to draws. Subset and inclusion: see opencv_lens.glsl.h and philox.glsl.h.

// Uniform in the open interval (0, 1), symmetric about 1/2: (k + 1/2) / 2^23 from the upper 23 bits. That number is
// exact in float, so float and double see the same draw, and neither 0 nor 1 ever comes.
FN REAL unit_from_bits(UINT bits) {
  return (REAL(float(bits >> 9)) + REAL(0.5)) * REAL(1.1920928955078125e-7);
}

// Quantile of the standard normal distribution: Wichura, algorithm AS 241, PPND7 (Applied Statistics 37, 1988), relative
// accuracy 1e-7, for 1.4e-11 < u < 1 - 1.4e-11: a draw of unit_from_bits never leaves that, so the far tail's third
// branch, which a GPU would work out for every pixel, is left away. GLSL has no such function, and formulas through sin
// and cos (Box-Muller) have only the absolute 2^-11 that Vulkan promises for those.
//
// In parts, so that a CPU can work out the middle for many draws at once and the tails for those that need them.
FN REAL normal_quantile_middle(REAL q) {
  REAL r = REAL(0.180625) - q * q;
  return q *
         (((REAL(5.9109374720e+01) * r + REAL(1.5929113202e+02)) * r + REAL(5.0434271938e+01)) * r +
          REAL(3.3871327179e+00)) /
         (((REAL(6.7187563600e+01) * r + REAL(7.8757757664e+01)) * r + REAL(1.7895169469e+01)) * r + REAL(1.0));
}

FN REAL normal_quantile_tail(REAL u) {
  REAL q = u - REAL(0.5);
  REAL tail = q < REAL(0.0) ? u : REAL(1.0) - u;
  REAL r = sqrt(-log(tail));
  r = r - REAL(1.6);
  REAL z = (((REAL(1.7023821103e-01) * r + REAL(1.3067284816e+00)) * r + REAL(2.7568153900e+00)) * r +
            REAL(1.4234372777e+00)) /
           ((REAL(1.2021132975e-01) * r + REAL(7.3700164250e-01)) * r + REAL(1.0));
  return q < REAL(0.0) ? -z : z;
}

FN REAL normal_quantile(REAL u) {
  REAL q = u - REAL(0.5);
  if (q * q <= REAL(0.180625)) {
    return normal_quantile_middle(q);
  }
  return normal_quantile_tail(u);
}

// Quantile of the Poisson distribution of the given mean, by inversion of one uniform draw.
//
// mean < 10: sequential search of the distribution function. The search also ends where terms fall below 1e-8, which
// keeps a rounded sum that never reaches u from running to the loop's end.
FN REAL poisson_search(REAL mean, REAL u) {
  REAL term = exp(-mean);
  REAL sum = term;
  REAL k = REAL(0.0);
  for (int i = 0; i < 64; ++i) {
    if (sum >= u || (term < REAL(1e-8) && k > mean)) {
      break;
    }
    k = k + REAL(1.0);
    term = term * mean / k;
    sum = sum + term;
  }
  return k;
}

// mean >= 10: Giles' asymptotic expansion of the inverse (algorithm 955, ACM TOMS 42, 2016, Q_N with the terms to
// 1/mean), of which poisson_quantile takes the floor: the Cornish-Fisher correction with the discrete offset already in
// it. w is the normal quantile of u. Its largest error at the switch moves 0.1 % of the draws by one electron; mean and
// variance stay within 1e-3 of their values.
FN REAL poisson_expansion(REAL mean, REAL w) {
  REAL s = sqrt(mean);
  REAL inverse_s = REAL(1.0) / s;
  REAL w2 = w * w;
  return mean + s * w + (REAL(2.0) + w2) * REAL(0.16666666666666667) -
         w * (REAL(2.0) + w2) * REAL(0.013888888888888889) * inverse_s +
         (REAL(-0.019753086419753086) + w2 * (REAL(0.0086419753086419753) + w2 * REAL(0.0037037037037037038))) *
             inverse_s * inverse_s;
}

FN REAL poisson_quantile(REAL mean, REAL u) {
  if (mean < REAL(10.0)) {
    return poisson_search(mean, u);
  }
  REAL n = poisson_expansion(mean, normal_quantile(u));
  return n > REAL(0.0) ? floor(n) : REAL(0.0);
}
