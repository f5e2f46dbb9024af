// Replies to decoded pictures: one at a time, always the newest one, and never a bitmap left open.

import { decodeAll } from './decoder.js';

export class Pictures {
  dropped = 0; // replies that a newer one overtook before they were shown
  open = 0; // bitmaps that wait for `take`, or are being decoded
  #worker = null;
  #waiting = null; // the newest reply that is not being decoded
  #busy = null; // the one that is
  #ready = null; // decoded
  #newest = -1; // frame_id that was decoded
  #onDecoded;
  #onError;

  /** `onDecoded(ms)` and `onError(text)` hear of every picture; `inWorker` false decodes on this thread. */
  constructor({ inWorker = true, onDecoded = () => {}, onError = () => {} } = {}) {
    this.#onDecoded = onDecoded;
    this.#onError = onError;
    if (inWorker) {
      this.#worker = new Worker(new URL('./decoder.js', import.meta.url), { type: 'module' });
      this.#worker.onmessage = ({ data }) => this.#done(data);
      this.#worker.onerror = (event) => this.#done({ error: event.message || 'the decoding worker does not start' });
    }
  }

  /** A parsed reply with its buffer, which is given away. `asked` comes back with its pictures. */
  offer(reply, buffer, asked) {
    if (reply.id <= this.#newest) {
      this.dropped++;
      return;
    }
    if (this.#waiting) this.dropped++;
    this.#waiting = { reply, buffer, asked };
    this.#next();
  }

  /** The newest decoded {id, info, asked, pictures: [[colour, alpha | null], ...]}, once, or null. Then `close` it. */
  take() {
    const ready = this.#ready;
    this.#ready = null;
    return ready;
  }

  /** Give back the memory of what `take` returned. */
  close({ pictures }) {
    for (const bitmap of pictures.flat()) {
      if (!bitmap) continue;
      bitmap.close();
      this.open--;
    }
  }

  #next() {
    if (this.#busy || !this.#waiting) return;
    const { reply, buffer } = (this.#busy = this.#waiting);
    this.#waiting = null;
    this.#newest = reply.id;
    this.#busy.started = performance.now();
    if (this.#worker) {
      this.#worker.postMessage({ buffer, eyes: reply.eyes }, [buffer]);
    } else {
      decodeAll(buffer, reply.eyes).then(
        (pictures) => this.#done({ pictures }),
        (error) => this.#done({ error: error.message }),
      );
    }
  }

  #done({ pictures, error }) {
    const { reply, asked, started } = this.#busy ?? {};
    this.#busy = null;
    if (pictures) {
      this.open += pictures.flat().filter(Boolean).length;
      if (this.#ready) {
        this.dropped++;
        this.close(this.#ready);
      }
      this.#ready = { id: reply.id, info: reply.info, asked, pictures };
      this.#onDecoded(performance.now() - started);
    } else {
      this.#onError(error);
    }
    this.#next();
  }
}
