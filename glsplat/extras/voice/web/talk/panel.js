// The controls of voice in a room: a button that says what talking means, joins and leaves; push to talk, and who is there.

import { Talk } from './talk.js';

const DIRECT = 'Your voice goes from this browser straight to those of the others who talk, encrypted. Their browsers learn your IP address, and yours learns theirs.';
const RELAYED = 'Your voice goes to the browsers of the others who talk, encrypted, through a relay. They do not learn your IP address.';
const KEPT = 'The sound does not pass this server, and nothing is recorded here. The others could record you.';
const NO_PATH = 'No path between your browsers: you do not hear each other. Another network may help, or a TURN server that this one names.';

/**
 * Insert the button before `first`, an element, and the other controls before `place`. `relay`: sound goes through TURN
 * servers only. Returns {talk, rows(), offered(room)}: rows for the menu of a headset; `offered` shows the controls for a
 * room, '' hides them.
 */
export function addTalk(first, place, { connection, voice, stage, relay }) {
  const document = place.ownerDocument;
  const talk = new Talk(connection, voice, stage);
  const element = (tag, fields, ...inside) => {
    const made = Object.assign(document.createElement(tag), fields);
    made.append(...inside);
    return made;
  };
  const button = (id, textContent = '') => element('button', { type: 'button', id, textContent });
  const [join, hold] = [button('talk-join', 'Talk'), button('talk-hold', 'Hold to talk (space bar)')];
  const push = element('input', { type: 'checkbox', id: 'talk-push' });
  const yes = element('button', { value: 'yes', className: 'first', id: 'talk-yes', textContent: 'Talk' });
  const no = element('button', { id: 'talk-no', textContent: 'Not now' });
  const words = [relay ? RELAYED : DIRECT, KEPT].map((textContent) => element('p', { textContent }));
  const form = element('form', { method: 'dialog', className: 'buttons' }, yes, no);
  const ask = element('dialog', { id: 'talk-ask' }, element('h2', { textContent: 'Talk with this room?' }), ...words, form);
  const people = element('ul', { id: 'talk-people' });
  const state = element('p', { className: 'note', id: 'talk-state' });
  state.setAttribute('role', 'status');
  const controls = element('div', {}, element('label', { className: 'tick' }, push, ' Push to talk'), ' ', hold);
  const box = element('section', { id: 'talk', hidden: true }, controls, people, state);
  box.setAttribute('aria-label', 'Talk with this room');
  join.setAttribute('aria-haspopup', 'dialog');
  first.before(join);
  place.before(box);
  document.body.append(ask); // the box may be hidden

  const show = () => {
    const on = talk.state !== 'off';
    join.setAttribute('aria-pressed', on);
    controls.hidden = !on;
    hold.hidden = !push.checked;
    people.replaceChildren(...[...talk.peers].map(([id, { name, path }]) => {
      const said = { looking: 'connecting…', open: talk.speaks(id) ? 'speaks' : '', none: NO_PATH }[path];
      return element('li', { textContent: said ? `${name}: ${said}` : name });
    }));
    const mine = voice.state === 'on' ? 'They hear you.' : `They do not hear you: ${voice.why || 'you are muted'}.`;
    state.textContent = on ? (talk.state === 'on' ? mine : 'Connecting…') : talk.why && `You do not talk: ${talk.why}.`;
  };
  const press = (down) => push.checked && talk.state !== 'off' && voice.mute(!down);
  const key = (event, down) => {
    if (event.code !== 'Space' || event.repeat || !push.checked || talk.state === 'off' || event.target.matches?.('input, select, textarea, button, summary')) return;
    event.preventDefault();
    press(down);
  };
  join.addEventListener('click', () => {
    if (talk.state !== 'off') return talk.stop();
    ask.returnValue = ''; // of the last time
    ask.showModal();
  });
  ask.addEventListener('close', () => ask.returnValue === 'yes' && talk.start().then(() => press(false)));
  push.addEventListener('change', () => {
    voice.mute(push.checked);
    show();
  });
  hold.addEventListener('pointerdown', () => press(true));
  for (const type of ['pointerup', 'pointercancel', 'pointerleave']) hold.addEventListener(type, () => press(false));
  document.addEventListener('keydown', (event) => key(event, true));
  document.addEventListener('keyup', (event) => key(event, false));
  document.defaultView.addEventListener('blur', () => press(false));
  for (const type of ['change', 'speaking']) talk.addEventListener(type, show);
  show();
  return {
    talk,
    rows: () => (talk.state === 'off' ? [] : [{ id: 'microphone', label: 'Microphone', value: voice.state === 'on' ? 'on' : 'off' }]),
    offered(room) {
      if (room !== box.dataset.room) talk.stop(); // what was agreed to was for that room
      box.dataset.room = room;
      join.hidden = box.hidden = !room;
    },
  };
}
