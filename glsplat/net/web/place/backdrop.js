// What lies behind the pictures is painted once for an eye that rests, and copied from then on: where pixels are painted
// by a processor, a room costs more than the picture before it.

export class Backdrop {
  #gl;
  #kept = []; // by view: {key, texture, framebuffer, whole}

  constructor(gl) {
    this.#gl = gl;
  }

  /**
   * The canvas of view `index`, whose viewport is {x, y, width, height}, as `paint()` leaves it; `key`, an array, says
   * all that it depends on. An eye that moves is painted as ever: a copy is made the second time that nothing changed.
   */
  draw(index, viewport, key, paint) {
    const kept = (this.#kept[index] ??= { key: [], whole: false });
    const same = key.length === kept.key.length && key.every((value, i) => value === kept.key[i]);
    if (same && kept.whole) return this.#put(kept, viewport);
    paint();
    if (same) this.#keep(kept, viewport);
    else Object.assign(kept, { key, whole: false });
  }

  #keep(kept, { x, y, width, height }) {
    const gl = this.#gl;
    kept.texture ??= gl.createTexture();
    kept.framebuffer ??= gl.createFramebuffer();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, kept.texture);
    gl.copyTexImage2D(gl.TEXTURE_2D, 0, gl.RGB, x, y, width, height, 0);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, kept.framebuffer);
    gl.framebufferTexture2D(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, kept.texture, 0);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    kept.whole = true;
  }

  /** Copies only where the canvas has no samples: `antialias: false` when its context is made. */
  #put({ framebuffer }, { x, y, width, height }) {
    const gl = this.#gl;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
    gl.blitFramebuffer(0, 0, width, height, x, y, x + width, y + height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
  }
}
