// A connection that delays replies by the latency of a study's condition.

import { Connection } from '../stream/connection.js';

/** Adds `latency` (ms) to the age of pictures. Acknowledgements are not delayed, so the rate stays. */
export class Delayed extends Connection {
  latency = 0;

  dispatchEvent(event) {
    if (event.type !== 'reply' || !(this.latency > 0)) return super.dispatchEvent(event);
    setTimeout(() => super.dispatchEvent(event), this.latency);
    return true;
  }
}
