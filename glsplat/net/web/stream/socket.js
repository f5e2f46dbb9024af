// A WebSocket whose messages are taken from the browser's network process at once, also while the page draws: in a worker.
//
// Chromium's network process answers the server's pings by itself, but stops reading, pings too, once some pictures wait
// to be fetched from it. To the server a page that fetches them late would look like a slow link.

const OPEN = 1; // as in WebSocket
const CLOSED = 3;
const LOOK = 50; // ms between two looks at what still waits to be sent

/** Like a WebSocket of array buffers: `onopen`, `onmessage`, `onclose`, `send`, `close`, `readyState`, `bufferedAmount`. */
export function openSocket(url, protocols) {
  if (typeof Worker !== 'undefined') return new WorkerSocket(url, protocols);
  const socket = new WebSocket(url, protocols);
  socket.binaryType = 'arraybuffer';
  return socket;
}

class WorkerSocket {
  readyState = 0;
  bufferedAmount = 0; // characters, and bytes of those that the worker has
  onopen = () => {};
  onmessage = () => {};
  onclose = () => {};
  #worker = new Worker(new URL(import.meta.url), { type: 'module' });
  #given = 0; // characters
  #taken = 0;

  constructor(url, protocols) {
    this.#worker.onmessage = ({ data }) => this.#heard(data);
    this.#worker.onerror = (event) => this.#closed({ code: 1006, reason: event.message || 'the connection worker failed to start' });
    this.#worker.postMessage({ url: String(url), protocols });
  }

  /** `sure`: not as datagrams, which may be lost. */
  send(text, sure = false) {
    this.#given += text.length;
    this.bufferedAmount += text.length;
    this.#worker.postMessage({ text, sure });
  }

  /** Open a second way, over which pictures and requests go while it is there. */
  openDatagrams(address, sha256) {
    this.#worker.postMessage({ datagrams: { address: String(address), sha256 } });
  }

  close(code) {
    if (this.readyState !== CLOSED) this.#worker.postMessage({ code });
  }

  #heard({ message, opened, taken, waits, closed }) {
    if (message !== undefined) this.onmessage({ data: message });
    if (opened) {
      this.readyState = OPEN;
      this.onopen();
    }
    if (taken !== undefined) {
      this.#taken = taken;
      this.bufferedAmount = this.#given - this.#taken + waits;
    }
    if (closed) this.#closed(closed);
  }

  #closed(how) {
    if (this.readyState === CLOSED) return;
    this.readyState = CLOSED;
    this.#worker.terminate();
    this.onclose(how);
  }
}

/** In the worker: opens, sends and closes what it is told, and hands on what comes. */
function serve() {
  let socket = null;
  let second = null;
  let taken = 0;
  let timer = 0;
  const tell = () => {
    clearTimeout(timer);
    self.postMessage({ taken, waits: socket.bufferedAmount });
    if (socket.bufferedAmount) timer = setTimeout(tell, LOOK);
  };
  self.onmessage = ({ data: { url, protocols, text, sure, datagrams, code } }) => {
    if (url) {
      socket = new WebSocket(url, protocols);
      socket.binaryType = 'arraybuffer';
      socket.onopen = () => self.postMessage({ opened: true });
      socket.onmessage = ({ data }) => self.postMessage({ message: data }, data instanceof ArrayBuffer ? [data] : []);
      socket.onclose = ({ code, reason }) => {
        clearTimeout(timer);
        second?.close();
        self.postMessage({ closed: { code, reason } });
      };
    } else if (text !== undefined) {
      taken += text.length;
      if (socket.readyState === OPEN && (sure || !second?.send(text))) socket.send(text);
      tell();
    } else if (datagrams) {
      const hand = (message) => self.postMessage({ message }, [message]);
      import('./datagrams.js').then(({ Datagrams }) => { // most pages never need it
        second?.close();
        second = new Datagrams(datagrams.address, datagrams.sha256, hand);
      });
    } else {
      second?.close();
      socket.close(code);
    }
  };
}

if (typeof WorkerGlobalScope !== 'undefined' && self instanceof WorkerGlobalScope) serve();
