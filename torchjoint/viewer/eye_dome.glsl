#version 300 es
// Eye-dome lighting (Boucheny, "Interactive scientific visualization of large datasets", 2009): a pixel is darker, the
// more its neighbours are in front of it. So a cloud has depth without normals.
precision highp float;
uniform highp sampler2D depth;
uniform bool reversed; // 1 is near, 0 is far
uniform float radius; // pixels
out vec4 shade;
const float STRENGTH = 20.0; // of a doubling of the distance between a pixel and its neighbours
float nearness(ivec2 at) { // the inverse of the distance, in some unit; 0: background
  float value = texelFetch(depth, clamp(at, ivec2(0), textureSize(depth, 0) - 1), 0).r;
  return reversed ? value : 1.0 - value;
}
void main() {
  ivec2 here = ivec2(gl_FragCoord.xy);
  float own = nearness(here), sum = 0.0;
  for (int step = 0; step < 8; step++) {
    float angle = float(step) * 0.7853982;
    float other = nearness(here + ivec2(round(radius * vec2(cos(angle), sin(angle)))));
    sum += max(0.0, log2(max(other, 1e-7) / max(own, 1e-7)));
  }
  shade = vec4(vec3(own > 0.0 ? exp(-STRENGTH * min(sum / 8.0, 0.05)) : 1.0), 1.0);
}
