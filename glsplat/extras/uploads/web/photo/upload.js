// Uploads photographs and follows the making of an avatar (docs/protocol.md, section 9). Touches no element of the
// page.

const PAUSE = 500; // ms between two polls
const PATIENCE = 60; // unanswered polls in a row before it fails
const IDLE = { state: 'idle', name: '', share: 0, ahead: 0, steps: [], error: '', findings: [], goes_on: false, later: '' };

/**
 * Event `change`. `now.state` is idle, sending, waiting, making, done or failed; `share`: 0 to 1 of the current step.
 */
export class Upload extends EventTarget {
  now = IDLE;
  #connection;
  #request = null;
  #run = 0; // number of the last start, resume or cancel; answers to earlier ones are dropped

  constructor(connection) {
    super();
    this.#connection = connection;
  }

  get busy() {
    return ['sending', 'waiting', 'making'].includes(this.now.state);
  }

  /** Upload `pictures` ({front: Blob, back, left, right}) with the form's fields {height, anyway, title}. */
  async start(pictures, { height = null, anyway = false, title = '' } = {}) {
    const run = ++this.#run;
    const form = new FormData();
    form.append('consent', 'yes');
    if (height !== null) form.append('height', String(height));
    if (anyway) form.append('anyway', 'yes');
    if (title) form.append('name', title);
    for (const [view, picture] of Object.entries(pictures)) form.append(view, picture, view);
    this.#become({ ...IDLE, state: 'sending' });
    let answer;
    try {
      answer = await this.#send(form, run);
    } catch {
      answer = { status: 0, text: 'the server does not answer, or the connection is too slow' };
    }
    if (run !== this.#run) return;
    if (answer.status === 202) this.#follow(JSON.parse(answer.text), run);
    else this.#become({ state: 'failed', error: answer.text.trim() || `the server answers ${answer.status}` });
  }

  /**
   * Make a refused avatar anyway, from the step that refused it. Resolves to false if the server has forgotten it.
   * While the server is busy, `now.later` has its message, and the call may be repeated.
   */
  async goOn() {
    const run = ++this.#run;
    const failed = this.now;
    this.#become({ ...failed, state: 'waiting', goes_on: false, later: '' }); // no second request meanwhile
    const response = await this.#ask('POST', '/anyway').catch(() => null);
    const busy = response?.status === 503 ? (await response.text().catch(() => '')).trim() : '';
    const answer = response?.ok ? await response.json().catch(() => null) : null;
    if (run !== this.#run) return true;
    if (answer) this.#follow(answer, run);
    else this.#become({ ...failed, goes_on: busy !== '', later: busy });
    return answer !== null || busy !== '';
  }

  /** Follow an avatar that was begun before the page was reloaded. */
  resume(name) {
    this.#follow({ ...IDLE, state: 'waiting', name }, ++this.#run);
  }

  /** Cancel the making, or dismiss its result. */
  cancel() {
    this.#run++;
    this.#request?.abort();
    if ((this.busy || this.now.goes_on) && this.now.name) this.#ask('DELETE').catch(() => {}); // it ends by itself otherwise
    this.#become(IDLE);
  }

  #ask(method, more = '') {
    return this.#connection.fetch(`avatars/${this.now.name}${more}`, { method });
  }

  async #follow(told, run) {
    this.#become(told);
    let unanswered = 0;
    while (run === this.#run && this.busy) {
      await new Promise((done) => setTimeout(done, PAUSE));
      const response = run === this.#run ? await this.#ask('GET').catch(() => null) : null;
      const answer = response?.ok ? await response.json().catch(() => null) : null;
      if (run !== this.#run) return;
      if (answer) {
        unanswered = 0;
        this.#become(answer);
      } else if (response?.status === 404) {
        this.#become({ state: 'failed', error: 'the server no longer has it; send the picture again' });
      } else if (++unanswered >= PATIENCE) {
        this.#become({ state: 'failed', error: 'the server does not answer' });
      }
    }
  }

  /** POST by XMLHttpRequest, which reports progress. Resolves to {status, text}. */
  #send(form, run) {
    return new Promise((done, failed) => {
      const request = (this.#request = new XMLHttpRequest());
      request.open('POST', this.#connection.address('avatars'));
      for (const [name, value] of Object.entries(this.#connection.headers)) request.setRequestHeader(name, value);
      request.upload.onprogress = ({ loaded, total }) => {
        if (run === this.#run) this.#become({ share: loaded / Math.max(total, 1) });
      };
      request.onload = () => done({ status: request.status, text: request.responseText });
      request.onerror = request.onabort = failed;
      request.send(form);
    });
  }

  #become(change) {
    this.now = { ...this.now, ...change };
    this.dispatchEvent(new Event('change'));
  }
}

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
