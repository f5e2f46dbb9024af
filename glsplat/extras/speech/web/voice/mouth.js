// Visemes to the weights of ARKit's shapes. Twin: glsplat/extras/speech/speaking.py.

/** One mouth. It is at rest in silence. */
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
