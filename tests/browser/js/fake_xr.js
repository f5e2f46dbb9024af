// A WebXR device that tests steer: window.fakeXR. Two eyes of 1024 x 1024 with frusta like a Quest 3's, canted on request,
// a head, hands or controllers and a body whose poses the test gives, and frames that come when it says so.
// fake_xr_types.js and pixels.js go before it, in one function.
'use strict';

const RAD = Math.PI / 180;
const SIDES = ['left', 'right'];
const ROOM = rigid([0, 0, 0], [0, 0, 0, 1]);
const KNOWN = ['viewer', 'local', 'local-floor', 'hand-tracking', 'body-tracking', 'unbounded', 'light-estimation'];

/** What the test sets. Poses are [x, y, z, qx, qy, qz, qw] in metres in the room, whose floor is y = 0. */
const device = {
  modes: ['immersive-vr', 'immersive-ar'],
  features: KNOWN.slice(0, 5),
  head: [0, 1.6, 0, 0, 0, 0, 1], // null: tracking lost
  ipd: 0.063, // metres
  cant: 0, // degrees that each eye looks outwards
  fov: { left: 54, right: 40, up: 44, down: 53 }, // degrees of the left eye; the right one's are mirrored
  side: 1024, // pixels of an eye
  input: 'none', // 'hands', 'controllers'
  hands: { left: null, right: null }, // {joints: [25 poses, each with a radius in metres behind it]}, or null: lost
  controllers: { left: null, right: null }, // {grip: pose, ray: pose}, or null: lost
  buttons: { left: {}, right: {} }, // {trigger, squeeze, a}: 0 to 1
  body: null, // {joint name: pose}
  light: null, // {sh: 27 numbers, direction: [x, y, z], intensity: [r, g, b], probe: pose}; null: nothing is known of it yet
  grants: true, // false: the person refuses the session
};
let current = null; // the immersive session
const compatible = new WeakSet(); // contexts that may be shown in a headset

for (const Kind of [window.WebGLRenderingContext, window.WebGL2RenderingContext]) {
  Kind.prototype.makeXRCompatible = async function makeXRCompatible() { compatible.add(this); };
}
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function patched(type, options) {
  const context = getContext.call(this, type, { ...options, xrCompatible: false });
  if (context && options?.xrCompatible) compatible.add(context);
  return context;
};

function matrixOf(pose) {
  return pose ? rigid(pose.slice(0, 3), pose.slice(3, 7)) : null;
}

/** Room from eye, column-major. */
function eyeMatrix(side) {
  const sign = side === 'left' ? -1 : 1;
  const half = (-sign * device.cant * RAD) / 2;
  const eye = rigid([(sign * device.ipd) / 2, 0, 0], [0, Math.sin(half), 0, Math.cos(half)]);
  return product(matrixOf(device.head), eye);
}

/** OpenGL projection of an eye from its four angles, column-major. */
function projection(side, near, far) {
  const tan = (name) => Math.tan(device.fov[name] * RAD);
  const [l, r] = side === 'left' ? [-tan('left'), tan('right')] : [-tan('right'), tan('left')];
  const [d, u] = [-tan('down'), tan('up')];
  return new Float32Array([
    2 / (r - l), 0, 0, 0, 0, 2 / (u - d), 0, 0, (r + l) / (r - l), (u + d) / (u - d), -(far + near) / (far - near), -1,
    0, 0, (-2 * far * near) / (far - near), 0,
  ]);
}

class XRFrame {
  #open = true;

