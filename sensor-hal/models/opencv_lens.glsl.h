// OpenCV's lens model, written once for shader (float), simulator (double) and calibrator (ceres::Jet).
//
// The subset that GLSL and C++ share: plain functions over REAL, results through OUT(REAL), no overloads, no
// member access. Include it through sensor-hal/models/lens.h in C++; a shader defines REAL, OUT and FN itself
// (see one_source.glsl.h). No include guard: it is included once per instantiation.
//
// Ideal normalised coordinates (x, y) = (X/Z, Y/Z) in the optical frame (x right, y down, z forward) map to
// distorted ones (OpenCV documentation, "Camera Calibration and 3D Reconstruction"):
//
//   r2 = x^2 + y^2,  L = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
//   xd = x L + 2 p1 x y + p2 (r2 + 2 x^2)
//   yd = y L + p1 (r2 + 2 y^2) + 2 p2 x y
//
// and pixels are u = fx xd + cx, v = fy yd + cy with pixel centres at integers.

// The distorted point and the Jacobian j = d(xd, yd)/d(x, y); `den` is the denominator of L.
FN void lens_distort_jacobian(REAL x, REAL y, REAL k1, REAL k2, REAL p1, REAL p2, REAL k3, REAL k4, REAL k5,
                              REAL k6, OUT(REAL) xd, OUT(REAL) yd, OUT(REAL) jxx, OUT(REAL) jxy,
                              OUT(REAL) jyx, OUT(REAL) jyy, OUT(REAL) den) {
  REAL r2 = x * x + y * y;
  REAL num = REAL(1.0) + r2 * (k1 + r2 * (k2 + r2 * k3));
  den = REAL(1.0) + r2 * (k4 + r2 * (k5 + r2 * k6));
  REAL scale = num / den;
  REAL dnum = k1 + r2 * (REAL(2.0) * k2 + r2 * REAL(3.0) * k3);
  REAL dden = k4 + r2 * (REAL(2.0) * k5 + r2 * REAL(3.0) * k6);
  REAL dscale = (dnum - scale * dden) / den;  // dL/dr2
  xd = x * scale + REAL(2.0) * p1 * x * y + p2 * (r2 + REAL(2.0) * x * x);
  yd = y * scale + p1 * (r2 + REAL(2.0) * y * y) + REAL(2.0) * p2 * x * y;
  jxx = scale + REAL(2.0) * x * x * dscale + REAL(2.0) * p1 * y + REAL(6.0) * p2 * x;
  jxy = REAL(2.0) * x * y * dscale + REAL(2.0) * p1 * x + REAL(2.0) * p2 * y;
  jyx = jxy;  // p1 and p2 enter as the gradient of a potential: the Jacobian is symmetric
  jyy = scale + REAL(2.0) * y * y * dscale + REAL(6.0) * p1 * y + REAL(2.0) * p2 * x;
}

FN void lens_distort(REAL x, REAL y, REAL k1, REAL k2, REAL p1, REAL p2, REAL k3, REAL k4, REAL k5, REAL k6,
                     OUT(REAL) xd, OUT(REAL) yd) {
  REAL r2 = x * x + y * y;
  REAL num = REAL(1.0) + r2 * (k1 + r2 * (k2 + r2 * k3));
  REAL den = REAL(1.0) + r2 * (k4 + r2 * (k5 + r2 * k6));
  REAL scale = num / den;
  xd = x * scale + REAL(2.0) * p1 * x * y + p2 * (r2 + REAL(2.0) * x * x);
  yd = y * scale + p1 * (r2 + REAL(2.0) * y * y) + REAL(2.0) * p2 * x * y;
}

