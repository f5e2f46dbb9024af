// Pictures and requests in datagrams of WebTransport (docs/protocol.md, section 5.3), in the socket's worker.
//
// Any fault closes the transport; the WebSocket then carries everything again.

import { Assembler, HEAD, NONCE, PICTURE, PING, piecesOf } from './pieces.js';

const STALE = 200; // ms; the browser drops older datagrams unsent
const OPENS = 2000; // ms; limit for opening the transport
const SILENT = 2000; // ms without a datagram, while requests are sent, before it closes
const WAIT = 1; // unsent datagrams above which a request takes the WebSocket
const QUEUE = 4096; // unread datagrams at most

export class Datagrams {
  open = false;
  #transport = null;
  #writer = null;
  #timer = 0;
  #number = 0;
  #heard = 0; // ms, when the last datagram arrived
  #asked = 0; // requests sent since then
  #waits = 0; // datagrams that the browser has not sent yet

  /** `onPicture(buffer)` is called with what a binary message of the WebSocket would hold. */
  constructor(url, sha256, onPicture) {
    this.#run(url, sha256, onPicture).catch(() => {}).finally(() => this.close());
  }

  /** Send a request as datagrams; return false, and send nothing, while earlier ones are unsent. */
  send(text) {
    if (!this.open || this.#waits > WAIT) return false;
    this.#asked++;
    for (const datagram of piecesOf(++this.#number, text)) this.#write(datagram);
    return true;
  }

  close() {
    this.open = false;
    clearInterval(this.#timer);
    try {
      this.#transport?.close();
    } catch {
      // it was closed before it was open
    }
    this.#transport = null;
  }

  #write(datagram) {
    this.#waits++;
    const done = () => this.#waits--;
    this.#writer.write(datagram).then(done, done);
  }

  async #run(url, sha256, onPicture) {
    const value = Uint8Array.from(atob(sha256), (c) => c.charCodeAt(0));
    const transport = (this.#transport = new WebTransport(url, {
      serverCertificateHashes: [{ algorithm: 'sha-256', value }],
      requireUnreliable: true,
      congestionControl: 'low-latency',
    }));
    transport.closed.catch(() => {});
    const late = setTimeout(() => this.close(), OPENS);
    await transport.ready.finally(() => clearTimeout(late));
    const { datagrams } = transport;
    datagrams.incomingHighWaterMark = QUEUE;
    datagrams.outgoingMaxAge = STALE;
    this.#writer = (datagrams.createWritable?.() ?? datagrams.writable).getWriter();
    const reader = datagrams.readable.getReader();
    const whole = new Assembler();
    this.#heard = performance.now();
    this.#timer = setInterval(() => {
      if (this.#asked > 1 && performance.now() - this.#heard > SILENT) this.close();
    }, SILENT / 4);
    this.open = true;
    for (;;) {
      const { value: datagram, done } = await reader.read();
      if (done || !this.open) return;
      this.#heard = performance.now();
      this.#asked = 0;
      if (datagram[0] === PING) {
        this.#write(datagram.slice(HEAD));
      } else if (datagram[0] === PICTURE) {
        const bytes = whole.add(datagram);
        if (!bytes) continue;
        this.#write(bytes.slice(0, NONCE));
        onPicture(bytes.buffer.slice(NONCE));
      }
    }
  }
}
