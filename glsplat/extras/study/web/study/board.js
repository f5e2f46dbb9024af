// The study's panel in VR: an instruction, a countdown, or one item of a questionnaire, pressed by a ray or a pinch.

import { Board } from '../show/panel.js';
import { multiply, place, translation } from '../space/matrix.js';

const SIZE = { width: 1024, height: 640, edge: 40 };
const METRES = 0.64; // wide
const SIDE = [0.15, 0, 0]; // metres from where a menu hangs beside the mirror: clear of its glass
const FRONT = [-0.55, 0.05, 0.69]; // the same, to a quarter of a metre before the glass ...
const FACE = 0.61; // ... and the angle about its upright axis by which it then faces the user
const MENU = 0.32; // metres: menus that are wider hang beside a mirror
const INK = { ground: 'rgba(16,20,28,0.94)', text: '#e8edf5', dim: '#9fb0c8', cell: '#2b3340', hover: '#4a6ea8', chosen: '#8ab8ff' };
const BUTTON = { width: 250, height: 80 };

/** Replaces Panel in `Immersive` (rows, hovered, hang, hit, label). `show(content)` sets what it shows. */
export class StudyBoard {
  rows = []; // unused: the content has the cells
  hovered = -1;
  #board = new Board(SIZE.width, SIZE.height);
  #content = { cells: [] };
  #pinned = null;
  #kind = null;

  get transform() {
    return this.#board.transform;
  }

  /**
   * {kind, aside, heading, text, big, cells: [{id, x, y, width, height, label, chosen}], ends}; one of the same `kind`
   * stays in its place, `aside` is beside the mirror.
   */
  show(content) {
    const kind = `${content.kind} ${Boolean(content.aside)}`;
    this.#content = content;
    if (kind !== this.#kind) this.#pinned = null;
    this.#kind = kind;
  }

  /** Place the board anew for another kind of content only: a board that moves with the wrist cannot be pressed. */
  hang(transform, width) {
    const [c, s] = [Math.cos(FACE), Math.sin(FACE)];
    const front = multiply(translation(FRONT), [c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, 0, 0, 0, 1]);
    const away = width < MENU ? translation([0, 0, 0]) : this.#content.aside ? translation(SIDE) : front;
    this.#pinned ??= multiply(transform, away);
    this.#board.transform = this.#pinned;
  }

  /** Return the cell that a ray (origin, unit direction) hits: {index, row: {id}, distance, point}, or null. */
  hit(origin, direction) {
    const met = this.#board.hit(origin, direction, METRES);
    if (!met) return null;
    const { x, y } = met;
    const index = this.#content.cells.findIndex((c) => x >= c.x && x <= c.x + c.width && y >= c.y && y <= c.y + c.height);
    return { ...met, index, row: index < 0 ? {} : this.#content.cells[index] };
  }

  /** Room coordinates of a cell's middle once it hangs in its place, for tests. */
  where(id) {
    const cell = this.#content.cells.find((one) => one.id === id);
    if (!cell || !this.#pinned) return null;
    const scale = METRES / SIZE.width;
    const x = (cell.x + cell.width / 2 - SIZE.width / 2) * scale;
    const y = (SIZE.height / 2 - cell.y - cell.height / 2) * scale;
    return place(multiply(this.transform, translation([x, y, 0])));
  }

  label(painter) {
    const key = JSON.stringify([this.#content, this.hovered]);
    return this.#board.label(painter, key, (ink) => this.#paint(ink), METRES);
  }

  #paint(ink) {
    const { heading = '', text = '', big = '', cells, ends = [] } = this.#content;
    ink.fillStyle = INK.ground;
    ink.fillRect(0, 0, SIZE.width, SIZE.height);
    ink.textBaseline = 'middle';
    ink.textAlign = 'left';
    ink.fillStyle = INK.dim;
    ink.font = '32px system-ui, sans-serif';
    ink.fillText(heading, SIZE.edge, 44, SIZE.width - 2 * SIZE.edge);
    ink.fillStyle = INK.text;
    const { size, lines } = fitted(ink, text, SIZE.width - 2 * SIZE.edge, big ? 130 : 250);
    ink.font = `${size}px system-ui, sans-serif`;
    lines.forEach((line, i) => ink.fillText(line, SIZE.edge, 100 + (i + 0.5) * size * 1.25));
    ink.textAlign = 'center';
    if (big) {
      ink.font = '150px system-ui, sans-serif';
      ink.fillText(big, SIZE.width / 2, 370);
    }
    cells.forEach((cell, i) => this.#cell(ink, cell, i));
    ink.font = '30px system-ui, sans-serif';
    ink.fillStyle = INK.dim;
    ends.forEach((label, i) => {
      ink.textAlign = i ? 'right' : 'left';
      ink.fillText(label, i ? SIZE.width - SIZE.edge : SIZE.edge, 500, SIZE.width / 2 - SIZE.edge);
    });
  }

  #cell(ink, { x, y, width, height, label, chosen }, index) {
    ink.fillStyle = index === this.hovered ? INK.hover : chosen ? INK.chosen : INK.cell;
    ink.fillRect(x, y, width, height);
    ink.fillStyle = chosen && index !== this.hovered ? '#000' : INK.text;
    ink.font = '32px system-ui, sans-serif';
    ink.textAlign = 'center';
    ink.fillText(label, x + width / 2, y + height / 2, width - 8);
  }
}

/** Return the largest text size that fits: {size, lines}. */
function fitted(ink, text, width, height) {
  for (let size = 54; ; size -= 2) {
    ink.font = `${size}px system-ui, sans-serif`;
    const lines = text.split('\n').flatMap((part) => wrapped(ink, part, width));
    if (lines.length * size * 1.25 <= height || size <= 14) return { size, lines };
  }
}

function wrapped(ink, text, width) {
  const lines = [];
  let line = '';
  for (const word of text.split(' ')) {
    const longer = line ? `${line} ${word}` : word;
    if (line && ink.measureText(longer).width > width) {
      lines.push(line);
      line = word;
    } else {
      line = longer;
    }
  }
  return [...lines, line];
}

/** A button at the panel's foot: `place` 0 left, 1 middle, 2 right. */
export function button(id, label, at) {
  const x = [SIZE.edge, (SIZE.width - BUTTON.width) / 2, SIZE.width - SIZE.edge - BUTTON.width][at];
  return { id, label, x, y: SIZE.height - BUTTON.height - 24, width: BUTTON.width, height: BUTTON.height };
}

/** Cells side by side, one a value: [{id, label, chosen}] with their places. */
export function row(cells) {
  const gap = cells.length > 12 ? 2 : 10;
  const width = (SIZE.width - 2 * SIZE.edge - gap * (cells.length - 1)) / cells.length;
  return cells.map((cell, i) => ({ ...cell, x: SIZE.edge + i * (width + gap), y: 380, width, height: 86 }));
}

/** Cells below each other, two columns from the fifth on. */
export function column(cells) {
  const columns = cells.length > 4 ? 2 : 1;
  const rows = Math.ceil(cells.length / columns);
  const width = (SIZE.width - 2 * SIZE.edge - 10 * (columns - 1)) / columns;
  const height = Math.min(70, 290 / rows - 8);
  return cells.map((cell, i) => ({
    ...cell, x: SIZE.edge + (i % columns) * (width + 10), y: 230 + Math.floor(i / columns) * (height + 8), width, height,
  }));
}
