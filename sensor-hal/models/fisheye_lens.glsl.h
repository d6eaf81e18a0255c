// Fisheye lens after Kannala and Brandt ("A generic camera model and calibration method for conventional, wide-angle,
// and fish-eye lenses", PAMI 2006) in the odd form that OpenCV's fisheye module has. Subset and inclusion: see
// opencv_lens.glsl.h; needs angles.glsl.h before it.
//
//   theta = angle of the ideal ray to the optical axis
//   r     = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
//   (xd, yd) = r (cos phi, sin phi),  phi the ray's direction round the axis
//
// theta_max is where the model ends: its fold, the first theta with dr/dtheta = 0, or pi. Beyond it other rays would
// fall on the same pixels. It depends on the coefficients alone: fisheye_theta_max of camera_model.h.

FN REAL fisheye_radius(REAL theta, REAL k1, REAL k2, REAL k3, REAL k4) {
  REAL t2 = theta * theta;
  return theta * (REAL(1.0) + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
}

FN REAL fisheye_radius_slope(REAL theta, REAL k1, REAL k2, REAL k3, REAL k4) {
  REAL t2 = theta * theta;
  return REAL(1.0) + t2 * (REAL(3.0) * k1 + t2 * (REAL(5.0) * k2 + t2 * (REAL(7.0) * k3 + t2 * REAL(9.0) * k4)));
}

// The distorted point of a direction of any length; valid = 0 beyond theta_max and straight backwards, where no
// direction round the axis is left.
FN void fisheye_project(REAL x, REAL y, REAL z, REAL k1, REAL k2, REAL k3, REAL k4, REAL theta_max, OUT(REAL) xd,
                        OUT(REAL) yd, OUT(REAL) valid) {
  REAL r2 = x * x + y * y;
  valid = REAL(1.0);
  if (r2 <= REAL(1e-16) * z * z) {
    // On the axis r = theta = tan theta to the last digit, and sqrt has no derivative.
    xd = x / z;
    yd = y / z;
    if (!(z > REAL(0.0))) {
      xd = REAL(0.0);
      yd = REAL(0.0);
      valid = REAL(0.0);
    }
    return;
  }
  REAL r = sqrt(r2);
  REAL theta = angle_from_axis(r, z);
  REAL scale = fisheye_radius(theta, k1, k2, k3, k4) / r;
  xd = x * scale;
  yd = y * scale;
  // Written as "not below" so that a NaN is invalid too.
  if (!(theta <= theta_max)) {
    valid = REAL(0.0);
  }
}

// The direction of unit length with fisheye_project(x, y, z) = (xd, yd): Newton's iteration on r(theta), which grows up
// to theta_max, within a bracket that halves where a step would leave it. `tolerance` is the residual that counts as
// the target: about 1e-6 for float, 1e-15 for double. valid = 0 where no ray of the lens reaches the point.
FN void fisheye_unproject(REAL xd, REAL yd, REAL k1, REAL k2, REAL k3, REAL k4, REAL theta_max, REAL tolerance,
                          OUT(REAL) x, OUT(REAL) y, OUT(REAL) z, OUT(REAL) valid) {
  REAL r2 = xd * xd + yd * yd;
  valid = REAL(1.0);
  if (r2 <= REAL(1e-16)) {
    x = xd;
    y = yd;
    z = REAL(1.0);
    return;
  }
  REAL r = sqrt(r2);
  x = REAL(0.0);
  y = REAL(0.0);
  z = REAL(1.0);
  if (!(r <= fisheye_radius(theta_max, k1, k2, k3, k4))) {
    valid = REAL(0.0);
    return;
  }
  REAL low = REAL(0.0);
  REAL high = theta_max;
  REAL theta = r < theta_max ? r : theta_max;
  for (int i = 0; i < 60; ++i) {
    REAL error = fisheye_radius(theta, k1, k2, k3, k4) - r;
    if (error > REAL(0.0)) {
      high = theta;
    } else {
      low = theta;
    }
    REAL next = theta - error / fisheye_radius_slope(theta, k1, k2, k3, k4);
    if (!(next >= low && next <= high)) {
      next = REAL(0.5) * (low + high);
    }
    theta = next;
    if (error <= tolerance && -error <= tolerance) {
      break;
    }
  }
  REAL sine = REAL(0.0);
  angle_sine_cosine(theta, sine, z);
  x = xd * sine / r;
  y = yd * sine / r;
}
