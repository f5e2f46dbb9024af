// Video of docs/protocol.md, section 5.2, decoded by WebCodecs: one coded picture in, a bitmap an eye out.

// what the server can code, by its names, and one of each to ask the browser about
const KNOWN = { vp9: 'vp09.00.51.08', h264: 'avc1.640033' };
const SIZE = { codedWidth: 2048, codedHeight: 1024 };
const LATENCY = { optimizeForLatency: true };
// sRGB by the matrix of BT.601, in limited range: what a stream says of it is not heard by all decoders
const COLOURS = { primaries: 'bt709', transfer: 'iec61966-2-1', matrix: 'smpte170m', fullRange: false };
const LONGEST = 1000; // ms for a picture; a decoder that takes longer holds it back

/** The names of those that this browser decodes, the best first. */
export async function decodable() {
  if (typeof VideoDecoder === 'undefined') return []; // an old browser, or a page that is not secure
  const asked = Object.entries(KNOWN).map(async ([name, codec]) => {
    const { supported } = await VideoDecoder.isConfigSupported({ codec, ...SIZE, ...LATENCY }).catch(() => ({}));
    return supported ? [name] : [];
  });
  return (await Promise.all(asked)).flat();
}

/** One stream. It goes on from the picture before, so each is to be given, one after the other. */
export class VideoFrames {
  #decoder = null;
  #form = '';
  #last = 0; // number of the picture before
  #resolve = () => {};

  /** Of `data`, described by a reply's `video`, with eyes of `side`: [[colour, alpha | null], ...]; null: lost. */
  async decode(data, { codec, number, key, size, eyes, alpha }, side, options) {
    if (key) this.#begin(codec, size);
    else if (number !== this.#last + 1 || this.#decoder?.state !== 'configured') return null;
    this.#last = number;
    const frame = await this.#frame(new EncodedVideoChunk({ type: key ? 'key' : 'delta', timestamp: number, data }));
    if (!frame) {
      this.#last = 0;
      this.#form = ''; // another decoder goes on: what this one still has would be taken for a later picture
      return null;
    }
    const part = (at) => at && createImageBitmap(frame, ...at, ...side, options);
    try {
      return options ? await Promise.all(eyes.map((at, i) => Promise.all([part(at), part(alpha?.[i] ?? null)]))) : [];
    } finally {
      frame.close();
    }
  }

  #begin(codec, [codedWidth, codedHeight]) {
    const form = `${codec} ${codedWidth} ${codedHeight}`;
    if (form === this.#form && this.#decoder.state === 'configured') return;
    if (this.#decoder && this.#decoder.state !== 'closed') this.#decoder.close();
    this.#form = form;
    this.#decoder = new VideoDecoder({ output: (frame) => this.#resolve(frame), error: () => this.#resolve(null) });
    this.#decoder.configure({ codec, codedWidth, codedHeight, colorSpace: COLOURS, ...LATENCY });
  }

  #frame(chunk) {
    return new Promise((resolve) => {
      const timer = setTimeout(() => this.#resolve(null), LONGEST);
      this.#resolve = (frame) => {
        clearTimeout(timer);
        this.#resolve = (late) => late?.close();
        resolve(frame);
      };
      try {
        this.#decoder.decode(chunk);
      } catch {
        this.#resolve(null);
      }
    });
  }
}
