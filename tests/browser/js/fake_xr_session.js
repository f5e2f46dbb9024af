// The fake device's session, system and steering wheel: window.fakeXR. After fake_xr.js, in the same function.
'use strict';

const EVENTS = ['end', 'inputsourceschange', 'select', 'selectstart', 'selectend', 'squeeze', 'squeezestart',
  'squeezeend', 'visibilitychange'];
const pageFrame = window.requestAnimationFrame.bind(window);
const paused = []; // the page's own animation frames wait while a headset shows a session, as on a Quest

class XRSession extends EventTarget {
  constructor(mode, features) {
    super();
    readonly(this, {
      enabledFeatures: Object.freeze(features), environmentBlendMode: mode === 'immersive-ar' ? 'alpha-blend' : 'opaque',
      interactionMode: 'world-space', isSystemKeyboardSupported: false,
    });
    EVENTS.forEach((type) => {
      this[`on${type}`] = null;
      this.addEventListener(type, (event) => this[`on${type}`]?.(event));
    });
    const start = device.head ?? [0, 1.6, 0];
    this[INNER] = {
      mode, ended: false, visibility: 'visible', state: new XRRenderState({}), pending: null, callbacks: [],
      handle: 0, running: new Set(), sources: new Map(), list: Object.freeze([]), start: start.slice(0, 3),
    };
  }

  get visibilityState() { return this[INNER].visibility; }
  get renderState() { return this[INNER].state; }
  get inputSources() { return this[INNER].list; }

  updateRenderState(values = {}) {
    const inner = this[INNER];
    if (inner.ended) fail('InvalidStateError', 'the session has ended');
    const { baseLayer } = values;
    if (baseLayer && baseLayer[INNER].session !== this) fail('InvalidStateError', 'a layer of another session');
    const { depthNear, depthFar, baseLayer: layer } = inner.pending ?? inner.state;
    inner.pending = new XRRenderState({ depthNear, depthFar, baseLayer: layer, ...values });
  }

  async requestReferenceSpace(type) {
    const inner = this[INNER];
    if (inner.ended) fail('InvalidStateError', 'the session has ended');
    const origins = {
      viewer: () => matrixOf(device.head),
      local: () => rigid(inner.start, [0, 0, 0, 1]),
      'local-floor': () => ROOM,
      unbounded: () => ROOM,
    };
    if (type !== 'bounded-floor' && !(type in origins)) throw new TypeError(`no reference space is called ${type}`);
    if (!this.enabledFeatures.includes(type)) fail('NotSupportedError', `${type} was not asked for, or not granted`);
    return new XRReferenceSpace(this, origins[type]);
  }

  async requestLightProbe() {
    if (this[INNER].ended) fail('InvalidStateError', 'the session has ended');
    if (!this.enabledFeatures.includes('light-estimation')) fail('NotSupportedError', 'light-estimation was not granted');
    return new XRLightProbe(this);
  }

  requestAnimationFrame(callback) {
    if (this[INNER].ended) return 0;
    this[INNER].handle += 1;
    this[INNER].callbacks.push({ handle: this[INNER].handle, callback });
    return this[INNER].handle;
  }

  async end() {
    if (this[INNER].ended) fail('InvalidStateError', 'the session has ended');
    this[INNER].ended = true;
    this[INNER].callbacks = [];
    if (current === this) current = null;
    paused.splice(0).forEach(pageFrame);
    await null; // the page goes on before it hears of it
    this.dispatchEvent(happened('end', { session: this }));
  }
}

class XRSystem extends EventTarget {
  ondevicechange = null;

  async isSessionSupported(mode) {
    checkMode(mode);
    return mode === 'inline' || device.modes.includes(mode);
  }

