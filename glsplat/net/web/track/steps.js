// Walking without feet: the user's steps and turns by keys or a stick, in a space whose floor stays where it is.

import { IDENTITY, invert, movePoint, multiply, place, subtract, translation, turnY } from '../space/matrix.js';
import { quaternion, rotationVector } from './drivers.js';

export const STRIDE = 0.4; // metres
export const TURN = Math.PI / 6; // radians
const APART = 0.7; // metres between two heads, at least
const FARTHEST = 4; // metres from where the user stood first

export class Steps {
  #matrix = IDENTITY; // space from that of the user who has not moved

  /** `others()` returns the heads [x, y, z] of everybody else. */
  constructor(others = () => []) {
    this.others = others;
  }

  get matrix() {
    return this.#matrix;
  }

  reset(matrix = IDENTITY) {
    this.#matrix = matrix;
  }

  /** Move by metres along `ahead` (level, unit) and to its right, unless somebody stands there. Returns whether it did. */
  step(head, ahead, forth, right) {
    return this.to(head, [head[0] + forth * ahead[0] - right * ahead[2], 0, head[2] + forth * ahead[2] + right * ahead[0]]);
  }

  /** Move the head over the point `to`, unless somebody stands there. Returns whether it did. */
  to(head, to) {
    if (!this.free(head, to)) return false;
    this.#matrix = multiply(translation([to[0] - head[0], 0, to[2] - head[2]]), this.#matrix);
    return true;
  }

  /** Return whether a head may move over the point `to`: not into somebody, nor far away. */
  free(head, to) {
    const { 12: x, 14: z } = this.#matrix;
    const near = Math.hypot(x + to[0] - head[0], z + to[2] - head[2]) <= FARTHEST;
    return near && this.others().every((other) => gap(other, to) > Math.min(APART, gap(other, head)));
  }

  /** Turn to the left by radians about the head. */
  turn(head, angle) {
    const about = [head[0], 0, head[2]];
    this.#matrix = multiply(translation(about), multiply(turnY(angle), multiply(translation(subtract([0, 0, 0], about)), this.#matrix)));
  }

  /** The pose of the space from its base, as WebXR wants it for a reference space: {position, orientation}. */
  get offset() {
    const m = invert(this.#matrix);
    const [x, y, z] = place(m);
    const half = Math.atan2(m[8], m[0]) / 2;
    return [{ x, y, z }, { x: 0, y: Math.sin(half), z: 0, w: Math.cos(half) }];
  }

  /** Move what drives an avatar ({pose} or {tracking}; {}: the rest pose). */
  moved(drive) {
    const m = this.#matrix;
    if (m === IDENTITY) return drive;
    const turn = [0, Math.sin(Math.atan2(m[8], m[0]) / 2), 0, Math.cos(Math.atan2(m[8], m[0]) / 2)];
    if (drive.tracking) {
      const at = (pose) => pose && [...movePoint(m, pose.slice(0, 3)), ...(pose.length > 3 ? after(turn, pose.slice(3)) : [])];
      const tracking = { ...drive.tracking };
      for (const [key, value] of Object.entries(tracking)) {
        if (key.endsWith('_joints')) tracking[key] = value?.map(at);
        else if (key === 'body') tracking[key] = Object.fromEntries(Object.entries(value).map(([name, one]) => [name, at(one)]));
        else if (value?.length === 7) tracking[key] = at(value);
      }
      return { ...drive, tracking };
    }
    const pose = drive.pose ?? {};
    const root = [pose.root_pose ?? [0, 0, 0]].flat();
    return { ...drive, pose: { ...pose, trans: movePoint(m, [pose.trans ?? [0, 0, 0]].flat()), root_pose: rotationVector(after(turn, quaternion(root))) } };
  }
}

const gap = (a, b) => Math.hypot(a[0] - b[0], a[2] - b[2]);

/** The product of two quaternions x y z w: first `b`, then `a`. */
function after(a, b) {
  const [[ax, ay, az, aw], [bx, by, bz, bw]] = [a, b];
  return [aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz];
}
