// The page's programs, GLSL ES 3.00. Positions are metres in the room; colours are premultiplied.

import { build } from '../place/shaders.js';

/**
 * A picture put back into the room, by the inverse depth of points on a grid. Homogeneous throughout: the way from the
 * picture to the screen is right on any plane seen from anywhere.
 */
const PICTURE = {
  vertex: `#version 300 es
layout(location = 0) in float inverse; // 1 / metres along the axis of the camera that it was drawn for
uniform ivec2 grid;    // columns, rows
uniform vec4 extent;   // left, up, width, height of the picture, in tangents
uniform mat4 cuts;     // four planes in that camera's axes
uniform mat4 clip_from_camera;
out vec2 uv;
out vec4 within;
void main() {
  uv = vec2(gl_VertexID % grid.x, gl_VertexID / grid.x) / vec2(grid - 1);
  vec4 place = vec4(extent.x + uv.x * extent.z, extent.y - uv.y * extent.w, -1.0, inverse);
  within = place * cuts;
  gl_Position = clip_from_camera * place;
}`,
  fragment: `#version 300 es
precision highp float;
uniform sampler2D colour;
uniform sampler2D alpha;
uniform vec4 box;      // x, y, width, height of what was sent, as parts of the whole picture
uniform bool has_alpha;
uniform vec2 range;    // alpha from, up to which anything is drawn
in vec2 uv;
in vec4 within;
out vec4 result;
void main() {
  vec2 at = (uv - box.xy) / box.zw;
  bool inside = all(greaterThanEqual(at, vec2(0.0))) && all(lessThanEqual(at, vec2(1.0)));
  float a = !has_alpha ? 1.0 : inside ? texture(alpha, at).r : 0.0; // without alpha all around is black
  if (any(lessThan(within, vec4(0.0))) || a < range.x || a >= range.y) discard;
  result = vec4(inside ? texture(colour, at).rgb * a : vec3(0.0), a); // colours are straight: alpha alone cuts them
}`,
};

const FLAT = {
  vertex: `#version 300 es
layout(location = 0) in vec3 position;
uniform mat4 clip_from_room;
out vec3 point;
void main() {
  point = position;
  gl_Position = clip_from_room * vec4(position, 1.0);
}`,
  fragment: `#version 300 es
precision highp float;
uniform vec4 paint;    // premultiplied
uniform vec3 eye;
uniform float fade;    // metres from the eye at which nothing is left; 0: everywhere alike
in vec3 point;
out vec4 result;
void main() {
  result = paint * (fade > 0.0 ? clamp(1.0 - distance(point, eye) / fade, 0.0, 1.0) : 1.0);
}`,
};

const LABEL = {
  vertex: `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 texel;
uniform mat4 clip_from_room;
out vec2 at;
void main() {
  at = texel.xy;
  gl_Position = clip_from_room * vec4(position, 1.0);
}`,
  fragment: `#version 300 es
precision highp float;
uniform sampler2D colour;
in vec2 at;
out vec4 result;
void main() {
  result = texture(colour, at);
}`,
};

/** {picture, flat, label}: each {use(), at: uniform locations by name}. Throws with the compiler's words. */
export function buildPrograms(gl) {
  return { picture: build(gl, PICTURE), flat: build(gl, FLAT), label: build(gl, LABEL) };
}
