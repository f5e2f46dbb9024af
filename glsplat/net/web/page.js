// The flat page's controls: they show the settings, change them, and say what the user asked for. Nothing here knows
// the server or the headset.

const CHOICES = ['view', 'place', 'avatar', 'room', 'size', 'driver', 'drawn'];
const FLAGS = ['light', 'stereo', 'figures'];
const NOTES = {
  name: { right: 'Shown over your head to others in the room.', wrong: 'Not used: enter up to 32 letters and digits.' },
  height: { right: 'Optional; 0.5 to 2.8. Fits the avatar to you in VR.', wrong: 'Not used: enter metres from 0.5 to 2.8, such as 1.75.' },
};
const BUTTONS = ['enter-vr', 'enter-ar', 'try-vr', 'elsewhere', 'invite', 'again', 'face', 'record', 'calibrate', 'fullscreen'];

/**
 * Events: 'enter-vr', 'enter-ar', 'try-vr' (without a headset), 'elsewhere' (another device), 'invite', 'again' (once more), 'face', 'record', 'calibrate',
 * 'fullscreen'; 'token' (detail: text), 'file' (a File).
 */
export class Page extends EventTarget {
  #document;
  #settings;
  #xr = { vr: 'looking for a headset…', ar: 'looking for a headset…' };
  #inside = false;

