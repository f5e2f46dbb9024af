import { NAME } from './settings.js';
import { turned } from './space/light.js';
import { Calibration } from './track/calibration.js';
import { Motion } from './track/drivers.js';
import { check } from './twins.js';

/** A rotation vector as a matrix, row by row (Rodrigues). */
function matrixOf([x, y, z]) {
  const angle = Math.hypot(x, y, z) || 1e-12;
  const [a, b, c] = [x / angle, y / angle, z / angle];
  const [s, k] = [Math.sin(angle), 1 - Math.cos(angle)];
  return [
    1 - k * (b * b + c * c), k * a * b - s * c, k * a * c + s * b,
    k * a * b + s * c, 1 - k * (a * a + c * c), k * b * c - s * a,
    k * a * c - s * b, k * b * c + s * a, 1 - k * (a * a + b * b),
  ];
}

check({
  turned: ({ light, matrix }) => turned(light, matrix),
  motion({ fps, frames, seconds }) {
    const { root_pose: root, body_pose: body, trans } = new Motion({ fps, frames }).at(seconds).pose;
    return { body: [...root, ...body].flatMap(matrixOf), trans: trans.flat() };
  },
  calibrated({ samples, height }) {
    const calibration = new Calibration(null);
    calibration.begin(0, { height });
    samples.forEach((sample, i) => calibration.add(sample, 10 * i));
    return calibration.add(null, 2000).result;
  },
  named: ({ name }) => name !== '' && NAME.test(name),
});
