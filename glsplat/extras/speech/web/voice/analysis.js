// Sound to visemes: cepstra of short frames and a small network over some of them, by the table voice/visemes.json.
// Twin: glsplat/extras/speech/analysis.py. Runs in the audio thread, in a page and in Node.

/**
 * A stream of sound at `rate` samples a second; `table` is visemes.json. The length of the pieces makes no difference.
 */
export class Analysis {
  #table;
  #rate;
  #length;
  #size;
  #window;
  #bank;
  #cosines;
  #decay;
  #ring; // the last samples
  #heard = 0;
  #frames = 0;
  #peak;
  #past = [];
  #levels = [];
  #fft;

  constructor(table, rate) {
    const { sound, network } = (this.#table = table);
    if (!(rate >= 16000 && rate <= 384000)) throw new Error(`speech needs 16000 to 384000 samples a second, not ${rate}`);
    this.#rate = rate;
    const n = (this.#length = Math.floor(sound.window * rate + 0.5));
    this.#size = 2 ** Math.ceil(Math.log2(n));
    this.#window = Float64Array.from({ length: n }, (_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * (i + 0.5)) / n));
    const power = this.#window.reduce((sum, v) => sum + v * v, 0);
    this.#bank = bank(sound, rate, this.#size, 2 / (power * this.#size));
    this.#cosines = Array.from({ length: sound.coefficients }, (_, k) =>
      Float64Array.from({ length: sound.bands }, (_, b) => {
        return Math.cos((Math.PI * k * (b + 0.5)) / sound.bands) * Math.sqrt((k ? 2 : 1) / sound.bands);
      }),
    );
    this.#decay = 0.5 ** (sound.hop / sound.half_life);
    this.#ring = new Float64Array(n);
    this.#peak = sound.start;
    this.#fft = new Transform(this.#size);
    this.deepest = 1 - Math.min(...network.offsets);
  }

  /**
   * The frames that end within `samples`: [{time (seconds of the sound), visemes, level (decibels below the peak)}].
   */
  add(samples) {
    const { hop, window } = this.#table.sound;
    const out = [];
    let end = this.#end(hop);
    if (end <= this.#heard) end = this.#take(out, hop, window); // the frame before the first sample
    for (const value of samples) {
      this.#ring[this.#heard % this.#length] = Number.isFinite(value) ? Math.max(-4, Math.min(4, value)) : 0;
      this.#heard++;
      while (end <= this.#heard) end = this.#take(out, hop, window);
    }
    return out;
  }

  #end(hop) {
    return Math.floor(this.#frames * hop * this.#rate + 0.5);
  }

  #take(out, hop, window) {
    const time = (this.#frames - this.#table.network.ahead) * hop - window / 2;
    out.push({ time, ...this.#judged() });
    this.#frames++;
    return this.#end(hop);
  }

  #judged() {
    const { sound, network } = this.#table;
    const n = this.#length;
    let mean = 0;
    for (const value of this.#ring) mean += value / n;
    const { real, imaginary } = this.#fft;
    real.fill(0);
    imaginary.fill(0);
    for (let i = 0; i < n; i++) real[i] = (this.#ring[(this.#heard + i) % n] - mean) * this.#window[i];
    this.#fft.run();
    const energies = this.#bank.map(({ first, weights }) => {
      let sum = 0;
      for (let i = 0; i < weights.length; i++) {
        const [a, b] = [real[first + i], imaginary[first + i]];
        sum += weights[i] * (a * a + b * b);
      }
      return sum;
    });
    const level = energies.reduce((sum, energy) => sum + energy, 0);
    this.#peak = Math.max(this.#peak * this.#decay, level, sound.least);
    const logs = energies.map((energy) => Math.log(energy / this.#peak + sound.tiny));
    const cepstrum = this.#cosines.map((row) => row.reduce((sum, v, b) => sum + v * logs[b], 0));
    this.#past.push(cepstrum);
    while (this.#past.length < this.deepest) this.#past.unshift(cepstrum); // frames before the first one equal it
    if (this.#past.length > this.deepest) this.#past.shift();
    this.#levels.push(10 * Math.log10(level / this.#peak + sound.tiny));
    if (this.#levels.length > network.ahead + 1) this.#levels.shift();
    const seen = network.offsets.flatMap((offset) => this.#past[this.deepest - 1 + offset]);
    const hidden = layer(seen, network.hidden, network.hidden_bias).map(Math.tanh);
    const logits = layer(hidden, network.output, network.output_bias);
    const most = Math.max(...logits);
    const likely = logits.map((logit) => Math.exp(logit - most));
    const sum = likely.reduce((a, b) => a + b, 0);
    return { visemes: likely.map((v) => v / sum), level: this.#levels[0] };
  }
}

function layer(input, weights, bias) {
  const out = [...bias];
  for (let i = 0; i < input.length; i++) {
    const row = weights[i];
    for (let j = 0; j < out.length; j++) out[j] += input[i] * row[j];
  }
  return out;
}

/** Return triangular filters, evenly spaced on the mel scale: {first, weights} each, without their zeros. */
function bank({ low, high, bands }, rate, size, factor) {
  const mel = (f) => 2595 * Math.log10(1 + f / 700);
  const edges = Array.from({ length: bands + 2 }, (_, i) => {
    return 700 * (10 ** ((mel(low) + ((mel(high) - mel(low)) * i) / (bands + 1)) / 2595) - 1);
  });
  return Array.from({ length: bands }, (_, b) => {
    const [from, top, to] = edges.slice(b, b + 3);
    const weights = Array.from({ length: size / 2 + 1 }, (_, i) => {
      const f = (i * rate) / size;
      return factor * Math.max(0, Math.min((f - from) / (top - from), (to - f) / (to - top)));
    });
    const first = Math.max(0, weights.findIndex((weight) => weight > 0));
    return { first, weights: weights.slice(first, weights.findLastIndex((weight) => weight > 0) + 1) };
  });
}

/** The discrete Fourier transform of `real` and `imaginary`, in place (Cooley & Tukey 1965, radix 2). */
class Transform {
  #turns;
  #order;

  constructor(size) {
    this.real = new Float64Array(size);
    this.imaginary = new Float64Array(size);
    const bits = Math.log2(size);
    this.#order = Uint32Array.from({ length: size }, (_, i) => {
      let out = 0;
      for (let bit = 0; bit < bits; bit++) out |= ((i >> bit) & 1) << (bits - 1 - bit);
      return out;
    });
    this.#turns = Float64Array.from({ length: size }, (_, i) => {
      const angle = (-2 * Math.PI * (i >> 1)) / size;
      return i & 1 ? Math.sin(angle) : Math.cos(angle);
    });
  }

  run() {
    const { real, imaginary } = this;
    const size = real.length;
    for (let i = 0; i < size; i++) {
      const j = this.#order[i];
      if (j <= i) continue;
      [real[i], real[j]] = [real[j], real[i]];
      [imaginary[i], imaginary[j]] = [imaginary[j], imaginary[i]];
    }
    for (let half = 1; half < size; half *= 2) {
      const step = size / half; // two numbers a turn
      for (let start = 0; start < size; start += 2 * half) {
        for (let k = 0; k < half; k++) {
          const [c, s] = [this.#turns[k * step], this.#turns[k * step + 1]];
          const [a, b] = [start + k, start + k + half];
          const re = real[b] * c - imaginary[b] * s;
          const im = real[b] * s + imaginary[b] * c;
          real[b] = real[a] - re;
          imaginary[b] = imaginary[a] - im;
          real[a] += re;
          imaginary[a] += im;
        }
      }
    }
  }
}

/** One mouth, visemes to the weights of ARKit's shapes; at rest in silence. Twin: glsplat/extras/speech/speaking.py. */
export class Mouth {
  #table;
  #names;
  #shapes;
  #closing;
  #nearer;
  #mixed;
  #closed = 0;

  constructor(table) {
    this.#table = table;
    const visemes = Object.entries(table.visemes);
    this.#names = [...new Set(visemes.flatMap(([, weights]) => Object.keys(weights)))].sort();
    this.#shapes = visemes.map(([, weights]) => this.#names.map((name) => weights[name] ?? 0));
    this.#closing = visemes.findIndex(([name]) => name === table.mouth.closes);
    this.#nearer = 1 - Math.exp(-table.sound.hop / table.mouth.smooth);
    this.#mixed = visemes.map((_, i) => (i ? 0 : 1));
  }

  /** Return the weights after one more frame of Analysis: {name: 0 to 1} of all shapes that visemes use. */
  add({ visemes, level }) {
    const { closed, opens, jaw } = this.#table.mouth;
    this.#mixed = this.#mixed.map((mixed, i) => mixed + (visemes[i] - mixed) * this.#nearer);
    const now = clamped((visemes[this.#closing] - closed[0]) / (closed[1] - closed[0]));
    this.#closed = Math.max(now, this.#closed - this.#table.sound.hop / opens);
    const weights = this.#names.map((name, k) => {
      let sum = 0;
      this.#mixed.forEach((mixed, i) => (sum += i === this.#closing ? 0 : mixed * this.#shapes[i][k]));
      if (name === 'jawOpen') sum *= jaw[0] + (1 - jaw[0]) * clamped(1 + level / jaw[1]);
      return sum * (1 - this.#closed) + this.#shapes[this.#closing][k] * this.#closed;
    });
    return Object.fromEntries(this.#names.map((name, k) => [name, weights[k]]));
  }
}

const clamped = (value) => Math.min(1, Math.max(0, value));
