/** Reads scene files: the fields that Python's renderer reads, with the same errors. */

import { turnTowards, viewOf } from "./camera.js";
import { GsgenError } from "./errors.js";
import { EASINGS, isKeyed } from "./key_frames.js";
import { IDENTITY, linearPart, product, rotationOf, solve } from "./matrices.js";
import { hintAmong, written } from "./words.js";

const VERSION = "1"; // the major one
const AXES = ["+x", "-x", "+y", "-y", "+z", "-z"];
const COLORS = { black: [0, 0, 0, 1], white: [1, 1, 1, 1], transparent: [0, 0, 0, 0] };
const KINDS = ["pinhole", "orthographic", "panorama"];
const SHADINGS = ["unlit", "headlight"];
const CAMERA_FORMS = "orbit:AZIMUTH,ELEVATION[,RADIUS] or look-at:EX,EY,EZ,TX,TY,TZ";
const ORBIT = { azimuth: 30, elevation: 20 };
const LONGEST = 60; // letters of a value in a message

/** What a scene file says of a model, and of a mesh. @typedef {ReturnType<typeof modelOf>} SceneModel */
/** @typedef {ReturnType<typeof meshOf>} SceneMesh */
/** @typedef {{position: number[], text: string, normal: number[] | null, camera: any}} SceneAnnotation The camera as an orbit. */

const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
const isNumber = (value) => Number.isFinite(value) && Math.abs(value) <= 1e12;
const isSwitch = (value) => typeof value === "boolean";
const isText = (value) => typeof value === "string" && value !== "";
const isList = (length) => (value) => Array.isArray(value) && value.length === length && value.every(isNumber);
const isMatrix = (value) => Array.isArray(value) && value.length === 4 && value.every(isList(4));
const isNumbers = (value) => isNumber(value) || typeof value === "boolean" || (Array.isArray(value) && value.every(isNumbers));
const within = (low, high) => (value) => isNumber(value) && value >= low && value <= high;

/** The fields of one object of a scene file. */
class Fields {
  constructor(document, where, separator = ".") {
    this.document = document;
    this.where = where;
    this._separator = separator;
    this._known = [];
  }

  location(name) {
    return this.where + this._separator + name;
  }

  /** Refuse the value of a field. @returns {never} */
  refuse(name, message, hint = "") {
    throw new GsgenError(message, { where: this.location(name), hint });
  }

  /** Read a field; null if it is absent. */
  read(name, isGood, expected) {
    this._known.push(name);
    const value = this.document[name] ?? null;
    const text = written(value);
    if (value !== null && !isGood(value)) {
      this.refuse(name, `is ${text.length > LONGEST ? `${text.slice(0, LONGEST)}…` : text}, expected ${expected}`);
    }
    return value;
  }

  choice(name, words) {
    return this.read(name, (value) => words.includes(value), words.join(" or "));
  }

  /** Read a field that must be there. */
  required(name, isGood = isText, expected = "text") {
    return this.read(name, isGood, expected) ?? this.refuse(name, `is missing, expected ${expected}`);
  }

  nested(name) {
    const value = this.read(name, isObject, "an object");
    return value && new Fields(value, this.location(name));
  }

  /** Read a list of objects; a text stands for an object's path. */
  parts(name) {
    const entries = this.read(name, Array.isArray, "a list") ?? [];
    return entries.map((entry, index) => {
      const part = typeof entry === "string" ? { path: entry } : entry;
      const where = `${this.location(name)}[${index}]`;
      if (!isObject(part)) throw new GsgenError(`is ${written(entry)}, expected an object or a path`, { where });
      return new Fields(part, where);
    });
  }

  /** Refuse fields that nobody read. @template T @param {T} [result] What the others say. @returns {T} */
  close(result) {
    const unknown = Object.keys(this.document).find((name) => !this._known.includes(name));
    if (unknown === undefined) return /** @type {T} */ (result);
    const hint = hintAmong(unknown, this._known, "It may have");
    throw new GsgenError(`unknown field ${written(unknown)}`, { where: this.where, hint });
  }
}

/**
 * Read a scene file.
 * @param {Record<string, any>} document
 * @param {string} name Of the file, for messages.
 * @param {(where: string, problem: string) => void} warn Told what a page does not draw.
 */
