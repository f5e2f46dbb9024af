import { readAvatar } from './avatar/avatar.js';
import { chosen, densityOf, proxyOf } from './avatar/detail.js';
import { HERE, Skeleton, amountsOf, matrixOf, movedMeans, quaternionOf } from './draw/bones.js';
import { ARKIT } from './draw/crowd.js';
import { cameraOfFile, uniformsOf } from './draw/frame.js';
import { parsePoses } from './stream/pose.js';
import { bytesOf, check } from './twins.js';

/** An avatar's file, which comes in small pieces. */
function read(file) {
  const bytes = bytesOf(file);
  return readAvatar((async function* () {
    for (let at = 0; at < bytes.length; at += 700) yield bytes.subarray(at, at + 700);
  })());
}

function bonesOf(skeleton, { vectors, root, translations = null }) {
  const joints = new Float64Array(4 * skeleton.count);
  for (let j = 0; j < skeleton.count; j++) quaternionOf(vectors, 3 * j, joints, 4 * j);
  return skeleton.bones({ joints, root, translations });
}

const matrices = (joints) => Array.from({ length: joints.length / 4 }, (_, j) => matrixOf([...joints.subarray(4 * j, 4 * j + 4)])).flat();

check({
  bones: ({ rig, ...pose }) => bonesOf(new Skeleton(rig), pose),
  level: ({ densities, wanted, before }) => chosen(densities, wanted, before ?? undefined),
  async density({ file, camera, ...pose }) {
    const { skeleton, levels } = await read(file);
    return densityOf(proxyOf(levels.get(0)), cameraOfFile(camera), bonesOf(skeleton, pose), HERE);
  },
  async expressed({ file, expression }) {
    const { names, levels } = await read(file);
    const splats = levels.get(0);
    const amounts = amountsOf(splats.shapes, names.map((name) => expression[ARKIT.indexOf(name)] ?? 0));
    return { amounts, means: amounts && movedMeans(splats, amounts, new Float32Array(3 * splats.count)) };
  },
  async avatar({ file }) {
    const { skeleton, names, levels } = await read(file);
    const { means, quats, scales, opacities, sh, joints, weights, shapes, surface } = levels.get(0);
    const { normals, occlusion, shade } = surface ?? { normals: null, occlusion: null, shade: null };
    const splats = { means, quats, scales, opacities, sh, bound: joints, weights, texels: shapes?.texels ?? null };
    return { joints: skeleton.names, shapes: names, ...splats, normals, occlusion, shade };
  },
  uniforms: ({ light }) => uniformsOf(light),
  bodies: ({ reply }) =>
    parsePoses(bytesOf(reply).buffer).bodies.map(({ key, you, frameId, at, t, sha256, opacity, place, root, joints, expression, translations }) => {
      const m = matrixOf([...place.rotation]).map((v) => v * place.scale);
      const rows = [0, 1, 2].flatMap((row) => [...m.slice(3 * row, 3 * row + 3), place.translation[row]]);
      return { head: [key, you, frameId, at, t, sha256], opacity, place: rows, root, joints: matrices(joints), expression, translations };
    }),
});
