// The page's programs, GLSL ES 3.00. Positions are metres in the room; colours are premultiplied.

import { build } from '../place/program.js';

/** A picture put back into the room: `texel` is projective, so that it is right on any plane seen from anywhere. */
const PICTURE = {
  vertex: `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 texel; // picture coordinates times w, and w
uniform mat4 clip_from_room;
out vec3 uvw;
void main() {
  uvw = texel;
  gl_Position = clip_from_room * vec4(position, 1.0);
}`,
  fragment: `#version 300 es
precision highp float;
uniform sampler2D colour;
uniform sampler2D alpha;
uniform vec4 box;      // x, y, width, height of what was sent, as parts of the whole picture
uniform bool has_alpha;
in vec3 uvw;
out vec4 result;
void main() {
  vec2 at = (uvw.xy / uvw.z - box.xy) / box.zw;
  bool inside = uvw.z > 0.0 && all(greaterThanEqual(at, vec2(0.0))) && all(lessThanEqual(at, vec2(1.0)));
  vec4 nothing = vec4(0.0, 0.0, 0.0, has_alpha ? 0.0 : 1.0); // black, and see-through where anything is
  float a = has_alpha ? texture(alpha, at).r : 1.0;
  result = inside ? vec4(texture(colour, at).rgb * a, a) : nothing; // colours are straight: alpha alone cuts them
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