export function readScene(document, name, warn) {
  const fields = new Fields(document, name, ": ");
  const version = fields.read("gsgen_scene", isText, "text");
  if (version && version.split(".")[0] !== VERSION) fields.refuse("gsgen_scene", `is ${version}, expected ${VERSION}.0`);
  const models = fields.parts("models").map(modelOf);
  const meshes = fields.parts("meshes").map(meshOf);
  const posts = fields.parts("posts").map(postOf);
  if (!models.length && !meshes.length) {
    throw new GsgenError("the scene file has neither models nor meshes", { where: name, hint: "Name a file in `models`." });
  }
  for (const side of ["width", "height"]) fields.read(side, (value) => Number.isInteger(value) && within(1, 16384)(value), "a whole number from 1 to 16384");
  const kind = fields.choice("kind", KINDS);
  if (kind && kind !== "pinhole") warn("kind", `${kind} is not drawn in pages`);
  const up = axisOf(fields.choice("up", AXES) ?? "-y");
  const fieldOfView = fields.read("fov", (value) => isNumber(value) && value > 0 && value < 180, "a number between 0 and 180");
  const camera = cameraOf(fields, up, warn);
  const background = backgroundOf(fields);
  const annotations = fields.parts("annotations").map((part) => annotationOf(part, up));
  const sound = soundOf(fields.nested("sound"));
  const timeline = fields.nested("timeline");
  const keyed = [camera, ...[...models, ...posts].flatMap(({ inputs }) => Object.values(inputs))].filter(isKeyed);
  const lengths = models.map(({ segments }) => segments.reduce((sum, segment) => sum + segment.seconds, 0));
  const last = Math.max(0, ...lengths, ...keyed.flatMap(({ keys }) => keys.map(({ at }) => at)));
  const seconds = timeline?.read("seconds", (value) => isNumber(value) && value >= 0, "a finite number from 0") ?? last;
  timeline?.read("fps", within(0.1, 100), "a number from 0.1 to 100");
  const loop = timeline?.read("loop", isSwitch, "true or false") ?? false;
  timeline?.close();
  if (timeline && !seconds) timeline.refuse("seconds", "is 0, expected a number above 0, or key frames");
  fields.close();
  return { models, meshes, posts, annotations, camera, background, sound, up, fieldOfView, seconds, loop };
}

/** @param {Fields} fields Of a model: its place, how it is drawn, and values or key frames of its inputs. */
function modelOf(fields) {
  const segments = fields.parts("segments").map(segmentOf);
  const capacity = fields.read("capacity", (value) => Number.isInteger(value) && within(1, 2 ** 30)(value), "a whole number from 1 to 1073741824");
  if (segments.length && fields.document.path != null) fields.refuse("path", "excludes `segments`: leave one of them out");
  if (Boolean(segments.length) !== (capacity !== null)) fields.refuse("capacity", "is the most Gaussians of `segments`: give both or neither");
  return fields.close({
    path: segments.length ? undefined : fields.required("path"),
    segments,
    capacity: capacity ?? 0,
    transform: transformOf(fields),
    opacity: fields.read("opacity_scale", (value) => isNumber(value) && value >= 0, "a finite number from 0") ?? 1,
    degree: fields.read("sh_degree", (value) => [0, 1, 2, 3].includes(value), "a whole number from 0 to 3"),
    antialias: fields.choice("antialias", ["classic", "mip"]),
    clip: clipOf(fields),
    isSorted: fields.choice("blend", ["alpha", "declared"]) === "alpha",
    inputs: inputsOf(fields),
    isVisible: fields.read("visible", isSwitch, "true or false") ?? true,
    where: fields.where,
    fields: fields.document,
  });
}

function segmentOf(fields) {
  const seconds = fields.required("seconds", (value) => isNumber(value) && value > 0, "seconds above 0");
  return fields.close({ path: fields.required("path"), seconds, where: fields.where });
}

/** @param {Fields} fields Of a mesh: its place, how it is drawn, and the clip that it plays. */
function meshOf(fields) {
  const isName = (value) => isText(value) || (Number.isInteger(value) && value >= 0);
  return fields.close({
    path: fields.required("path"),
    transform: transformOf(fields),
    shading: fields.choice("shading", SHADINGS),
    opacity: fields.read("opacity_scale", within(0, 1), "a finite number from 0 to 1") ?? 1,
    animation: fields.read("animation", isName, "text or a whole number from 0"),
    isVisible: fields.read("visible", isSwitch, "true or false") ?? true,
    where: fields.where,
    fields: fields.document,
  });
}

