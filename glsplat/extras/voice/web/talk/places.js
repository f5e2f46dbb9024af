// Where the others' mouths are, in the user's own space: from the people of picture replies, or from poses.

import { fromPose, invert, movePoint, multiply } from '../space/matrix.js';

const MOUTH = 1.5; // metres above the ground on which somebody stands, where the head is not known

/** Return {name: [x, y, z]} of the people in the room of a stage; metres. */
export function mouths({ info, here, renderedBy }, now = performance.now()) {
  const room = renderedBy.by === 'here' ? here.people.room : info.room;
  if (!Array.isArray(room?.people)) return {};
  const raised = ([x, y, z]) => [x, y + MOUTH, z];
  if (renderedBy.by !== 'here') return Object.fromEntries(room.people.map(({ name, at, head }) => [name, head ?? raised(at)]));
  const names = Object.fromEntries(room.people.map(({ key, name }) => [key, name]));
  const own = invert(fromPose(room.place));
  const bodies = here.people.at(now).map(({ key, root, place: { translation, rotation, scale } }) => {
    const at = movePoint(multiply(own, fromPose([...translation, ...rotation])), root.map((v) => v * scale));
    return [names[key], raised(at)];
  });
  return Object.fromEntries(bodies);
}
