// The page of docs/vr.md: creates its parts and connects them.

import { Page } from './page.js';
import { Dock } from './show/dock.js';
import { Elsewhere } from './show/elsewhere.js';
import { Menu, numbers } from './show/menu.js';
import { Orbit } from './show/orbit.js';
import { Stage } from './show/stage.js';
import { Viewer } from './show/viewer.js';
import { Immersive, support } from './show/xr.js';
import { NAME, SPLATS_CACHE, Settings, browserStorage } from './settings.js';
import { Connection } from './stream/connection.js';
import { Tabs } from './stream/tabs.js';
import { Calibration, EYES_OF_STATURE } from './track/calibration.js';
import { Living, Motion, Recording, Rest, parseRecording, readRecording } from './track/drivers.js';
import { Recorder } from './track/recorder.js';
import { STRIDE, Steps, TURN } from './track/steps.js';

const TOKEN = 'glsplat.token'; // in this tab's storage only
const SOON = 2000; // ms between requests to a server that still loads avatars
const NUMBERS = 500; // ms between updates of the figures
const STATURE = 1.71; // metres, of who wears an emulated headset, unless given
const CIRCLE = 1.2; // metres from the middle of a room to its seats, at least
const ENOUGH = 15; // pictures a second below which the page shows a note
const SIZES = [512, 768, 1024, 1536]; // sides of a square picture; others have as many pixels

const asked = new URLSearchParams(location.search);
const settings = new Settings(browserStorage(), Object.fromEntries([...asked].filter(([name]) => ['room', 'name'].includes(name))));
const page = new Page(document, settings);
const canvas = document.getElementById('canvas');
const gl = canvas.getContext('webgl2', { xrCompatible: true, antialias: false, alpha: false });
const calibration = new Calibration();
const recorder = new Recorder();
const connection = new Connection(() => ({
  avatar: settings.get('room') && !settings.chosen('avatar') ? '' : chosenAvatar()?.name ?? settings.get('avatar'), // '': the room's choice
  height: stature(),
  span: measured?.span,
  room: settings.get('room'),
  name: settings.get('room') ? settings.get('name') : '',
  label: settings.get('room') ? 0 : '', // the page draws names by itself
}));
let measured = calibration.load(); // {height, eyes, span, floor} of the user, in metres, or null
let offer = null; // answer of GET /session
let emulates = false; // a headset
let ownRecording = null; // samples of the user's file

if (!gl) {
  page.xr({ vr: 'this browser has no WebGL 2', ar: 'this browser has no WebGL 2' });
  page.status('This page needs WebGL 2, which this browser lacks.', 'error');
  throw new Error('no WebGL 2');
}

const stage = new Stage(gl, connection, settings);
const orbit = new Orbit();
const viewer = new Viewer(canvas, stage, orbit, settings, (drive) => steps.moved(speaking(drive)));
viewer.onAsked = () => voice?.sent();
const menu = new Menu(settings, stage, recorder, {
  calibrate: () => calibration.begin(performance.now(), { height: settings.get('height') }),
  record: () => toggleRecording(),
  leave: () => immersive.end(),
  microphone: () => voice.mute(voice.state === 'on'),
  more: () => talk?.rows() ?? [],
  worn: () => titleOf(chosenAvatar()?.name),
  wears: () => chosenAvatar()?.name,
  met: () => sentence(),
});
const immersive = new Immersive(gl, stage, settings, menu, {
  calibration,
  recorder,
  driven: () => chosenAvatar()?.tracking ?? true,
  speaks: (sample) => voice?.speaks(sample) ?? sample,
  measured: () => measured,
  radius: () => circle(),
  others: () => stage.heads.others,
  accompanied: () => !you() || stage.people.length > 1, // until that is known, the mirror is aside
  onCalibrated: (result) => {
    measured = result;
    calibration.save(result);
    immersive.moveFloor(result.floor);
    immersive.say(`Calibrated: you are ${result.height.toFixed(2)} m tall`);
    connection.restart(); // the address of /ws has the height
  },
  onEnd: () => {
    if (saves) toggleRecording();
    page.inside(false);
    orbit.attach(canvas);
    viewer.start();
    tell();
  },
});

