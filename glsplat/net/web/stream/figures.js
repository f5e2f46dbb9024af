// What the page knows of its own speed: series of the last seconds, and their medians.

const KEPT = 240; // values of a series: two seconds at 120 Hz

class Series {
  #values = [];

  add(value) {
    if (this.#values.push(value) > KEPT) this.#values.shift();
  }

  /** The q-quantile, 0.5 the median; null while there is nothing. */
  at(q) {
    if (!this.#values.length) return null;
    const sorted = [...this.#values].sort((a, b) => a - b);
    return sorted[Math.min(sorted.length - 1, Math.floor(q * sorted.length))];
  }
}

/** Events a second over the last two seconds. */
class Rate {
  #times = [];

  add(now) {
    this.#times.push(now);
    this.#trim(now);
  }

  at(now) {
    this.#trim(now);
    const span = Math.max(now - (this.#times[0] ?? now), 0);
    return span > 0 ? ((this.#times.length - 1) * 1000) / span : 0;
  }

  #trim(now) {
    while (this.#times.length && this.#times[0] < now - 2000) this.#times.shift();
  }
}

export class Figures {
  shown = 0; // pictures
  #rates = { shown: new Rate(), frames: new Rate() };
  #series = new Map();

  /** A frame of the display began at `now` (ms). */
  frame(now) {
    this.#rates.frames.add(now);
  }

  /** A picture asked for at `asked` (ms) is drawn for the first time at `now`. */
  show(asked, now) {
    this.shown++;
    this.#rates.shown.add(now);
    this.add('age', now - asked);
  }

  /** One value (ms) of a named series. */
  add(name, value) {
    if (!Number.isFinite(value)) return;
    if (!this.#series.has(name)) this.#series.set(name, new Series());
    this.#series.get(name).add(value);
  }

  /** The stage times of a reply's JSON, and the time from request to reply. */
  reply(info, roundTrip) {
    this.add('round trip', roundTrip);
    for (const [stage, ms] of Object.entries(info.times ?? {})) this.add(`server ${stage}`, ms);
  }

  median(name) {
    return this.#series.get(name)?.at(0.5) ?? null;
  }

  p95(name) {
    return this.#series.get(name)?.at(0.95) ?? null;
  }

  rate(name, now) {
    return this.#rates[name].at(now);
  }

  /** Names of all series, those of the server last. */
  names() {
    return [...this.#series.keys()].sort((a, b) => a.startsWith('server') - b.startsWith('server'));
  }
}
