// The light of the room that a headset's cameras see, where the browser tells it (WebXR Lighting Estimation).

import { turned } from '../space/light.js';

const LARGEST = 1e4; // of a number of a light (docs/protocol.md)

/** The feature to ask a session for. */
export const FEATURE = 'light-estimation';

export class Estimate {
  #probe = null;

  /** Whatever is missing, there is no estimate, and nobody is told. */
  async start(session) {
    this.#probe = null;
    try {
      this.#probe = (await session.requestLightProbe?.()) ?? null;
    } catch {
      // the device does not let us
    }
  }

  stop() {
    this.#probe = null;
  }

  /**
   * {ambient, sun} (draw/light.js) along the axes of `space`, or null. The nine coefficients are of radiance, in the order
   * and with the signs of ours, the primary light an irradiance: as three.js reads them (XREstimatedLight).
   */
  light(frame, space) {
    const estimate = this.#probe && frame.getLightEstimate?.(this.#probe);
    const pose = estimate && frame.getPose(this.#probe.probeSpace, space);
    if (!pose) return null;
    const { sphericalHarmonicsCoefficients: values, primaryLightDirection: d, primaryLightIntensity: i } = estimate;
    if (values?.length !== 27) return null;
    const ambient = Array.from({ length: 9 }, (_, k) => [...values.slice(3 * k, 3 * k + 3)]);
    const [length, color] = [Math.hypot(d.x, d.y, d.z), [i.x, i.y, i.z].map((v) => Math.max(v, 0))];
    const sun = length > 0 && color.some((v) => v > 0) ? { direction: [d.x / length, d.y / length, d.z / length], color } : null;
    const sound = (v) => Math.abs(v) <= LARGEST;
    return ambient.flat().every(sound) && color.every(sound) ? turned({ ambient, sun }, pose.transform.matrix) : null;
  }
}
