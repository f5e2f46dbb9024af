// Runs the page's connection on a fake socket and prints what it sent as JSON (test_link_page.py).
globalThis.location = new URL('http://localhost:8000/vr/index.html');
// Node 18 has none
globalThis.CustomEvent ??= class extends Event {
  constructor(type, { detail = null } = {}) {
    super(type);
    this.detail = detail;
  }
};
const sent = [];
let socket = null;

globalThis.WebSocket = class {
  static OPEN = 1;
  readyState = 1;
  bufferedAmount = 0;

  constructor() {
    socket = this;
  }

  send(text) {
    sent.push(JSON.parse(text));
  }

  close() {}
};

const { Connection } = await import(process.argv[2]);

/** A reply of one eye with an empty JPEG. */
function reply(id) {
  const info = new TextEncoder().encode('{}');
  const view = new DataView(new ArrayBuffer(20 + info.length));
  view.setUint16(0, 0x5256, true);
  view.setUint16(2, 1, true);
  view.setUint32(4, id, true);
  view.setUint8(8, 1);
  view.setUint32(10, 2, true);
  view.setUint32(16, info.length, true);
  new Uint8Array(view.buffer, 20).set(info);
  return { data: view.buffer };
}

const connection = new Connection(() => ({}));
connection.restart();
socket.onopen();
connection.send({});
connection.send({});
await new Promise((done) => setTimeout(done, 30));
socket.onmessage(reply(1));
connection.send({});
socket.onmessage(reply(3));
connection.send({});
connection.send({});
console.log(JSON.stringify(sent));
