// What the panel in the room says and does.

const WORDS = { view: 'View', avatar: 'Avatar', room: 'Room', size: 'Size', quality: 'Quality', drawn: 'Drawn by' };
const QUALITIES = [50, 65, 80, 90]; // what the panel offers of a number

/** {rows(immersive, now), press(id)} over the settings and `deeds` {calibrate(), record(), leave(), more(): rows of extras, by id,
 * worn() -> title and wears() -> name of the user's avatar, met() -> sentence on the room's people, or ''}. */
export class Menu {
  #settings;
  #stage;
  #recorder;
  #deeds;
  #numbers = { rows: [], until: 0 };

  constructor(settings, stage, recorder, deeds) {
    this.#settings = settings;
    this.#stage = stage;
    this.#recorder = recorder;
    this.#deeds = deeds;
  }

  rows(immersive, now) {
    const choices = Object.entries(WORDS)
      .filter(([name]) => this.#values(name).length > 1)
      .map(([name, label]) => ({ id: name, label, value: this.#chosen(name) }));
    const recording = this.#recorder.recording;
    return [
      ...choices,
      ...this.#deeds.more(),
      { id: 'calibrate', label: 'Calibrate (stand straight)' },
      { id: 'record', label: recording ? 'Stop recording' : 'Record', value: recording ? clock(this.#recorder.seconds) : '' },
      { id: 'figures', label: 'Figures', value: this.#settings.get('figures') ? 'on' : 'off' },
      { id: 'leave', label: 'Leave' },
      { label: this.#said(immersive) },
      ...(this.#deeds.met() ? [{ label: this.#deeds.met() }] : []),
      ...(this.#settings.get('figures') ? this.#figures(now) : []),
    ];
  }

  press(id) {
    if (id in WORDS) {
      const values = this.#values(id);
      const now = id === 'avatar' ? this.#deeds.wears() : this.#settings.get(id);
      this.#settings.set(id, values[(values.indexOf(now) + 1) % values.length]);
    } else if (id === 'figures') {
      this.#settings.set('figures', !this.#settings.get('figures'));
    } else {
      this.#deeds[id]();
    }
  }

  #values(name) {
    return this.#settings.options(name)?.map(({ value }) => value) ?? QUALITIES;
  }

  #chosen(name) {
    if (name === 'avatar') return this.#deeds.worn();
    const value = this.#settings.get(name);
    return this.#settings.options(name)?.find((option) => option.value === value)?.label ?? String(value);
  }

  #said({ untracked }) {
    if (this.#stage.notice) return this.#stage.notice;
    if (untracked.length === 2) return 'No hands tracked';
    if (untracked.length) return `The ${untracked[0]} hand is not tracked`;
    if (this.#stage.connection.state !== 'open') return 'Connecting…';
    return this.#stage.link || 'Connected';
  }

  #figures(now) {
    if (now > this.#numbers.until) {
      const shown = Object.entries(numbers(this.#stage.stats(performance.now())));
      this.#numbers = { rows: shown.map(([label, value]) => ({ label, value })), until: now + 500 };
    }
    return this.#numbers.rows;
  }
}

/** The figures as words for people: {label: text}. */
export function numbers(stats) {
  const ms = (value) => (value === null || value === undefined ? '–' : `${value.toFixed(1)} ms`);
  return {
    'Pictures a second': stats.fps.toFixed(1),
    'Display frames a second': stats.frameRate.toFixed(1),
    'Age of a picture, median': ms(stats.ageMs),
    'Age of a picture, 95 %': ms(stats.ageP95Ms),
    'Round trip': ms(stats.rttMs),
    'Server: drawing': ms(stats.server.render),
    'Server: encoding': ms(stats.server.encode),
    'Server: solving': ms(stats.server.ik),
    Decoding: ms(stats.decodeMs),
    'Dropped: here / server': `${stats.dropped} / ${stats.droppedByServer}`,
    'Drawn by': stats.drawn.by === 'here' ? `this device, ${stats.drawn.splats} splats` : 'the server',
    Because: stats.drawn.reason,
  };
}

function clock(seconds) {
  return `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, '0')}`;
}
