// The voice's controls on the flat page: a button to start and stop, a button to mute, and the state in words.

import { Voice } from './voice.js';

const SAID = 'Your voice moves the avatar’s mouth: only the shape of the mouth is sent. The sound stays in this browser, unless you talk with a room.';
const STATES = { off: '', asking: 'Waiting for permission to use the microphone…', on: 'Listening.', muted: 'Muted.', refused: '' };

/**
 * Insert the controls after `place`, an element; request smaller pictures of `stage` while the user speaks. Return the
 * voice.
 */
export function addVoice(place, stage) {
  const voice = new Voice();
  const hurry = new Hurry();
  stage.sideFor = (side, ...rest) => hurry.side(side, Object.keys(voice.weights() ?? {}).length > 0, ...rest);
  const document = place.ownerDocument;
  const element = (tag, fields) => Object.assign(document.createElement(tag), fields);
  const box = element('section', { id: 'voice' });
  box.setAttribute('aria-label', 'Your voice');
  const talk = element('button', { type: 'button', id: 'voice-talk' });
  const mute = element('button', { type: 'button', id: 'voice-mute' });
  const note = element('p', { className: 'note', id: 'voice-note', textContent: SAID });
  const state = element('p', { className: 'note', id: 'voice-state' });
  state.setAttribute('role', 'status');
  talk.setAttribute('aria-describedby', note.id);
  box.append(talk, ' ', mute, note, state);
  place.after(box);
  const show = () => {
    const open = voice.state === 'on' || voice.state === 'muted';
    talk.textContent = open ? 'Stop listening' : 'Speak with my microphone';
    talk.disabled = voice.state === 'asking';
    mute.hidden = !open;
    mute.textContent = voice.state === 'muted' ? 'Unmute' : 'Mute';
    mute.setAttribute('aria-pressed', String(voice.state === 'muted'));
    state.textContent = voice.why ? `Not listening: ${voice.why}.` : STATES[voice.state];
  };
  talk.addEventListener('click', () => (voice.state === 'on' || voice.state === 'muted' ? voice.stop() : voice.start()));
  mute.addEventListener('click', () => voice.mute(voice.state === 'on'));
  voice.addEventListener('change', show);
  show();
  return voice;
}

const SOON = 1000 / 30; // ms a picture; above it, request no more pixels than the display shows
const ENOUGH = 1000 / 15; // ms a picture; above it, request fewer
const STEP = 0.75; // factor of a picture's side, for each step down
const LEAST = 256; // pixels of a side
const PATIENCE = 400; // ms between two steps down
const CALM = 5000; // ms of silence before pictures get their full size again

/** Requests smaller pictures while the user speaks to a slow server: a late mouth is worse than a less sharp one. */
export class Hurry {
  #share = 1;
  #slow = false; // pictures took longer than SOON while the user spoke
  #spoke = -Infinity;
  #changed = -Infinity;

  /**
   * Return the side to request instead of `side`, pixels. `speaks`: the mouth moves; `times`: {render, encode} of the
   * last picture, ms; `seen`: the side with as many pixels as the display has for it.
   */
  side(side, speaks, { render = 0, encode = 0 } = {}, now, seen = Infinity) {
    if (speaks) this.#spoke = now;
    if (now - this.#spoke > CALM) [this.#share, this.#slow] = [1, false];
    else this.#slow ||= render + encode > SOON;
    const whole = this.#slow ? Math.min(side, Math.max(seen, LEAST)) : side; // `seen` grows as the viewer comes nearer
    if (this.#slow && render + encode > ENOUGH && now - this.#changed > Math.max(PATIENCE, 2 * (render + encode)) && whole * this.#share * STEP >= LEAST) {
      this.#share *= STEP;
      this.#changed = now;
    }
    return Math.round(whole * this.#share);
  }
}
