// How another device gets to this page: one sentence, and where an address helps, its QR code.

const FILE = '<svg xmlns="http://www.w3.org/2000/svg" '; // what makes an element a picture of its own

/** Opens the dialog #code; `ask(room)` promises {page, local, svg} of the server (docs/protocol.md), or null. */
export class Elsewhere {
  #get;
  #ask;

  constructor(document, ask) {
    this.#get = (id) => document.getElementById(id);
    this.#ask = ask;
    this.#get('code-close').addEventListener('click', () => this.#get('code').close());
    this.#get('code-copy').addEventListener('click', () => navigator.clipboard?.writeText(this.#get('code-address').textContent));
  }

  /** Show how to open this page, or with a `room` how to invite others into it. */
  async open(room = '') {
    const found = reached(await this.#ask(room).catch(() => null), room);
    const { words, svg, address } = room && found ? invited(found) : said(found);
    this.#get('code-title').textContent = room ? `Invite to the room ${room}` : 'On a headset or a phone';
    this.#get('code-words').textContent = words;
    this.#get('code-address').textContent = address;
    const image = new Image();
    image.alt = 'The address as a QR code';
    if (svg) image.src = URL.createObjectURL(new Blob([svg.replace('<svg ', FILE)], { type: 'image/svg+xml' }));
    this.#get('code-picture').replaceChildren(...(svg ? [image] : []));
    this.#get('code').showModal();
  }
}

/** Behind a proxy the server takes itself for this computer's alone; who got here knows better. */
function reached(found, room) {
  const here = ['localhost', '127.0.0.1', '[::1]'].includes(location.hostname);
  const page = location.origin + location.pathname + (room && `?room=${encodeURIComponent(room)}`);
  return found?.local && !here ? { page, local: false, svg: '' } : found;
}

function invited({ page, local, svg }) {
  const words = local
    ? 'This address works only on this computer: for guests on other devices, serve with --host 0.0.0.0 --self-signed.'
    : 'Anyone who opens or scans this address meets you in the room.';
  return { words, svg, address: page };
}

function said(found) {
  const port = location.port || (location.protocol === 'https:' ? '443' : '80');
  if (!found) return { words: 'The server does not answer. Try again in a moment.', svg: '', address: location.origin };
  if (found.local) {
    return {
      words: `This server accepts connections only from this computer. To reach it from your network, start it with the command below. For a Quest on a cable, run adb reverse tcp:${port} tcp:${port} and open this page in its browser.`,
      svg: '',
      address: 'glsplat serve --host 0.0.0.0 --self-signed',
    };
  }
  const secure = found.page.startsWith('https:');
  const words = secure
    ? 'Scan this with the phone or the headset, accept the certificate once, then choose Enter VR there.'
    : 'Scan this with the phone. Headsets allow VR only on https: start the server with --self-signed for that.';
  return { words, svg: found.svg, address: found.page };
}
