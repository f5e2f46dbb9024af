// Voice between the pages of a room: who talks, and the signals between their browsers (docs/protocol.md, 2.2).

import { fromPose, invert, movePoint, multiply } from '../space/matrix.js';
import { Peer } from './peer.js';

const PLACED = 50; // ms between two looks at where people stand
const LOUD = 0.01; // root mean square of a voice, full scale 1
const HOLD = 400; // ms for which somebody still speaks in a pause

/**
 * Events: 'change' of `state` (off, joining, on; `why`: why it ended, in words) or of `peers`; 'speaking' (detail {id,
 * name, you, speaking}). `voice` has the microphone (voice/voice.js).
 */
export class Talk extends EventTarget {
  state = 'off';
  why = '';
  peers = new Map(); // by id
  #connection;
  #voice;
  #stage;
  #context = null;
  #configuration = {};
  #opens = false; // whether the microphone was opened for this
  #stream = null; // of the microphone ...
  #meter = null; // ... and its AnalyserNode
  #joined = false;
  #placed = 0;
  #speaks = new Map(); // by id, 0 for the user: ms until which somebody speaks
  #timer = 0;

  constructor(connection, voice, stage) {
    super();
    [this.#connection, this.#voice, this.#stage] = [connection, voice, stage];
    connection.addEventListener('talk', ({ detail }) => this.state === 'off' || this.#heard(detail));
    connection.addEventListener('complaint', ({ detail }) => detail.code === 'talk_full' && this.stop(detail.message));
    connection.addEventListener('state', () => this.state === 'off' || this.#connected());
    voice.addEventListener('change', () => this.#share());
    stage.onFrame = (views) => this.#place(views);
  }

  /** Open the microphone and join. Without a microphone the user only listens. Call within a click. */
  async start() {
    if (this.state !== 'off') return;
    this.#context = new AudioContext({ latencyHint: 'interactive' });
    this.#timer = setInterval(() => this.#listen(performance.now()), PLACED);
    this.#become('joining');
    this.#opens = !this.#voice.stream;
    if (this.#opens) await this.#voice.start();
    else this.#voice.mute(false);
    if (this.state !== 'off') this.#connected();
  }

  /** Leave; the microphone stays open where it was before. */
  stop(why = '') {
    if (this.state === 'off') return;
    this.#connection.talk({ join: false });
    this.#clear();
    clearInterval(this.#timer);
    this.#context.close();
    this.#stream = this.#meter = null;
    this.#become('off', why);
    if (this.#opens) this.#voice.stop();
  }

  /** Join on a new connection; on none there is nobody. */
  #connected() {
    if (this.#connection.state !== 'open') {
      this.#clear();
      this.#become('joining');
    } else if (!this.#joined && this.#voice.state !== 'asking') {
      this.#joined = true;
      this.#connection.talk({ join: true });
      this.#share();
    }
  }

  #clear() {
    this.#joined = false;
    for (const id of [...this.peers.keys()]) this.#remove(id);
  }

  #heard({ you, peers, iceServers, iceTransportPolicy, joined, left, from, signal }) {
    if (you !== undefined) {
      this.#configuration = { iceServers, iceTransportPolicy };
      peers.forEach((one) => this.#add(one, true));
      this.#become('on');
    }
    if (joined) this.#add(joined, false);
    if (left !== undefined) this.#remove(left);
    if (signal) this.peers.get(from)?.receive(signal);
  }

  #add({ id, name }, offers) {
    const peer = new Peer({ name }, {
      offers,
      configuration: this.#configuration,
      context: this.#context,
      track: this.#track,
      send: (signal) => this.#connection.talk({ to: id, signal }),
      changed: () => this.#become(this.state),
    });
    this.peers.set(id, peer);
    this.#become(this.state);
  }

  #remove(id) {
    const peer = this.peers.get(id);
    if (!peer) return;
    this.#speaking(id, peer.name, false);
    peer.close();
    this.peers.delete(id);
    this.#become(this.state);
  }

  get #track() {
    return this.#voice.stream?.getAudioTracks()[0] ?? null;
  }

  /** Give the peers the microphone of now. */
  #share() {
    if (this.state === 'off') return;
    const { stream } = this.#voice;
    if (stream !== this.#stream) {
      this.#stream = stream;
      this.#meter = stream && new AnalyserNode(this.#context, { fftSize: 1024 });
      if (stream) this.#context.createMediaStreamSource(stream).connect(this.#meter);
    }
    for (const peer of this.peers.values()) peer.share(this.#track);
    this.#become(this.state);
  }

  #place([{ transform }]) {
    const now = performance.now();
    if (!this.peers.size || now - this.#placed < PLACED) return;
    this.#placed = now;
    const [places, ear] = [mouths(this.#stage), invert(transform)];
    for (const peer of this.peers.values()) if (places[peer.name]) peer.place(movePoint(ear, places[peer.name]));
  }

  #listen(now) {
    for (const [id, meter, name] of [[0, this.#meter, ''], ...[...this.peers].map(([id, { meter, name }]) => [id, meter, name])]) {
      if (meter && loudness(meter) > LOUD) this.#speaking(id, name, true, now + HOLD);
      else if (now > (this.#speaks.get(id) ?? now)) this.#speaking(id, name, false);
      this.peers.get(id)?.wait(this.#stage.late(now));
    }
  }

  #speaking(id, name, speaking, until) {
    const before = this.#speaks.has(id);
    if (speaking) this.#speaks.set(id, until);
    else this.#speaks.delete(id);
    if (before !== speaking) this.dispatchEvent(new CustomEvent('speaking', { detail: { id, name, you: id === 0, speaking } }));
  }

  /** Whether the person of an id speaks; 0 is the user. */
  speaks(id) {
    return this.#speaks.has(id);
  }

  #become(state, why = '') {
    Object.assign(this, { state, why });
    this.dispatchEvent(new Event('change'));
  }
}

/** Return the root mean square of the last samples. */
function loudness(meter) {
  const samples = new Float32Array(meter.fftSize);
  meter.getFloatTimeDomainData(samples);
  return Math.hypot(...samples) / Math.sqrt(samples.length);
}

const MOUTH = 1.5; // metres above the ground on which somebody stands, where the head is not known

/** Return {name: [x, y, z]} of the people in the room of a stage; metres. */
export function mouths({ info, here, renderedBy }, now = performance.now()) {
  const room = renderedBy.by === 'here' ? here.people.room : info.room;
  if (!Array.isArray(room?.people)) return {};
  const raised = ([x, y, z]) => [x, y + MOUTH, z];
  if (renderedBy.by !== 'here') return Object.fromEntries(room.people.map(({ name, at, head }) => [name, head ?? raised(at)]));
  const names = Object.fromEntries(room.people.map(({ key, name }) => [key, name]));
  const own = invert(fromPose(room.place));
  const bodies = here.people.at(now).map(({ key, root, place: { translation, rotation, scale } }) => {
    const at = movePoint(multiply(own, fromPose([...translation, ...rotation])), root.map((v) => v * scale));
    return [names[key], raised(at)];
  });
  return Object.fromEntries(bodies);
}