  async requestSession(mode, { requiredFeatures = [], optionalFeatures = [] } = {}) {
    checkMode(mode);
    if (!navigator.userActivation.isActive) fail('SecurityError', 'a session needs a click or key of the person');
    if (current) fail('InvalidStateError', 'there is an immersive session already');
    if (!device.modes.includes(mode)) fail('NotSupportedError', `no ${mode} on this device`);
    const can = (name) => device.features.includes(name);
    if (!requiredFeatures.every(can)) fail('NotSupportedError', 'a required feature is missing');
    if (!device.grants) fail('NotAllowedError', 'the person said no');
    const features = new Set(['viewer', 'local', ...requiredFeatures, ...optionalFeatures.filter(can)]);
    current = new XRSession(mode, [...features]);
    fakeXR.sessions += 1;
    return current;
  }
}

function checkMode(mode) {
  if (!['inline', 'immersive-vr', 'immersive-ar'].includes(mode)) throw new TypeError(`no mode is called ${mode}`);
}

function spaceOf(session, origin) {
  const space = new XRSpace(session, origin);
  space[INNER].input = true;
  return space;
}

function jointSpaces(session, side) {
  return new Map(JOINTS.map((jointName, index) => {
    const space = spaceOf(session, () => matrixOf(device.hands[side]?.joints[index]));
    space[INNER].radius = () => device.hands[side].joints[index][7] ?? 0.01;
    return [jointName, readonly(space, { jointName })];
  }));
}

/** A controller's buttons and stick in the order of the mapping xr-standard, read as they are now. */
function gamepadOf(side) {
  const names = ['trigger', 'squeeze', '', 'stick', 'a', 'b'];
  const buttons = names.map((name) => Object.defineProperties({}, {
    value: { get: () => device.buttons[side]?.[name] ?? 0, enumerable: true },
    pressed: { get: () => (device.buttons[side]?.[name] ?? 0) > 0.5, enumerable: true },
    touched: { get: () => (device.buttons[side]?.[name] ?? 0) > 0, enumerable: true },
  }));
  return readonly({}, {
    id: '', index: -1, connected: true, mapping: 'xr-standard', axes: Object.freeze([0, 0, 0, 0]),
    buttons: Object.freeze(buttons), timestamp: 0,
  });
}

function makeSource(session, handedness) {
  const held = { handedness, targetRayMode: 'tracked-pointer', skipRendering: false };
  if (device.input === 'hands') {
    const allowed = session.enabledFeatures.includes('hand-tracking');
    const joints = jointSpaces(session, handedness);
    const wrist = () => joints.get('wrist')[INNER].origin();
    return readonly({}, {
      ...held, profiles: Object.freeze(['generic-hand-select', 'generic-trigger']), gamepad: null,
      hand: allowed ? joints : null, gripSpace: spaceOf(session, wrist),
      targetRaySpace: spaceOf(session, () => matrixOf(device.hands[handedness]?.ray) ?? wrist()),
    });
  }
  const pose = (name) => matrixOf(device.controllers[handedness]?.[name] ?? device.controllers[handedness]?.grip ?? null);
  return readonly({}, {
    ...held, profiles: Object.freeze(['meta-quest-touch-plus', 'oculus-touch-v3', 'generic-trigger-squeeze-thumbstick']),
    gamepad: gamepadOf(handedness), hand: null, gripSpace: spaceOf(session, () => pose('grip')),
    targetRaySpace: spaceOf(session, () => pose('ray')),
  });
}

/** Brings the session's input sources up to what the device has; tells the page. */
function changeSources(session) {
  const inner = session[INNER];
  const list = device.input === 'hands' ? device.hands : device.input === 'controllers' ? device.controllers : {};
  const wanted = SIDES.filter((side) => list[side] !== undefined).map((side) => `${device.input} ${side}`);
  const removed = [...inner.sources].filter(([key]) => !wanted.includes(key)).map(([, source]) => source);
  const added = wanted.filter((key) => !inner.sources.has(key)).map((key) => [key, makeSource(session, key.split(' ')[1])]);
  if (!removed.length && !added.length) return;
  const kept = [...inner.sources].filter(([key]) => wanted.includes(key));
  inner.sources = new Map([...kept, ...added]);
  inner.list = Object.freeze([...inner.sources.values()]);
  session.dispatchEvent(happened('inputsourceschange', { session, added: added.map(([, source]) => source), removed }));
}

