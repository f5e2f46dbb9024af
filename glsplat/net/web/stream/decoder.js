// A worker that decodes pictures, JPEGs and video, to bitmaps (pictures.js).

// the texture gets the server's bytes: no colour management, no premultiplication
const OPTIONS = { premultiplyAlpha: 'none', colorSpaceConversion: 'none' };

/**
 * Decode the pictures of a reply: [[colour, alpha | null], ...] of ImageBitmap, left eye first. Closes all if one
 * fails.
 */
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

let frames = null; // promise of the decoder of a video; each picture goes on from the one before

/**
 * Return {pictures}, {lost: true} or {error}. `skip`: decode a picture of a video for the next one alone; `pictures` is
 * empty.
 */
async function decode({ buffer, eyes, video, side, skip }) {
  try {
    if (!video) return { pictures: await decodeAll(buffer, eyes) };
    frames ??= import('./video.js').then(({ VideoFrames }) => new VideoFrames());
    const data = new Uint8Array(buffer, ...eyes[0].colour);
    const pictures = await (await frames).decode(data, video, side, skip ? null : OPTIONS);
    return pictures ? { pictures } : { lost: true };
  } catch (error) {
    return { error: error.message };
  }
}

self.onmessage = async ({ data }) => {
  const answer = await decode(data);
  self.postMessage(answer, (answer.pictures ?? []).flat().filter(Boolean));
};
