// A place's programs, GLSL ES 3.00. Colours are those of the display: light was worked out by bake.js. Positions are metres.

const SKY_OF = `
uniform vec3 zenith, horizon;
vec3 sky(vec3 d) {
  float up = clamp(d.y * inversesqrt(dot(d, d)), 0.0, 1.0);
  return mix(horizon, zenith, up * (2.0 - up));
}
`;

const SHADE = `
uniform vec4 blobs[16];    // x, z, radius, strength
uniform int blob_count;
uniform float shadow;
float shade(vec2 p) { // what shadows leave
  float left = 1.0;
  for (int i = 0; i < blob_count; i++) {
    vec2 off = (p - blobs[i].xy) / blobs[i].z;
    left *= 1.0 - blobs[i].w * exp(-dot(off, off));
  }
  return mix(1.0, left, shadow);
}
`;

const FLOOR = `
uniform sampler2D faces, grain;
uniform vec2 metres;       // that the grain covers; 0: there is none
vec3 floor_at(vec2 p, vec2 uv) {
  vec3 c = texture(faces, uv).rgb;
  return metres.x > 0.0 ? c * (2.0 * texture(grain, p / metres).r) : c;
}
`;

const HEAD = '#version 300 es\nprecision highp float;\n';

/** The sky where nothing is before it: one triangle, at the far end. */
export const SKY = {
  vertex: `#version 300 es
uniform mat4 room_from_clip; // without the eye's place
out vec3 direction;
void main() {
  vec2 at = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  vec4 far = room_from_clip * vec4(at, 1.0, 1.0);
  direction = far.xyz / far.w;
  gl_Position = vec4(at, 1.0, 1.0);
}`,
  fragment: `${HEAD}${SKY_OF}
in vec3 direction;
out vec4 result;
void main() {
  float grit = fract(52.98 * fract(dot(gl_FragCoord.xy, vec2(0.0671, 0.00584)))) - 0.5; // no bands in the dark
  result = vec4(sky(direction) + grit / 255.0, 1.0);
}`,
};

const VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 texel;  // in the faces, and 1 on the floor
layout(location = 2) in vec3 colour; // below 0: the faces'
uniform mat4 clip_from_room;
out vec3 point, at, own;
void main() {
  point = position;
  at = texel;
  own = colour;
  gl_Position = clip_from_room * vec4(position, 1.0);
  gl_PointSize = texel.x;
}`;

/** Floor, walls, ceiling, and what has its own colour; in a mirror the floor with its shadows. */
export const ROOM = {
  vertex: VERTEX,
  fragment: `${HEAD}${SHADE}${FLOOR}
uniform vec4 before;       // a plane behind which nothing is painted
in vec3 point, at, own;
out vec4 result;
void main() {
  if (dot(before, vec4(point, 1.0)) < 0.0) discard;
  vec3 c = own;
  if (own.x < 0.0) c = at.z > 0.5 ? floor_at(point.xz, at.xy) * shade(point.xz) : texture(faces, at.xy).rgb;
  result = vec4(c, 1.0);
}`,
};

/** Shadows, over any floor. */
export const SHADOW = {
  vertex: VERTEX,
  fragment: `${HEAD}${SHADE}
in vec3 point, at, own;
out vec4 result;
void main() { result = vec4(0.0, 0.0, 0.0, 1.0 - shade(point.xz)); }`,
};

/** A mirror's glass over what it shows. */
export const GLASS = {
  vertex: VERTEX,
  fragment: `${HEAD}uniform vec4 paint; // premultiplied
out vec4 result;
void main() { result = paint; }`,
};

/** {use(), at: uniform locations by name}. Throws with the compiler's words. */
export function build(gl, { vertex, fragment }) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    gl.deleteShader(shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader)).join(' ');
    throw new Error(`a shader failed to compile: ${gl.getProgramInfoLog(program)} ${logs}`);
  }
  const at = {};
  for (let i = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
    const { name } = gl.getActiveUniform(program, i);
    at[name] = gl.getUniformLocation(program, name);
  }
  return { use: () => gl.useProgram(program), at };
}
