// The places that an avatar can stand in, as numbers: colours are linear light, lengths metres, y up, the floor at 0.

/** What a user chooses from; `plain` is a grid in the dark and costs nothing. */
export const PLACES = [
  { value: 'day', label: 'Daylight room' },
  { value: 'studio', label: 'Grey studio' },
  { value: 'night', label: 'Night terrace' },
  { value: 'plain', label: 'Plain dark' },
];

/**
 * `half`: half the width and depth, and the height where there are `walls`. `sky`: {zenith, horizon, hills: their colour,
 * ridge: how high they are, radians, stars: how many}. `fade`: where a floor without walls begins to be the horizon, and
 * where it is. `floor`: its colour; `boards`: {across, along: metres a piece, joint: how dark its edges are, vary: how
 * unlike pieces are}. `windows`: [wall, from, to, bottom, top] with wall 0 to 3 for -x, +x, -z, +z, which let in `light`.
 * `lamps`: [x, height, z, red, green, blue]; `sun`: towards it, and its colour. `shadow`: how dark it is under a foot.
 */
export const LOOKS = {
  day: {
    walls: true,
    half: [4.6, 3.3, 4.6],
    sky: { zenith: [0.22, 0.45, 0.82], horizon: [0.84, 0.89, 0.93], hills: [0.3, 0.4, 0.4], ridge: 0.055, stars: 0 },
    fade: null,
    floor: [0.42, 0.28, 0.17],
    boards: { across: 0.16, along: 1.7, joint: 0.5, vary: 0.3 },
    wall: [0.8, 0.76, 0.69],
    ceiling: [0.82, 0.81, 0.78],
    windows: [
      [0, -3.4, -1.0, 0.35, 2.75],
      [0, 0.2, 2.6, 0.35, 2.75],
      [2, 1.5, 3.9, 0.85, 2.6],
    ],
    frame: [0.66, 0.65, 0.62],
    light: [1.5, 1.55, 1.62],
    ambient: [0.36, 0.345, 0.32],
    sun: { towards: [-0.8, 0.62, -0.2], colour: [1.5, 1.22, 0.86] },
    lamps: [],
    bench: { from: [-3.3, 0, -4.35], to: [-0.7, 0.44, -3.8], colour: [0.3, 0.19, 0.11] },
    shadow: 0.75,
  },
  studio: {
    walls: false,
    half: [12, 3.3, 12],
    sky: { zenith: [0.06, 0.063, 0.07], horizon: [0.23, 0.235, 0.245], hills: null, ridge: 0, stars: 0 },
    fade: [1.5, 8],
    floor: [0.4, 0.405, 0.415],
    boards: null,
    windows: [],
    light: [0, 0, 0],
    ambient: [0.5, 0.5, 0.5],
    sun: null,
    lamps: [[0, 3.4, 0.4, 6.4, 6.35, 6.2]],
    bench: null,
    shadow: 0.7,
  },
  night: {
    walls: false,
    half: [12, 3.3, 12],
    sky: { zenith: [0.004, 0.008, 0.022], horizon: [0.07, 0.08, 0.135], hills: [0.014, 0.018, 0.034], ridge: 0.075, stars: 260 },
    fade: [3, 11],
    floor: [0.17, 0.18, 0.2],
    boards: { across: 0.8, along: 0.8, joint: 0.45, vary: 0.22 },
    windows: [],
    light: [0, 0, 0],
    ambient: [0.13, 0.16, 0.25],
    sun: null,
    lamps: [[-2.4, 1.1, -1.6, 1.9, 1.15, 0.5], [2.6, 1.1, -2.0, 1.9, 1.15, 0.5], [0.4, 2.6, 2.2, 2.0, 1.75, 1.35]],
    bench: null,
    shadow: 0.8,
  },
};
