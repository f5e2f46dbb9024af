import { bytesOf, check, textOf } from './twins.js';
import { intrinsics, tangentsOf } from './space/frustum.js';
import { fromPose, viewmat } from './space/matrix.js';
import { parseReply } from './stream/reply.js';

let now = 0; // ms
let sockets = [];
let timers = [];
Object.defineProperty(performance, 'now', { value: () => now }); // Node 18: cannot be assigned
globalThis.setTimeout = (then) => timers.push(then);
globalThis.location = { href: 'http://server.example/vr/', protocol: 'http:' };
globalThis.CustomEvent ??= class extends Event { // Node 18
  constructor(type, { detail }) {
    super(type);
    this.detail = detail;
  }
};
globalThis.WebSocket = class {
  static OPEN = 1;
  readyState = 1;
  bufferedAmount = 0;
  sent = [];

  constructor(url) {
    this.url = new URL(url);
    sockets.push(this);
  }

  send(text) {
    this.sent.push(JSON.parse(text));
  }
};
const { Connection } = await import('./stream/connection.js');

/** A connection that is about to open. */
function connecting(options = {}) {
  [sockets, timers] = [[], []];
  const connection = new Connection(() => options);
  connection.restart();
  return connection;
}

const ended = { code: 1006, reason: '' };

/** A reply without pictures. */
function empty(frameId, info) {
  const text = new TextEncoder().encode(JSON.stringify(info));
  const data = new Uint8Array(18 + text.length);
  const view = new DataView(data.buffer);
  data.set([0x56, 0x52, 1, 0]);
  view.setUint32(4, frameId, true);
  data[8] = 1;
  view.setUint32(14, text.length, true);
  data.set(text, 18);
  return data.buffer;
}

check({
  address({ url, options, resume }) {
    const connection = connecting(options);
    if (resume) {
      sockets[0].onopen();
      connection.send({}, null);
      sockets[0].onmessage({ data: empty(1, { room: { resume } }) });
      sockets[0].onclose(ended);
      timers.pop()();
    }
    const opened = sockets.at(-1).url; // the page's own server: here of another name
    return { path: opened.pathname.replace('/ws', new URL(url).pathname), query: Object.fromEntries(opened.searchParams) };
  },
  eye: ({ pose, projection, size }) => ({ viewmat: viewmat(fromPose(pose)), K: intrinsics(tangentsOf(projection), size) }),
  reply({ data }) {
    const bytes = bytesOf(data);
    const part = (at) => (at ? textOf(bytes.subarray(at[0], at[0] + at[1])) : '');
    try {
      const { id, eyes, info, depth } = parseReply(bytes.buffer);
      return {
        id,
        eyes: eyes.map(({ eye, colour, alpha }) => [eye, part(colour), part(alpha)]),
        info,
        depth: (depth ?? []).map(({ columns, rows, inverse }) => [columns, rows, ...inverse]),
      };
    } catch {
      return null;
    }
  },
  conversation({ steps }) {
    const connection = connecting();
    let shown = null;
    let complaint = null;
    connection.addEventListener('reply', ({ detail }) => (shown = detail.reply.id));
    connection.addEventListener('complaint', ({ detail }) => (complaint = detail));
    let first = 0; // the page goes on counting from connection to connection
    const counted = (message) => ({ ...message, ...(message.frame_id && { frame_id: message.frame_id - first }), ack: message.ack && message.ack - first });
    return steps.map(({ at, do: what, data }) => {
      [now, shown, complaint] = [at, null, null];
      const socket = sockets.at(-1);
      const before = socket.sent.length;
      if (what === 'open') {
        timers.pop()?.();
        first = connection.sentId;
        sockets.at(-1).onopen();
      } else if (what === 'closed') {
        socket.onclose(ended);
      } else if (what === 'request') {
        connection.send({}, null);
        return counted(socket.sent.at(-1));
      } else if (what === 'text') {
        socket.onmessage({ data });
        return { code: complaint.code, message: complaint.message, frame_id: complaint.frame_id ?? null };
      } else {
        const bytes = bytesOf(data);
        const view = new DataView(bytes.buffer);
        view.setUint32(4, view.getUint32(4, true) + first, true);
        socket.onmessage({ data: bytes.buffer });
        const sent = socket.sent.length > before ? counted(socket.sent.at(-1)) : null;
        return { shown: complaint ? false : shown && shown - first, sent };
      }
      return null;
    });
  },
});
