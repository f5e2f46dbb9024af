// The sound of one other page: a WebRTC connection, and its voice in space.

const GATHERED = 30; // ms in which signals go into one message
const PATIENCE = 12_000; // ms without a path before the user is told
const AGAIN = 5000; // ms between attempts to find a path
const MOST = 40; // signals of a message that are read
const SMOOTH = 0.03; // s, time constant of movements
// ms: how far a voice may be before its lips (half of what is noticed, ITU-R BT.1359), and may be held back for that
const [EARLIEST, LONGEST] = [20, 250];
const SPACE = { panningModel: 'HRTF', distanceModel: 'inverse', refDistance: 1, rolloffFactor: 1 }; // 6 dB for twice as far

export class Peer {
  path = 'looking'; // looking, open, none
  meter; // AnalyserNode of the sound before it is placed
  out; // PannerNode
  #pc;
  #offers;
  #send;
  #changed;
  #receiver = null;
  #sender = null;
  #track = null; // of our microphone
  #element = null;
  #signals = [];
  #timers = {};
  #last = Promise.resolve(); // signals are taken one after the other

  /**
   * `offers`: this side makes the offers, as it came later; `send(text)` sends a signal; `changed()` is called when
   * `path` changes.
   */
  constructor({ name }, { offers, configuration, context, track, send, changed }) {
    Object.assign(this, { name, meter: new AnalyserNode(context, { fftSize: 1024 }), out: new PannerNode(context, SPACE) });
    this.meter.connect(this.out).connect(context.destination);
    [this.#offers, this.#send, this.#changed, this.#track] = [offers, send, changed, track];
    const pc = (this.#pc = new RTCPeerConnection(configuration));
    pc.onicecandidate = ({ candidate }) => candidate && this.#post({ candidate });
    pc.onconnectionstatechange = () => this.#look(pc.connectionState);
    pc.ontrack = ({ track: theirs, receiver }) => {
      this.#receiver = receiver;
      const stream = new MediaStream([theirs]);
      this.#element = Object.assign(new Audio(), { srcObject: stream, muted: true }); // else Chromium plays nothing (crbug.com/933677)
      context.createMediaStreamSource(stream).connect(this.meter);
    };
    if (offers) {
      pc.onnegotiationneeded = () => this.#describe().catch(() => {});
      this.#sender = pc.addTransceiver(track ?? 'audio', { direction: 'sendrecv' }).sender;
    }
    this.#timers.patience = setTimeout(() => this.#become('none'), PATIENCE);
  }

  /** Send this track of a microphone from now on; null: silence. */
  share(track) {
    this.#track = track;
    this.#sender?.replaceTrack(track).catch(() => {});
  }

  /** Take a signal of the other side, in order. It may be anything. */
  receive(text) {
    this.#last = this.#last.then(() => this.#take(JSON.parse(text))).catch(() => {});
  }

  /** Place the voice: [x, y, z] metres in the axes of the user's head (-z ahead). */
  place([x, y, z]) {
    const { positionX, positionY, positionZ, context } = this.out;
    [positionX, positionY, positionZ].forEach((to, i) => to.setTargetAtTime([x, y, z][i], context.currentTime, SMOOTH));
  }

  /** Hold the voice back, together with the network's jitter, for lips that are seen `late` ms after they moved. */
  wait(late) {
    if (this.#receiver) this.#receiver.jitterBufferTarget = Math.min(LONGEST, Math.max(0, late - EARLIEST));
  }

  close() {
    Object.values(this.#timers).forEach(clearTimeout);
    this.#pc.close();
    this.out.disconnect();
    if (this.#element) this.#element.srcObject = null;
  }

  async #take(signals) {
    const pc = this.#pc;
    for (const { sdp, candidate } of signals.slice(0, MOST)) {
      if (sdp) await pc.setRemoteDescription({ type: this.#offers ? 'answer' : 'offer', sdp });
      if (sdp && !this.#offers) {
        const [first, ...others] = pc.getTransceivers();
        others.forEach((other) => other.stop()); // one sound, no pictures
        this.#sender = first.sender;
        first.direction = 'sendrecv';
        await first.sender.replaceTrack(this.#track);
        await this.#describe();
      }
      if (candidate) await pc.addIceCandidate(candidate).catch(() => {});
    }
  }

  async #describe() {
    await this.#pc.setLocalDescription();
    this.#post({ sdp: this.#pc.localDescription.sdp });
  }

  #post(signal) {
    this.#signals.push(signal);
    this.#timers.post ??= setTimeout(() => {
      this.#timers.post = undefined;
      this.#send(JSON.stringify(this.#signals.splice(0)));
    }, GATHERED);
  }

  #look(state) {
    clearTimeout(this.#timers.again);
    if (state === 'connected') {
      clearTimeout(this.#timers.patience);
      this.#become('open');
    } else if (state === 'failed') {
      this.#become('none');
      if (this.#offers) this.#timers.again = setTimeout(() => this.#pc.restartIce(), AGAIN);
    }
  }

  #become(path) {
    this.path = path;
    this.#changed();
  }
}
