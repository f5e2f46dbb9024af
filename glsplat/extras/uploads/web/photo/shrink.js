// A picture file as the server takes it: as it is, or made smaller where it is over the limit.

const KINDS = ['image/jpeg', 'image/png', 'image/webp'];
const SIDE = 4096; // pixels; the server itself keeps 2048
const QUALITY = 0.92;

/**
 * `file` as it is where it has at most `most` bytes and is of KINDS: the server wants what cameras write into it, such
 * as their focal length. Else a JPEG of the same picture, upright. Rejects, in words, what the browser cannot read.
 */
export async function fitted(file, most) {
  if (file.size <= most && KINDS.includes(file.type)) return file;
  let picture;
  try {
    picture = await createImageBitmap(file, { imageOrientation: 'from-image' });
  } catch {
    throw new Error(`this browser cannot read ${file.name}: choose a JPEG, PNG or WebP picture`);
  }
  const scale = Math.min(1, SIDE / Math.max(picture.width, picture.height));
  const canvas = document.createElement('canvas');
  canvas.width = Math.max(1, Math.round(picture.width * scale));
  canvas.height = Math.max(1, Math.round(picture.height * scale));
  const ink = canvas.getContext('2d');
  ink.fillStyle = '#fff'; // where it is transparent
  ink.fillRect(0, 0, canvas.width, canvas.height);
  ink.drawImage(picture, 0, 0, canvas.width, canvas.height);
  picture.close();
  const made = await new Promise((done) => canvas.toBlob(done, 'image/jpeg', QUALITY));
  if (!made || made.size > most) throw new Error(`${file.name} is too large: choose a smaller picture`);
  return made;
}