// Parts of extras, each loaded when the server first offers what it is for.
let voice = null; // extras/speech
let talk = null; // extras/voice
let photo = null; // extras/uploads

const addHere = once(async () => {
  stage.addHere((await import('./show/here.js')).Here);
  wear();
});

const addVoice = once(async () => {
  voice = (await import('./voice/panel.js')).addVoice(document.getElementById('controls'), stage);
  voice.addEventListener('leap', () => viewer.askNow());
});

const addTalk = once(async () => {
  await addVoice(); // has the microphone
  const { addTalk: add } = await import('./talk/panel.js');
  talk = add(document.getElementById('invite'), document.getElementById('controls'), { connection, voice, stage, ...offer.talk });
  talk.talk.addEventListener('speaking', ({ detail }) => stage.names.speaking(detail.name, detail.speaking));
  talk.offered(settings.get('room'));
});

const addPhoto = once(async () => {
  const { addPhoto: add } = await import('./photo/form.js');
  photo = await add(document.getElementById('no-photo'), connection, {
    async wear(name) {
      await askOffer();
      settings.set('avatar', name);
    },
    /** Return why it could not be deleted, or ''. */
    async remove(name) {
      settings.set('avatar', offer.avatars[0].name); // the server ends connections that show it
      const response = await connection.fetch(`avatars/${name}`, { method: 'DELETE' }).catch(() => null);
      await askOffer();
      return response?.ok ? '' : ((await response?.text()) ?? 'the server does not answer');
    },
    made: askOffer,
  });
  photo.height = settings.get('height');
  photo.offered(offer.upload, chosenAvatar());
});

/** Return a function that calls `load` once, after the first picture, and shows a message if it fails. */
function once(load) {
  let loading = null;
  return () => (loading ??= stage.begun.then(load).catch((error) => complain(`a part of this page did not load: ${error.message}`)));
}

const dock = new Dock(document, settings, {
  async picture(name) {
    const response = await connection.fetch(`thumbnails/${encodeURIComponent(name)}`);
    return response.status === 200 ? URL.createObjectURL(await response.blob()) : null; // 204: deleted meanwhile
  },
  add: () => page.show(photo && offer?.upload ? 'photo' : 'no-photo'),
  worn: () => chosenAvatar()?.name,
});
const elsewhere = new Elsewhere(document, async (room) => (await connection.fetch(room ? `reach?room=${encodeURIComponent(room)}` : 'reach')).json());

const steps = new Steps(() => stage.heads.others); // of the flat page
const tabs = new Tabs(
  () => (connection.state === 'open' ? person() : ''),
  () => {
    gone = true; // the server ends the connection when the other tab has come
    if (!connection.resume) connection.stop(); // nobody yet
    const { matrix } = immersive.mode ? immersive.steps : steps;
    return { resume: connection.resume, matrix, avatar: settings.chosen('avatar') ? settings.get('avatar') : '' };
  },
);
let gone = false; // another tab has taken over
let taken = ''; // the person that another tab has, who is wanted here

/** Return who the user is in a room, for other tabs: '' while alone or without a name. */
const person = () => (settings.get('room') && settings.get('name') ? `${settings.get('room')}/${settings.get('name')}` : '');

const you = () => (settings.get('room') ? stage.people.find((one) => one.you) : undefined);

const titleOf = (name) => offer?.avatars.find((one) => one.name === name)?.title || (name ?? '');

/** Return the avatar of the user: the chosen one; in a room, without a choice, the one that the server chose. */
function chosenAvatar() {
  if (!offer) return undefined;
  const name = settings.get('room') && !settings.chosen('avatar') ? you()?.avatar : settings.get('avatar');
  return offer.avatars.find((one) => one.name === name) ?? offer.avatars[0];
}