// The inverse: (x, y) with lens_distort(x, y) = (xd, yd) on the branch that holds the optical axis.
//
// The model folds: beyond the curve where det J = 0 it maps other rays onto the same pixels. So the target is
// walked from the axis to (xd, yd) in steps, each mended by Newton's iteration; an iterate beyond the fold
// (det J <= 0, or a denominator <= 0) steps back half-way to the last one before it, and no step is longer
// than half the way from the axis so far. Where k2 or k3 turn a folded lens back there is a second sensor
// model behind the fold, with det J > 0 again, which a step may reach from the edge of the first: so the way
// from the axis to the result is looked at once more. A walk that does not end on its target before the fold
// returns valid = 0, and no ray of the lens reaches that pixel. `tolerance` is the residual that counts as
// the target, in normalised units: about 1e-6 for float, 1e-13 for double.
FN void lens_undistort(REAL xd, REAL yd, REAL k1, REAL k2, REAL p1, REAL p2, REAL k3, REAL k4, REAL k5,
                       REAL k6, REAL tolerance, OUT(REAL) x, OUT(REAL) y, OUT(REAL) valid) {
  const int steps = 8;
  x = REAL(0.0);
  y = REAL(0.0);
  valid = REAL(1.0);
  REAL good_x = REAL(0.0);
  REAL good_y = REAL(0.0);
  REAL jxx = REAL(1.0);
  REAL jxy = REAL(0.0);
  REAL jyx = REAL(0.0);
  REAL jyy = REAL(1.0);
  REAL den = REAL(1.0);
  REAL det = REAL(1.0);
  REAL ex = REAL(0.0);
  REAL ey = REAL(0.0);
  for (int step = 1; step <= steps; ++step) {
    REAL part = REAL(float(step)) / REAL(float(steps));
    int rounds = step == steps ? 20 : 4;
    REAL enough = step == steps ? tolerance : REAL(1e-2);
    for (int round_index = 0; round_index < rounds; ++round_index) {
      lens_distort_jacobian(x, y, k1, k2, p1, p2, k3, k4, k5, k6, ex, ey, jxx, jxy, jyx, jyy, den);
      ex = ex - part * xd;
      ey = ey - part * yd;
      det = jxx * jyy - jxy * jyx;
      if (det > REAL(1e-6) && den > REAL(0.0) && jxx + jyy > REAL(0.0)) {
        good_x = x;
        good_y = y;
        REAL dx = (jyy * ex - jxy * ey) / det;
        REAL dy = (jxx * ey - jyx * ex) / det;
        REAL longest2 = REAL(0.0625) + REAL(0.25) * (x * x + y * y);
        // Halved until it is short enough: no square root, whose derivative at 0 is none.
        for (int halving = 0; halving < 20; ++halving) {
          if (dx * dx + dy * dy > longest2) {
            dx = REAL(0.5) * dx;
            dy = REAL(0.5) * dy;
          }
        }
        x = x - dx;
        y = y - dy;
        // On the way it is enough to stay near the line; at its end the step that was just taken is the last.
        if (ex * ex + ey * ey <= enough * enough) {
          break;
        }
      } else {
        x = REAL(0.5) * (x + good_x);
        y = REAL(0.5) * (y + good_y);
      }
    }
  }
  lens_distort_jacobian(x, y, k1, k2, p1, p2, k3, k4, k5, k6, ex, ey, jxx, jxy, jyx, jyy, den);
  ex = ex - xd;
  ey = ey - yd;
  det = jxx * jyy - jxy * jyx;
  // Written as "not small" so that a NaN is invalid too.
  if (!(ex * ex + ey * ey <= tolerance * tolerance * (REAL(1.0) + xd * xd + yd * yd)) || det <= REAL(1e-6) ||
      den <= REAL(0.0) || jxx + jyy <= REAL(0.0)) {
    valid = REAL(0.0);
  }
  const int samples = 16;
  for (int i = 1; i < samples; ++i) {
    REAL along = REAL(float(i)) / REAL(float(samples));
    lens_distort_jacobian(along * x, along * y, k1, k2, p1, p2, k3, k4, k5, k6, ex, ey, jxx, jxy, jyx, jyy,
                          den);
    det = jxx * jyy - jxy * jyx;
    if (det <= REAL(1e-6) || den <= REAL(0.0) || jxx + jyy <= REAL(0.0)) {
      valid = REAL(0.0);
    }
  }
}
