// The light of a place as it falls on who stands in its middle: that in which its floor and walls were worked out, exposed.

import { FACTORS, SPREAD, polynomials } from '../space/light.js';
import { subtract, unit } from '../space/matrix.js';
import { lightIn } from './bake.js';
import { LOOKS } from './looks.js';

const WHERE = [0, 1.2, 0]; // the breast of who stands there
const NORMALS = 160; // at which it is looked up
const EXPOSURE = 1.5; // dark skin by day is as bright as on a photograph, and white cloth does not clip
const GOLDEN = Math.PI * (3 - Math.sqrt(5));
const known = new Map(); // by name

/** {ambient, sun} (draw/frame.js) of the place of that name, in the room's axes; null where there is none. */
export function lightOf(name) {
  if (!LOOKS[name]) return null;
  if (!known.has(name)) known.set(name, worked(LOOKS[name]));
  return known.get(name);
}

/** Its strongest lamp, or the sun, is one that casts shadow; all else becomes nine numbers a colour. */
function worked(look) {
  const dark = { ...look, ambient: [0, 0, 0], light: [0, 0, 0], lamps: [], sun: null };
  const alone = [...look.lamps.map((lamp) => ({ lamps: [lamp] })), ...(look.sun ? [{ sun: look.sun }] : [])];
  const shining = alone.map((one) => {
    const direction = unit(one.sun ? one.sun.towards : subtract(one.lamps[0].slice(0, 3), WHERE));
    return { one, direction, color: lightIn({ ...dark, ...one })(WHERE, direction).map((v) => v * Math.PI) };
  });
  shining.sort((a, b) => sum(b.color) - sum(a.color));
  const sun = shining.length && sum(shining[0].color) > 0 ? shining[0] : null;
  const lamps = look.lamps.filter((lamp) => lamp !== sun?.one.lamps?.[0]);
  const falls = lightIn({ ...look, lamps, sun: sun?.one.sun ? null : look.sun });
  const ambient = FACTORS.map(() => [0, 0, 0]);
  for (let i = 0; i < NORMALS; i++) {
    const y = 1 - (2 * i + 1) / NORMALS; // evenly over the sphere, on a spiral
    const level = Math.sqrt(1 - y * y);
    const normal = [level * Math.cos(GOLDEN * i), y, level * Math.sin(GOLDEN * i)];
    const light = falls(WHERE, normal);
    polynomials(normal).forEach((value, k) => {
      for (let c = 0; c < 3; c++) ambient[k][c] += (light[c] * value * FACTORS[k] * 4 * Math.PI) / (NORMALS * SPREAD[k]);
    });
  }
  return exposed({ ambient, sun: sun && { direction: sun.direction, color: sun.color } });
}

/** As much brighter in every place: who stands on the terrace at night is darker than in the room by day, as its floor is. */
function exposed({ ambient, sun }) {
  const by = (rgb) => rgb.map((v) => v * EXPOSURE);
  return { ambient: ambient.map(by), sun: sun && { ...sun, color: by(sun.color) } };
}

const sum = ([r, g, b]) => r + g + b;