/** Return the radius in metres of the circle on which the people of the room stand; 0 while alone. */
function circle() {
  const found = offer?.rooms?.find(({ name }) => name === settings.get('room'));
  return found ? Math.max(CIRCLE, found.seats / (2 * Math.PI)) : 0; // rule of glsplat/extras/rooms/room.py
}

let stood = null; // radius of the room of the camera's position

/** In a room, move the camera behind the user, who stands on the circle of seats, so that it shows everybody. */
function standAround() {
  const radius = circle();
  if (radius === stood) return;
  stood = radius;
  steps.reset();
  if (!radius) {
    orbit.standAlone();
    return;
  }
  orbit.standBack([0, 0.95, radius], radius);
  orbit.walk = (forth, right, turns) => {
    const { own } = stage.heads;
    const m = steps.matrix;
    if (!own) return;
    if (turns) steps.turn(own, turns * TURN);
    else steps.step(own, [m[8], 0, m[10]], STRIDE * forth, STRIDE * right);
    const by = turns ? [0, 0, 0] : [0, 1, 2].map((i) => steps.matrix[12 + i] - m[12 + i]);
    orbit.goAlong(by, Math.atan2(steps.matrix[8], steps.matrix[10]));
  };
}

/** Return {room, name, avatar, others: [{name, speaks}], given} of the user's room; null while alone. `given`: the avatar of who chose none, else ''. */
function company() {
  const own = you();
  if (!own || connection.state !== 'open') return null;
  const others = stage.people.filter((one) => !one.you).map(({ name }) => ({ name, speaks: stage.names.speaks(name) }));
  const given = settings.chosen('avatar') ? '' : own.avatar;
  return { room: settings.get('room'), name: own.name, avatar: titleOf(own.avatar), others, given };
}

/** Return a line on it for the panel. */
function sentence() {
  const met = company();
  if (!met) return '';
  const others = met.others.map(({ name, speaks }) => (speaks ? `● ${name}` : name)).join(', ');
  return `You are ${met.name}${others ? `; with ${others}` : '; nobody else yet'}`;
}

/** Add the voice's mouth to what drives the avatar. An avatar that cannot be driven gets none. */
function speaking(drive) {
  if (!voice) return drive;
  if (drive.tracking) return { ...drive, tracking: voice.speaks(drive.tracking) };
  const moves = drive.pose || (voice.state === 'on' && (chosenAvatar()?.tracking ?? true));
  return moves ? { ...drive, pose: voice.speaks(drive.pose ?? {}) } : drive;
}

/** Update the stage for the user's avatar and room. */
function wear() {
  stage.canHide = Boolean(chosenAvatar()?.head);
  if (stage.here) stage.here.offer = chosenAvatar()?.hand_out ?? null;
  stage.framing.furnished = offer?.rooms?.find(({ name }) => name === settings.get('room'))?.scene ?? true;
  standAround();
  if (offer?.talk && settings.get('room')) addTalk();
  talk?.offered(settings.get('room'));
}

/** Fetch /session, then connect. */
async function begin() {
  try {
    const response = await connection.fetch('session');
    if (response.status === 401) {
      page.askToken(sessionStorage.getItem(TOKEN) ? 'Wrong token. Enter the right one.' : 'This server needs a token.');
      sessionStorage.removeItem(TOKEN);
      connection.token = null;
      return;
    }
    if (response.ok) offered(await response.json());
  } catch {
    // no answer: the connection reports it and retries
  }
  connection.restart();
}

async function askOffer() {
  const response = await connection.fetch('session').catch(() => null);
  if (response?.ok) offered(await response.json());
}

