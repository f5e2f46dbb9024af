// Draws people on this device instead of showing the server's pictures: poses arrive as replies (stream/pose.js),
// avatars are fetched once (avatar/cache.js), and draw/ draws them for the eyes of each frame.

import { AvatarCache } from '../avatar/cache.js';
import { HERE } from '../draw/bones.js';
import { Choice } from '../draw/choice.js';
import { ARKIT } from '../draw/crowd.js';
import { Own } from '../draw/own.js';
import { fromJoints, partsOf } from '../place/shadow.js';
import { turned } from '../space/light.js';
import { IDENTITY, fromPose, invert, movePoint, multiply } from '../space/matrix.js';
import { People, parsePoses } from '../stream/pose.js';

const JAW = ARKIT.indexOf('jawOpen');

export class Here {
  people = new People();
  face = new OwnFace();
  cache;
  choice;
  #gl;
  #own = null; // created for the first avatar
  #connection;
  #offer = null; // `hand_out` of the user's avatar: {sha256, url, ...}, or null
  #handedOut = []; // hashes of all avatars that the server hands out
  #refused = ''; // why the server refuses poses
  #jaw = 0; // weight of the user's jawOpen in the last picture

  constructor(gl, connection, settings) {
    [this.#gl, this.#connection] = [gl, connection];
    connection.parsePoses = parsePoses;
    this.cache = new AvatarCache((path) => connection.fetch(path));
    this.choice = new Choice(settings.get('drawn'));
    settings.addEventListener('change', ({ detail: { name, value } }) => {
      if (name === 'drawn') this.choice.wish = value;
    });
  }

  /** The user's avatar: its `hand_out` of /session. */
  set offer(offer) {
    if (this.#offer && offer?.sha256 !== this.#offer.sha256) this.people.clear();
    this.#offer = offer ?? null;
    this.#refused = '';
  }

  /** Take the hashes of all avatars that the server hands out now; delete others from the browser. */
  handedOut(hashes) {
    for (const sha256 of this.#handedOut) if (!hashes.includes(sha256)) this.cache.forget(sha256).catch(() => {});
    this.#handedOut = hashes;
    this.cache.sweep(hashes).catch(() => {});
  }

  /** Forget all people, for another connection. */
  clear() {
    this.people.clear();
  }

  /** Take a reply in poses; `said`: the expression of its request. */
  arrived(parsed, said, now) {
    this.people.arrived(parsed, now);
    if (parsed.bodies.some(({ you }) => you)) this.face.answered = said;
  }

  /** Take the server's reason for refusing poses of this avatar. */
  refuse(words) {
    this.#refused = words;
  }

  /**
   * Return whether this device draws the frame for these views of `where` (a placing); measures it when needed. `rate`:
   * the server's pictures per second.
   */
  draws(views, where, rate, now) {
    this.choice.frame(now);
    // measure with the whole avatar: the coarsest level alone is much faster
    if (!this.choice.declined && this.choice.asks(this.#why(now), now) && (this.choice.settled || this.cache.whole(this.#offer.sha256))) {
      const avatar = this.cache.get(this.#offer.sha256, now);
      this.#own.people = [{ key: 0, avatar, pose: atRest(avatar.skeleton) }];
      this.choice.measured(this.#own.measure(views, where.shown, this.choice.display), rate, now);
      this.#own.people = [];
    }
    return this.choice.here;
  }

  /**
   * Draw all people. `inside`: the view is from inside the user's own avatar; `light`: in the user's space, null for
   * the server's, `servers`. Returns the age of the oldest pose in ms, or null.
   */
  draw(views, framebuffer, where, { inside, light, servers, now }) {
    const bodies = this.people.at(now);
    const stands = this.people.room?.place ? fromPose(this.people.room.place) : IDENTITY;
    const shown = multiply(where.shown, invert(stands));
    const me = bodies.find(({ you }) => you);
    const face = me ? this.face.over(me.expression) : null;
    const faced = (body) => (body === me ? face : body.expression);
    const people = bodies.map((body) => ({ ...body, expression: faced(body), avatar: this.cache.get(body.sha256, now), pose: body }));
    this.cache.keep(new Set([...bodies.map(({ sha256 }) => sha256), this.#offer?.sha256]));
    this.#own.people = people.filter(({ avatar, joints }) => avatar && joints.length === 4 * avatar.skeleton.count);
    if (!this.#own.people.length) return null;
    this.#jaw = face?.[JAW] ?? 0;
    const falling = light ? turned(light, stands) : servers;
    this.#own.draw(views, framebuffer, shown, { glass: where.glass, headless: inside && me ? me.key : null, light: falling });
    return Math.max(...bodies.map(({ age }) => age));
  }

  /** Return everybody's shadows on the floor of the room as `shown`. */
  shadows(shown, now) {
    const room = this.people.room?.place ? multiply(shown, invert(fromPose(this.people.room.place))) : shown;
    return this.people.at(now).flatMap((body) => {
      const avatar = this.cache.get(body.sha256, now);
      if (!avatar || body.joints.length !== 4 * avatar.skeleton.count) return [];
      const stands = multiply(room, standing(body.place));
      return fromJoints(partsOf(avatar.skeleton, body).map((point) => movePoint(stands, point)));
    });
  }

  /** Return [{key, name, label, you, head, glass}] of everybody in a room; `head`: the joint, in the room as it is shown. */
  heads(where) {
    const { room } = this.people;
    if (!room || !this.#own) return [];
    const byKey = new Map(this.#own.people.map((one) => [one.key, one]));
    const shown = multiply(where.shown, invert(fromPose(room.place ?? [0, 0, 0, 0, 0, 0, 1])));
    return room.people
      .filter(({ key }) => byKey.has(key))
      .map(({ key, name, label, you }) => ({ key: name, name, label, you, head: headOf(byKey.get(key), shown), glass: where.glass }));
  }

  /** Figures for `stats()`. */
  stats() {
    const { here, reason } = this.choice;
    return { by: here ? 'here' : 'server', reason, splats: this.#own?.drawn ?? 0, people: this.people.size, avatars: this.cache.size, layers: this.#own?.kind ?? '', jaw: here ? this.#jaw : 0 };
  }

  lost() {
    this.#own?.lost();
  }

  restore(gl) {
    this.#gl = gl;
    this.#own?.restored();
  }

  /** Return why nothing can be drawn here, in words, or ''. */
  #why(now) {
    if (!this.#offer) return 'the server does not hand out the splats of this avatar';
    if (this.#refused) return this.#refused;
    if (this.people.room?.people.some(({ sha256 }) => sha256 === null)) return 'the splats of somebody here are not handed out';
    if (!this.#own) {
      this.#own = new Own(this.#gl);
      this.#own.open(async () => (await fetch(new URL('../draw/programs.json', import.meta.url))).json());
    }
    if (this.#own.why) return this.#own.why;
    const avatar = this.cache.get(this.#offer.sha256, now);
    if (this.cache.why(this.#offer.sha256)) return this.cache.why(this.#offer.sha256);
    return avatar && this.#own.ready ? '' : 'the avatar is loading';
  }
}

function atRest(skeleton) {
  const joints = new Float64Array(4 * skeleton.count);
  for (let j = 0; j < skeleton.count; j++) joints[4 * j + 3] = 1;
  return { joints, root: [0, 0, 0] };
}

/** Return the place of a person's head joint, in the room as it is shown. */
function headOf({ avatar: { skeleton }, pose, place = HERE }, shown) {
  const joint = skeleton.placeOf(pose, Math.max(skeleton.names.indexOf('head'), 0));
  return movePoint(multiply(shown, standing(place)), joint);
}

/** Return the matrix from the space of an avatar at a place to the room. */
function standing({ translation, rotation, scale }) {
  return multiply(fromPose([...translation, ...rotation]), [scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, 1]);
}

const byName = (said) => (Array.isArray(said) ? Object.fromEntries(ARKIT.map((name, i) => [name, said[i]])) : (said ?? {}));

export class OwnFace {
  /** Expressions of the newest request and of the one answered last: by name, or in ARKit's order. */
  now = null;
  answered = null;
  #weights = new Float32Array(ARKIT.length);

  /**
   * Return the server's `expression` [52] (null: all 0) with the weights of `now`. Weights that only the answered
   * request had are 0; others, such as eye movements of the server, stay. Null if all are 0.
   */
  over(expression) {
    const [now, before] = [byName(this.now), byName(this.answered)];
    const names = Object.keys({ ...before, ...now });
    if (!names.length) return expression;
    this.#weights.set(expression ?? new Float32Array(ARKIT.length));
    for (const name of names) {
      const i = ARKIT.indexOf(name);
      if (i >= 0) this.#weights[i] = Math.min(1, Math.max(0, now[name] ?? 0));
    }
    return this.#weights.some((weight) => weight !== 0) ? this.#weights : null;
  }
}
