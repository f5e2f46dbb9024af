// Decodes video (docs/protocol.md, section 5.2) by WebCodecs: one coded picture in, one bitmap per eye out.

// codecs of the server by name, each with a codec string for the browser
const KNOWN = { vp9: 'vp09.00.51.08', h264: 'avc1.640033' };
const SIZE = { codedWidth: 2048, codedHeight: 1024 };
const LATENCY = { optimizeForLatency: true };
// sRGB by the matrix of BT.601, limited range; not all decoders read it from the stream
const COLOURS = { primaries: 'bt709', transfer: 'iec61966-2-1', matrix: 'smpte170m', fullRange: false };
const LONGEST = 1000; // ms per picture; a slower decoder counts as failed

/** Return the names of the codecs that this browser decodes, the best first. */
export async function decodable() {
  if (typeof VideoDecoder === 'undefined') return []; // an old browser, or a page that is not secure
  const asked = Object.entries(KNOWN).map(async ([name, codec]) => {
    const { supported } = await VideoDecoder.isConfigSupported({ codec, ...SIZE, ...LATENCY }).catch(() => ({}));
    return supported ? [name] : [];
  });
  return (await Promise.all(asked)).flat();
}

/** One stream. Every picture has to be passed in order, as each depends on the one before. */
export class VideoFrames {
  #decoder = null;
  #form = '';
  #last = 0; // number of the last picture
  #resolve = () => {};

  /**
   * Decode `data` by a reply's `video`, for eyes of size `side`: [[colour, alpha | null], ...]; null where it is lost.
   */
  async decode(data, { codec, number, key, size, eyes, alpha }, side, options) {
    if (key) this.#begin(codec, size);
    else if (number !== this.#last + 1 || this.#decoder?.state !== 'configured') return null;
    this.#last = number;
    const frame = await this.#frame(new EncodedVideoChunk({ type: key ? 'key' : 'delta', timestamp: number, data }));
    if (!frame) {
      this.#last = 0;
      this.#form = ''; // use another decoder: late output of this one would be taken for a later picture
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
