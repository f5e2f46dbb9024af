// The package's own shaders, put together for WebGL2: docs/webgl.md says what programs.json (glsplat/extras/browser/web_shaders.py) has.

// transform feedback wants a fragment shader, too
const NOTHING = 'void main() {}\n';

/** The text of a stage of a program: what `flatten` of glsplat/shaders gives, byte for byte. */
export function textOf(table, name, number) {
  const { stages, defines } = table.programs[name];
  const flags = defines[number].map((flag) => `#define ${flag}\n`).join('');
  return `${table.head}\n${flags}${table.stages[stages[number]]}`;
}

/** Programs of one context, compiled when they are first asked for. */
export class Programs {
  #gl;
  #made = new Map(); // name -> {program, at}

  /** `table`: the object of programs.json. */
  constructor(gl, table) {
    this.#gl = gl;
    this.table = table;
  }

  /**
   * {use(), at: uniform locations by name, attributes: locations by name} of a program, with its samplers and its block
   * where slots.py has them. `vertex`: a text of the page's own in place of its vertex shader. Throws with the
   * compiler's words.
   */
  get(name, vertex = null) {
    const key = vertex === null ? name : `${name} ${vertex}`;
    if (!this.#made.has(key)) this.#made.set(key, this.#link(name, vertex));
    return this.#made.get(key);
  }

  release() {
    for (const { program } of this.#made.values()) this.#gl.deleteProgram(program);
    this.#made.clear();
  }

  #link(name, vertex) {
    const [gl, { table }] = [this.#gl, this];
    if (!Object.hasOwn(table.programs, name)) throw new Error(`there is no program "${name}" for this page`);
    const { captured, stages } = table.programs[name];
    const fragment = stages.length > 1 ? textOf(table, name, 1) : `${table.head}\n${NOTHING}`;
    const program = gl.createProgram();
    const texts = [[gl.VERTEX_SHADER, vertex ?? textOf(table, name, 0)], [gl.FRAGMENT_SHADER, fragment]];
    for (const [type, text] of texts) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader);
    }
    if (captured.length) gl.transformFeedbackVaryings(program, captured, gl.INTERLEAVED_ATTRIBS);
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      const words = [gl.getProgramInfoLog(program), ...logs].filter(Boolean).join(' ').trim();
      gl.deleteProgram(program);
      throw new Error(`the program "${name}" does not compile: ${words}`);
    }
    return this.#bound(program);
  }

  #bound(program) {
    const [gl, { units, frame_block: slot }] = [this.#gl, this.table];
    const [at, attributes] = [{}, {}];
    const count = (what) => gl.getProgramParameter(program, what) ?? 0; // null of a lost context
    gl.useProgram(program);
    for (let i = count(gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
      const { name } = gl.getActiveUniform(program, i);
      at[name] = gl.getUniformLocation(program, name);
      if (Object.hasOwn(units, name) && at[name]) gl.uniform1i(at[name], units[name]);
    }
    for (let i = count(gl.ACTIVE_ATTRIBUTES) - 1; i >= 0; i--) {
      const { name } = gl.getActiveAttrib(program, i);
      attributes[name] = gl.getAttribLocation(program, name);
    }
    const block = gl.getUniformBlockIndex(program, 'Frame');
    if (block !== gl.INVALID_INDEX && block !== null) gl.uniformBlockBinding(program, block, slot);
    return { program, at, attributes, use: () => gl.useProgram(program) };
  }
}