/** The steering wheel of tests. */
const fakeXR = {
  device,
  sessions: 0, // entered so far
  frames: 0, // given to the page so far
  motion: null, // (ms, device) => void before each frame
  last: null, // {time, eyes: {left: {matrix, projection}, right}} of the newest frame, room from eye
  running: false,
  fence: null, // of the newest frame while the GPU draws it

  get session() { return current; },

  /** One XR frame at a time in ms. False: the page gets none now. */
  step(time = performance.now()) {
    this.motion?.(time, device);
    const session = current;
    const inner = session?.[INNER];
    if (!inner || inner.visibility === 'hidden') return false;
    if (inner.pending) [inner.state, inner.pending] = [inner.pending, null];
    changeSources(session);
    if (!inner.state.baseLayer || !inner.callbacks.length) return false;
    clearLayer(inner.state.baseLayer);
    const { depthNear, depthFar } = inner.state;
    const eyes = device.head && Object.fromEntries(SIDES.map((side) =>
      [side, { matrix: eyeMatrix(side), projection: [...projection(side, depthNear, depthFar)] }]));
    const frame = new XRFrame(session, time, true);
    inner.running.add(frame);
    inner.callbacks.splice(0).forEach(({ callback }) => {
      try {
        callback(time, frame);
      } catch (error) {
        reportError(error);
      }
    });
    inner.running.delete(frame);
    frame[INNER].close();
    this.frames += 1;
    this.last = { time, eyes, mode: inner.mode };
    const { gl } = inner.state.baseLayer[INNER];
    this.fence = { gl, sync: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0) };
    gl.flush();
    return true;
  },

  /** Whether the newest frame is drawn. A headset gives no further one before; else they would queue up for seconds. */
  drawn() {
    if (!this.fence) return true;
    const { gl, sync } = this.fence;
    if (gl.getSyncParameter(sync, gl.SYNC_STATUS) !== gl.SIGNALED && !gl.isContextLost()) return false;
    gl.deleteSync(sync);
    this.fence = null;
    return true;
  },

  /** Frames at the page's own rate until stop(). */
  run() {
    if (this.running) return;
    this.running = true;
    const next = (time) => {
      if (!this.running) return;
      if (this.drawn()) this.step(time);
      pageFrame(next);
    };
    pageFrame(next);
  },

  stop() { this.running = false; },

  /** A whole press: 'select' or 'squeeze' on the side's input source. */
  press(side, what = 'select') {
    const session = current;
    const inputSource = [...session.inputSources].find((source) => source.handedness === side);
    for (const type of [`${what}start`, what, `${what}end`]) {
      if (session[INNER].ended) return;
      const frame = new XRFrame(session, performance.now(), false);
      session.dispatchEvent(happened(type, { frame, inputSource }));
      frame[INNER].close();
    }
  },

  visibility(state) {
    current[INNER].visibility = state;
    current.dispatchEvent(happened('visibilitychange', { session: current }));
  },

  /** What an eye was shown: RGBA bytes as base64, rows bottom-up. */
  pixels(side) {
    const { gl, side: size } = current[INNER].state.baseLayer[INNER];
    const { framebuffer } = current[INNER].state.baseLayer;
    return readPixels(gl, framebuffer, side === 'left' ? 0 : size, 0, size, size);
  },
};

window.requestAnimationFrame = (callback) => (current ? paused.push(callback) : pageFrame(callback));
const SEEN = { XRSystem, XRSession, XRFrame, XRRenderState, XRWebGLLayer, XRRigidTransform, XRReferenceSpace, fakeXR };
for (const [name, value] of Object.entries(SEEN)) Object.defineProperty(window, name, { value, configurable: true, writable: true });
Object.defineProperty(navigator, 'xr', { value: new XRSystem(), configurable: true });
