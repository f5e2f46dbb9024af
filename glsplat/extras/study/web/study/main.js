// The participant's page: shows the steps that the server sends, and reports the participant's actions.

import { Settings } from '../settings.js';
import { Orbit } from '../show/orbit.js';
import { Stage } from '../show/stage.js';
import { Viewer } from '../show/viewer.js';
import { Immersive, support } from '../show/xr.js';
import { Figures } from '../stream/figures.js';
import { Calibration } from '../track/calibration.js';
import { Rest } from '../track/drivers.js';
import { Recorder } from '../track/recorder.js';
import { StudyBoard } from './board.js';
import { content } from './content.js';
import { Delayed } from './delayed.js';
import { Form } from './form.js';
import { Link, brought, pause } from './link.js';
import { Questions } from './questions.js';

const KEY = 'glsplat.extras.study';
const NOTHING = { getItem: () => null, setItem: () => {} }; // the study has the settings; none are kept
const TICK = 100; // ms

const page = Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16).padStart(2, '0')).join('');
const { secret, token } = brought(KEY);
const link = new Link({ secret, token });
const settings = new Settings(NOTHING);
settings.set('place', 'plain'); // the same surroundings as in earlier studies
settings.set('light', false); // in passthrough, too
const canvas = document.getElementById('canvas');
const gl = canvas.getContext('webgl2', { xrCompatible: true, antialias: false, alpha: false });
const connection = new Delayed(() => ({ study: page }));
let state = null;
let complaint = '';
let told = 0; // ms, when the state arrived
let spoken = '';
let elsewhere = false;

if (!gl) {
  document.getElementById('status').textContent = 'This page needs WebGL 2, which this browser lacks.';
  throw new Error('no WebGL 2');
}
connection.token = token;

const query = new URLSearchParams(location.search);
const inWorker = query.get('decode') !== 'main';
const size = Number(query.get('size') ?? 1024); // pixels, both sides of an eye's picture
settings.setOptions('size', [{ value: size >= 64 && size <= 2048 ? size : 1024 }]);
const stage = new Stage(gl, connection, settings, { inWorker });
const orbit = new Orbit();
const viewer = new Viewer(canvas, stage, orbit, settings);
const board = new StudyBoard();
const questions = new Questions((message) => send(message));
const deeds = {
  consent: (accepted) => attempt({ do: 'consent', step: state.step, accepted }),
  ready: () => attempt({ do: 'ready', step: state.step }),
};
const form = new Form(document, questions, deeds);
const immersive = new Immersive(gl, stage, settings, { rows: () => [], press }, {
  calibration: new Calibration(NOTHING),
  recorder: new Recorder(),
  driven: () => state?.condition !== null,
  speaks: (sample) => sample,
  measured: () => null,
  radius: () => 0, // alone
  onCalibrated: () => {},
  onEnd: () => viewer.start(),
});
immersive.panel = board;

/** Send one message; take the state that answers it. Throws a Refusal. */
async function send(message) {
  const found = await link.ask('study/do', { page, ...message });
  take(found);
  return found;
}

/** Send with retries until the server answers or refuses. */
async function attempt(message) {
  for (let count = 0; ; count++) {
    try {
      return await send(message);
    } catch (refusal) {
      say(refusal.message);
      if (!refusal.passes) return null;
      await pause(count, refusal);
    }
  }
}

function press(id) {
  if (id === 'agree' || id === 'decline') deeds.consent(id === 'agree');
  else if (id === 'ready') deeds.ready();
  else if (id === 'back') questions.back();
  else if (id === 'next') questions.next();
  else answer(id.slice('value:'.length));
}

/** Answer by a value pressed on the board; a point of a scale leads to the next item. */
function answer(text) {
  const { item } = questions;
  if (!item) return;
  questions.choose(item.kind === 'choice' ? text : Number(text));
  if (item.kind !== 'slider' && !questions.last) questions.next();
}

function take(found) {
  if (state && found.revision < state.revision && found.title === state.title && !fresh) return; // overtaken
  fresh = false;
  const before = state?.condition ?? null;
  const runs = found.phase === 'running' && !(state?.phase === 'running' && state.step === found.step);
  if (runs) stage.figures = new Figures(); // of this task alone
  state = found;
  told = performance.now();
  questions.told(found);
  lead(before, found.condition);
  speak(found);
  show();
}
let fresh = true; // take the next state whatever its revision: the server may be another one

