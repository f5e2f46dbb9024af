// A WebXR session: tracking up, pictures down, three views, a panel. Everything is in the room of `local-floor`.

import { isAhead, tangentsOf } from '../space/frustum.js';
import { turned } from '../space/light.js';
import { apply, multiply, place, translation, unit } from '../space/matrix.js';
import { VIEWS, heading, placing, standing } from '../space/placing.js';
import { Arc } from '../track/arc.js';
import { STRIDE, TURN, Steps } from '../track/steps.js';
import { bodyOf, drivenBodyOf, sampleOf } from '../track/xr-sample.js';
import { Notice, Panel } from './panel.js';
import { panelPlace, pointers } from './reach.js';

const OPTIONAL = ['local-floor', 'hand-tracking', 'body-tracking'];
const EYES = 1.6; // metres above the floor, where the device knows no floor and nothing was calibrated
const NEXT_VIEW = 4; // the gamepad button A or X
const PUSHED = 0.6; // of a stick
const PACE = 300; // ms between two steps by a stick
const DOUBLE = 500; // ms between two pinches of the left hand that go to the next view

/** {vr, ar}: true, or in words why not. */
export async function support() {
  if (!isSecureContext) return both('Browsers allow VR only on https or localhost: start the server with --self-signed.');
  if (!navigator.xr) return both('This browser has no WebXR: open this page in a headset, or in Chrome or Edge with one.');
  const can = async (mode, words) => ((await navigator.xr.isSessionSupported(mode).catch(() => false)) ? true : words);
  return {
    vr: await can('immersive-vr', 'No headset is connected to this device.'),
    ar: await can('immersive-ar', 'No headset with passthrough is connected to this device.'),
  };
}

const both = (words) => ({ vr: words, ar: words });

/**
 * One session at a time. `actions` is what the panel's rows do: {rows(immersive) -> rows, press(id)}; `tools`:
 * {calibration, recorder, driven(), speaks(sample), measured(), radius() of the room, others() of it, accompanied() in it, onCalibrated(result), onEnd()}.
 */
export class Immersive {
  mode = ''; // vr, ar, or empty while there is no session
  panel = new Panel();
  untracked = []; // sides of hands that are not tracked
  pointer = null; // of a mouse: [x, y, eye], -1 to 1 in the picture of an eye
  steps;
  #gl;
  #stage;
  #settings;
  #actions;
  #tools;
  #notice = new Notice();
  #estimate = new Estimate();
  #arc = new Arc();
  #session = null;
  #space = null;
  #base = null; // the space before the floor was moved
  #floor = null; // after that, before the user was put in the middle of it
  #stood = null; // after that, before the user made steps
  #views = []; // of the last frame
  #head = null; // in it: room from head
  #sample = null; // of it, without the mouth
  #asked = 0; // ms, when a sample was sent last
  #stepped = 0; // ms
  #where = null;
  #company = false; // whether the view was placed with others in the room
  #again = false; // place the view anew
  #restand = false; // and the user
  #pressed = false;
  #pinched = 0;
  #message = { text: '', until: 0 };
  #link = ''; // what the user was told of it

  constructor(gl, stage, settings, actions, tools) {
    this.#gl = gl;
    this.#stage = stage;
    this.#settings = settings;
    this.#actions = actions;
    this.#tools = tools;
    this.steps = new Steps(tools.others);
    settings.addEventListener('change', ({ detail }) => {
      if (detail.name === 'view' || detail.name === 'room') this.#again = true;
      if (detail.name === 'room') this.#restand = true;
    });
  }

