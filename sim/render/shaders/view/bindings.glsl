#extension GL_EXT_samplerless_texture_functions : require
#define MAX_HAZES 4
#define MAX_LAMPS 128
#define MAX_CASCADES 5
#include "sim/render/shaders/view/view_structs.glsl.h"
layout(set = 0, binding = 0) uniform FrameBlock { ViewFrame frame; };
layout(set = 0, binding = 1) uniform sampler2D sky_map;
layout(set = 0, binding = 2) uniform texture2DArray shadow_map;
layout(set = 0, binding = 3) uniform texture2D zenith_map;
