// The current questionnaire: its item, the answers, and those not yet on the server's disk.

import { pause } from './link.js';

const KEY = 'glsplat.extras.study.unsaved'; // answers that are not on the server's disk, in this tab's storage

/** Event: 'change'. Answers are sent one after the other; each is kept until the server has saved or refused it. */
export class Questions extends EventTarget {
  step = '';
  items = [];
  index = 0;
  answers = {};
  trouble = ''; // why the newest answers are not saved
  refused = 0; // answers that the server refused
  #saved = {}; // answers on the server's disk
  #send;
  #queue = JSON.parse(sessionStorage.getItem(KEY) ?? '[]'); // [{step, item, value, seconds}]
  #running = false;
  #asked = 0; // when the item was shown first, ms

  /** `send(message)` resolves once the answer is on disk; it throws a Refusal. */
  constructor(send) {
    super();
    this.#send = send;
    if (this.#queue.length) this.#run();
  }

  get item() {
    return this.items[this.index] ?? null;
  }

  get answered() {
    return this.item !== null && this.answers[this.item.name] !== undefined;
  }

  /** Return whether the item has its answer. */
  get free() {
    return this.answered || this.item?.required === false;
  }

  get last() {
    return this.index === this.items.length - 1;
  }

  get saving() {
    return this.#queue.length > 0;
  }

  /** Take the server's state; another step begins at the first item without an answer. */
  told(state) {
    if (state.kind !== 'questionnaire') {
      this.step = '';
      this.items = [];
      return;
    }
    this.#saved = state.answers;
    const again = state.step === this.step && state.attempt === this.attempt;
    if (!again) {
      const unsaved = this.#queue.filter(({ step }) => step === state.step).map(({ item, value }) => [item, value]);
      Object.assign(this, { step: state.step, attempt: state.attempt, items: state.items, trouble: '' });
      this.answers = { ...state.answers, ...Object.fromEntries(unsaved) };
      const open = this.items.findIndex(({ name }) => this.answers[name] === undefined);
      this.#go(open < 0 ? this.items.length - 1 : open);
    }
  }

  /** Answer the current item. */
  choose(value) {
    if (!this.item || this.answers[this.item.name] === value) return;
    this.answers = { ...this.answers, [this.item.name]: value };
    const seconds = Math.round(performance.now() - this.#asked) / 1000;
    this.#queue = this.#queue.filter(({ step, item }) => step !== this.step || item !== this.item.name);
    this.#queue.push({ step: this.step, item: this.item.name, value, seconds });
    this.#keep();
    this.#run();
    this.#tell();
  }

  back() {
    if (this.index > 0) this.#go(this.index - 1);
  }

  /** Go to the next item; after the last one, submit the questionnaire once all answers are saved. */
  next() {
    if (!this.free) return;
    if (!this.last) {
      this.#go(this.index + 1);
      return;
    }
    const open = this.items.findIndex(({ name, required }) => required && this.answers[name] === undefined);
    if (open >= 0) {
      this.#go(open);
      return;
    }
    if (this.#queue.some(({ step, submit }) => submit && step === this.step)) return;
    this.#queue.push({ step: this.step, submit: true });
    this.#keep();
    this.#run();
    this.#tell();
  }

  /** Replace a refused answer by the server's, unless a newer one was given. */
  #restore({ step, item, value }) {
    if (step !== this.step || this.answers[item] !== value) return;
    const { [item]: _, ...others } = this.answers;
    this.answers = item in this.#saved ? { ...others, [item]: this.#saved[item] } : others;
    this.refused++;
  }

  #go(index) {
    if (!this.saving) this.trouble = '';
    this.index = index;
    this.#asked = performance.now();
    this.#tell();
  }

  async #run() {
    if (this.#running) return;
    this.#running = true;
    let failures = 0;
    while (this.#queue.length) {
      const [first] = this.#queue;
      const { submit, ...answer } = first;
      try {
        await this.#send(submit ? { do: 'submit', step: first.step } : { do: 'answer', ...answer });
        failures = 0;
        this.trouble = '';
        this.#queue = this.#queue.filter((one) => one !== first);
      } catch (refusal) {
        if (refusal.passes || refusal.code === 'paused' || refusal.code === 'enter' || refusal.code === 'elsewhere') {
          this.trouble = refusal.message;
          this.#tell();
          await pause(failures++, refusal);
          continue;
        }
        this.trouble = refusal.message; // refused for good; the state has the current item
        this.#queue = this.#queue.filter((one) => one !== first);
        if (!submit) this.#restore(first);
      }
      this.#keep();
      this.#tell();
    }
    this.#running = false;
  }

  #keep() {
    sessionStorage.setItem(KEY, JSON.stringify(this.#queue));
  }

  #tell() {
    this.dispatchEvent(new Event('change'));
  }
}
