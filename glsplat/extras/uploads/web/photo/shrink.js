// Shrinks pictures that are larger than the server takes.

const KINDS = ['image/jpeg', 'image/png', 'image/webp'];
const SIDE = 4096; // pixels; the server itself keeps 2048
const QUALITY = 0.92;

/**
 * Return `file` itself if it has at most `most` bytes and is of KINDS, as the server reads its EXIF data, such as the
 * focal length. Otherwise return an upright JPEG of it. Rejects with a sentence if the browser cannot read it.
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
  ink.fillStyle = '#fff'; // behind transparent pixels
  ink.fillRect(0, 0, canvas.width, canvas.height);
  ink.drawImage(picture, 0, 0, canvas.width, canvas.height);
  picture.close();
  const made = await new Promise((done) => canvas.toBlob(done, 'image/jpeg', QUALITY));
  if (!made || made.size > most) throw new Error(`${file.name} is too large: choose a smaller picture`);
  return made;
}