function offered(session) {
  offer = session;
  const named = (value) => ({ value, label: `${value}` });
  settings.setOptions('avatar', session.avatars.map(({ name, title }) => ({ value: name, label: title || name })));
  const rooms = (session.rooms ?? []).map(({ name, seats }) => ({ value: name, label: `${name} (up to ${seats} people)` }));
  settings.setOptions('room', [{ value: '', label: 'None: alone' }, ...rooms]);
  if (asked.get('room') && !rooms.some(({ value }) => value === asked.get('room'))) complain(`there is no room "${asked.get('room')}" here`);
  if (!NAME.test(asked.get('name') ?? '')) complain('the name in the address is not used: up to 32 letters and digits are needed');
  const drivers = [{ value: 'rest', label: 'Standing still' }];
  for (const name of session.motions) drivers.push({ value: `motion:${name}`, label: `Motion: ${name}` });
  if (session.recording) drivers.push({ value: 'recording', label: 'Recorded head and hands' });
  settings.setOptions('driver', [...drivers, { value: 'file', label: 'My recording…' }]);
  if (settings.get('driver') === 'rest') drive(); // the avatar and its motions are known now
  const sizes = sizesUpTo(session.max_side);
  stage.framing.largest = session.max_side / 1.5;
  settings.setOptions('size', sizes.map(named));
  if (session.rate && sizes.includes(session.size[0])) settings.setDefault('size', session.size[0]);
  const slow = session.rate && session.rate < ENOUGH;
  const smaller = sizes[0] < session.size[0] ? '; smaller ones are faster' : '';
  page.sizeNote(slow ? `This server draws about ${session.rate.toFixed(0)} pictures a second at ${session.size[0]}${smaller}.` : '');
  stage.light = session.light ?? null;
  connection.videos = session.video ?? [];
  settings.setDefault('light', !session.light); // a server that was started with a light keeps it
  wear();
  const handedOut = session.avatars.map(({ hand_out: given }) => given?.sha256).filter(Boolean);
  if (stage.here) stage.here.handedOut(handedOut);
  else if (handedOut.length) addHere().then(() => stage.here?.handedOut(handedOut));
  else globalThis.caches?.delete(SPLATS_CACHE).catch(() => {}); // avatars of earlier sessions
  if (session.voice) addVoice();
  if (photo) photo.offered(session.upload, chosenAvatar());
  else if (session.upload) addPhoto();
  document.getElementById('no-photo').hidden = Boolean(session.upload);
  if (session.loading) setTimeout(askOffer, SOON); // more avatars will follow
}

/**
 * Return the sides of a square picture for a server's limit; pictures may be 1.5 times as high or as wide as a square.
 */
function sizesUpTo(most) {
  const fit = SIZES.filter((side) => 1.5 * side <= most);
  return fit.length ? fit : [Math.max(1, Math.floor(most / 1.5))];
}

/** Drive the avatar by the motion or recording of the settings. */
async function drive() {
  const name = settings.get('driver');
  let driver = new Rest();
  try {
    if (name === 'file' && ownRecording) driver = new Recording(ownRecording);
    else if (name === 'recording') driver = new Recording(parseRecording(await text('recording')));
    else if (name === 'rest' && chosenAvatar()?.tracking && offer.motions.includes('idle')) {
      const { fps, frames } = JSON.parse(await text('motions/idle'));
      driver = new Motion({ fps, frames: [frames[0]] }); // arms down; a request without a pose shows a T-pose
    } else if (name.startsWith('motion:')) driver = living(name, new Motion(JSON.parse(await text(`motions/${name.slice(7)}`))));
  } catch (error) {
    complain(`cannot play this: ${error.message}`);
  }
  if (name === settings.get('driver')) viewer.driver = driver; // else a later choice loaded faster
}

/** Add glances to the idle motion, which alone repeats every six seconds. */
const living = (name, motion) => (name === 'motion:idle' ? new Living(motion) : motion);

async function text(path) {
  const response = await connection.fetch(path);
  if (!response.ok) throw new Error(`the server answers ${response.status} for ${path}`);
  return response.text();
}

/** Return the user's height in metres; undefined: the server estimates it. */
const stature = () => settings.get('height') ?? measured?.height ?? (emulates ? STATURE : undefined);

