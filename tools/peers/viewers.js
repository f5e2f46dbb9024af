// Frames of the page against those of other viewers, in one page, in turns. Run by python -m tools.peers.

import * as THREE from 'three';
import * as OLDER from 'older'; // what GaussianSplats3D was made for: with newer ones it shows nothing
import * as GS3D from 'gs3d';
import { SparkRenderer, SplatMesh } from 'spark';
import * as GSPLAT from 'gsplat';
import { Crowd } from '/vr/draw/crowd.js';
import { readAvatar } from '/vr/avatar/avatar.js';
import { quaternionOf } from '/vr/draw/bones.js';
import { look } from '/vr/draw/device.js';
import { Motion } from '/vr/track/drivers.js';

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const IPD = 0.063;
const FOV = 50;

const canvasOf = (side) => Object.assign(document.createElement('canvas'), { width: 2 * side, height: side });
const pixel = new Uint8Array(4);
const wait = (gl) => {
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null); // Spark leaves one bound
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
};

/** Both eyes that look at the avatar's middle from an angle about it, as three.js cameras. */
function eyesAt(angle, distance, height) {
  return [-0.5, 0.5].map((side) => {
    const camera = new THREE.PerspectiveCamera(FOV, 1, 0.05, 100);
    const middle = new THREE.Vector3(distance * Math.sin(angle), height, distance * Math.cos(angle));
    camera.position.copy(middle);
    camera.lookAt(0, height - 0.1, 0);
    camera.translateX(side * IPD);
    camera.updateMatrixWorld(true);
    return camera;
  });
}

async function* once(bytes) {
  yield bytes;
}

async function ours(side, walking) {
  const canvas = canvasOf(side);
  const gl = canvas.getContext('webgl2', { antialias: false, alpha: true });
  const { software } = look(gl);
  const table = await (await fetch('/vr/draw/programs.json')).json();
  const avatar = await readAvatar(once(new Uint8Array(await (await fetch('/data/avatar.splats')).arrayBuffer())));
  for (const level of [...avatar.levels.keys()]) if (level > 0) avatar.levels.delete(level); // all 40,000, as the others
  const motion = walking ? new Motion(await (await fetch('/data/walk.json')).json()) : null;
  const joints = new Float64Array(4 * avatar.skeleton.count);
  const crowd = new Crowd(gl, table, { triangle: software, kind: '' });
  const standing = await (await fetch('/data/pose.json')).json();
  return {
    gl, canvas,
    draw(angle, frame, distance, height) {
      const { joints_pose: turns, trans } = motion ? motion.at(frame / 30).pose : standing;
      for (let j = 0; j < avatar.skeleton.count; j++) quaternionOf(turns[j], 0, joints, 4 * j);
      crowd.people = [{ key: 0, avatar, pose: { joints, root: trans } }];
      gl.clearColor(0, 0, 0, 1);
      gl.clear(gl.COLOR_BUFFER_BIT);
      const eyes = eyesAt(angle, distance, height).map((camera, i) => ({
        transform: camera.matrixWorld.elements,
        projection: camera.projectionMatrix.elements,
        viewport: { x: i * side, y: 0, width: side, height: side },
      }));
      crowd.draw(eyes, null, IDENTITY);
    },
  };
}

/** A three.js renderer of a scene whose splats `fill(scene, renderer)` adds. */
async function three(side, fill) {
  const canvas = canvasOf(side);
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
  renderer.setSize(2 * side, side, false);
  renderer.setScissorTest(true);
  renderer.autoClear = true;
  const scene = new THREE.Scene();
  await fill(scene, renderer);
  return {
    gl: renderer.getContext(), canvas,
    draw(angle, _, distance, height) {
      eyesAt(angle, distance, height).forEach((camera, i) => {
        renderer.setViewport(i * side, 0, side, side);
        renderer.setScissor(i * side, 0, side, side);
        renderer.render(scene, camera);
      });
    },
  };
}

const spark = (side) =>
  three(side, async (scene, renderer) => {
    scene.add(new SparkRenderer({ renderer }));
    const mesh = new SplatMesh({ url: '/data/avatar.ply' });
    await mesh.initialized;
    scene.add(mesh);
  });

