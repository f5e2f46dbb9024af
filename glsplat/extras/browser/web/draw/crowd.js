// The people that this device draws, with their poses and levels of detail.

import { HERE, amountsOf, matrixOf } from './bones.js';
import { Drawing } from './drawing.js';
import { cameraOf } from './frame.js';

/** Names of ARKit's 52 shapes in the order of an expression on the wire (docs/conventions.md). */
export const ARKIT = [
  'eyeBlinkLeft', 'eyeLookDownLeft', 'eyeLookInLeft', 'eyeLookOutLeft', 'eyeLookUpLeft', 'eyeSquintLeft', 'eyeWideLeft',
  'eyeBlinkRight', 'eyeLookDownRight', 'eyeLookInRight', 'eyeLookOutRight', 'eyeLookUpRight', 'eyeSquintRight',
  'eyeWideRight', 'jawForward', 'jawLeft', 'jawRight', 'jawOpen', 'mouthClose', 'mouthFunnel', 'mouthPucker', 'mouthLeft',
  'mouthRight', 'mouthSmileLeft', 'mouthSmileRight', 'mouthFrownLeft', 'mouthFrownRight', 'mouthDimpleLeft',
  'mouthDimpleRight', 'mouthStretchLeft', 'mouthStretchRight', 'mouthRollLower', 'mouthRollUpper', 'mouthShrugLower',
  'mouthShrugUpper', 'mouthPressLeft', 'mouthPressRight', 'mouthLowerDownLeft', 'mouthLowerDownRight', 'mouthUpperUpLeft',
  'mouthUpperUpRight', 'browDownLeft', 'browDownRight', 'browInnerUp', 'browOuterUpLeft', 'browOuterUpRight', 'cheekPuff',
  'cheekSquintLeft', 'cheekSquintRight', 'noseSneerLeft', 'noseSneerRight', 'tongueOut',
];

export class Crowd {
  #drawing;
  #people = []; // [{key, avatar, pose, place, expression, opacity}]
  #levels = new Map(); // last level by key
  #shown = []; // [{splats, skeleton}] of the drawing

  /** `options`: of Drawing. */
  constructor(gl, table, options = {}) {
    this.#drawing = new Drawing(gl, table, options);
  }

  get drawing() {
    return this.#drawing;
  }

  /** Number of splats of the last frame. */
  get drawn() {
    return this.#drawing.drawn;
  }

  /**
   * [{key, avatar (avatar.js), pose {joints, root, translations}, place, expression [52] or null, opacity}], whom all
   * views see.
   */
  set people(people) {
    this.#people = people.filter(({ avatar }) => avatar.levels.size > 0);
    const keys = new Set(this.#people.map(({ key }) => key));
    for (const key of this.#levels.keys()) if (!keys.has(key)) this.#levels.delete(key);
  }

  get people() {
    return this.#people;
  }

  /**
   * Draw for eyes [{transform, projection, viewport}] into a framebuffer; `shown` and `glass` as of Drawing.draw.
   * `headless`: key of the person whose head is hidden; `light` of frame.js, in the space of the people.
   */
  draw(eyes, framebuffer, shown, { glass = null, headless = null, light = null } = {}) {
    const { width, height } = eyes[0].viewport;
    const cameras = eyes.map((eye) => cameraOf(eye, width, height, shown));
    const posed = this.#people.map((person) => ({ place: HERE, opacity: 1, ...person, bones: person.avatar.skeleton.bones(person.pose) }));
    const things = posed.map(({ key, avatar, bones, place }) => {
      const level = avatar.levelFor(placedCameras(cameras, place), bones, place, this.#levels.get(key));
      this.#levels.set(key, level);
      const splats = avatar.levels.get(level);
      return { splats: key === headless ? avatar.without(splats, 'head') : splats, skeleton: avatar.skeleton };
    });
    const same = things.length === this.#shown.length
      && things.every(({ splats, skeleton }, i) => splats === this.#shown[i].splats && skeleton === this.#shown[i].skeleton);
    if (!same) this.#drawing.show(things);
    this.#shown = things;
    posed.forEach(({ bones, place, expression, opacity, avatar }, i) => {
      const { shapes } = things[i].splats;
      const amounts = shapes && expression ? amountsOf(shapes, weightsOf(avatar.names, expression)) : null;
      this.#drawing.pose(i, { bones, place, amounts, opacity });
    });
    this.#drawing.light = light;
    this.#drawing.draw(eyes, framebuffer, shown, glass);
  }

  release() {
    this.#drawing.release();
  }
}

/** Return cameras in an item's own space, without its scale, to choose its level. */
function placedCameras(cameras, { translation: [x, y, z], rotation }) {
  if (x === 0 && y === 0 && z === 0 && rotation[3] === 1) return cameras;
  const r = matrixOf(rotation);
  return cameras.map((camera) => {
    const rows = [0, 4, 8].flatMap((row) => {
      const [a, b, c, d] = camera.rows.slice(row, row + 4);
      const turned = [0, 1, 2].map((k) => a * r[k] + b * r[3 + k] + c * r[6 + k]);
      return [...turned, a * x + b * y + c * z + d];
    });
    return { ...camera, rows };
  });
}

/** Return the weights of an avatar's shapes for an expression in ARKit's order. */
function weightsOf(names, expression) {
  return names.map((name) => expression[ARKIT.indexOf(name)] ?? 0);
}
