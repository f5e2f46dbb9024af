// The study's state as content of the panel in VR, with the ids of its buttons.

import { button, column, row } from './board.js';

const MOST_CELLS = 25; // of a slider; finer ones are pressed to the nearest of them

/** Return the board's content, as StudyBoard.show takes it. */
export function content(state, questions, left, trouble) {
  if (!state) return { kind: 'wait', text: trouble || 'Please wait…', cells: [] };
  const heading = state.ended ? state.title : `${state.title} · ${state.number} of ${state.of}`;
  if (state.ended) return { kind: 'ended', heading, text: ending(state.ended), cells: [] };
  if (state.paused) return { kind: 'paused', heading, text: 'Please wait. The experimenter has paused the session.', cells: [] };
  if (state.kind === 'consent') {
    const cells = [button('decline', 'I do not agree', 0), button('agree', 'I agree', 2)];
    return { kind: state.step, heading, text: state.text, cells };
  }
  if (state.kind === 'rest') return { kind: state.step, heading, text: 'Please rest for a moment.', big: seconds(left), cells: [] };
  if (state.kind === 'task') return task(state, heading, left);
  return question(questions, trouble || questions.trouble);
}

function task(state, heading, left) {
  const kind = state.step;
  if (state.phase === 'instruction') {
    return { kind, heading, text: state.text, cells: state.ready ? [button('ready', 'I am ready', 1)] : [] };
  }
  if (state.phase === 'countdown') return { kind, heading, text: state.text, big: seconds(left), cells: [] };
  return { kind, aside: true, text: state.text, cells: [] };
}

function question(questions, trouble) {
  const { item, index, items } = questions;
  if (!item) return { kind: 'wait', text: 'Please wait…', cells: [] };
  const heading = `${index + 1} of ${items.length}${trouble ? ` · not saved${questions.saving ? ' yet' : ''}: ${trouble}` : ''}`;
  const answer = questions.answers[item.name];
  const cells = [];
  if (index > 0) cells.push(button('back', 'Back', 0));
  if (questions.free) cells.push(button('next', questions.last ? 'Finish' : 'Next', 2));
  const ends = item.labels.length === 2 && item.kind !== 'choice' ? item.labels : [];
  if (item.kind === 'choice') {
    cells.push(...column(item.labels.map((label) => ({ id: `value:${label}`, label, chosen: label === answer }))));
  } else if (item.kind === 'text') {
    return { kind: questions.step, heading, text: `${item.text}\n(answer this on the page)`, cells };
  } else {
    cells.push(...row(values(item).map((value, i) => ({
      id: `value:${value}`, label: wording(item, value, i), chosen: value === answer,
    }))));
  }
  return { kind: questions.step, heading, text: item.text, cells, ends };
}

/** Return the values that can be pressed. */
function values({ from, to, step }) {
  const steps = Math.round((to - from) / step);
  const stride = Math.ceil((steps + 1) / MOST_CELLS);
  const found = [];
  for (let i = 0; i <= steps; i += stride) found.push(rounded(from + i * step));
  if (found.at(-1) !== to) found.push(to);
  return found;
}

const rounded = (value) => Math.round(value * 1e9) / 1e9;

function wording({ labels, kind, from, to }, value, i) {
  if (labels.length > 2) return `${labels[i]}`;
  return kind === 'points' || [from, to, (from + to) / 2].includes(value) ? `${value}` : '';
}

export const seconds = (left) => (left === null ? '' : `${Math.max(0, Math.ceil(left))}`);

export function ending(ended) {
  if (ended === 'done') return 'That was all. Thank you! You may take the headset off.';
  if (ended === 'declined') return 'You did not agree, so nothing more will be asked or recorded. Thank you.';
  return 'The session has ended. Thank you.';
}