  /** Enter 'vr' or 'ar'. Rejects with words if the device does not let us. */
  async enter(mode) {
    const optionalFeatures = mode === 'ar' ? [...OPTIONAL, FEATURE] : OPTIONAL;
    const session = await navigator.xr.requestSession(`immersive-${mode}`, { optionalFeatures });
    try {
      await this.#gl.makeXRCompatible?.();
      session.updateRenderState({ baseLayer: new XRWebGLLayer(session, this.#gl), depthNear: 0.05, depthFar: 50 });
      await this.#findFloor(session);
    } catch (error) {
      await session.end().catch(() => {});
      throw error;
    }
    this.#session = session;
    this.mode = mode;
    if (mode === 'ar') this.#estimate.start(session);
    this.#where = null;
    session.addEventListener('end', () => this.#ended(session));
    session.addEventListener('select', (event) => this.#arc.aims || this.#selected(event));
    // a controller's trigger presses the panel, a hand has no squeeze
    session.addEventListener('selectstart', (event) => event.inputSource.hand && this.#aimed(event));
    session.addEventListener('squeezestart', (event) => this.#aimed(event));
    for (const type of ['selectend', 'squeezeend']) session.addEventListener(type, ({ inputSource }) => inputSource === this.#arc.source && this.#landed());
    this.#stage.clear();
    this.#stage.connection.hurry(); // some browsers drop sockets on the way in
    session.requestAnimationFrame((now, frame) => this.#frame(now, frame));
  }

  end() {
    return this.#session?.end();
  }

  /**
   * Send the sample of the last frame again, in time, in place of a frame that would show nothing new. Return false if
   * there are reasons for a frame.
   */
  rest(now) {
    const { calibration, recorder } = this.#tools;
    if (!this.#sample || this.#again || calibration.running || recorder.recording || this.#arc.source || !this.#stage.rests(now)) return false;
    if (now - this.#asked >= this.#stage.pause(now)) {
      this.#asked = now;
      this.#stage.askAgain(this.#drive(this.#tools.speaks(this.#sample), now), now);
    }
    return true;
  }

  #drive(sample, now) {
    return this.#tools.driven() ? { tracking: sample, t: now } : {};
  }

  /** Tell the user for some seconds. */
  say(text, ms = 3000) {
    this.#message = { text, until: performance.now() + ms };
  }

  /** Move the floor: `height` is its y in the device's own space, metres. */
  moveFloor(height) {
    this.#floor = height
      ? this.#base.getOffsetReferenceSpace(new XRRigidTransform({ x: 0, y: height, z: 0 }))
      : this.#base;
    this.#space = this.#stood = this.#floor;
    this.#again = this.#restand = true;
  }

  async #findFloor(session) {
    try {
      this.#base = await session.requestReferenceSpace('local-floor');
    } catch {
      const eyes = this.#tools.measured()?.eyes ?? EYES;
      const local = await session.requestReferenceSpace('local');
      this.#base = local.getOffsetReferenceSpace(new XRRigidTransform({ x: 0, y: -eyes, z: 0 }));
    }
    this.#base.addEventListener('reset', () => (this.#again = this.#restand = true)); // the user looks another way from now on
    this.moveFloor(this.#tools.measured()?.floor ?? 0);
  }

  #ended(session) {
    if (session !== this.#session) return;
    this.#session = this.#sample = null;
    this.#estimate.stop();
    this.mode = '';
    this.#stage.clear();
    this.#tools.onEnd();
  }

  #frame(now, frame) {
    const { session } = frame;
    if (session !== this.#session) return;
    session.requestAnimationFrame((later, next) => this.#frame(later, next));
    if (this.#restand) this.#stand(frame);
    const viewer = frame.getViewerPose(this.#space);
    if (!viewer) return; // the device is lost: the last picture stays
    const views = viewer.views.map((view) => ({
      transform: view.transform.matrix,
      projection: view.projectionMatrix,
      viewport: session.renderState.baseLayer.getViewport(view),
    }));
    const head = viewer.transform.matrix;
    const company = this.#tools.accompanied?.() ?? false;
    if (!this.#where || this.#again || company !== this.#company) this.#placeView(head, company);
    const tracked = sampleOf(frame, this.#space, viewer);
    const lower = drivenBodyOf(frame, this.#space);
    if (lower) tracked.body = lower;
    const sample = this.#tools.speaks(tracked);
    this.#use(sample, now, frame);
    [this.#views, this.#head, this.#sample, this.#asked] = [views, head, tracked, now];
    const { hung } = this.#where;
    // a picture shows the room or its mirror image: most show what is straight ahead
    const [where, also] = hung && isAhead(hung.glass, head) ? [hung, this.#where] : [this.#where, hung];
    // the glass of a mirror in no place is black: nothing shows through
    const alpha = this.mode === 'ar' || this.#settings.get('place') !== 'plain';
    const { framebuffer } = session.renderState.baseLayer;
    const [room, transparent] = [this.mode === 'vr', this.mode === 'ar'];
    const labels = () => this.#labels(frame, head, sample, now);
    this.#stage.display = session.frameRate;
    const around = transparent ? this.#estimate.light(frame, this.#space) : undefined;
    const deep = where.view === 'own' || this.#where.whole; // hands are near, others far; one's image moves with oneself
    this.#stage.frame(views, where, this.#drive(sample, now), { also, framebuffer, alpha, transparent, room, around, labels, deep, now });
  }

  #placeView(head, company) {
    this.#again = false;
    this.#company = company;
    this.#where = placing(this.#settings.get('view'), head, this.#tools.radius(), company);
    this.#stage.clear();
  }

  /** In a room with others the user begins at the origin and looks along +z: to the middle (docs/protocol.md, 2.1). */
  #stand(frame) {
    this.#restand = false;
    this.steps.reset();
    this.#space = this.#stood = this.#floor;
    const viewer = this.#settings.get('room') !== '' && frame.getViewerPose(this.#floor);
    if (!viewer) return;
    const { place: [x, y, z], yaw } = standing(viewer.transform.matrix);
    const turn = { x: 0, y: Math.sin(yaw / 2), z: 0, w: Math.cos(yaw / 2) };
    this.#space = this.#stood = this.#floor.getOffsetReferenceSpace(new XRRigidTransform({ x, y, z }, turn));
  }

  /** Step by strides ahead and to the right of where the head looks, or turn to the left by `turns`. */
  step(forth, right, turns = 0) {
    if (!this.#head) return;
    const at = place(this.#head);
    if (turns) this.steps.turn(at, turns * TURN);
    else this.steps.step(at, heading(this.#head), STRIDE * forth, STRIDE * right);
    this.#offset();
  }

  #offset() {
    this.#space = this.#stood.getOffsetReferenceSpace(new XRRigidTransform(...this.steps.offset));
  }

  /** Begin an arc to the floor with a pinch or a squeeze that points at no panel. */
  #aimed({ frame, inputSource, timeStamp }) {
    const [ray] = pointers(frame, this.#space, [inputSource]);
    if (ray && !this.panel.hit(ray.origin, ray.direction)) this.#arc.begin(inputSource, timeStamp);
  }

  /** Step to the end of the arc. */
  #landed() {
    const to = this.#arc.end();
    if (to && this.steps.to(place(this.#head), to)) this.#offset();
  }

  /** A stick steps while it is pushed, to the sides with the right hand it turns. */
  #walk(sources, now) {
    const pushed = sources.map(({ gamepad, handedness }) => [handedness, gamepad?.axes[2] ?? 0, gamepad?.axes[3] ?? 0]);
    const [side, x, y] = pushed.find(([, x, y]) => Math.hypot(x, y) > PUSHED) ?? [];
    if (side === undefined) this.#stepped = 0;
    else if (now - this.#stepped > PACE) {
      this.#stepped = now;
      if (Math.abs(y) > Math.abs(x)) this.step(-Math.sign(y), 0);
      else if (side === 'right') this.step(0, 0, -Math.sign(x));
      else this.step(0, Math.sign(x));
    }
  }

  /** What else a sample is for: recording, calibrating, telling that hands are missing, the view's button. */
  #use(sample, now, frame) {
    const { recorder, calibration, onCalibrated } = this.#tools;
    if (recorder.recording) {
      const body = bodyOf(frame, this.#space);
      recorder.add(sample, now, body ? { body } : {});
    }
    if (calibration.running) {
      const { progress, result, error } = calibration.add(sample, now);
      if (progress !== undefined) this.say('Stand straight and look ahead…', 500);
      if (error) this.say(error);
      if (result) onCalibrated(result);
    }
    this.untracked = ['left', 'right'].filter((side) => !sample[side] && !sample[`${side}_grip`]);
    const sources = [...frame.session.inputSources];
    const pressed = sources.some(({ gamepad }) => gamepad?.buttons[NEXT_VIEW]?.pressed);
    if (pressed && !this.#pressed) this.nextView();
    this.#pressed = pressed;
    this.#walk(sources, now);
  }

  nextView() {
    const next = (VIEWS.indexOf(this.#settings.get('view')) + 1) % VIEWS.length;
    this.#settings.set('view', VIEWS[next]);
  }

  /** A trigger or a pinch: what the ray points at, or, twice with the left hand and at nothing, the next view. */
  #selected({ frame, inputSource }) {
    const [ray] = pointers(frame, this.#space, [inputSource]);
    const hit = ray && this.panel.hit(ray.origin, ray.direction);
    if (hit?.row.id) {
      this.#actions.press(hit.row.id);
    } else if (!hit && inputSource.hand && inputSource.handedness === 'left') {
      const now = performance.now();
      if (now - this.#pinched < DOUBLE) this.nextView();
      this.#pinched = now;
    }
  }

  /** Press what the mouse points at. */
  click() {
    const ray = this.#mouse();
    const hit = ray && this.panel.hit(ray.origin, ray.direction);
    if (hit?.row.id) this.#actions.press(hit.row.id);
  }

  /** The ray of the mouse: {origin, direction}, or null. */
  #mouse() {
    const eye = this.#views[this.pointer?.[2]];
    if (!eye) return null;
    const { left, right, down, up } = tangentsOf(eye.projection);
    const [x, y] = this.pointer.map((v) => (v + 1) / 2); // of the eye's picture
    const direction = apply(eye.transform, [left + x * (right - left), down + y * (up - down), -1, 0]).slice(0, 3);
    return { origin: place(eye.transform), direction: unit(direction) };
  }

  #labels(frame, head, sample, now) {
    this.panel.rows = this.#actions.rows(this, now);
    const { transform, width } = panelPlace(this.#where, head, sample, this.#tools.others?.());
    this.panel.hang(transform, width);
    const hits = [...pointers(frame, this.#space, frame.session.inputSources), this.#mouse()]
      .filter(Boolean)
      .map(({ origin, direction }) => this.panel.hit(origin, direction))
      .filter(Boolean);
    this.panel.hovered = hits.length ? hits[0].index : -1;
    const [hand] = this.#arc.source ? pointers(frame, this.#space, [this.#arc.source]) : [];
    if (hand) this.#arc.follow(hand, now, (point) => this.steps.free(place(head), point));
    const labels = [this.panel.label(this.#stage.painter), ...this.#arc.marks(place(head))];
    if (this.#stage.link !== this.#link) {
      this.#link = this.#stage.link;
      if (this.#link) this.say(this.#link); // once: from then on it stands on the panel
    }
    this.#notice.text = performance.now() < this.#message.until ? this.#message.text : this.#stage.notice;
    if (this.#notice.text) {
      this.#notice.transform = multiply(head, translation([0, -0.12, -1]));
      labels.push(this.#notice.label(this.#stage.painter));
    }
    return labels;
  }
}

const LARGEST = 1e4; // of a number of a light (docs/protocol.md)

const FEATURE = 'light-estimation';

/** The light of the room that a headset's cameras see, where the browser tells it (WebXR Lighting Estimation). */
class Estimate {
  #probe = null;

  /** Whatever is missing, there is no estimate, and nobody is told. */
  async start(session) {
    this.#probe = null;
    try {
      this.#probe = (await session.requestLightProbe?.()) ?? null;
    } catch {
      // the device does not let us
    }
  }

  stop() {
    this.#probe = null;
  }

  /**
   * {ambient, sun} (draw/frame.js) along the axes of `space`, or null. The nine coefficients are of radiance, in the order
   * and with the signs of ours, the primary light an irradiance: as three.js reads them (XREstimatedLight).
   */
  light(frame, space) {
    const estimate = this.#probe && frame.getLightEstimate?.(this.#probe);
    const pose = estimate && frame.getPose(this.#probe.probeSpace, space);
    if (!pose) return null;
    const { sphericalHarmonicsCoefficients: values, primaryLightDirection: d, primaryLightIntensity: i } = estimate;
    if (values?.length !== 27) return null;
    const ambient = Array.from({ length: 9 }, (_, k) => [...values.slice(3 * k, 3 * k + 3)]);
    const [length, color] = [Math.hypot(d.x, d.y, d.z), [i.x, i.y, i.z].map((v) => Math.max(v, 0))];
    const sun = length > 0 && color.some((v) => v > 0) ? { direction: [d.x / length, d.y / length, d.z / length], color } : null;
    const sound = (v) => Math.abs(v) <= LARGEST;
    return ambient.flat().every(sound) && color.every(sound) ? turned({ ambient, sun }, pose.transform.matrix) : null;
  }
}
