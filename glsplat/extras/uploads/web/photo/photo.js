// "Your photo": loads the form, and follows an avatar that was begun before the page was reloaded.

import { PhotoForm } from './form.js';
import { Upload } from './upload.js';

const MAKING = 'glsplat.making'; // the avatar that is being made, in this tab's storage only

/**
 * Insert the form before `place`, an element. `deeds`: those of PhotoForm, and `made()` for a new avatar. Return the
 * form.
 */
export async function addPhoto(place, connection, deeds) {
  const markup = await (await fetch(new URL('form.html', import.meta.url))).text();
  place.insertAdjacentHTML('beforebegin', markup);
  const upload = new Upload(connection);
  const form = new PhotoForm(place.ownerDocument, upload, deeds);
  upload.addEventListener('change', () => {
    if (upload.busy && upload.now.name) sessionStorage.setItem(MAKING, upload.now.name);
    else sessionStorage.removeItem(MAKING);
    if (upload.now.state === 'done') deeds.made();
  });
  const making = sessionStorage.getItem(MAKING);
  if (making) upload.resume(making);
  return form;
}