  constructor(session, time, animation) {
    readonly(this, { session, predictedDisplayTime: time });
    this[INNER] = { animation, views: new Map(), close: () => { this.#open = false; } };
  }

  #check(...spaces) {
    if (!this.#open) fail('InvalidStateError', 'this frame is over: poses are asked for in its own callback');
    if (spaces.some((space) => space[INNER].session !== this.session)) {
      fail('InvalidStateError', 'a space of another session');
    }
  }

  /** Base from space, column-major, or null. */
  #relate(space, base) {
    if (this.session.visibilityState === 'visible-blurred' && space[INNER].input) return null;
    const [from, to] = [space[INNER].origin(), base[INNER].origin()];
    return from && to ? product(inverted(to), from) : null;
  }

  get body() {
    const { session } = this;
    if (!this.#open || !session.enabledFeatures.includes('body-tracking') || !device.body) return null;
    return new Map(Object.keys(device.body).map((name) => {
      const space = new XRSpace(session, () => matrixOf(device.body?.[name]));
      return [name, readonly(space, { jointName: name })];
    }));
  }

  getViewerPose(base) {
    this.#check(base);
    if (!this[INNER].animation) fail('InvalidStateError', 'viewer poses are for animation frames');
    const to = base[INNER].origin();
    if (!device.head || !to) return null;
    const { depthNear, depthFar } = this.session.renderState;
    const back = inverted(to);
    const views = SIDES.map((eye) => readonly({ [INNER]: { frame: this } }, {
      eye, projectionMatrix: projection(eye, depthNear, depthFar), recommendedViewportScale: null,
      transform: transformOf(product(back, eyeMatrix(eye))), isFirstPersonObserver: false,
    }));
    return poseAt(product(back, matrixOf(device.head)), { views: Object.freeze(views) });
  }

  getLightEstimate(probe) {
    this.#check(probe.probeSpace);
    if (!device.light) return null;
    const point = ([x, y, z]) => new DOMPointReadOnly(x, y, z, 0);
    return readonly({}, {
      sphericalHarmonicsCoefficients: new Float32Array(device.light.sh),
      primaryLightDirection: point(device.light.direction), primaryLightIntensity: point(device.light.intensity),
    });
  }

  getPose(space, base) {
    this.#check(space, base);
    const found = this.#relate(space, base);
    return found && poseAt(found);
  }

  getJointPose(joint, base) {
    this.#check(joint, base);
    const found = this.#relate(joint, base);
    return found && poseAt(found, { radius: joint[INNER].radius() });
  }

  fillPoses(spaces, base, transforms) {
    const list = [...spaces];
    this.#check(...list, base);
    if (transforms.length < 16 * list.length) throw new TypeError('the array is too small for the poses');
    let all = true;
    list.forEach((space, index) => {
      const found = this.#relate(space, base);
      all &&= found !== null;
      transforms.set(found ?? new Array(16).fill(NaN), 16 * index);
    });
    return all;
  }
}

class XRLightProbe extends EventTarget {
  onreflectionchange = null;

  constructor(session) {
    super();
    readonly(this, { probeSpace: new XRSpace(session, () => matrixOf(device.light?.probe)) });
  }
}

class XRRenderState {
  constructor(values) {
    readonly(this, { depthNear: 0.1, depthFar: 1000, inlineVerticalFieldOfView: null, baseLayer: null, ...values });
  }
}

class XRWebGLLayer extends EventTarget {
  constructor(session, gl, options = {}) {
    super();
    if (session[INNER].ended || gl.isContextLost()) fail('InvalidStateError', 'session or context is gone');
    if (!compatible.has(gl)) fail('InvalidStateError', 'the context is not XR compatible');
    const side = Math.round(device.side * (options.framebufferScaleFactor ?? 1));
    const framebuffer = makeFramebuffer(gl, 2 * side, side, options.alpha ?? true);
    readonly(this, {
      antialias: false, ignoreDepthValues: options.ignoreDepthValues ?? false, framebuffer,
      framebufferWidth: 2 * side, framebufferHeight: side,
    });
    this.fixedFoveation = null;
    this[INNER] = { session, gl, side };
  }

  getViewport(view) {
    const { frame } = view[INNER];
    if (frame.session !== this[INNER].session || !frame.session[INNER].running.has(frame)) {
      fail('InvalidStateError', 'a view of another session, or of a frame that is over');
    }
    const { side } = this[INNER];
    return readonly({}, { x: view.eye === 'left' ? 0 : side, y: 0, width: side, height: side });
  }
}
