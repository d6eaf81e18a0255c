// The farthest depth (reversed: the smallest value) of each tile of 16 x 16 pixels, over all samples.
#extension GL_EXT_samplerless_texture_functions : require
layout(local_size_x = 8, local_size_y = 8) in;
#ifdef MULTISAMPLED
layout(set = 0, binding = 0) uniform texture2DMS depth;
#else
layout(set = 0, binding = 0) uniform texture2D depth;
#endif
layout(set = 0, binding = 1) writeonly buffer Tiles { float tiles[]; };
layout(push_constant) uniform Push { uvec4 size; };  // width, height [px], tiles along a row, rows of tiles

void main() {
  uvec2 tile = gl_GlobalInvocationID.xy;
  if (tile.x >= size.z || tile.y >= size.w) return;
  uvec2 first = tile * 16u;
  uvec2 last = min(first + 16u, size.xy);
  float farthest = 1.0;
  for (uint y = first.y; y < last.y && farthest > 0.0; ++y)
    for (uint x = first.x; x < last.x; ++x) {
#ifdef MULTISAMPLED
      for (int s = 0; s < 4; ++s) farthest = min(farthest, texelFetch(depth, ivec2(x, y), s).x);
#else
      farthest = min(farthest, texelFetch(depth, ivec2(x, y), 0).x);
#endif
    }
  tiles[tile.y * size.z + tile.x] = farthest;
}