/** @param {Fields} fields @returns {SceneAnnotation} */
function annotationOf(fields, up) {
  const position = fields.required("position", isList(3), "3 numbers");
  const camera = fields.read("camera", (value) => isText(value) && placeOf(value) !== null, CAMERA_FORMS);
  const normal = fields.read("normal", isList(3), "3 numbers");
  return fields.close({ position, text: fields.required("text"), normal, camera: camera && orbitOf(placeOf(camera), up) });
}

/** @param {Fields | null} fields Of a recording, and of its place on the timeline. */
function soundOf(fields) {
  return fields && fields.close({
    path: fields.required("path"),
    start: fields.read("start", isNumber, "a number") ?? 0,
    captions: fields.read("captions", isText, "text"),
    where: fields.where,
  });
}

function postOf(fields) {
  return fields.close({ path: fields.required("path"), inputs: inputsOf(fields), where: fields.where });
}

/** Return the place of an object: its matrix, or first scaled, then turned, then moved. */
function transformOf(fields) {
  const matrix = fields.read("transform", isMatrix, "4×4 numbers");
  const isScale = (value) => isNumber(value) || isList(3)(value);
  const scale = fields.read("scale", isScale, "a number or 3 numbers");
  const turn = turnOf(fields);
  const [x, y, z] = fields.read("translate", isList(3), "3 numbers") ?? [0, 0, 0];
  const steps = ["translate", "rotate", "scale"].filter((name) => fields.document[name] != null);
  if (matrix && steps.length) fields.refuse(steps[0], "excludes `transform`: leave one of them out");
  const sides = typeof scale === "number" ? [scale, scale, scale] : (scale ?? [1, 1, 1]);
  const linear = product(turn, [sides[0], 0, 0, 0, sides[1], 0, 0, 0, sides[2]]);
  const [a, b, c, d, e, f, g, h, i] = linear;
  const transform = matrix?.flat() ?? [a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1];
  const isWhole = [12, 13, 14, 15].every((place) => transform[place] === IDENTITY[place]);
  const isInvertible = solve(linearPart(transform), [1, 1, 1]).every(Number.isFinite);
  if (!isWhole || !isInvertible) fields.refuse(matrix ? "transform" : "scale", "is not an invertible affine transform");
  return transform;
}

/** Return a 3×3 rotation: of a quaternion w, x, y, z, or of an axis and degrees. */
function turnOf(fields) {
  const isTurn = (value) => isObject(value) || isList(4)(value);
  const value = fields.read("rotate", isTurn, '{"axis": [x, y, z], "degrees": d} or [w, x, y, z]') ?? [1, 0, 0, 0];
  let quaternion = value;
  if (isObject(value)) {
    const nested = new Fields(value, fields.location("rotate"));
    const axis = nested.read("axis", isList(3), "3 numbers");
    const degrees = nested.read("degrees", isNumber, "a number");
    nested.close();
    if (!axis || degrees === null || !Math.hypot(...axis)) fields.refuse("rotate", 'expected {"axis": [x, y, z], "degrees": d} or [w, x, y, z]');
    const half = (degrees * Math.PI) / 360;
    quaternion = [Math.cos(half), ...axis.map((part) => (Math.sin(half) * part) / Math.hypot(...axis))];
  }
  const length = Math.hypot(...quaternion);
  if (!length) fields.refuse("rotate", "is the quaternion 0 0 0 0, expected one with a length");
  return rotationOf(quaternion.map((part) => part / length));
}

function clipOf(fields) {
  const nested = fields.nested("clip");
  if (!nested) return null;
  const [low, high] = ["low", "high"].map((name) => nested.read(name, isList(3), "3 numbers"));
  nested.close();
  if (!low || !high || low.some((part, axis) => part > high[axis])) fields.refuse("clip", 'expected {"low": [x, y, z], "high": [x, y, z]} with low <= high');
  return { low, high };
}

function inputsOf(fields) {
  const values = fields.read("inputs", isObject, "an object") ?? {};
  const nested = new Fields(values, fields.location("inputs"));
  return Object.fromEntries(
    Object.keys(values).map((name) => {
      const value = nested.read(name, (given) => isObject(given) || isNumbers(given), "numbers or key frames");
      return [name, isObject(value) ? { keys: keysOf(nested.nested(name), numbersOf, "numbers") } : value];
    }),
  );
}

const numbersOf = (value) => (isNumbers(value) ? [value].flat(3).map(Number) : null);

