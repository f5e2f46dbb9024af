// Who only waits is alive: on top of a motion that stands, slow turns of the head, a shift of weight, and breath, which do
// not come round together.

const [LEFT_HIP, RIGHT_HIP, SPINE1, LEFT_ANKLE, RIGHT_ANKLE, SPINE3, NECK, HEAD] = [0, 1, 2, 6, 7, 8, 11, 14]; // of body_pose
const LEGS = 0.9; // metres from the hips to the floor: feet stay where they are while the hips move
const LOOKS = [0, 0.34, 0.1, -0.3, 0, -0.14, 0.26, 0]; // radians to the left, one after the other
const NODS = [0, 0.05, -0.04, 0.06, 0, 0.1, -0.03, 0.02];
const STAY = 3.7; // seconds for each
const TURNING = 0.9; // seconds from one to the next

/** A driver around another one whose poses have a `body_pose`. */
export class Living {
  #motion;

  constructor(motion) {
    this.#motion = motion;
    [this.duration, this.frames] = [motion.duration, motion.frames];
  }

  /** {pose} at a time in seconds. */
  at(seconds) {
    const drive = this.#motion.at(seconds);
    const { body_pose: body, trans } = drive.pose ?? {};
    if (!body || body.length < HEAD + 1 || !trans) return drive;
    const turns = body.map((turn) => [...turn]);
    const add = (joint, axis, angle) => (turns[joint][axis] += angle);
    const shift = 0.022 * Math.sin(seconds * 0.37) + 0.012 * Math.sin(seconds * 0.23 + 1); // metres to the left
    const lean = Math.atan2(shift, LEGS);
    for (const hip of [LEFT_HIP, RIGHT_HIP]) add(hip, 2, -lean);
    for (const ankle of [LEFT_ANKLE, RIGHT_ANKLE]) add(ankle, 2, lean);
    add(SPINE1, 2, 0.6 * lean);
    add(SPINE3, 0, 0.014 * Math.sin(seconds * 1.45)); // breath
    const look = eased(LOOKS, seconds);
    add(SPINE3, 1, 0.15 * look);
    add(NECK, 1, 0.35 * look);
    add(HEAD, 1, 0.5 * look);
    add(HEAD, 0, eased(NODS, seconds));
    return { ...drive, pose: { ...drive.pose, body_pose: turns, trans: [trans[0] + shift, trans[1], trans[2]] } };
  }
}

/** From one value to the next, each of which stays for a while. */
function eased(values, seconds) {
  const place = seconds / STAY;
  const at = (i) => values[((i % values.length) + values.length) % values.length];
  const t = Math.min(1, ((place - Math.floor(place)) * STAY) / TURNING);
  const part = t * t * (3 - 2 * t);
  return at(Math.floor(place)) + part * (at(Math.floor(place) + 1) - at(Math.floor(place)));
}
