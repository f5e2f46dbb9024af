import { check } from './twins.js';
import { VIEWS, placing, serverEye, standing } from './space/placing.js';
import { subtract, unit } from './space/matrix.js';

check({
  views: ({ head, eye }) =>
    VIEWS.map((view) => {
      const { shown, mirror, glass, normal = null, ...rest } = placing(view, head);
      const right = glass && unit(subtract(glass[1], glass[0]));
      return { view: rest.view, shown, mirror, right, normal, server: serverEye({ shown, mirror }, eye) };
    }),
  stands({ head }) {
    const { place, yaw } = standing(head);
    return [place[0], place[2], Math.sin(yaw / 2), Math.cos(yaw / 2)];
  },
});
