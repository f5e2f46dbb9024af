// Expressions on the CPU: weights to what shapes.glsl reads, and where the splats then are, for their order.
// Twin: glsplat/skinning/shapes.py. The shader moves the splats themselves.

const BEND = 3 / 127; // of an axis, a unit of a shape's bends

/**
 * What the GPU reads at `weights` [T]: metres a unit of moves and axis a unit of bends, [2 T]; null where all are 0.
 * `limits`: [2 T], least and largest weight.
 */
export function amountsOf({ sizes, limits }, weights) {
  const out = new Float32Array(2 * sizes.length);
  let any = false;
  for (let k = 0; k < sizes.length; k++) {
    const w = Math.min(Math.max(weights[k] || 0, limits[2 * k]), limits[2 * k + 1]);
    any ||= w !== 0;
    [out[2 * k], out[2 * k + 1]] = [w * sizes[k], w * BEND];
  }
  return any ? out : null;
}

/** The means [3 N] of splats at those amounts, into `out`. */
export function movedMeans({ means, count, shapes: { starts, texels } }, amounts, out) {
  out.set(means);
  for (let i = 0; i < count; i++) {
    for (let e = starts[i]; e < starts[i + 1]; e++) {
      const by = amounts[2 * (texels[4 * e + 3] & 255)];
      if (by === 0) continue;
      const [first, second] = [texels[4 * e], texels[4 * e + 1]];
      out[3 * i] += by * ((first << 16) >> 16);
      out[3 * i + 1] += by * (first >> 16);
      out[3 * i + 2] += by * ((second << 16) >> 16);
    }
  }
  return out;
}