/** Emulate a headset for whoever has none. */
async function emulated() {
  const { emulate } = await import('./emulate/emulate.js'); // 260 kB
  emulates = true;
  emulate(canvas, {
    eyes: () => EYES_OF_STATURE * stature(),
    step: (...strides) => immersive.step(...strides),
    point: (at) => (immersive.pointer = at),
    click: () => immersive.click(),
    end: () => immersive.end(),
    rest: (now) => immersive.rest(now),
  });
  if (connection.state !== 'off') connection.restart(); // the address of /ws has the height
  page.xr(await support());
}

async function enter(mode) {
  try {
    viewer.stop();
    await immersive.enter(mode);
    orbit.detach();
    page.inside(true);
    tell();
  } catch (error) {
    viewer.start();
    complain(`cannot enter ${mode.toUpperCase()}: ${error.message}`);
  }
}

let saves = false; // a recording runs, or has stopped by itself and is to be saved

function toggleRecording() {
  if (!saves) {
    if (!immersive.mode && !(viewer.driver instanceof Recording)) {
      complain('nothing to record: neither head nor hands drive the avatar');
      return;
    }
    saves = true;
    recorder.start();
    page.recording(true);
    return;
  }
  saves = false;
  page.recording(false);
  if (recorder.word) complain(recorder.word);
  const link = document.createElement('a');
  link.href = URL.createObjectURL(recorder.stop());
  link.download = `glsplat-${new Date().toISOString().slice(0, 19).replaceAll(':', '-')}.jsonl`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Show the state in words, and a button for what the user can do about it. */
function tell() {
  const met = company();
  const words = { off: 'Not connected', connecting: 'Connecting…', open: met ? '' : 'Connected', waiting: 'Not connected' };
  const where = immersive.mode ? ` In ${immersive.mode.toUpperCase()}.` : '';
  const elsewhereOpen = gone || (taken && taken === person()) ? 'You are in this room in another tab.' : '';
  const said = (connection.state !== 'open' && elsewhereOpen) || (stage.notice ? capital(stage.notice) : stage.link || words[connection.state]);
  page.status((said + where).trim(), stage.notice ? 'error' : 'info');
  const waits = gone || (connection.state === 'waiting' && connection.problem !== 'token');
  const who = met ? `Room ${met.room}` : titleOf(chosenAvatar()?.name) || 'glsplat';
  page.title(who, waits ? (elsewhereOpen ? 'Continue here' : 'Try again now') : '');
  page.company(met);
}

/** Show a message for some seconds, on the page and in the room. */
function complain(text) {
  stage.complain(text);
  tell();
}

const capital = (words) => words.charAt(0).toUpperCase() + words.slice(1);

connection.addEventListener('state', () => {
  if (gone && connection.state === 'waiting') connection.stop();
  tell();
  if (connection.problem === 'token') begin();
  if (connection.state === 'open') taken = '';
  if (connection.problem === 'refused' && person() && connection.state === 'waiting') seekTab();
  if (connection.state === 'open' && (!offer || connection.opened > 1)) askOffer(); // the server may be another one
});
connection.addEventListener('offer', ({ detail }) => offered(detail));
connection.addEventListener('complaint', tell);

/** Find out whether it is another tab of this browser that has the person. */
async function seekTab() {
  const who = person();
  if ((await tabs.has(who)) && who === person()) taken = who;
  tell();
}

/** Take the place, the steps and the avatar of the person that another tab gave up. */
function goOn({ resume, matrix, avatar }) {
  connection.resume = resume;
  const before = steps.matrix;
  steps.reset(matrix);
  orbit.goAlong([0, 1, 2].map((i) => matrix[12 + i] - before[12 + i]), Math.atan2(matrix[8], matrix[10]));
  if (avatar) settings.set('avatar', avatar);
}

/** Continue as the person that another tab has, or try again. */
async function again() {
  const kept = gone || taken ? await tabs.take(person()) : null;
  gone = false;
  if (kept) goOn(kept);
  if (connection.state === 'off') connection.restart();
  else connection.hurry();
}

let worn = ''; // avatar that the server chose

connection.addEventListener('reply', () => {
  const own = you()?.avatar ?? '';
  if (own === worn) return;
  worn = own;
  wear();
  dock.show();
});

page.addEventListener('enter-vr', () => enter('vr'));
page.addEventListener('try-vr', () => emulated().then(() => enter('vr')));
page.addEventListener('invite', () => elsewhere.open(settings.get('room')));
page.addEventListener('enter-ar', () => enter('ar'));
page.addEventListener('elsewhere', () => elsewhere.open());
page.addEventListener('again', again);
page.addEventListener('face', () => orbit.toggleFace());
page.addEventListener('record', toggleRecording);
page.addEventListener('calibrate', () => menu.press('calibrate'));
page.addEventListener('fullscreen', () => {
  const done = document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen();
  done.catch((error) => complain(`cannot enter full screen: ${error.message}`));
});
page.addEventListener('token', ({ detail }) => {
  sessionStorage.setItem(TOKEN, detail);
  connection.token = detail;
  begin();
});
page.addEventListener('file', async ({ detail }) => {
  try {
    ownRecording = await readRecording(detail);
    settings.set('driver', 'file');
    drive();
  } catch (error) {
    ownRecording = null;
    complain(`${detail.name}: ${error.message}`);
  }
});
settings.addEventListener('change', ({ detail: { name } }) => {
  if (name === 'driver' || (name === 'avatar' && settings.get('driver') === 'rest')) drive();
  if (name === 'name' && !settings.get('room')) return; // only rooms show it
  if (['avatar', 'height', 'room', 'name'].includes(name)) {
    wear();
    photo?.wears(chosenAvatar());
    if (photo) photo.height = settings.get('height');
    orbit.changed();
    stage.clear();
    if (connection.state !== 'off') connection.restart();
  }
});
connection.awake = () => !gone && (!document.hidden || immersive.mode !== ''); // a page in the background makes no attempt
document.addEventListener('visibilitychange', () => {
  if (!document.hidden) connection.hurry();
});
canvas.addEventListener('webglcontextlost', (event) => {
  event.preventDefault();
  stage.lost();
});
canvas.addEventListener('webglcontextrestored', () => stage.restore(gl));

// a link may have the token behind "#", which no request carries; it is removed from the address
const brought = new URLSearchParams(location.hash.slice(1)).get('token');
if (brought) {
  sessionStorage.setItem(TOKEN, brought);
  history.replaceState(null, '', location.pathname + location.search);
}
connection.token = sessionStorage.getItem(TOKEN);

orbit.attach(canvas);
viewer.covered = () => page.covered();
viewer.ready = () => viewer.driver !== null; // do not show a moving avatar at rest first
viewer.rests = () => photo?.busy ?? false; // making an avatar needs the processor, perhaps of this machine
viewer.onDrive = ({ tracking, t }) => {
  if (recorder.recording && tracking) recorder.add(tracking, t);
};
support().then((found) => page.xr(found));
navigator.xr?.addEventListener?.('devicechange', () => support().then((found) => page.xr(found)));
setInterval(() => {
  page.drawn(stage.renderedBy);
  page.atFace(orbit.close);
  if (stage.figures.shown) dock.load();
  if (settings.get('figures')) page.numbers(numbers(stage.stats(performance.now())));
  if (saves && !recorder.recording) toggleRecording(); // it is full: save it
  tell();
}, NUMBERS);

window.glsplat = Object.freeze({
  /** Numbers for programs and tests; docs/vr.md lists them. */
  stats: () => ({ session: immersive.mode || 'none', view: settings.get('view'), ...stage.stats(performance.now()) }),
});

if (asked.has('emulate')) await emulated();
begin();
drive();
viewer.start();
