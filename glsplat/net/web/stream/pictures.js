// Decodes replies to bitmaps, one at a time, the newest first, and closes every bitmap.
//
// Each picture of a video is decoded, because the next depends on it; only the newest becomes bitmaps.

const MOST = 16; // queued pictures of a video above which it restarts at a key frame

export class Pictures {
  dropped = 0; // replies replaced by a newer one before they were shown
  open = 0; // bitmaps that are not closed
  #worker = new Worker(new URL('./decoder.js', import.meta.url), { type: 'module' });
  #waiting = []; // queued replies: the newest, before it those of a video
  #busy = null; // the reply that is being decoded
  #ready = null; // decoded
  #newest = -1; // frame_id that was decoded
  #onDecoded;
  #onError;

  /** `onDecoded(ms)` or `onError(text)` is called for every picture. */
  constructor({ onDecoded, onError }) {
    this.#onDecoded = onDecoded;
    this.#onError = onError;
    this.#worker.onmessage = ({ data }) => this.#done(data);
    this.#worker.onerror = (event) => this.#done({ error: event.message || 'the decoding worker failed to start' });
  }

  /** Queue a parsed reply; its buffer is transferred. `asked` comes back with its pictures. */
  offer(reply, buffer, asked) {
    if (reply.id <= this.#newest) {
      this.dropped++;
      return;
    }
    if (this.#waiting.length && !this.#waiting.at(-1).reply.info.video) {
      this.dropped++;
      this.#waiting.pop();
    }
    if (this.#waiting.length >= MOST) {
      this.dropped += this.#waiting.length;
      this.#waiting = []; // the decoder then reports a gap, and a key frame is requested
    }
    this.#waiting.push({ reply, buffer, asked });
    this.#next();
  }

  /** Whether `take` has something to return. */
  get ready() {
    return this.#ready !== null;
  }

  /**
   * Return the newest decoded {id, info, depth, asked, pictures: [[colour, alpha | null], ...]} once, or null. Then
   * `close` it.
   */
  take() {
    const ready = this.#ready;
    this.#ready = null;
    return ready;
  }

  /** Close the bitmaps of what `take` returned. */
  close({ pictures }) {
    for (const bitmap of pictures.flat()) {
      if (!bitmap) continue;
      bitmap.close();
      this.open--;
    }
  }

  #next() {
    if (this.#busy || !this.#waiting.length) return;
    const { reply, buffer } = (this.#busy = this.#waiting.shift());
    this.#newest = reply.id;
    this.#busy.started = performance.now();
    const { video, size: side } = reply.info;
    this.#worker.postMessage({ buffer, eyes: reply.eyes, video, side, skip: this.#waiting.length > 0 }, [buffer]);
  }

  #done({ pictures, lost, error }) {
    const { reply, asked, started } = this.#busy ?? {};
    this.#busy = null;
    if (lost) {
      reply.lost?.();
    } else if (pictures?.length === 0) {
      reply.decoded?.();
      this.dropped++;
    } else if (pictures) {
      reply.decoded?.();
      this.open += pictures.flat().filter(Boolean).length;
      if (this.#ready) {
        this.dropped++;
        this.close(this.#ready);
      }
      this.#ready = { id: reply.id, info: reply.info, depth: reply.depth, asked, pictures };
      this.#onDecoded(performance.now() - started);
    } else {
      reply?.lost?.();
      this.#onError(error);
    }
    this.#next();
  }
}
