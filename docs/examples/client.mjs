// A client without a library: asks a server for ten stereo pairs of a waving arm and keeps the last one's pictures.
//
//     glsplat serve                                  # in another terminal
//     node client.mjs [ws://127.0.0.1:8000/ws]       # Node 22 or newer; 20 with --experimental-websocket
//
// In a browser the same lines work without the files. What the fields mean: docs/protocol.md, sections 3 and 4.
import { writeFileSync } from 'node:fs';

if (!globalThis.WebSocket) throw new Error('this Node has no WebSocket: take 22 or newer, or 20 with --experimental-websocket');
const COUNT = 10;
const socket = new WebSocket(process.argv[2] ?? 'ws://127.0.0.1:8000/ws');
socket.binaryType = 'arraybuffer';

const eye = (x) => ({ viewmat: [1, 0, 0, -x, 0, -1, 0, 1.1, 0, 0, -1, 2.4, 0, 0, 0, 1], K: [512, 512, 256, 256] });
const armed = (angle) => Array.from({ length: 21 }, (_, joint) => (joint === 16 ? [0, 0, angle] : [0, 0, 0])); // a shoulder

function ask(number) {
  const pose = { body_pose: armed(Math.sin(number / 2)) };
  socket.send(JSON.stringify({ v: 1, frame_id: number, ack: number - 1, eyes: [eye(-0.03), eye(0.03)], size: [512, 512], pose }));
}

socket.onopen = () => ask(1);
socket.onerror = () => console.error(`no server at ${socket.url}: start glsplat serve`);
socket.onmessage = ({ data }) => {
  if (typeof data === 'string') throw new Error(data); // what the server complains of
  const view = new DataView(data);
  let at = 9;
  for (let i = 0; i < view.getUint8(8); i++) {
    const [side, length] = [view.getUint8(at), view.getUint32(at + 1, true)];
    writeFileSync(`${['left', 'right'][side]}.jpg`, new Uint8Array(data, at + 5, length));
    at += 5 + length;
  }
  const info = JSON.parse(new TextDecoder().decode(new Uint8Array(data, at + 4, view.getUint32(at, true))));
  const number = view.getUint32(4, true);
  console.log(`picture ${number}: ${info.size.join(' x ')}, ${info.times.total.toFixed(0)} ms at the server`);
  if (number < COUNT) ask(number + 1);
  else socket.close();
};