async function gs3d(side) {
  const canvas = canvasOf(side);
  const renderer = new OLDER.WebGLRenderer({ canvas, antialias: false });
  renderer.setSize(2 * side, side, false);
  renderer.setScissorTest(true);
  // it takes the size of an eye's picture from an element on the page
  const frame = document.body.appendChild(document.createElement('div'));
  Object.assign(frame.style, { position: 'absolute', left: '0', top: '0', width: `${side}px`, height: `${side}px` });
  const camera = new OLDER.PerspectiveCamera(FOV, 1, 0.05, 100);
  const viewer = new GS3D.Viewer({
    renderer, camera,
    rootElement: frame,
    selfDrivenMode: false,
    useBuiltInControls: false,
    sharedMemoryForWorkers: false,
    gpuAcceleratedSort: false,
    sceneRevealMode: GS3D.SceneRevealMode.Instant,
    ignoreDevicePixelRatio: true,
  });
  await viewer.addSplatScene('/data/avatar.ply', { showLoadingUI: false, progressiveLoad: false });
  return {
    gl: renderer.getContext(), canvas,
    draw(angle, _, distance, height) {
      eyesAt(angle, distance, height).forEach((eye, i) => {
        camera.position.copy(eye.position);
        camera.quaternion.copy(eye.quaternion);
        camera.updateMatrixWorld(true);
        renderer.setViewport(i * side, 0, side, side);
        renderer.setScissor(i * side, 0, side, side);
        if (i === 0) viewer.update(); // one order for both eyes
        viewer.render();
      });
    },
  };
}

/** gsplat.js has one camera a canvas: both eyes are drawn into the same half, one after the other. */
async function gsplat(side) {
  const canvas = Object.assign(document.createElement('canvas'), { width: side, height: side });
  const renderer = new GSPLAT.WebGLRenderer(canvas, []);
  renderer.setSize(side, side);
  const scene = new GSPLAT.Scene();
  await GSPLAT.PLYLoader.LoadAsync('/data/avatar.ply', scene);
  const camera = new GSPLAT.Camera();
  camera.data.fx = camera.data.fy = side / 2 / Math.tan((FOV * Math.PI) / 360);
  camera.data.setSize(side, side);
  camera.data.near = 0.05;
  const over = new THREE.Quaternion(1, 0, 0, 0); // its cameras look along +z, y down
  return {
    gl: renderer.gl, canvas,
    draw(angle, _, distance, height) {
      for (const eye of eyesAt(angle, distance, height)) {
        const turned = eye.quaternion.clone().multiply(over);
        camera.position = new GSPLAT.Vector3(...eye.position);
        camera.rotation = new GSPLAT.Quaternion(turned.x, turned.y, turned.z, turned.w);
        camera.update();
        renderer.render(scene, camera);
      }
    },
  };
}

const MAKE = {
  'this page': (side) => ours(side, false),
  'this page, walking': (side) => ours(side, true),
  GaussianSplats3D: gs3d,
  Spark: spark,
  'gsplat.js': gsplat,
};

let drawers = {};

/** Make all that are compared, for pictures of `side`, and let them settle: theirs sort in workers, and show by and by. */
window.prepare = async ({ side, distance, height }) => {
  for (const [name, make] of Object.entries(MAKE)) drawers[name] = await make(side);
  for (const one of Object.values(drawers)) {
    for (let i = 0; i < 25; i++) {
      one.draw(0, 0, distance, height);
      wait(one.gl);
      await new Promise((done) => setTimeout(done, 60));
    }
  }
  return Object.keys(drawers);
};

/** Milliseconds of each of some frames of one of them, while the camera circles from `first` on, `of` frames a circle. */
window.run = async ({ name, frames, first, of, distance, height }) => {
  const { draw, gl } = drawers[name];
  const found = [];
  for (let i = 0; i < frames; i++) {
    const begun = performance.now();
    draw((2 * Math.PI * (first + i)) / of, first + i, distance, height);
    wait(gl);
    found.push(performance.now() - begun);
    await new Promise((done) => setTimeout(done, 2)); // their workers answer between frames
  }
  return found;
};

/** A picture of each from the front, as PNG in base64: to look at. */
window.pictures = async ({ distance, height }) => {
  const out = {};
  for (const [name, one] of Object.entries(drawers)) {
    one.draw(0, 0, distance, height);
    out[name] = one.canvas.toDataURL('image/png');
  }
  return out;
};
window.ready = true;
