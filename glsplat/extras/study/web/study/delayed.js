// A connection whose replies come later than they arrive: the latency that a condition adds.

import { Connection } from '../stream/connection.js';

/** Acknowledgements are not delayed, so the rate stays; the age of pictures grows by `latency` (ms). */
export class Delayed extends Connection {
  latency = 0;

  dispatchEvent(event) {
    if (event.type !== 'reply' || !(this.latency > 0)) return super.dispatchEvent(event);
    setTimeout(() => super.dispatchEvent(event), this.latency);
    return true;
  }
}
