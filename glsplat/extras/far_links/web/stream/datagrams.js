// The second way of docs/protocol.md, section 5.3: pictures and requests by datagrams of WebTransport, in the worker.
//
// Whatever is wrong with it, it closes, and all goes over the WebSocket again.

import { Assembler, HEAD, NONCE, PICTURE, PING, piecesOf } from './pieces.js';

const STALE = 200; // ms after which a datagram need not be sent any more
const OPENS = 2000; // ms within which it has to be there
const SILENT = 2000; // ms without a datagram, while there are requests
const WAIT = 1; // datagrams that may wait to be sent when a request comes
const QUEUE = 4096; // datagrams that may wait to be read

export class Datagrams {
  open = false;
  #transport = null;
  #writer = null;
  #timer = 0;
  #number = 0;
  #heard = 0; // when
  #asked = 0; // requests since then
  #waits = 0; // datagrams that the browser has not sent

  /** `onPicture(buffer)` gets what a binary message of the WebSocket is. */
  constructor(url, sha256, onPicture) {
    this.#run(url, sha256, onPicture).catch(() => {}).finally(() => this.close());
  }

  /** Whether that text is sent this way: it is not while the browser holds back what was sent before. */
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
