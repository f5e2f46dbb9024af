// A panel in the room: rows of text on a canvas, pressed by a ray from a hand or a controller. And a line of notice.

import { axis, dot, multiply, place, subtract, translation } from '../space/matrix.js';

const PIXELS = { width: 512, row: 44, rows: 24, text: 24, edge: 16 };
const INK = { ground: 'rgba(16,20,28,0.92)', text: '#e8edf5', dim: '#9fb0c8', hover: 'rgba(70,110,190,0.75)' };

/** A label for `Painter.view` whose texture follows a canvas. */
export class Board {
  transform = null; // room from label; null: not shown
  #painter = null;
  #texture = null;
  #drawn = '';

  constructor(width, height) {
    this.canvas = document.createElement('canvas');
    this.canvas.width = width;
    this.canvas.height = height;
    this.ink = this.canvas.getContext('2d');
  }

  /** Where a ray (origin, unit direction) meets a board so many metres wide: {x, y (pixels), distance, point}, or null. */
  hit(origin, direction, metres) {
    const m = this.transform;
    if (!m) return null;
    const normal = axis(m, 2);
    const slope = dot(direction, normal);
    if (slope > -1e-3) return null; // from behind, or along it
    const distance = dot(subtract(place(m), origin), normal) / slope;
    const point = origin.map((v, i) => v + distance * direction[i]);
    const { width, height } = this.canvas;
    const x = (dot(subtract(point, place(m)), axis(m, 0)) * width) / metres + width / 2;
    const y = height / 2 - (dot(subtract(point, place(m)), axis(m, 1)) * width) / metres;
    return distance < 0 || x < 0 || x > width || y < 0 || y > height ? null : { x, y, distance, point };
  }

  /** Draw anew by `paint(ink, canvas)` if `key` says that something else is to be seen; {texture, transform, ...}. */
  label(painter, key, paint, width) {
    const { canvas } = this;
    if (painter !== this.#painter) [this.#painter, this.#texture, this.#drawn] = [painter, painter.texture(), null];
    if (key !== this.#drawn) {
      this.ink.clearRect(0, 0, canvas.width, canvas.height);
      paint(this.ink, canvas);
      painter.fill(this.#texture, canvas, true);
      this.#drawn = key;
    }
    const height = (width * canvas.height) / canvas.width;
    return { texture: this.#texture, transform: this.transform, width, height };
  }
}

/** Rows [{id, label, value}] with an id can be pressed; others are text. */
export class Panel {
  rows = [];
  hovered = -1;
  width = 0.34; // metres
  #board = new Board(PIXELS.width, PIXELS.row * PIXELS.rows + 2 * PIXELS.edge);

  get transform() {
    return this.#board.transform;
  }

  /** Hang it up: room from panel, the middle of its rows at the origin. */
  hang(transform, width) {
    this.width = width;
    const { height } = this.#board.canvas; // rows begin at its upper edge
    const below = ((height - this.#tall) / 2) * (width / this.#board.canvas.width);
    this.#board.transform = multiply(transform, translation([0, -below, 0]));
  }

  get #tall() {
    return Math.min(this.#board.canvas.height, this.rows.length * PIXELS.row + 2 * PIXELS.edge);
  }

  /** The row that a ray (origin, unit direction) meets, with the distance: {index, row, distance, point}, or null. */
  hit(origin, direction) {
    const met = this.#board.hit(origin, direction, this.width);
    const index = met ? Math.floor((met.y - PIXELS.edge) / PIXELS.row) : -1;
    return this.rows[index] ? { ...met, index, row: this.rows[index] } : null;
  }

  label(painter) {
    const key = JSON.stringify([this.rows, this.hovered]);
    return this.#board.label(painter, key, (ink, canvas) => this.#paint(ink, canvas), this.width);
  }

  #paint(ink, canvas) {
    const { row, edge, text } = PIXELS;
    ink.fillStyle = INK.ground;
    ink.fillRect(0, 0, canvas.width, this.#tall);
    ink.font = `${text}px system-ui, sans-serif`;
    ink.textBaseline = 'middle';
    this.rows.forEach(({ id, label, value = '' }, i) => {
      const middle = edge + (i + 0.5) * row;
      if (id && i === this.hovered) {
        ink.fillStyle = INK.hover;
        ink.fillRect(edge / 2, middle - row / 2 + 2, canvas.width - edge, row - 4);
      }
      ink.textAlign = 'left';
      ink.fillStyle = id ? INK.text : INK.dim;
      ink.fillText(id ? `▸ ${label}` : label, edge, middle, canvas.width - 2 * edge);
      ink.textAlign = 'right';
      ink.fillStyle = INK.dim;
      ink.fillText(value, canvas.width - edge, middle, canvas.width / 2);
    });
  }
}

/** One or two lines before the user's eyes. */
export class Notice {
  text = '';
  #board = new Board(1024, 128);

  set transform(transform) {
    this.#board.transform = transform;
  }

  label(painter) {
    return this.#board.label(painter, this.text, (ink, canvas) => this.#paint(ink, canvas), 0.7);
  }

  #paint(ink, { width, height }) {
    ink.fillStyle = INK.ground;
    ink.fillRect(0, 0, width, height);
    ink.fillStyle = INK.text;
    ink.textAlign = 'center';
    ink.textBaseline = 'middle';
    ink.font = '36px system-ui, sans-serif';
    const lines = broken(ink, this.text, width - 40);
    lines.forEach((line, i) => ink.fillText(line, width / 2, (height * (i + 1)) / (lines.length + 1), width - 40));
  }
}

/** Text in at most two lines that fit a width in pixels. */
function broken(ink, text, width) {
  if (ink.measureText(text).width <= width) return [text];
  const words = text.split(' ');
  let first = words.shift() ?? '';
  while (words.length && ink.measureText(`${first} ${words[0]}`).width <= width) first += ` ${words.shift()}`;
  return [first, words.join(' ')];
}
