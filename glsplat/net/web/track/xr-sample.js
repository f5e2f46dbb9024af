// One XR frame to a tracking sample of docs/protocol.md, section 3.3.

const JOINTS = 25;
const WRIST = 0;
const LEG = ['upper-leg', 'lower-leg', 'foot-ankle', 'foot-ball'];
/** Names of the body's joints that are used, as glsplat/tracking/sample.py has them. */
export const BODY_JOINTS = ['hips', 'spine-lower', ...['left', 'right'].flatMap((s) => LEG.map((j) => `${s}-${j}`))];
const buffer = new Float32Array(16 * JOINTS);

/** {head, left, right, left_joints, ...} in the reference space; metres, quaternions x y z w. */
export function sampleOf(frame, space, viewer) {
  const sample = { head: pose(viewer.transform) };
  for (const source of frame.session.inputSources) {
    const side = source.handedness;
    if (side !== 'left' && side !== 'right') continue;
    if (source.hand) Object.assign(sample, tracked(frame, space, source.hand, side));
    else if (source.gripSpace) Object.assign(sample, held(frame, space, source, side));
  }
  return sample;
}

/** Joints of the body by name, each 7 numbers, where the device grants them; else null. */
export function bodyOf(frame, space) {
  if (!frame.body) return null;
  const joints = {};
  for (const [name, joint] of frame.body) {
    const found = frame.getPose(joint, space);
    if (found) joints[name] = pose(found.transform);
  }
  return Object.keys(joints).length ? joints : null;
}

/** Those that the server drives pelvis, feet and knees by (the protocol's `tracking.body`), places alone; or null. */
export function drivenBodyOf(frame, space) {
  if (!frame.body) return null;
  const joints = {};
  for (const name of BODY_JOINTS) {
    const joint = frame.body.get(name);
    const found = joint && frame.getPose(joint, space);
    if (found) joints[name] = pose(found.transform).slice(0, 3);
  }
  return Object.keys(joints).length ? joints : null;
}

function tracked(frame, space, hand, side) {
  const wrist = frame.getJointPose(hand.get('wrist'), space);
  if (!wrist) return {};
  const out = { [side]: pose(wrist.transform) };
  if (frame.fillPoses(hand.values(), space, buffer)) {
    const joints = [];
    for (let joint = WRIST; joint < JOINTS; joint++) {
      for (let k = 12; k < 15; k++) joints.push(rounded(buffer[16 * joint + k]));
    }
    out[`${side}_joints`] = joints;
  }
  return out;
}

/** A controller: the hand holds it, and closes as far as squeeze and trigger do. */
function held(frame, space, { gripSpace, gamepad }, side) {
  const grip = frame.getPose(gripSpace, space);
  if (!grip) return {};
  const out = { [`${side}_grip`]: pose(grip.transform) };
  if (gamepad) {
    const [trigger, squeeze] = [0, 1].map((i) => gamepad.buttons[i]?.value ?? 0);
    out[`${side}_curl`] = rounded(GRASP + (1 - GRASP) * Math.max(squeeze, trigger / 2)); // one finger is not a fist
  }
  return out;
}

const GRASP = 0.25; // curl of fingers around a controller that presses nothing

function pose({ position: p, orientation: q }) {
  return [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(rounded);
}

const rounded = (value) => Math.round(value * 1e6) / 1e6;
