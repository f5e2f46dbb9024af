// The page that `glsplat page` writes: one avatar, its motions, a headset where there is one, and no server.

import { chunksOf, readAvatar } from '../avatar/avatar.js';
import { quaternionOf } from '../draw/bones.js';
import { Own } from '../draw/own.js';
import { lightOf } from '../place/light.js';
import { PLACES } from '../place/looks.js';
import { fromJoints, partsOf } from '../place/shadow.js';
import { Orbit } from '../show/orbit.js';
import { Painter } from '../show/painter.js';
import { turned } from '../space/light.js';
import { IDENTITY, invert, movePoint, multiply, translation, turnY } from '../space/matrix.js';
import { heading } from '../space/placing.js';
import { Motion } from '../track/drivers.js';

const AWAY = 1.6; // metres from the visitor to the avatar at first
const [CANVAS, HEADSET] = [60, 72]; // Hz, where nobody says
const EYES = 1.6; // metres above the floor, where the device knows no floor

class Headset {
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

const DENSEST = 2; // canvas pixels a CSS pixel
const $ = (id) => document.getElementById(id);
const address = (path) => new URL(`../${path}`, import.meta.url);

const canvas = $('canvas');
const gl = canvas.getContext('webgl2', { xrCompatible: true, antialias: false, alpha: false });
const own = new Own(gl);
const orbit = new Orbit();
const frames = { shown: 0, lost: 0 };
let painter = null;
let person = null; // {avatar}
let headset = null;
let whole = false; // all levels of the avatar are there
let measured = ''; // what the kind of layers was chosen for
let chosen = 0; // counts choices of a motion
let playing = { driver: null, since: 0 }; // since: ms

function say(text, level = 'info') {
  if ($('status').textContent === text) return; // it would be read aloud with every frame
  $('status').textContent = text;
  $('status').dataset.level = level;
}

const capital = (words) => `${words.charAt(0).toUpperCase()}${words.slice(1)}.`;

async function file(path) {
  const response = await fetch(address(path));
  if (!response.ok) throw new Error(`cannot load ${path} (${response.status})`);
  return response;
}

const json = async (path) => (await file(path)).json();

async function begin() {
  const about = await json('page.json');
  document.title = $('name').textContent = about.name;
  $('credit').textContent = about.credit;
  if (!(await own.open(() => json('draw/programs.json')))) return say(capital(own.why), 'error');
  painter = new Painter(gl);
  showPlaces();
  showMotions(about.motions);
  headset = new Headset(gl, { button: $('enter-vr'), draw: drawEyes, say });
  requestAnimationFrame(frame);
  await readAvatar(chunksOf(await file(about.avatar)), (avatar) => {
    person ??= { avatar };
    say('');
  });
  whole = true;
  return undefined;
}

/** The places to choose from; an address may name one: ?place=studio. */
function showPlaces() {
  const asked = new URLSearchParams(location.search).get('place');
  $('place').replaceChildren(...PLACES.map(({ value, label }) => new Option(label, value, value === asked, value === asked)));
}

/** A chip a motion; the first one moves. */
function showMotions(motions) {
  const chips = [{ label: 'Stand', file: null }, ...motions].map(({ label, file: path }) => {
    const chip = document.createElement('button');
    chip.type = 'button';
    chip.textContent = label;
    chip.addEventListener('click', () => choose(chip, path));
    return chip;
  });
  $('motions').replaceChildren(...chips);
  choose(chips[motions.length ? 1 : 0], motions[0]?.file ?? null);
}

/** Let a motion move the avatar; a later choice is not overtaken by an earlier one. */
async function choose(chip, path) {
  for (const other of $('motions').children) other.setAttribute('aria-pressed', String(other === chip));
  const number = ++chosen;
  try {
    const driver = path ? new Motion(await json(path)) : null;
    if (number === chosen) playing = { driver, since: performance.now() };
  } catch (error) {
    say(`This motion cannot be played: ${error.message}`, 'error');
  }
}

/** How the avatar stands at `now`, ms: rotations as quaternions. */
function poseAt(now) {
  const count = person.avatar.skeleton.count;
  const { joints_pose: turns = [], trans = [0, 0, 0], translations } = playing.driver?.at((now - playing.since) / 1000).pose ?? {};
  const joints = new Float64Array(4 * count);
  for (let j = 0; j < count; j++) quaternionOf(turns[j] ?? [0, 0, 0], 0, joints, 4 * j);
  return { joints, root: trans, translations: translations ?? null };
}

/** The place, and the shadow of who stands in it. */
function around(eyes, shown, now) {
  const look = $('place').value;
  const points = person && look !== 'plain' ? partsOf(person.avatar.skeleton, poseAt(now)) : [];
  const blobs = fromJoints(points.map((point) => movePoint(shown, point)));
  eyes.forEach((eye, i) => painter.view(eye, i, { room: true, look, blobs }));
}

/** Draw for eyes into a framebuffer; `shown`: the room seen from the avatar's space. */
function drawEyes(eyes, framebuffer, shown, now) {
  painter.begin(framebuffer, false);
  around(eyes, shown, now);
  if (!person) return;
  own.people = [{ key: 0, avatar: person.avatar, pose: poseAt(now) }];
  const what = `${headset.display} ${whole}`; // the coarsest level and the canvas say little of the rest
  if (measured !== what) {
    measured = what;
    own.measure(eyes, shown, headset.display);
    painter.begin(framebuffer, false);
    around(eyes, shown, now);
  }
  const light = lightOf($('place').value);
  if (own.draw(eyes, framebuffer, shown, { light: light && turned(light, invert(shown)) })) frames.shown++;
  else if (own.why) say(capital(own.why), 'error');
}

function frame(now) {
  requestAnimationFrame(frame);
  if (headset.inside || gl.isContextLost() || !painter) return;
  const density = Math.min(DENSEST, devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.round(side * density));
  if (!width || !height) return;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  drawEyes(orbit.views(width, height), null, IDENTITY, now);
}

canvas.addEventListener('webglcontextlost', (event) => {
  event.preventDefault();
  frames.lost++;
  own.lost();
  painter = null;
});
canvas.addEventListener('webglcontextrestored', () => {
  own.restored();
  painter = new Painter(gl);
});
orbit.attach(canvas);

window.glsplat = Object.freeze({
  /** Numbers for programs and tests; docs/webgl.md lists them. */
  stats: () => ({ ...frames, drawn: own.drawn, kind: own.kind, ready: own.ready, why: own.why, session: headset?.inside ? 'vr' : 'none' }),
});

begin().catch((error) => say(capital(error.message), 'error'));
