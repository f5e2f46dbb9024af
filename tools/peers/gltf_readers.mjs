// node gltf_readers.mjs FILE...: what the Khronos validator and three.js say of glTF files, one JSON object on stdout.
// Both packages are looked for from the working directory.
import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

const require = createRequire(pathToFileURL(process.cwd() + '/').href);
const validator = require('gltf-validator');
// three's loader is made for browsers: pictures are taken as decoded, everything else is as there
globalThis.self = globalThis;
globalThis.ProgressEvent ??= class extends Event {};
globalThis.createImageBitmap ??= async () => ({ width: 1, height: 1, close() {} });
const loader = pathToFileURL(require.resolve('three/addons/loaders/GLTFLoader.js'));
const { GLTFLoader } = await import(loader.href);

const { Mesh } = await import(new URL('../../../build/three.module.js', loader).href);

function shown(object) {
  const attributes = object.geometry.attributes;
  const out = {
    kind: object.type, material: object.material.type, vertexColors: object.material.vertexColors,
    map: Boolean(object.material.map), attributes: {}, bones: null,
  };
  for (const [name, attribute] of Object.entries(attributes)) {
    const values = [];
    for (let i = 0; i < attribute.count; i++) {
      for (let k = 0; k < attribute.itemSize; k++) values.push(attribute.getComponent(i, k)); // normalised ones decoded
    }
    out.attributes[name] = { count: attribute.count, width: attribute.itemSize, values };
  }
  if (object.morphTargetInfluences) { // as three's own Mesh moves vertices; its Points have no such method
    const mesh = new Mesh(object.geometry);
    mesh.morphTargetInfluences = object.morphTargetInfluences.map((_, target) => ((target * 37) % 11) / 10);
    out.targets = Object.keys(object.morphTargetDictionary);
    out.morphed = [];
    for (let i = 0; i < attributes.position.count; i++) {
      out.morphed.push(mesh.getVertexPosition(i, new (object.position.constructor)()).toArray());
    }
  }
  if (object.isSkinnedMesh) {
    object.updateMatrixWorld(true);
    out.bones = object.skeleton.bones.map((bone) => bone.name);
    out.inverse = object.skeleton.boneInverses.map((matrix) => matrix.elements);
    out.skinned = [];
    const at = new (object.position.constructor)();
    const { index } = object.geometry; // corner by corner
    for (let i = 0; i < index.count; i++) out.skinned.push(object.getVertexPosition(index.getX(i), at).toArray());
  }
  return out;
}

const all = {};
for (const path of process.argv.slice(2)) {
  const data = await readFile(path);
  const report = await validator.validateBytes(new Uint8Array(data), { maxIssues: 1000 });
  const buffer = data.buffer.slice(data.byteOffset, data.byteOffset + data.length);
  const gltf = await new GLTFLoader().parseAsync(path.endsWith('.gltf') ? data.toString() : buffer, '');
  gltf.scene.updateMatrixWorld(true);
  const objects = [];
  gltf.scene.traverse((object) => { if (object.geometry) objects.push(shown(object)); });
  all[path] = { issues: report.issues.messages, objects };
}
process.stdout.write(JSON.stringify(all));
