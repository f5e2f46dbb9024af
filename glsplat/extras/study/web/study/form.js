// The study on the flat page: the same steps as in VR, with labels and by keyboard.

import { ending, seconds } from './content.js';

/** Fills `#step`; the participant's actions go to `deeds` {consent(accepted), ready()} and the questions. */
export class Form {
  #document;
  #questions;
  #deeds;
  #shown = '';
  #state = null;
  #complaint = '';

  constructor(document, questions, deeds) {
    this.#document = document;
    this.#questions = questions;
    this.#deeds = deeds;
    questions.addEventListener('change', () => this.show(this.#state, this.#complaint));
  }

  show(state, complaint) {
    this.#state = state;
    this.#complaint = complaint;
    if (!state) return;
    this.#set('title', state.title);
    this.#set('progress', state.ended ? '' : `Step ${state.number} of ${state.of}`);
    const key = JSON.stringify([
      state.step, state.phase, state.attempt, state.paused, state.ended,
      state.kind === 'questionnaire' ? [this.#questions.step, this.#questions.index, this.#questions.refused] : 0,
    ]);
    if (key !== this.#shown) {
      const had = this.#shown !== '' && this.#get('step').contains(this.#document.activeElement);
      this.#shown = key;
      this.#get('step').replaceChildren(...this.#built(state));
      const first = this.#get('step').querySelector('input:checked, input, textarea, button:enabled');
      if (had) first?.focus();
    }
    this.#update(state);
  }

  /** Show the seconds that are left. */
  tick(left) {
    const clock = this.#document.getElementById('left');
    if (clock && clock.textContent !== seconds(left)) clock.textContent = seconds(left);
  }

  #built(state) {
    if (state.ended) return [this.#text(ending(state.ended))];
    if (state.paused) return [this.#text('Please wait. The experimenter has paused the session.')];
    if (state.kind === 'consent') {
      const text = this.#text(state.text, 'text consent');
      text.tabIndex = 0; // lets the keyboard scroll it
      return [text, this.#buttons([['agree', 'I agree', () => this.#deeds.consent(true)],
        ['decline', 'I do not agree', () => this.#deeds.consent(false)]])];
    }
    if (state.kind === 'rest') return [this.#text('Please rest for a moment.'), this.#clock()];
    if (state.kind === 'task') {
      const ready = state.phase === 'instruction' && state.ready;
      return [this.#text(state.text), ...(state.phase === 'countdown' ? [this.#clock()] : []),
        ...(ready ? [this.#buttons([['ready', 'I am ready', () => this.#deeds.ready()]])] : [])];
    }
    return this.#asked();
  }

  #asked() {
    const { item, index, items, answers } = this.#questions;
    if (!item) return [this.#text('Please wait…')];
    const set = this.#element('fieldset');
    set.append(this.#element('legend', item.text), this.#control(item, answers[item.name]));
    const ends = item.labels.length === 2 && item.kind !== 'choice' ? item.labels : [];
    const row = this.#element('div', '', 'ends');
    row.append(...ends.map((label) => this.#element('span', label)));
    if (ends.length) set.append(row);
    const said = this.#element('p', `${index + 1} of ${items.length}`, 'note');
    return [said, set, this.#buttons([
      ...(index > 0 ? [['back', 'Back', () => this.#questions.back()]] : []),
      ['next', this.#questions.last ? 'Finish' : 'Next', () => this.#questions.next()],
    ]), this.#element('p', '', 'note', 'saved')];
  }

  #control(item, answer) {
    if (item.kind === 'text') {
      const area = this.#element('textarea');
      area.rows = 4;
      area.maxLength = 4000;
      area.setAttribute('aria-label', item.text);
      area.value = answer ?? '';
      area.addEventListener('change', () => this.#questions.choose(area.value));
      return area;
    }
    if (item.kind === 'slider') return this.#slider(item, answer);
    const worded = item.labels.length > 2;
    const group = this.#element('div', '', item.kind === 'choice' || worded ? 'choices' : 'points');
    const count = item.kind === 'choice' ? 0 : Math.round((item.to - item.from) / item.step) + 1;
    const options = item.kind === 'choice' ? item.labels : Array.from({ length: count }, (_, i) => item.from + i * item.step);
    group.append(...options.map((value, i) => {
      const label = this.#element('label');
      const input = this.#element('input');
      Object.assign(input, { type: 'radio', name: 'answer', value: String(value), checked: value === answer });
      input.addEventListener('change', () => this.#questions.choose(value));
      const word = item.kind === 'points' && worded ? item.labels[i] : String(value);
      label.append(input, this.#element('span', word));
      return label;
    }));
    return group;
  }

  #slider(item, answer) {
    const box = this.#element('div');
    const input = this.#element('input');
    const value = answer ?? (item.from + item.to) / 2;
    Object.assign(input, { type: 'range', min: item.from, max: item.to, step: item.step, id: 'answer' });
    input.value = value;
    input.classList.toggle('unanswered', answer === undefined);
    input.setAttribute('aria-label', item.text);
    const out = this.#element('output', answer === undefined ? 'not answered yet' : String(answer));
    const choose = () => {
      out.textContent = input.value;
      input.classList.remove('unanswered');
      this.#questions.choose(Number(input.value));
    };
    input.addEventListener('change', choose);
    input.addEventListener('click', choose); // a click on the middle, which changes nothing, is an answer, too
    input.addEventListener('keyup', (event) => (event.key === 'Enter' || event.key === ' ') && choose());
    box.append(input, out);
    return box;
  }

  #update(state) {
    const next = this.#document.getElementById('next');
    if (next) next.disabled = !this.#questions.free;
    const saved = this.#document.getElementById('saved');
    const { saving, trouble } = this.#questions;
    const why = saving ? `Not saved yet: ${trouble}. Trying again.` : `Not saved: ${trouble}.`;
    if (saved) saved.textContent = trouble ? why : saving ? 'Saving…' : '';
    const words = this.#complaint || (state.trouble ? 'The server cannot write to its disk right now.' : '');
    this.#get('status').dataset.level = words ? 'error' : 'info';
    this.#set('status', words || 'Connected');
  }

  #buttons(list) {
    const row = this.#element('div', '', 'buttons');
    row.append(...list.map(([id, label, press]) => {
      const button = this.#element('button', label, '', id);
      button.type = 'button';
      button.addEventListener('click', press);
      return button;
    }));
    return row;
  }

  #text(words, kind = 'text') {
    return this.#element('p', words, kind);
  }

  #clock() {
    const clock = this.#element('p', '', 'big', 'left');
    clock.setAttribute('role', 'timer');
    return clock;
  }

  #get(id) {
    return this.#document.getElementById(id);
  }

  #set(id, text) {
    if (this.#get(id).textContent !== text) this.#get(id).textContent = text;
  }

  #element(tag, text = '', kind = '', id = '') {
    const element = this.#document.createElement(tag);
    if (text) element.textContent = text;
    if (kind) element.className = kind;
    if (id) element.id = id;
    return element;
  }
}
