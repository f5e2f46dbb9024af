// VR without a server: the avatar stands before its visitor, who walks around it.

import { multiply, translation, turnY } from '../space/matrix.js';
import { heading } from '../space/placing.js';

const AWAY = 1.6; // metres from the visitor to the avatar at first
const [CANVAS, HEADSET] = [60, 72]; // Hz, where nobody says
const EYES = 1.6; // metres above the floor, where the device knows no floor

export class Headset {
  inside = false;
  display = CANVAS; // Hz of what is drawn for
  #gl;
  #draw;
  #say;
  #space = null;
  #shown = null; // the room from the avatar's space

  /** `button` enters; `draw(eyes, framebuffer, shown, now)` is called for each frame; `say(text, level)`. */
  constructor(gl, { button, draw, say }) {
    [this.#gl, this.#draw, this.#say] = [gl, draw, say];
    button.addEventListener('click', () => this.#enter(button));
    navigator.xr?.isSessionSupported('immersive-vr').then((can) => (button.disabled = !can), () => {});
  }

  async #enter(button) {
    button.disabled = true;
    try {
      const session = await navigator.xr.requestSession('immersive-vr', { optionalFeatures: ['local-floor'] });
      session.addEventListener('end', () => {
        this.inside = button.disabled = false;
        this.display = CANVAS;
      });
      await this.#gl.makeXRCompatible?.();
      session.updateRenderState({ baseLayer: new XRWebGLLayer(session, this.#gl), depthNear: 0.05, depthFar: 50 });
      this.#space = await session.requestReferenceSpace('local-floor').catch(async () => {
        const local = await session.requestReferenceSpace('local');
        return local.getOffsetReferenceSpace(new XRRigidTransform({ x: 0, y: -EYES, z: 0 }));
      });
      this.#space.addEventListener('reset', () => (this.#shown = null));
      [this.inside, this.#shown, this.display] = [true, null, session.frameRate ?? HEADSET];
      session.requestAnimationFrame((now, frame) => this.#frame(now, frame));
    } catch (error) {
      button.disabled = false;
      this.#say(`Cannot enter VR: ${error.message}`, 'error');
    }
  }

  #frame(now, frame) {
    const { session } = frame;
    session.requestAnimationFrame((later, next) => this.#frame(later, next));
    const viewer = frame.getViewerPose(this.#space);
    if (!viewer || this.#gl.isContextLost()) return; // the last picture stays
    this.#shown ??= before(viewer.transform.matrix);
    const layer = session.renderState.baseLayer;
    const eyes = viewer.views.map((view) => ({
      transform: view.transform.matrix,
      projection: view.projectionMatrix,
      viewport: layer.getViewport(view),
    }));
    this.#draw(eyes, layer.framebuffer, this.#shown, now);
  }
}

/** The place before a head, turned to it. */
function before(head) {
  const ahead = heading(head);
  const yaw = Math.atan2(-ahead[0], -ahead[2]); // an avatar faces +z
  return multiply(translation([head[12] + AWAY * ahead[0], 0, head[14] + AWAY * ahead[2]]), turnY(yaw));
}
