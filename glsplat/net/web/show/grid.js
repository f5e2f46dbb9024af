// Points over a picture with the inverse depth of each, two triangles between any four of them, on the GPU.

export class Grid {
  size = [0, 0]; // columns, rows
  #gl;
  #array;
  #points;
  #corners;

  constructor(gl) {
    this.#gl = gl;
    this.#array = gl.createVertexArray();
    [this.#points, this.#corners] = [gl.createBuffer(), gl.createBuffer()];
    gl.bindVertexArray(this.#array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#points);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 1, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.#corners);
    gl.bindVertexArray(null);
  }

  /** Whether nothing of it can hide another part. */
  get flat() {
    return this.size[0] * this.size[1] <= 4;
  }

  /** Take over {columns, rows, inverse: Float32Array, row by row}. */
  fill({ columns, rows, inverse }) {
    const gl = this.#gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#points);
    gl.bufferData(gl.ARRAY_BUFFER, inverse, gl.STREAM_DRAW);
    if (columns === this.size[0] && rows === this.size[1]) return;
    this.size = [columns, rows];
    const corners = [];
    for (let i = 0; i < columns * (rows - 1); i++) {
      if ((i + 1) % columns) corners.push(i, i + 1, i + columns, i + 1, i + columns + 1, i + columns);
    }
    gl.bindVertexArray(this.#array);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint16Array.from(corners), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  draw() {
    const gl = this.#gl;
    gl.bindVertexArray(this.#array);
    gl.drawElements(gl.TRIANGLES, 6 * (this.size[0] - 1) * (this.size[1] - 1), gl.UNSIGNED_SHORT, 0);
    gl.bindVertexArray(null);
  }
}
