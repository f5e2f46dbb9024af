// Parses the binary reply of docs/protocol.md, section 4, without copying its pictures. Twin: glsplat/net/reply.py.

const MAGIC = 0x5256; // "VR", little endian
const JPEG = 0xd8ff; // first bytes: FF D8
const MOST = 65535; // points of a grid

/**
 * Return {id, eyes: [{eye, colour: [offset, length], alpha: [offset, length] | null}], info, depth}: depth is null, or
 * a grid {columns, rows, inverse} an eye. Throws if it ends early.
 */
export function parseReply(buffer) {
  const view = new DataView(buffer);
  if (view.getUint16(0, true) !== MAGIC || view.getUint16(2, true) !== 1) throw new Error('not a reply of protocol version 1');
  const id = view.getUint32(4, true);
  const eyes = [];
  let offset = 9;
  const part = () => {
    const length = view.getUint32(offset, true);
    const found = [offset + 4, length];
    offset += 4 + length;
    if (offset > buffer.byteLength) throw new Error('truncated reply');
    return found;
  };
  for (let n = view.getUint8(8); n > 0; n--) {
    const eye = view.getUint8(offset++);
    const colour = part();
    // these two bytes begin neither another picture's length nor a JSON object
    const follows = offset + 6 <= buffer.byteLength && view.getUint16(offset + 4, true) === JPEG;
    eyes.push({ eye, colour, alpha: follows ? part() : null });
  }
  const [start, length] = part();
  const info = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, start, length)));
  return { id, eyes, info, depth: info.depth ? grids(info.depth, new Uint8Array(buffer, offset)) : null };
}

/** Return copies of the grids behind the JSON. */
function grids({ grid: [columns, rows], inverse }, data) {
  const count = columns * rows;
  const whole = Number.isInteger(columns) && Number.isInteger(rows) && columns > 1 && rows > 1 && count <= MOST;
  if (!whole || data.length !== count * inverse.length) throw new Error('the depth of the reply has a wrong size');
  return inverse.map(([low, high], i) => {
    const steps = data.subarray(i * count, (i + 1) * count);
    return { columns, rows, inverse: Float32Array.from(steps, (step) => low + ((high - low) / 255) * step) };
  });
}
