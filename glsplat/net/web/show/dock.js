// The dock of the flat page: who is seen, what moves them, and the way into a headset. Knows settings, not the server.

const AGAIN = 5000; // ms until a picture that did not come is asked for again

/**
 * Shows `settings` avatar and driver as pictures and chips; `picture(name)` promises the address of a
 * thumbnail, or null; `worn()` names who is shown where nobody was chosen.
 */
export class Dock {
  #document;
  #settings;
  #picture;
  #worn;
  #pictures = new Map(); // by name
  #add; // what the last tile of the strip does

  constructor(document, settings, { picture, add, worn = () => undefined }) {
    [this.#document, this.#settings, this.#picture, this.#add, this.#worn] = [document, settings, picture, add, worn];
    for (const type of ['change', 'options']) {
      settings.addEventListener(type, ({ detail: { name } }) => {
        if (name === 'avatar') this.#showPeople();
        if (name === 'driver') this.#showMotions();
      });
    }
    this.#showPeople();
    this.#showMotions();
  }

  /** Fetch the pictures that are still missing: after the avatar itself, which comes first. */
  async load() {
    for (const { value: name } of this.#settings.options('avatar')) {
      if (this.#pictures.has(name)) continue;
      this.#pictures.set(name, null); // on its way: asked for once
      const picture = await this.#picture(name).catch(() => null);
      if (picture) this.#pictures.set(name, picture);
      else setTimeout(() => this.#pictures.delete(name), AGAIN);
      this.#showPeople();
    }
  }

  /** Show who is worn now. */
  show() {
    this.#showPeople();
  }

  #showPeople() {
    const chosen = this.#worn() ?? this.#settings.get('avatar');
    const options = this.#settings.options('avatar');
    const made = options.map(({ value, label }) => {
      return this.#button('person', label, value === chosen, () => this.#settings.set('avatar', value), this.#face(value, label));
    });
    const yours = this.#button('person', 'Yours', null, this.#add, this.#blank('+'));
    yours.setAttribute('aria-label', 'Your photo');
    this.#replace('people', options.length ? [...made, yours] : []);
  }

  #face(name, label) {
    const address = this.#pictures.get(name);
    if (!address) return this.#blank(label.slice(0, 1).toUpperCase());
    const image = this.#document.createElement('img');
    [image.src, image.alt, image.width, image.height] = [address, '', 56, 56];
    return image;
  }

  #blank(text) {
    const blank = this.#document.createElement('span');
    [blank.className, blank.textContent, blank.ariaHidden] = ['blank', text, 'true'];
    return blank;
  }

  #showMotions() {
    const chosen = this.#settings.get('driver');
    const shown = this.#settings.options('driver').filter(({ value }) => value !== 'file' && value !== 'recording');
    const chips = shown.map(({ value, label }) => {
      const words = value === 'rest' ? 'Stand still' : label.replace(/^Motion: /, '').replaceAll('-', ' ');
      const name = words.charAt(0).toUpperCase() + words.slice(1);
      return this.#button('chip', name, value === chosen, () => this.#settings.set('driver', value));
    });
    this.#replace('motions', chips);
  }

  #button(kind, text, pressed, deed, before = null) {
    const button = this.#document.createElement('button');
    [button.type, button.className] = ['button', kind];
    if (pressed !== null) button.setAttribute('aria-pressed', String(pressed));
    const words = this.#document.createElement('span');
    words.textContent = text;
    button.append(...[before, words].filter(Boolean));
    button.addEventListener('click', deed);
    return button;
  }

  /** The focus stays on the button of the same place. */
  #replace(id, buttons) {
    const list = this.#document.getElementById(id);
    const at = [...list.children].indexOf(this.#document.activeElement);
    buttons.forEach((button, i) => (button.id = `${id}-${i}`));
    list.replaceChildren(...buttons);
    buttons[at]?.focus({ preventScroll: true });
  }
}
