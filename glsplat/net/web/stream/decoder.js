// Pictures to bitmaps, JPEGs and video, in a worker or (for comparison) on the page's own thread.

// what the server sent is what the texture gets: no colour management, no alpha of the codec's own
const OPTIONS = { premultiplyAlpha: 'none', colorSpaceConversion: 'none' };

/** All pictures of a reply: [[colour, alpha | null], ...] of ImageBitmap, left eye first. Closes all if one fails. */
async function decodeAll(buffer, eyes) {
  const decode = (part) =>
    part && createImageBitmap(new Blob([new Uint8Array(buffer, ...part)], { type: 'image/jpeg' }), OPTIONS);
  const made = await Promise.allSettled(eyes.flatMap(({ colour, alpha }) => [decode(colour), decode(alpha)]));
  const failed = made.find(({ status }) => status === 'rejected');
  if (failed) {
    for (const { value } of made) value?.close();
    throw new Error(`a picture cannot be decoded (${failed.reason?.message ?? failed.reason})`);
  }
  return eyes.map((_, i) => [made[2 * i].value, made[2 * i + 1].value]);
}

export class Decoder {
  #video = null; // promise of the stream's decoder

  /** {pictures}, none where `skip` says that only the next of a video needs it, or {lost: true}, or {error}. */
  async decode({ buffer, eyes, video, side, skip }) {
    try {
      if (!video) return { pictures: await decodeAll(buffer, eyes) };
      this.#video ??= import('./video.js').then(({ VideoFrames }) => new VideoFrames());
      const data = new Uint8Array(buffer, ...eyes[0].colour);
      const pictures = await (await this.#video).decode(data, video, side, skip ? null : OPTIONS);
      return pictures ? { pictures } : { lost: true };
    } catch (error) {
      return { error: error.message };
    }
  }
}

/** In a worker: answers what `Decoder.decode` takes by what it gives. */
function serve() {
  const decoder = new Decoder();
  self.onmessage = async ({ data }) => {
    const answer = await decoder.decode(data);
    self.postMessage(answer, (answer.pictures ?? []).flat().filter(Boolean));
  };
}

if (typeof WorkerGlobalScope !== 'undefined' && self instanceof WorkerGlobalScope) serve();
