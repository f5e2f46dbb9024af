// Draws the last values as a curve (SVG).

const SVG = 'http://www.w3.org/2000/svg';
const [WIDTH, HEIGHT] = [300, 80]; // of its own units

/** Return the SVG of `values`, the newest at the right; `most` values fill the width, `highest` is the upper edge. */
export function curve(values, most, highest, title) {
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
