// The form "Your photo": chosen pictures, progress, findings about a picture, and the finished avatar.

import { NAME } from '../settings.js';
import { Upload, fitted } from './upload.js';

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

const VIEWS = ['front', 'back', 'left', 'right'];
const SIDES = { front: 'From the front', back: 'From behind', left: 'From the left', right: 'From the right' };

/** `deeds`: wear(name) and remove(name), which return promises. Shown while the server takes photographs. */
class PhotoForm {
  #document;
  #upload;
  #deeds;
  #offer = null; // of GET /session: {views, picture_bytes, body_bytes}, or null
  #sent = null; // {pictures, height, title} of the last upload, for "Make it anyway"
  #shown = ''; // blob URL of the preview
  #worn = null; // the avatar that is worn, if it can be deleted
  #sure = false; // the next press deletes

  constructor(document, upload, deeds) {
    this.#document = document;
    this.#upload = upload;
    this.#deeds = deeds;
    this.#listen();
    upload.addEventListener('change', () => this.#show());
    this.#show();
  }

  /** Whether an avatar is being made. */
  get busy() {
    return this.#upload.busy;
  }

  /**
   * Show the form if the server takes photographs (`offer` of /session, or null). `worn`: the avatar shown, of
   * /session.
   */
  offered(offer, worn) {
    this.#offer = offer;
    this.#get('photo').hidden = !offer;
    this.wears(worn);
  }

  /** Note which avatar is worn now. */
  wears(worn) {
    this.#worn = worn?.made ? worn : null;
    this.#sure = false;
    this.#showDelete();
  }

  /** Height in metres that is used unless the user types another. */
  set height(metres) {
    this.#get('photo-height').placeholder = metres === null ? 'not given' : metres.toFixed(2);
    this.#get('photo-height').dataset.known = metres ?? '';
  }

  #get(id) {
    return this.#document.getElementById(id);
  }

