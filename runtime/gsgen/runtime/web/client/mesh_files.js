/** Reads files of meshes by the loaders of three.js, with the colours that Python's renderer gives them. */

import { download } from "./download.js";
import { failing } from "./errors.js";
import { contentKind } from "./file_kinds.js";
import { textOf } from "./splat_files.js";
import { importThree } from "./three_modules.js";

/** Loaders by the kinds of `contract/file_kinds`. */
const LOADERS = { glb: "GLTF", gltf: "GLTF", obj: "OBJ", "ply-mesh": "PLY", stl: "STL", fbx: "FBX" };
const HEAD_BYTES = 65536; // by which a file is recognised
const [STL_HEADER, STL_FACE] = [84, 50]; // bytes
const LIBRARY = /^[ \t]*mtllib[ \t]+(.+?)[ \t]*$/gm;

/**
 * A material of a mesh.
 * @typedef {object} Surface
 * @property {any} mesh Of three.js.
 * @property {number} slot Index of the material, of meshes with several.
 * @property {number[]} color Red, green, blue.
 * @property {any} map A texture in sRGB, or null.
 * @property {boolean} isLinear Whether `color` and the colours of vertices are linear light.
 * @property {boolean} isColored Whether the file gives it a colour.
 */
/** @typedef {{three: any, root: any, surfaces: Surface[], clips: any[], isYUp: boolean}} MeshFile Root and clips of three.js. */

/** Return which loader reads a file. */
function loaderOf(bytes, path) {
  const kind = contentKind(textOf(new Uint8Array(bytes, 0, Math.min(bytes.byteLength, HEAD_BYTES))));
  const count = bytes.byteLength < STL_HEADER ? 0 : new DataView(bytes).getUint32(STL_HEADER - 4, true);
  if (count && STL_HEADER + STL_FACE * count === bytes.byteLength) return "STL";
  const named = /\.(obj|stl)$/i.exec(path)?.[1].toUpperCase();
  const title = kind?.title ?? "of an unknown kind";
  return LOADERS[kind?.name] ?? named ?? failing(path, "Known: GLB, glTF, OBJ, PLY, STL and FBX.")(`is ${title}, expected a mesh`);
}

/**
 * Read a mesh file.
 * @param {ArrayBuffer} bytes
 * @param {string} path For messages.
 * @param {string} base The address to which those of its materials and textures are relative.
 * @param {(where: string, problem: string) => void} warn
 * @returns {Promise<MeshFile>}
 */
export async function readMeshFile(bytes, path, base, warn) {
  const name = loaderOf(bytes, path);
  const [three, { [`${name}Loader`]: Loader }] = await importThree(`loaders/${name}Loader.js`);
  const manager = new three.LoadingManager();
  const missing = [];
  manager.onError = (address) => missing.push(address);
  // Where a file holds its neighbours, three.js sets its own address before theirs.
  manager.setURLModifier((address) => address.slice(Math.max(address.lastIndexOf("data:"), 0)));
  let loaded = Promise.resolve();
  manager.onStart = () => (loaded = new Promise((resolve) => (manager.onLoad = resolve)));
  const loader = new Loader(manager);
  const folder = new URL(".", base).href;
  let file;
  try {
    if (name === "GLTF") file = gltfFile(await loader.parseAsync(bytes, folder));
    else if (name === "FBX") file = fbxFile(loader.parse(bytes, folder));
    else if (name === "OBJ") file = await objFile(three, loader, manager, new TextDecoder().decode(bytes), base, warn);
    else file = plainFile(three, new three.Mesh(loader.parse(bytes)));
  } catch (error) {
    return failing(path, "Copy or export the file again.")(`cannot be read: ${error.message}`);
  }
  await loaded; // textures
  if (missing.length) failing(path, "Textures must be PNG, JPEG or WebP.")(`names files that cannot be loaded: ${missing.join(", ")}`);
  if (!file.surfaces.length) failing(path, "Give a file with faces.")("the mesh file has no triangles");
  for (const { map } of file.surfaces) {
    if (!map) continue;
    // Texels are interpolated as they are stored, without smaller copies, as Python does.
    Object.assign(map, { colorSpace: three.NoColorSpace, wrapS: three.RepeatWrapping, wrapT: three.RepeatWrapping });
    Object.assign(map, { generateMipmaps: false, minFilter: three.LinearFilter, magFilter: three.LinearFilter, needsUpdate: true });
  }
  return { three, ...file };
}

/** Return the surfaces of a tree; points and lines are hidden, as Python draws none. */
function surfacesOf(root, surfaceOf) {
  const surfaces = [];
  root.traverse((object) => {
    if (object.isMesh) [object.material].flat().forEach((material, slot) => surfaces.push({ mesh: object, slot, ...surfaceOf(material, object.geometry) }));
    else if (object.isLine || object.isPoints) object.layers.disableAll();
  });
  return surfaces;
}

const linearColor = ({ r, g, b }) => [r, g, b];
const encodedColor = (color) => linearColor(color.clone().convertLinearToSRGB());

/** Colours are linear, textures sRGB. */
function gltfFile({ scene, animations, parser }) {
  const surfaces = surfacesOf(scene, (material, geometry) => {
    const index = parser.associations.get(material)?.materials;
    const { baseColorFactor } = parser.json.materials?.[index]?.pbrMetallicRoughness ?? {};
    const { map = null, color } = material;
    return { color: linearColor(color), map, isLinear: true, isColored: Boolean(map || baseColorFactor || geometry.attributes.color) };
  });
  return { root: scene, surfaces, clips: animations, isYUp: true };
}

/** Pages alone draw FBX. */
function fbxFile(root) {
  const surfaces = surfacesOf(root, ({ map = null, color }) => {
    return { color: linearColor(color), map, isLinear: true, isColored: true };
  });
  return { root, surfaces, clips: root.animations, isYUp: true };
}

/** Return the file of an OBJ with its material files; one that is missing leaves it without materials. */
async function objFile(three, loader, manager, text, base, warn) {
  const libraries = [...text.matchAll(LIBRARY)].map(([, name]) => name);
  const missing = (library) => warn(library, "is missing; the mesh is drawn without materials");
  const texts = await Promise.all(
    libraries.map((library) => download(new URL(library, base).href).then((data) => new TextDecoder().decode(data), () => missing(library))),
  );
  if (texts.length && texts.every((each) => each !== undefined)) {
    const [, { MTLLoader }] = await importThree("loaders/MTLLoader.js");
    loader.setMaterials(new MTLLoader(manager).parse(texts.join("\n"), new URL(".", base).href));
  }
  return plainFile(three, loader.parse(text), loader.materials);
}

/** Colours of materials, vertices and textures are sRGB; three.js made the first two linear. */
function plainFile(three, root, materials = null) {
  const encoded = new Set();
  const surfaces = surfacesOf(root, ({ name }, { attributes: { color: vertices } }) => {
    const own = name ? materials?.materials[name] : null;
    const { map = null, color = new three.Color(1, 1, 1) } = own ?? {};
    for (let i = 0; vertices && !encoded.has(vertices) && i < vertices.count; i++) {
      vertices.setXYZ(i, ...encodedColor(new three.Color().fromBufferAttribute(vertices, i)));
    }
    encoded.add(vertices);
    return { color: encodedColor(color), map, isLinear: false, isColored: Boolean(own || vertices) };
  });
  return { root, surfaces, clips: [], isYUp: false };
}
