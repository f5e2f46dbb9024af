// JPEGs to bitmaps, in a worker or (for comparison) on the page's own thread.

// what the server sent is what the texture gets: no colour management, no alpha of the codec's own
const OPTIONS = { premultiplyAlpha: 'none', colorSpaceConversion: 'none' };

/** All pictures of a reply: [[colour, alpha | null], ...] of ImageBitmap, left eye first. Closes all if one fails. */
export async function decodeAll(buffer, eyes) {
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

/** In a worker: answers {buffer, eyes} by {pictures} or {error}. */
function serve() {
  self.onmessage = async ({ data: { buffer, eyes } }) => {
    try {
      const pictures = await decodeAll(buffer, eyes);
      self.postMessage({ pictures }, pictures.flat().filter(Boolean));
    } catch (error) {
      self.postMessage({ error: error.message });
    }
  };
}

if (typeof WorkerGlobalScope !== 'undefined' && self instanceof WorkerGlobalScope) serve();
