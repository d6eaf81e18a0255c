// Which samples of a pixel a surface with holes covers, by the coverage that its map says.
layout(constant_id = 13) const bool kMultisampled = false;

void cut_holes(float coverage, float cutoff, uint instance) {
  gl_SampleMask[0] = 15;
  if (kMultisampled) {
    // Coverage by sample: as sharp as a pixel, round the cutoff. Which samples come first differs from pixel to pixel
    // and from instance to instance, so that leaves behind each other do not hide each other exactly.
    float covered = clamp((coverage - cutoff) / max(fwidth(coverage), 1e-4) + 0.5, 0.0, 1.0);
    int count = int(covered * 4.0 + 0.5);
    if (count == 0) discard;
    uint turn = pcg(uint(gl_FragCoord.x) + (uint(gl_FragCoord.y) << 16u) + instance) & 3u;
    uint bits = ((1u << count) - 1u) * 17u;
    gl_SampleMask[0] = int((bits >> turn) & 15u);
  } else if (coverage < cutoff) {
    discard;
  }
}
