// Small things of WebGL2 that every pass needs.

/** A texture that is fetched texel by texel. `kind`: the name of a sized format of `FORMATS`. */
export function texture(gl, kind, width, height, data = null) {
  const [internal, format, type] = FORMATS[kind].map((name) => gl[name]);
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, internal, width, height);
  nearest(gl, gl.TEXTURE_2D);
  if (data) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, format, type, data);
  return made;
}

const FORMATS = {
  R32F: ['R32F', 'RED', 'FLOAT'],
  RG32F: ['RG32F', 'RG', 'FLOAT'],
  RGB32F: ['RGB32F', 'RGB', 'FLOAT'],
  RGBA32F: ['RGBA32F', 'RGBA', 'FLOAT'],
  RGBA32UI: ['RGBA32UI', 'RGBA_INTEGER', 'UNSIGNED_INT'],
};

export function nearest(gl, target) {
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
}

/** A buffer of `data`, or of so many bytes. */
export function buffer(gl, data, usage) {
  const made = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, made);
  gl.bufferData(gl.ARRAY_BUFFER, data, usage);
  gl.bindBuffer(gl.ARRAY_BUFFER, null);
  return made;
}

/** A vertex array of attributes [{location, buffer, size, stride, offset, type (of integers)}]; those without a location are left out. */
export function vertexArray(gl, attributes) {
  const made = gl.createVertexArray();
  gl.bindVertexArray(made);
  for (const { location, buffer: source, size, stride = 0, offset = 0, type = null } of attributes) {
    if (location === undefined) continue;
    gl.bindBuffer(gl.ARRAY_BUFFER, source);
    gl.enableVertexAttribArray(location);
    if (type === null) gl.vertexAttribPointer(location, size, gl.FLOAT, false, stride, offset);
    else gl.vertexAttribIPointer(location, size, type, stride, offset);
  }
  gl.bindVertexArray(null);
  gl.bindBuffer(gl.ARRAY_BUFFER, null);
  return made;
}

/** Run a program of feedback over `count` points into a buffer. */
export function feedback(gl, program, array, into, count) {
  program.use();
  gl.bindVertexArray(array);
  gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, into);
  gl.enable(gl.RASTERIZER_DISCARD);
  gl.beginTransformFeedback(gl.POINTS);
  gl.drawArrays(gl.POINTS, 0, count);
  gl.endTransformFeedback();
  gl.disable(gl.RASTERIZER_DISCARD);
  gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null);
  gl.bindVertexArray(null);
}

/** Bind a texture to the unit of a sampler. */
export function bind(gl, unit, made, target = gl.TEXTURE_2D) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(target, made);
}

/** Copy a buffer into rows of a texture, without leaving the GPU. `kind`: of FORMATS. */
export function copyRows(gl, from, into, kind, width, first, rows) {
  const [, format, type] = FORMATS[kind].map((name) => gl[name]);
  gl.bindTexture(gl.TEXTURE_2D, into);
  gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, from);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, first, width, rows, format, type, 0);
  gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
}
