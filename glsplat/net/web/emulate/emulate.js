// A headset for whoever has none: /vr?emulate installs Meta's emulator, and this moves it by mouse and keys.

import { XRDevice, metaQuest3 } from './iwer.min.js';

const EYES = 1.6; // metres
const STEP = 0.05; // metres a key press
const TURN = 0.004; // radians a pixel

/** Install it; `canvas` then shows what the left eye sees. Dragging looks about, W A S D walk. */
export function emulate(canvas) {
  const device = new XRDevice(metaQuest3, { ipd: 0.063, stereoEnabled: true });
  device.installRuntime({ forceInstall: true }); // also where the browser has WebXR but no headset
  mendOffsets();
  device.primaryInputMode = 'hand';
  let [yaw, pitch] = [0, 0];
  const place = [0, EYES, 0];
  const move = () => {
    device.position.set(...place);
    const [a, b] = [yaw / 2, pitch / 2];
    device.quaternion.set(Math.cos(a) * Math.sin(b), Math.sin(a) * Math.cos(b), -Math.sin(a) * Math.sin(b), Math.cos(a) * Math.cos(b));
  };
  move();
  canvas.addEventListener('pointermove', (event) => {
    if (!device.activeSession || !event.buttons) return;
    yaw += TURN * event.movementX;
    pitch = Math.max(-1.4, Math.min(1.4, pitch + TURN * event.movementY));
    move();
  });
  addEventListener('keydown', (event) => {
    const [ahead, aside] = { w: [1, 0], s: [-1, 0], a: [0, -1], d: [0, 1] }[event.key.toLowerCase()] ?? [0, 0];
    if (!device.activeSession || (!ahead && !aside)) return;
    place[0] += STEP * (aside * Math.cos(yaw) - ahead * Math.sin(yaw));
    place[2] -= STEP * (ahead * Math.cos(yaw) + aside * Math.sin(yaw));
    move();
  });
  return device;
}

/** IWER 2.5 reads the entries of a matrix from the XRRigidTransform itself and so ignores every offset. */
function mendOffsets() {
  const { getOffsetReferenceSpace } = XRReferenceSpace.prototype;
  XRReferenceSpace.prototype.getOffsetReferenceSpace = function mended(offset) {
    return getOffsetReferenceSpace.call(this, offset.matrix);
  };
}
