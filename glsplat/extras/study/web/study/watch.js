// The experimenter's page: the participant's step and picture, and the commands of an experimenter.

import { Link, brought, pause } from './link.js';

const PICTURE = 1000; // ms between two pictures
const WORDS = { done: 'finished', declined: 'no consent was given', aborted: 'aborted' };

const link = new Link(brought('glsplat.extras.study.watch'));
const get = (id) => document.getElementById(id);
let state = null;
let shown = ''; // blob URL of the picture

function say(words, level = 'info') {
  const line = get('status');
  line.dataset.level = level;
  if (line.textContent !== words) line.textContent = words;
}

function show(found) {
  state = found;
  get('title').textContent = `${found.study}: ${found.participant}`;
  const trouble = found.trouble || (found.lost_lines ? `${found.lost_lines} lines of tracking were lost` : '');
  const words = found.ended ? `The session has ended: ${WORDS[found.ended]}.`
    : found.paused ? 'Paused.' : found.present ? 'Running.' : 'The participant’s page is not connected.';
  say(trouble ? `${words} ${trouble}` : words, trouble || (!found.present && !found.ended) ? 'error' : 'info');
  const { figures } = found;
  const number = (value, unit) => (value === undefined ? '–' : `${value.toFixed(1)} ${unit}`);
  facts({
    Step: found.ended ? '–' : `${found.number} of ${found.steps.length}: ${found.step}`,
    Phase: found.left === null ? found.phase : `${found.phase}, ${Math.ceil(found.left)} s left`,
    Attempt: `${found.attempt}`,
    Condition: found.condition ?? '–',
    Answered: found.items ? `${found.answered} of ${found.items}` : '–',
    Time: `${Math.floor(found.t / 60)} min ${Math.floor(found.t % 60)} s`,
    Seen: figures.session === 'vr' ? 'in VR' : 'on the page',
    Pictures: number(figures.fps, '/s'),
    'Their age': number(figures.age_ms, 'ms'),
  });
  get('pause').textContent = found.paused ? 'Continue' : 'Pause';
  for (const id of ['pause', 'repeat']) get(id).disabled = Boolean(found.ended);
  list('notes', found.notes.map(({ t, text }) => `${Math.floor(t)} s: ${text}`));
  list('steps', found.steps);
  [...get('steps').children].forEach((line, i) => {
    if (i === found.number - 1 && !found.ended) line.setAttribute('aria-current', 'step');
    else line.removeAttribute('aria-current');
  });
}

function facts(figures) {
  get('numbers').replaceChildren(...Object.entries(figures).flatMap(([label, value]) => [element('dt', label), element('dd', value)]));
}

function list(id, lines) {
  const now = [...get(id).children].map((line) => line.textContent);
  if (now.join('\n') !== lines.join('\n')) get(id).replaceChildren(...lines.map((line) => element('li', line)));
}

function element(tag, text) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

async function command(message) {
  try {
    show(await link.ask('study/command', message));
    return true;
  } catch (refusal) {
    say(refusal.message, 'error');
    return false;
  }
}

get('pause').addEventListener('click', () => command({ do: state?.paused ? 'continue' : 'pause' }));
get('repeat').addEventListener('click', () => command({ do: 'repeat' }));
get('note-form').addEventListener('submit', async (event) => {
  event.preventDefault();
  const note = get('note');
  if (await command({ do: 'note', text: note.value })) note.value = ''; // a note that is not on disk stays in the field
});
get('abort-form').addEventListener('submit', (event) => {
  event.preventDefault();
  command({ do: 'abort', text: get('reason').value });
});

async function follow() {
  for (let failures = 0; ; ) {
    try {
      show(await link.ask('study/watch', { after: state?.revision ?? -1 }));
      failures = 0;
    } catch (refusal) {
      say(refusal.status === 403 ? 'Open the experimenter’s link that the study printed.' : refusal.message, 'error');
      if (refusal.status === 401 || refusal.status === 403) return;
      state = null;
      await pause(failures++, refusal);
    }
  }
}

async function picture() {
  for (;;) {
    await new Promise((done) => setTimeout(done, PICTURE));
    if (document.hidden || !state?.shown) {
      get('picture').hidden = true;
      get('no-picture').hidden = false;
      continue;
    }
    const blob = await link.picture('study/picture').catch(() => null);
    if (!blob) continue;
    const before = shown;
    shown = URL.createObjectURL(blob);
    get('picture').src = shown;
    get('picture').hidden = false;
    get('no-picture').hidden = true;
    if (before) URL.revokeObjectURL(before);
  }
}

window.glsplat = Object.freeze({ study: () => state });
follow();
picture();