/** Apply the condition to the picture. */
function lead(before, condition) {
  connection.latency = condition?.latency ?? 0;
  if (condition && settings.get('view') !== condition.view) settings.set('view', condition.view);
  if (condition && connection.state === 'off') connection.restart();
  if (!condition && connection.state !== 'off') {
    connection.stop();
    stage.clear();
  }
  if (JSON.stringify(before) !== JSON.stringify(condition)) {
    stage.clear();
    if (condition) connection.hurry();
  }
}

function speak({ step, kind, phase, text, speak: aloud, attempt: number }) {
  const key = kind === 'task' && phase === 'instruction' && aloud ? `${step} ${number}` : '';
  if (key === spoken) return;
  spoken = key;
  globalThis.speechSynthesis?.cancel();
  if (key && globalThis.SpeechSynthesisUtterance) speechSynthesis.speak(new SpeechSynthesisUtterance(text));
}

function left() {
  const value = state?.left ?? null;
  return value === null ? null : value - (performance.now() - told) / 1000;
}

function show() {
  form.show(state, complaint);
  board.show(content(state, questions, left(), complaint));
}

function say(words) {
  complaint = words;
  const line = document.getElementById('status');
  line.dataset.level = words ? 'error' : 'info';
  if (words) line.textContent = words.charAt(0).toUpperCase() + words.slice(1);
  show();
}

/** Return the report of the page's speed; null before the first picture of a task. */
function figures() {
  if (!stage.figures.shown) return null;
  const found = stage.stats(performance.now());
  const { fps, ageMs, ageP95Ms, rttMs, frameRate } = found;
  return { fps, age_ms: ageMs, age_p95_ms: ageP95Ms, rtt_ms: rttMs, frame_rate: frameRate, session: immersive.mode || 'page' };
}

/** Poll the state for as long as the page is open. */
async function follow() {
  let failures = 0;
  let entered = false;
  for (;;) {
    try {
      if (!entered) {
        fresh = true;
        stage.canHide = (await send({ do: 'enter' })).heads; // hide the head, seen from inside
        entered = true;
      }
      const found = await link.ask('study/state', { page, after: state?.revision ?? -1, figures: figures() });
      failures = 0;
      if (complaint) say('');
      take(found);
      if (found.ended) await pause(3);
    } catch (refusal) {
      say(refusal.status === 403 ? 'Open the link that the study printed at its start.' : refusal.message);
      if (refusal.code === 'enter' || refusal.status === 0) entered = false;
      if (refusal.code === 'elsewhere') {
        elsewhere = true;
        connection.stop();
        return;
      }
      if (refusal.status === 401 || refusal.status === 403) return;
      await pause(failures++, refusal);
    }
  }
}

questions.addEventListener('change', show);
settings.addEventListener('change', ({ detail: { name, value } }) => {
  const wanted = state?.condition?.view;
  if (name === 'view' && wanted && value !== wanted) settings.set('view', wanted); // by a controller's button
});
const button = document.getElementById('enter-vr');
button.addEventListener('click', async () => {
  try {
    viewer.stop();
    await immersive.enter('vr');
  } catch (error) {
    viewer.start();
    say(`cannot enter VR: ${error.message}`);
  }
});

function headset({ vr }) {
  button.disabled = vr !== true;
  document.getElementById('vr-note').textContent = vr === true ? '' : vr;
}
support().then(headset);
navigator.xr?.addEventListener?.('devicechange', () => support().then(headset));

setInterval(() => {
  form.tick(left());
  if (immersive.mode) show();
}, TICK);
canvas.addEventListener('webglcontextlost', (event) => event.preventDefault());
canvas.addEventListener('webglcontextrestored', () => stage.restore(gl));

window.glsplat = Object.freeze({
  /** Numbers for programs and tests, as on the other page. */
  stats: () => ({ session: immersive.mode || 'none', view: settings.get('view'), ...stage.stats(performance.now()) }),
  /** The study's state of the server, and answers that are not saved yet. */
  study: () => ({ state, left: left(), item: questions.item?.name ?? null, saving: questions.saving, complaint, elsewhere }),
  /** Position of a cell of the panel in VR, in the room. */
  cell: (id) => board.where(id),
});

viewer.driver = new Rest();
orbit.attach(canvas);
viewer.start();
follow();
