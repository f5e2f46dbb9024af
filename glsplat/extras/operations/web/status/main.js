// The server's status page, updated by one request every two seconds.

const PAUSE = 2000; // ms
const $ = (id) => document.getElementById(id);
const TOKEN = 'glsplat.token'; // kept by the page in this tab
const CURVES = [
  { key: 'fps', label: 'Pictures a second', show: (v) => v.toFixed(1), least: 5 },
  { key: 'age', label: 'From request to reply, ms', show: (v) => v.toFixed(0), least: 50 },
  { key: 'load', label: 'Load per core', show: (v) => v.toFixed(2), least: 1 },
];
const SVG = 'http://www.w3.org/2000/svg';
const [WIDTH, HEIGHT] = [300, 80]; // of a curve, in its own units
const COLUMNS = ['id', 'avatar', 'room', 'a second', 'form', 'size', 'sent', 'dropped', 'failed', 'window'];
const sent = new Map(); // by client: {count, at} of the last poll, for its rate
const pictures = new Map(); // by avatar: {tag, address} of its picture, a blob

function ask(path) {
  const token = sessionStorage.getItem(TOKEN);
  const headers = token ? { Authorization: `Bearer ${token}` } : {};
  return fetch(new URL(path, location.href), { headers, cache: 'no-store', credentials: 'same-origin' });
}

async function json(path) {
  const response = await ask(path);
  if (!response.ok) throw new Error(`the server answers ${response.status}`);
  return response.json();
}

function make(tag, text = '', attributes = {}) {
  const element = document.createElement(tag);
  element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

async function look() {
  try {
    const { stats, history, avatars, pictures: sentLast } = await json('status.json');
    $('trouble').textContent = '';
    summary(stats);
    curves(history);
    clients(stats.clients, stats.connected);
    now(stats.clients, sentLast, avatars);
    await people(avatars);
  } catch (error) {
    $('trouble').textContent = `The server does not answer (${error.message}); these figures are old. Trying again.`;
  }
  setTimeout(look, document.hidden ? 5 * PAUSE : PAUSE);
}

function summary({ scene, driver, uptime, totals, fps, connected, max_clients: most, healthy }) {
  const minutes = Math.floor(uptime / 60);
  const up = minutes ? `${minutes} min` : `${Math.floor(uptime)} s`;
  $('summary').textContent = `${scene ? `${scene} on ` : ''}${driver}; up ${up}, ${totals.sent} pictures sent, ${fps.toFixed(1)} a second, ${connected} of ${most} clients, ${healthy ? 'healthy' : 'failing'}.`;
}

function curves(history) {
  $('curves').hidden = history.fps.length < 2;
  const made = CURVES.map(({ key, label, show, least }) => {
    const values = history[key];
    const figure = make('figure');
    const caption = make('figcaption', label);
    caption.append(make('strong', values.length ? show(values.at(-1)) : '–'));
    const highest = Math.max(least, ...values);
    const scale = make('p', '', { class: 'scale' });
    const [from, to] = [`${Math.round((history.most * history.step) / 60)} min ago`, 'now'];
    scale.append(make('span', from), make('span', `at most ${show(highest)}`), make('span', to));
    figure.append(caption, curve(values, history.most, highest, `${label}, at most ${show(highest)} in the last five minutes`), scale);
    return figure;
  });
  $('curves').replaceChildren(...made);
}

function clients(list, connected) {
  const at = performance.now();
  const rows = list.map((client) => {
    const before = sent.get(client.id) ?? { count: client.sent, at };
    const rate = at > before.at ? ((client.sent - before.count) * 1000) / (at - before.at) : 0;
    sent.set(client.id, { count: client.sent, at });
    return COLUMNS.map((name) => (name === 'a second' ? rate.toFixed(1) : `${client[name] ?? '–'}`));
  });
  for (const id of sent.keys()) if (!list.some((client) => client.id === id)) sent.delete(id);
  if (!rows.length) {
    const words = connected ? 'None of the clients is yours.' : 'Nobody is connected. Open the viewer to be the first.';
    return $('clients').replaceChildren(make('p', words));
  }
  const table = make('table');
  const row = (cells, tag) => {
    const made = make('tr');
    made.append(...cells.map((cell) => make(tag, cell, tag === 'th' ? { scope: 'col' } : {})));
    return made;
  };
  table.append(row(COLUMNS, 'th'), ...rows.map((cells) => row(cells, 'td')));
  return $('clients').replaceChildren(table);
}

/** Show the last pictures of clients, if the server gives them. */
function now(list, sentLast, avatars) {
  const shown = list.filter(({ id }) => sentLast[id]);
  $('now').hidden = !shown.length;
  const titles = new Map(avatars.map(({ name, title }) => [name, title]));
  const made = [];
  for (const { id, avatar, room } of shown) {
    const address = `data:image/jpeg;base64,${sentLast[id]}`;
    made.push(tile(address, `Client ${id}`, room ? `client ${id}, room ${room}` : `client ${id}: ${titles.get(avatar) || avatar}`));
  }
  $('pictures').replaceChildren(...made);
}

async function people(avatars) {
  $('avatars').hidden = !avatars.length;
  const made = [];
  for (const { name, title, tag } of avatars) made.push(tile(await picture(name, tag), title || name, title || name));
  $('people').replaceChildren(...made);
}

function tile(address, alt, text) {
  const figure = make('figure');
  figure.append(address ? make('img', '', { src: address, alt, width: 144, height: 144 }) : make('div', '', { class: 'blank' }), make('figcaption', text));
  return figure;
}

/** Return the blob URL of an avatar's picture, or null; fetched once for each tag. */
async function picture(name, tag) {
  const before = pictures.get(name);
  if (before && (!tag || tag === before.tag)) return before.address;
  const response = await ask(`thumbnails/${encodeURIComponent(name)}`).catch(() => null);
  if (response?.status !== 200) return before?.address ?? null; // 204: deleted meanwhile
  const address = URL.createObjectURL(await response.blob());
  if (before) setTimeout(() => URL.revokeObjectURL(before.address), PAUSE);
  pictures.set(name, { tag: response.headers.get('ETag')?.replaceAll('"', '') ?? tag, address });
  return address;
}

/** Return the SVG of `values`, the newest at the right; `most` values fill the width, `highest` is the upper edge. */
function curve(values, most, highest, title) {
  const svg = element('svg', { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: 'none', class: 'curve', role: 'img', 'aria-label': title });
  for (const part of [0.5, 1]) svg.append(element('line', { x1: 0, x2: WIDTH, y1: part * (HEIGHT - 2) + 1, y2: part * (HEIGHT - 2) + 1 }));
  const points = values.map((value, i) => {
    const x = WIDTH - ((values.length - 1 - i) * WIDTH) / (most - 1);
    const y = HEIGHT - 1 - (Math.min(value, highest) / highest) * (HEIGHT - 4);
    return `${x.toFixed(1)},${y.toFixed(1)}`;
  });
  svg.append(element('polyline', { points: points.join(' ') }));
  return svg;
}

function element(tag, attributes) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

look();
