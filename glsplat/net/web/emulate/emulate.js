// A headset for whoever has none: installs Meta's emulator, and moves it by mouse and keys.

import { XRDevice, metaQuest3 } from './iwer.min.js';

const TURN = 0.004; // radians a pixel
const STILL = 4; // pixels that the pointer of a click moves at most
const PACE = 150; // ms between two steps of a key that is held
const LIVELY = 300; // ms for which every frame of the display is drawn after an input
const REST = 250; // ms between two frames without one, at most
const WAYS = { w: [1, 0], s: [-1, 0], a: [0, -1], d: [0, 1] };
const KEYS = [
  ['Drag', 'look around'], ['W A S D', 'step'], ['H', 'raise or drop your hands'], ['T, held', 'pinch: an arc to the floor, to step there'], ['Click', 'press the panel: beside the mirror, else at your left hand'],
  ['V', 'one eye or both'], ['Esc', 'leave'],
];

// [right of the head, over it, behind it] of the height of the eyes, and a quaternion x y z w; hanging hands have their
// fingers down
const HANDS = {
  down: { left: [[-0.14, -0.47, 0.04], [-0.5, 0.5, 0.5, 0.5]], right: [[0.14, -0.47, 0.04], [-0.5, -0.5, -0.5, 0.5]] },
  raised: { left: [[0.1, -0.08, -0.375], [0, 0, 0, 1]], right: [[0.225, -0.156, -0.313], [0, 0, 0, 1]] }, // the panel beside the left one is in sight
};

/**
 * Install it; `canvas` then shows what both eyes see. `user` is who wears it, `eyes()` metres over the floor, and what a
 * session does: {eyes(), step(forth, right), point([x, y, eye] or null), click(), end(), rest(now)}; `rest` returns
 * whether a frame of the display may be left out.
 */
export function emulate(canvas, user) {
  const device = new XRDevice(metaQuest3, { ipd: 0.063, stereoEnabled: true });
  device.installRuntime({ forceInstall: true }); // also where the browser has WebXR but no headset
  mendOffsets();
  device.primaryInputMode = 'hand';
  device.canvasContainer.append(keysOf());
  let [yaw, pitch, hands, stepped, dragged, moved, drawn] = [0, 0, 'down', 0, 0, 0, 0];
  const move = () => {
    const eyes = user.eyes();
    device.position.set(0, eyes, 0);
    device.quaternion.set(...turned(yaw, [Math.sin(pitch / 2), 0, 0, Math.cos(pitch / 2)]));
    for (const [side, [[x, y, z], turn]] of Object.entries(HANDS[hands])) {
      const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
      device.hands[side].position.set(eyes * (c * x + s * z), eyes * (1 + y), eyes * (c * z - s * x));
      device.hands[side].quaternion.set(...turned(yaw, hands === 'raised' ? [Math.sin(pitch / 2), 0, 0, Math.cos(pitch / 2)] : turn));
    }
  };
  move();
  for (const type of ['pointerdown', 'pointermove', 'pointerup', 'keydown', 'keyup']) addEventListener(type, ({ timeStamp }) => (moved = timeStamp));
  leaveOut((now) => {
    if (device.activeSession && now - moved > LIVELY && now - drawn < REST && user.rest(now)) return true;
    drawn = now;
    return false;
  });
  let hung = false; // before the pinch
  const pinch = (value) => {
    if (value) hung = hands === 'down';
    if (hung) hands = value ? 'raised' : 'down';
    move();
    device.hands.right.updatePinchValue(value);
  };
  addEventListener('keyup', ({ key }) => device.activeSession && key.toLowerCase() === 't' && pinch(0));
  canvas.addEventListener('pointerdown', () => (dragged = 0));
  canvas.addEventListener('pointermove', (event) => {
    if (!device.activeSession) return;
    user.point(at(event, canvas, device.stereoEnabled));
    if (!event.buttons) return;
    dragged += Math.abs(event.movementX) + Math.abs(event.movementY);
    yaw += TURN * event.movementX;
    pitch = Math.max(-1.4, Math.min(1.4, pitch + TURN * event.movementY));
    move();
  });
  canvas.addEventListener('pointerup', (event) => {
    if (!device.activeSession || dragged > STILL) return;
    user.point(at(event, canvas, device.stereoEnabled));
    user.click();
  });
  addEventListener('keydown', (event) => {
    if (!device.activeSession || event.ctrlKey || event.altKey || event.metaKey) return;
    const key = event.key.toLowerCase();
    const actions = {
      h: () => {
        hands = hands === 'down' ? 'raised' : 'down';
        move();
      },
      t: () => event.repeat || pinch(1),
      v: () => (device.stereoEnabled = !device.stereoEnabled),
      escape: () => user.end(),
    };
    if (WAYS[key] && event.timeStamp - stepped > PACE) {
      stepped = event.timeStamp;
      user.step(...WAYS[key]);
    } else if (Object.hasOwn(actions, key)) actions[key]();
  });
}

/**
 * Let IWER, which draws at each frame of the display, leave out those for which `rests(now)` is true: both eyes cost a
 * software renderer a tenth of a second.
 */
function leaveOut(rests) {
  const next = globalThis.requestAnimationFrame.bind(globalThis);
  const paced = (then) => next((now) => (rests(now) ? paced(then) : then(now)));
  globalThis.requestAnimationFrame = paced;
}

/** A list of the keys, over the picture. */
function keysOf() {
  const list = document.createElement('dl');
  list.id = 'emulated-keys';
  for (const [key, words] of KEYS) {
    const [term, meaning] = [document.createElement('dt'), document.createElement('dd')];
    [term.textContent, meaning.textContent] = [key, words];
    list.append(term, meaning);
  }
  return list;
}

/** [x, y, eye] of a pointer: -1 to 1 in the picture of the eye that it is over. */
function at({ clientX, clientY }, canvas, stereo) {
  const box = canvas.getBoundingClientRect();
  const across = ((clientX - box.left) / box.width) * (stereo ? 2 : 1);
  const eye = Math.min(Math.floor(across), stereo ? 1 : 0);
  return [2 * (across - eye) - 1, 1 - (2 * (clientY - box.top)) / box.height, eye];
}

/** A quaternion x y z w, then a turn about the vertical. */
function turned(yaw, [x, y, z, w]) {
  const [s, c] = [Math.sin(yaw / 2), Math.cos(yaw / 2)];
  return [c * x + s * z, c * y + s * w, c * z - s * x, c * w - s * y];
}

/** IWER 2.5 reads the entries of a matrix from the XRRigidTransform itself and so ignores every offset. */
function mendOffsets() {
  const { getOffsetReferenceSpace } = XRReferenceSpace.prototype;
  XRReferenceSpace.prototype.getOffsetReferenceSpace = function mended(offset) {
    return getOffsetReferenceSpace.call(this, offset.matrix);
  };
}
