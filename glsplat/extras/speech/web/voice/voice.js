// The user's voice moves the avatar's mouth: microphone, audio thread, and the weights that requests carry.

const STALE = 300; // ms without a message of the audio thread before the mouth goes to rest
const LEAP = 0.05; // change of a weight since the last request that is worth a request at once
const WANTED = { echoCancellation: true, noiseSuppression: true, autoGainControl: true, channelCount: 1 };

/**
 * Events: 'change' of `state` (off, asking, on, muted, refused; `why`: the reason in words), and 'leap': the mouth
 * moved far enough for a request at once.
 */
export class Voice extends EventTarget {
  state = 'off';
  why = '';
  stream = null; // of the open microphone
  #context = null;
  #weights = {};
  #said = {}; // weights that `speaks` returned last
  #sent = {}; // weights of the last request that was sent
  #least = 0; // smallest weight that is sent
  #heard = 0;
  #round = 0; // number of the last start or stop; results of earlier ones are dropped

  /** Ask for the microphone, and listen. */
  async start() {
    if (this.#context || this.state === 'asking') return;
    const round = ++this.#round;
    this.#become('asking');
    let stream = null;
    let context = null;
    const drop = () => {
      stream?.getTracks().forEach((track) => track.stop());
      context?.close();
    };
    try {
      if (!navigator.mediaDevices) throw new Error('this page needs https, or http://localhost');
      stream = await navigator.mediaDevices.getUserMedia({ audio: WANTED });
      context = new AudioContext({ latencyHint: 'interactive' });
      const response = await fetch(new URL('visemes.json', import.meta.url));
      const table = await response.json();
      this.#least = table.mouth.least;
      await context.audioWorklet.addModule(new URL('worklet.js', import.meta.url));
      if (round !== this.#round) return drop();
      const listener = new AudioWorkletNode(context, 'listener', { numberOfOutputs: 0, processorOptions: { table } });
      listener.port.onmessage = ({ data }) => {
        this.#weights = data;
        this.#heard = performance.now();
        if (this.state === 'on' && leaps(this.#sent, data)) this.dispatchEvent(new Event('leap'));
      };
      context.createMediaStreamSource(stream).connect(listener);
      await context.resume();
      if (round !== this.#round) return drop();
      [this.stream, this.#context] = [stream, context];
      stream.getTracks().forEach((track) => (track.onended = () => this.stop('the microphone was disconnected')));
      this.#become('on');
    } catch (error) {
      drop();
      if (round === this.#round) this.#become('refused', error.name === 'NotAllowedError' ? 'the browser does not allow the microphone' : error.message);
    }
  }

  /** Stop, and release the microphone. */
  stop(why = '') {
    this.#round++;
    this.stream?.getTracks().forEach((track) => track.stop());
    this.#context?.close();
    [this.stream, this.#context, this.#weights] = [null, null, {}];
    this.#become(why ? 'refused' : 'off', why);
  }

  /** Mute or unmute; the microphone stays open. */
  mute(muted) {
    if (!this.#context) return;
    this.stream.getTracks().forEach((track) => (track.enabled = !muted));
    this.#become(muted ? 'muted' : 'on');
  }

  /** Return the current weights, {name: 0 to 1}; null while the microphone is closed. */
  weights() {
    if (this.state !== 'on') return null;
    if (performance.now() - this.#heard > STALE) return {};
    const kept = Object.entries(this.#weights).filter(([, weight]) => weight >= this.#least);
    return Object.fromEntries(kept.map(([name, weight]) => [name, Math.round(weight * 1000) / 1000]));
  }

  /** Return a sample of tracking, or a pose, with the current mouth added; weights that it has itself win. */
  speaks(body) {
    const said = this.weights();
    this.#said = said ?? {};
    return said && !Array.isArray(body.expression) ? { ...body, expression: { ...said, ...body.expression } } : body;
  }

  /** Note that the last result of `speaks` was sent. */
  sent() {
    this.#sent = this.#said;
  }

  #become(state, why = '') {
    Object.assign(this, { state, why });
    this.dispatchEvent(new Event('change'));
  }
}

const leaps = (from, to) => Object.entries(to).some(([name, weight]) => Math.abs(weight - (from[name] ?? 0)) > LEAP);
