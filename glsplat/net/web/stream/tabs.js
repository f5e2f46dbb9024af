// Tabs of this browser with the same person in a room: one of them may take the person over from another.

/**
 * Answers other tabs that ask for the person of this one. `mine()`: "room/name" or '', `left()`: this tab gives it up, and returns what the other one needs
 * to continue.
 */
export class Tabs {
  #channel = typeof BroadcastChannel === 'undefined' ? null : new BroadcastChannel('glsplat');
  #mine;
  #left;
  #answered = () => {};

  constructor(mine, left) {
    [this.#mine, this.#left] = [mine, left];
    if (this.#channel) this.#channel.onmessage = ({ data }) => this.#heard(data);
  }

  /** Promise whether another tab has a person. */
  has(who) {
    return this.#ask({ asks: who });
  }

  /** Make another tab give a person up; promises what its `left` returned, or null. */
  take(who) {
    return this.#ask({ takes: who });
  }

  #ask(message) {
    return new Promise((done) => {
      this.#answered = done;
      setTimeout(() => done(null), 500); // ms: tabs answer within a few, hidden ones too
      this.#channel?.postMessage(message);
    });
  }

  #heard({ asks, takes, is, kept }) {
    if (is) this.#answered(kept);
    const mine = this.#mine();
    if (!mine || mine !== (asks ?? takes)) return;
    this.#channel.postMessage({ is: mine, kept: takes ? this.#left() : {} });
  }
}
