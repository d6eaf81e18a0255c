// Depth of field of a thin lens. Subset and inclusion: see opencv_lens.glsl.h.
//
// A point at depth d is imaged to a disc of diameter f^2 |d - U| / (N C d (U - f)) pixels: focal length f, distance in
// focus U, f-number N, pixel pitch C (Potmesil and Chakravarty, SIGGRAPH 1981). All lengths in one unit. Written with
// |1 - U/d|, so that d may be infinite.
FN REAL blur_diameter_px(REAL depth, REAL focus_distance, REAL focal_length, REAL f_number, REAL pixel_pitch) {
  REAL defocus = REAL(1.0) - focus_distance / depth;
  defocus = defocus < REAL(0.0) ? -defocus : defocus;
  return focal_length * focal_length * defocus / (f_number * pixel_pitch * (focus_distance - focal_length));
}