  #listen() {
    const on = (id, type, listener) => this.#get(id).addEventListener(type, listener);
    on('photo-form', 'submit', (event) => {
      event.preventDefault();
      this.#submit();
    });
    for (const id of ['photo-front', 'photo-take']) on(id, 'change', () => this.#chose(id));
    on('photo-cancel', 'click', () => this.#upload.cancel());
    on('photo-again', 'click', () => {
      this.#upload.cancel();
      this.#get('photo-front').focus();
    });
    on('photo-anyway', 'click', () => this.#anyway());
    on('photo-wear', 'click', () => this.#wear());
    on('photo-delete', 'click', () => this.#delete());
  }

  /** Keep one picture from the front: the one chosen last. */
  #chose(id) {
    const [file] = this.#get(id).files;
    const other = this.#get(id === 'photo-front' ? 'photo-take' : 'photo-front');
    if (file) other.value = '';
    this.#preview(this.#front());
    this.#get('photo-name').placeholder = titleOf(file?.name ?? '') || 'not given';
    this.#warn('');
  }

  /** Make it anyway: from the step that refused it, or from the start if the server has forgotten it. */
  async #anyway() {
    if (this.#upload.now.goes_on && (await this.#upload.goOn())) return;
    if (this.#sent) this.#upload.start(this.#sent.pictures, { ...this.#sent, anyway: true });
    else this.#upload.resume(this.#upload.now.name); // reports that it is forgotten
  }

  #front() {
    return this.#get('photo-front').files[0] ?? this.#get('photo-take').files[0] ?? null;
  }

  #preview(file) {
    URL.revokeObjectURL(this.#shown);
    this.#shown = file ? URL.createObjectURL(file) : '';
    const image = this.#get('photo-shown');
    image.hidden = !file;
    if (file) image.src = this.#shown;
    else image.removeAttribute('src');
  }

  async #submit() {
    if (this.#upload.busy) return;
    const [height, wrong] = this.#height();
    if (!this.#front()) return this.#warn('Choose or take a picture from the front first.', 'photo-front');
    if (wrong) return this.#warn('Enter the height in metres from 0.5 to 2.8, such as 1.75.', 'photo-height');
    const title = this.#get('photo-name').value.trim() || titleOf(this.#front().name);
    if (!NAME.test(title)) {
      return this.#warn('Enter a name of up to 32 letters and digits, with blanks between them.', 'photo-name');
    }
    if (!this.#get('photo-consent').checked) {
      return this.#warn('First confirm that this is you or that this person agreed.', 'photo-consent');
    }
    this.#warn('');
    const button = this.#get('photo-make');
    button.disabled = true; // shrinking large pictures takes a moment
    try {
      const pictures = {};
      const files = VIEWS.map((view) => (view === 'front' ? this.#front() : this.#get(`photo-${view}`).files[0]));
      const sides = VIEWS.filter((_, i) => files[i]);
      const most = Math.min(this.#offer.picture_bytes, this.#offer.body_bytes / sides.length);
      for (const view of sides) pictures[view] = await fitted(files[VIEWS.indexOf(view)], most);
      this.#sent = { pictures, height, title };
      this.#upload.start(pictures, this.#sent);
    } catch (error) {
      this.#warn(capital(error.message), 'photo-front');
    } finally {
      button.disabled = false;
    }
  }

  /** Return [metres or null, whether the text is invalid]. */
  #height() {
    const input = this.#get('photo-height');
    const text = input.value.trim() || input.dataset.known || '';
    const metres = text === '' ? null : Number(text);
    return [metres, input.validity.badInput || (metres !== null && !(metres >= 0.5 && metres <= 2.8))];
  }

  #warn(text, id) {
    const line = this.#get('photo-warning');
    line.textContent = text;
    for (const field of ['photo-front', 'photo-name', 'photo-height', 'photo-consent']) {
      this.#get(field).setAttribute('aria-invalid', String(field === id));
    }
    if (id) this.#get(id).focus();
  }

  async #wear() {
    const { name } = this.#upload.now;
    await this.#deeds.wear(name);
    this.#forget();
    this.#upload.cancel();
    this.#get('canvas').focus();
  }

  /** Remove the pictures from the page. */
  #forget() {
    this.#get('photo-form').reset();
    this.#preview(null);
    this.#sent = null;
  }

  async #delete() {
    if (!this.#sure) {
      this.#sure = true;
      this.#showDelete();
      return;
    }
    const error = await this.#deeds.remove(this.#worn.name);
    if (error) this.#warn(capital(error));
  }

  #showDelete() {
    const button = this.#get('photo-delete');
    if (!this.#worn && this.#document.activeElement === button) this.#get('avatar').focus();
    this.#get('photo-delete-row').hidden = !this.#worn;
    button.textContent = this.#sure ? 'Press again to delete it for good' : `Delete ${this.#worn?.title || this.#worn?.name || ''}`;
  }

  #show() {
    const { state, share, steps, findings, goes_on: goesOn } = this.#upload.now;
    const { busy } = this.#upload;
    const moved = this.#document.activeElement?.closest('#photo-form, #photo-work'); // may be hidden below
    this.#get('photo-form').hidden = state !== 'idle';
    this.#get('photo-work').hidden = state === 'idle';
    const said = this.#get('photo-said');
    const words = this.#words();
    if (said.textContent !== words) said.textContent = words;
    said.classList.toggle('bad', state === 'failed');
    const bar = this.#get('photo-share');
    bar.hidden = !busy;
    if (state === 'waiting') bar.removeAttribute('value');
    else bar.value = share;
    this.#list('photo-steps', state === 'failed' ? [] : steps);
    this.#list('photo-findings', findings.map(({ side, text }) => `${SIDES[side] ?? capital(side)}: ${text}`));
    this.#get('photo-cancel').hidden = !busy;
    this.#get('photo-again').hidden = state !== 'failed';
    this.#get('photo-anyway').hidden = state !== 'failed' || !findings.length || !(goesOn || this.#sent);
    this.#get('photo-wear').hidden = state !== 'done';
    if (moved && !moved.checkVisibility()) this.#focus();
    else if (this.#document.activeElement === this.#document.body && moved) this.#focus();
  }

  /** Focus the next button, so that keyboard users are not sent back to the start of the page. */
  #focus() {
    const ids = ['photo-wear', 'photo-cancel', 'photo-anyway', 'photo-again', 'photo-front'];
    this.#get(ids.find((id) => this.#get(id).checkVisibility()) ?? 'avatar').focus();
  }

  #words() {
    const { state, share, ahead, steps, error, findings, later } = this.#upload.now;
    if (state === 'sending') return `Sending the picture: ${Math.round(100 * share)} %`;
    if (state === 'waiting') return ahead ? `Waiting: ${ahead} ahead of you` : 'Waiting to start';
    if (state === 'making') return `${capital(steps.at(-1) ?? 'beginning')}…`;
    if (state === 'done' && findings.length) return 'Your avatar is ready. A better picture would make a better one:';
    if (state === 'done') return 'Your avatar is ready.';
    if (state === 'failed' && later) return capital(later);
    if (state === 'failed' && findings.length) return 'The picture may not be suitable:';
    return state === 'failed' ? `It failed: ${error}` : '';
  }

  #list(id, lines) {
    const list = this.#get(id);
    list.hidden = !lines.length;
    if (lines.join('\n') === [...list.children].map((item) => item.textContent).join('\n')) return;
    list.replaceChildren(
      ...lines.map((line) => {
        const item = this.#document.createElement('li');
        item.textContent = line;
        return item;
      }),
    );
  }
}

/** Return a person's name made of a picture's file name: at most 32 letters and digits, or ''. */
const titleOf = (file) => file.replace(/\.[^.]*$/, '').replace(/[^\p{L}\p{N}_ .'-]+/gu, ' ').trim().replace(/^[^\p{L}\p{N}]+/u, '')
  .slice(0, 32).replace(/[^\p{L}\p{N}_.]+$/u, '');

const capital = (words) => words.charAt(0).toUpperCase() + words.slice(1);