/**
 * Read key frames.
 * @param {(value: any) => number[] | null} read What a value stands for.
 * @returns {import("./key_frames.js").KeyFrame[]}
 */
function keysOf(fields, read, expected) {
  const keys = fields.parts("keys").map((part) => {
    const at = part.required("at", (value) => isNumber(value) && value >= 0, "seconds from 0");
    const value = part.required("value", (given) => read(given) !== null, expected);
    const easing = part.choice("easing", Object.keys(EASINGS)) ?? "linear";
    return part.close({ at, value: /** @type {number[]} */ (read(value)), easing });
  });
  fields.close();
  if (!keys.length) fields.refuse("keys", "has no key frame");
  keys.forEach(({ at, value }, index) => {
    if (index && at <= keys[index - 1].at) fields.refuse(`keys[${index}].at`, "is not later than the one before");
    if (value.length !== keys[0].value.length) fields.refuse(`keys[${index}].value`, "has another form than the first");
  });
  return keys;
}

/** Return the numbers of an orbit or of an eye and a target; null of other texts. */
function placeOf(text) {
  const [, form, list] = /^(orbit|look-at)(?::(.*))?$/.exec(text) ?? [];
  const numbers = list ? list.split(",").map((word) => (word.trim() ? Number(word) : NaN)) : [];
  const lengths = form === "orbit" ? (list ? [2, 3] : [0]) : [6];
  if (!form || !lengths.includes(numbers.length) || !numbers.every(Number.isFinite)) return null;
  return numbers.length ? numbers : [ORBIT.azimuth, ORBIT.elevation];
}

/** Return the orbit of the numbers of :func:`placeOf`. */
export function orbitOf(numbers, up) {
  if (numbers.length < 6) {
    const [azimuth, elevation, radius] = numbers;
    return { azimuth, elevation, radius };
  }
  const [eye, target] = [numbers.slice(0, 3), numbers.slice(3)];
  const ahead = target.map((part, axis) => part - eye[axis]);
  return { view: viewOf(turnTowards(ahead, up), eye), radius: Math.hypot(...ahead) };
}

/** Return an orbit, or key frames of one; null for the usual one. */
function cameraOf(fields, up, warn) {
  const isCamera = (value) => isText(value) || isObject(value);
  const value = fields.read("camera", isCamera, "text or an object");
  if (isText(value)) {
    const numbers = placeOf(value);
    if (!numbers) warn("camera", `${written(value)} is neither orbit:… nor look-at:…; pages read no files of cameras`);
    return numbers && orbitOf(numbers, up);
  }
  if (!value) return null;
  if (isKeyed(value)) return { keys: keysOf(fields.nested("camera"), placeOf, CAMERA_FORMS) };
  const { view, fx, fy, cx, cy, width, height, kind = "pinhole", distortion } = value;
  if (!isMatrix(view) || ![fx, fy, cx, cy, width, height].every(isNumber)) {
    fields.refuse("camera", "is no camera: expected view, fx, fy, cx, cy, width and height");
  }
  if (kind !== "pinhole" || distortion) warn("camera", `${distortion ? "with distortion" : kind} is not drawn in pages`);
  if (Math.abs(cx - width / 2) > 1e-9 * width || Math.abs(cy - height / 2) > 1e-9 * height || Math.abs(fx - fy) > 1e-9 * fy) {
    warn("camera", "is drawn with its centre in the middle of the picture, and with square pixels");
  }
  return { view: view.flat(), fieldOfView: (360 / Math.PI) * Math.atan(height / (2 * fy)) };
}

/** Return red, green, blue and alpha; null without a background. */
function backgroundOf(fields) {
  const expected = "black, white, transparent, #rrggbb or 3 or 4 numbers from 0 to 1";
  const found = (value) => {
    if (Array.isArray(value)) {
      const isGood = [3, 4].includes(value.length) && value.every(within(0, 1));
      return isGood ? [...value, 1].slice(0, 4) : null;
    }
    const text = String(value).toLowerCase();
    if (/^#[0-9a-f]{6}$/.test(text)) return [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16) / 255).concat(1);
    return COLORS[text] ?? (text.includes(",") ? found(text.split(",").map(Number)) : null);
  };
  const value = fields.read("background", (given) => found(given) !== null, expected);
  return value === null ? null : found(value);
}

const axisOf = (axis) => ["x", "y", "z"].map((letter) => (axis[1] === letter ? (axis[0] === "-" ? -1 : 1) : 0));