  constructor(document, settings) {
    super();
    this.#document = document;
    this.#settings = settings;
    for (const name of settings.names) this.#show(name);
    settings.addEventListener('change', (event) => this.#show(event.detail.name));
    settings.addEventListener('options', (event) => this.#show(event.detail.name));
    this.#listen();
    this.#get('fullscreen').hidden = !document.fullscreenEnabled;
  }

  /** Say what is going on; level 'info' or 'error'. Screen readers read it out when it changes. */
  status(text, level = 'info') {
    const line = this.#get('status');
    line.dataset.level = level;
    if (line.textContent !== text) line.textContent = text;
  }

  /** How much of the picture the head and the dock lie over, CSS pixels. */
  covered() {
    const part = this.#get('company').hidden ? 0.5 : 1; // one avatar is beside the head, names of many are anywhere
    return { top: part * this.#get('top').offsetHeight, right: 0, bottom: this.#get('dock').offsetHeight, left: 0 };
  }

  /** What there is to say of how fast pictures of this size are; '' for nothing. */
  sizeNote(text) {
    this.#get('size-note').textContent = text;
  }

  /** Whose the avatar is, or which room it is, and what there is to be done about what `status` says: the button's words, or ''. */
  title(who, again = '') {
    const button = this.#get('again');
    if (this.#get('who').textContent !== who) this.#get('who').textContent = who;
    if (button.textContent !== again && again) button.textContent = again;
    button.hidden = !again;
  }

  /** As whom the user is in a room, and with whom: {name, avatar, others: [{name, speaks}], given}; null: alone. */
  company(met) {
    if (!met && !this.#get('company').hidden) this.#show('avatar');
    this.#get('company').hidden = this.#get('invite').hidden = !met;
    if (!met) return;
    if (met.given) this.#get('avatar').value = met.given;
    const you = `You are ${met.name}, as ${met.avatar}.`;
    const others = met.others.map(({ name, speaks }) => (speaks ? `${name} (speaking)` : name)).join(', ');
    const text = `${you} ${others ? `Here: ${others}.` : 'Nobody else is here yet.'}`;
    if (this.#get('company').textContent !== text) this.#get('company').textContent = text;
  }

  /** Whether the camera looks at the face. */
  atFace(close) {
    this.#get('face').setAttribute('aria-pressed', String(close));
  }

  /** Open the drawer, and in it a part with its first field. */
  show(part) {
    this.#settings.set('drawer', true);
    this.#get(part).open = true;
    this.#get(part).scrollIntoView({ block: 'nearest' });
    this.#get(part).querySelector('summary').focus();
  }

  /** The figures: label -> text, in that order. */
  numbers(figures) {
    const list = this.#get('numbers');
    const labels = Object.keys(figures);
    const terms = [...list.querySelectorAll('dt')];
    if (labels.length !== terms.length || labels.some((label, i) => label !== terms[i].textContent)) {
      list.replaceChildren(...labels.flatMap((label) => [this.#element('dt', label), this.#element('dd', '')]));
    }
    const values = list.querySelectorAll('dd');
    labels.forEach((label, i) => {
      if (values[i].textContent !== String(figures[label])) values[i].textContent = figures[label];
    });
  }

  /** Whether VR and AR can be entered: true, or why not, in words for beside the button. */
  xr({ vr = this.#xr.vr, ar = this.#xr.ar }) {
    this.#xr = { vr, ar };
    this.#showHeadset();
  }

  /** Whether the user is in VR or AR now: only then there is somebody to calibrate. */
  inside(inside) {
    this.#inside = inside;
    this.#showHeadset();
  }

  /** Who draws now, and why: `drawn` of the figures. */
  drawn({ by, reason }) {
    const text = `${by === 'here' ? 'This device' : 'The server'} draws: ${reason}.`;
    if (this.#get('drawn-note').textContent !== text) this.#get('drawn-note').textContent = text;
  }

  /** Whether a recording is running. */
  recording(running) {
    this.#get('record').textContent = running ? 'Stop and save' : 'Record';
  }

  /** Ask for the server's token; `text` says why. The form goes away when one is given. */
  askToken(text) {
    this.#get('token-why').textContent = text;
    this.#get('token-form').hidden = false;
    this.#get('token').focus();
  }

  #get(id) {
    return this.#document.getElementById(id);
  }

  #element(tag, text) {
    const element = this.#document.createElement(tag);
    element.textContent = text;
    return element;
  }

  #listen() {
    this.#get('drawer').addEventListener('click', () => {
      if (this.#settings.get('drawer')) return this.#close();
      this.#settings.set('drawer', true);
      return this.#get('drawer-close').focus();
    });
    this.#get('drawer-close').addEventListener('click', () => this.#close());
    this.#document.addEventListener('keydown', (event) => {
      if (event.key === 'Escape' && this.#settings.get('drawer') && !this.#get('code').open) this.#close();
    });
    const on = (id, type, listener) => this.#get(id).addEventListener(type, listener);
    for (const name of CHOICES) on(name, 'change', (event) => this.#change(name, event.target.value));
    for (const name of FLAGS) on(name, 'change', (event) => this.#change(name, event.target.checked));
    on('quality', 'input', (event) => this.#change('quality', event.target.value));
    for (const name of Object.keys(NOTES)) {
      on(name, 'change', ({ target }) => this.#note(name, this.#settings.set(name, target.validity.badInput ? 'no number' : target.value)));
    }
    for (const id of BUTTONS) on(id, 'click', () => this.dispatchEvent(new Event(id)));
    on('token-form', 'submit', (event) => this.#submitToken(event));
    on('file', 'change', (event) => {
      const [file] = event.target.files;
      if (file) this.dispatchEvent(new CustomEvent('file', { detail: file }));
    });
    this.#document.addEventListener('fullscreenchange', () => {
      this.#get('fullscreen').textContent = this.#document.fullscreenElement ? 'Leave full screen' : 'Full screen';
    });
  }

  /** The focus goes back to what opened the drawer. */
  #close() {
    this.#settings.set('drawer', false);
    this.#get('drawer').focus();
  }

  #change(name, value) {
    if (!this.#settings.set(name, value)) this.#show(name); // the control goes back to what is in force
  }

  /** What cannot be used stays there to be corrected; the note below it says what fits. */
  #note(name, right) {
    this.#get(name).setAttribute('aria-invalid', String(!right));
    const note = this.#get(`${name}-note`);
    note.textContent = NOTES[name][right ? 'right' : 'wrong'];
    note.classList.toggle('bad', !right);
  }

  #submitToken(event) {
    event.preventDefault();
    const input = this.#get('token');
    const detail = input.value.trim();
    input.value = '';
    if (!detail) return;
    this.#get('token-form').hidden = true;
    this.#get('canvas').focus();
    this.dispatchEvent(new CustomEvent('token', { detail }));
  }

  /** Bring a control to what the setting says. */
  #show(name) {
    const value = this.#settings.get(name);
    if (name === 'drawer') {
      this.#get('panel').hidden = !value;
      this.#get('drawer').setAttribute('aria-expanded', String(value));
      return;
    }
    if (CHOICES.includes(name)) this.#showChoice(this.#get(name), this.#settings.options(name), value);
    else if (FLAGS.includes(name)) this.#get(name).checked = value;
    else this.#get(name).value = value ?? '';
    if (name === 'quality') this.#get('quality-value').textContent = value;
    if (name in NOTES) this.#note(name, true);
    if (name === 'room') this.#get('room-row').hidden = this.#settings.options('room').length < 2;
    if (name === 'driver') this.#get('file-row').hidden = value !== 'file';
    if (name === 'figures') this.#get('figures-box').hidden = !value;
  }

  #showChoice(select, options, value) {
    const shown = [...select.options].map((option) => [option.value, option.textContent].join('\n'));
    const wanted = options.map((option) => [option.value, option.label].join('\n'));
    if (wanted.join('\n\n') !== shown.join('\n\n')) {
      const elements = options.map((option) => {
        const element = this.#element('option', option.label);
        element.value = option.value;
        return element;
      });
      select.replaceChildren(...elements);
    }
    select.value = String(value);
    select.disabled = options.length === 0;
  }

  /** One button for what this device can do, else one for another device; the note says why. */
  #showHeadset() {
    const can = (kind) => this.#xr[kind] === true;
    for (const kind of ['vr', 'ar']) {
      const reason = this.#inside ? 'the headset is on' : this.#xr[kind];
      this.#get(`enter-${kind}`).disabled = reason !== true;
      this.#get(`${kind}-note`).textContent = reason === true ? '' : reason;
    }
    const looking = this.#xr.vr.endsWith?.('…');
    this.#get('enter-vr').hidden = !can('vr') && (can('ar') || !looking);
    this.#get('enter-ar').hidden = !can('ar');
    this.#get('try-vr').hidden = can('vr') || this.#inside;
    this.#get('elsewhere').hidden = can('vr') || can('ar') || Boolean(looking);
    this.#get('ar-note').hidden = true;
    this.#get('vr-note').hidden = can('ar') && !can('vr');
    this.#get('calibrate').disabled = !this.#inside;
    this.#get('calibrate-note').textContent = this.#inside
      ? 'Stand straight for two seconds and look ahead; stretch your arms sideways to measure them too.'
      : 'Enter VR to calibrate: stand straight there for two seconds.';
  }
}
