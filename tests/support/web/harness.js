// What tests call in a page: functions of plain values; arrays are base64.

import { turnTowards, viewOf } from "/client/camera.js";
import { openDevice } from "/client/device.js";
import { findingsOf, inspected } from "/client/findings.js";
import { KernelCache } from "/client/host.js";
import { firstSubtree, subtreeRoot } from "/client/implicit_tiles.js";
import { openModel } from "/client/model.js";
import { choosePlan, evaluate, loadPlans } from "/client/plan.js";
import * as py from "/client/python.js";
import { Renderer } from "/client/renderer.js";
import { readInBackground } from "/client/file_reader.js";
import { readRequest } from "/client/splat_files.js";
import { SplatBuffers, paddedRows } from "/client/splat_buffers.js";
import * as uniforms from "/client/uniforms.js";

let opened = null;

function opening() {
  opened ??= (async () => {
    const plans = await loadPlans("/client/plans.json");
    const device = await openDevice();
    const errors = [];
    device.addEventListener("uncapturederror", (event) => errors.push(event.error.message));
    return { plans, device, errors, kernels: new KernelCache(device, plans) };
  })();
  return opened;
}

export const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

export function textOf(array) {
  const bytes = new Uint8Array(array.buffer ?? array);
  let text = "";
  for (let i = 0; i < bytes.length; i += 8192) {
    text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  }
  return btoa(text);
}

/** Return the matrix world → camera at `eye` that looks at `target`. */
export function viewTowards(eye, target, up) {
  return viewOf(turnTowards(target.map((x, i) => x - eye[i]), up), eye);
}

/** Compile every module, and return all messages of the compiler, by module. */
export async function compile() {
  const { plans, device } = await opening();
  const messages = {};
  for (const [row, { label, constants, text }] of plans.modules.entries()) {
    const module = device.createShaderModule({ label, code: constants + plans.texts[text] });
    const { messages: list } = await module.getCompilationInfo();
    if (list.length) messages[`${label} ${row}`] = list.map((m) => `${m.type}: ${m.message}`);
  }
  return { messages, count: plans.modules.length };
}

/** Return values of formulas: [formula, sizes] each. */
export function evaluateAll(cases) {
  return cases.map(([formula, sizes]) => evaluate(formula, sizes));
}

/** Return the bytes of uniforms: [{camera, background, pages}] each. */
export async function uniformsOf(cases) {
  const plans = await loadPlans("/client/plans.json");
  return cases.map(({ camera, background, pages }) => [
    textOf(uniforms.frameUniform(plans, camera, background)),
    textOf(uniforms.pageUniforms(plans, pages, camera)),
  ]);
}

/** Return splats in GPU memory. */
function buffersOf(device, plans, { rows, appearance, half, count, ...facts }) {
  const packed = new Float32Array(bytesOf(rows).buffer);
  const numbers = bytesOf(appearance).buffer;
  const dtype = half ? "float16" : "float32";
  const buffers = new SplatBuffers(device, plans, { ...facts, count: packed.length / 10 }, dtype);
  const colors = half ? new Uint16Array(numbers) : new Float32Array(numbers);
  buffers.write(0, packed, paddedRows(colors, facts.channels, buffers.stride));
  buffers.count = count;
  return buffers;
}

/** Draw sets from cameras, and return the images with the counts of each. */
export async function draw({ sets, cameras, outputs, background, pairs }) {
  const { plans, device, errors, kernels } = await opening();
  const renderer = new Renderer(kernels);
  if (pairs) renderer._pairs = pairs;
  const placed = sets.map(({ splats, ...rest }) => {
    return { buffers: buffersOf(device, plans, splats), ...rest };
  });
  renderer.setScene(placed);
  const frames = [];
  for (const camera of cameras) {
    await renderer.drawWhole(camera, { outputs, background });
    const images = {};
    for (const output of outputs) images[output] = textOf(await renderer.readImage(output));
    frames.push({ images, counts: renderer.counts, deep: renderer.host.plan.deep });
  }
  renderer.destroy();
  for (const { buffers } of placed) buffers.destroy();
  return { frames, errors: errors.splice(0) };
}

/** Return the first plan of a shape at given sizes. */
export async function choose(shape, sizes) {
  return choosePlan(await loadPlans("/client/plans.json"), shape, sizes);
}

/** Return the parts of served splat files as Python reads them; errors with their hints. */
export async function splatFiles(paths, isInWorker = true) {
  const read = isInWorker ? readInBackground : readRequest;
  const results = [];
  for (const path of paths) {
    const parts = [];
    const sink = {
      begin(facts) {
        const stride = 4 * Math.ceil(facts.channels / 4);
        return parts.push({ facts, stride, rows: new Float32Array(10 * facts.count), appearance: new Float32Array(stride * facts.count) }) - 1;
      },
      write(part, first, rows, appearance) {
        if (rows) parts[part].rows.set(rows, 10 * first);
        parts[part].appearance.set(appearance, parts[part].stride * first);
      },
      grow() {},
      end: (part, count, extent) => Object.assign(parts[part].facts, { count, extent }),
    };
    try {
      const { kind } = await read({ name: path, address: String(new URL(path, location)) }, sink);
      results.push({ kind, parts: parts.map(({ facts, stride, rows, appearance }) => {
        return { ...facts, stride, rows: textOf(rows), appearance: textOf(appearance) };
      }) });
    } catch (error) {
      results.push({ error: error.message, hint: error.hint, stack: error.stack });
    }
  }
  return results;
}

/** Return uris, box and geometric error of all tiles of implicit trees, subtree by subtree. */
export async function implicitTiles(address) {
  const { root, schema } = await (await fetch(address)).json();
  const tiles = [];
  const visit = async (tile) => {
    const subtree = tile.subtree ?? firstSubtree(tile);
    if (subtree) {
      const data = await (await fetch(new URL(subtree.uri, address))).arrayBuffer();
      return visit(subtreeRoot(data, subtree, schema, subtree.uri));
    }
    const uris = (tile.contents ?? [tile.content ?? []]).flatMap(({ uri = [] }) => uri);
    tiles.push([uris, tile.boundingVolume.box, tile.geometricError]);
    for (const child of tile.children ?? []) await visit(child);
  };
  await visit(root);
  return tiles;
}

/** Return what the page finds wrong with served models: an address and a target each. */
export async function findings(models) {
  const judged = async ([path, target]) => {
    const data = await (await fetch(path)).arrayBuffer();
    return findingsOf(inspected(new Uint8Array(data), { target }));
  };
  return Promise.all(models.map(judged));
}

/** Return numbers and texts as rules write them. */
export function written(numbers, texts, specs) {
  const rows = numbers.map((number) => {
    const value = py.float(number);
    return [py.repr(value), ...specs.map((spec) => py.format(value, spec))];
  });
  return [rows, texts.map(py.repr)];
}

/** Draw frames of a generator one after the other in one session, as an element does. */
export async function generatorFrames(path, frames) {
  const { device, errors, kernels } = await opening();
  let model = null;
  const renderer = new Renderer(kernels);
  const result = { images: [], isCaptured: false, errors: [], rebound: 0 };
  try {
    model = await openModel(kernels, await (await fetch(path)).arrayBuffer(), path);
    result.isCaptured = model.isCaptured;
    const place = () => renderer.setScene(model.sets);
    place();
    for (const { camera, values } of frames) {
      if (await model.update(values, camera)) {
        place();
        result.rebound += 1;
      }
      await renderer.drawWhole(camera);
      result.images.push(textOf(await renderer.readImage("color")));
    }
    result.extent = model.extent;
    result.isLinear = model.buffers.isLinear;
  } catch (error) {
    result.error = `${error.message} | ${error.hint ?? error.stack}`;
  }
  renderer.destroy();
  model?.destroy();
  result.errors = errors.splice(0);
  return result;
}

/** Open a generator twice at the same time, run both, and return what is wrong. */
export async function openTwice(path, { camera, values }) {
  const { errors, kernels } = await opening();
  const data = await (await fetch(path)).arrayBuffer();
  const models = await Promise.all([0, 1].map(() => openModel(kernels, data.slice(0), path)));
  await Promise.all(models.map((model) => model.update(values, camera)));
  const extents = models.map(({ extent }) => extent);
  for (const model of models) model.destroy();
  return { extents, errors: errors.splice(0) };
}

/** Draw a tileset from cameras, each once its tiles have arrived. */
export async function tilesetFrames(address, cameras, options) {
  const { device, errors, kernels } = await opening();
  const failures = [];
  kernels.plans.streaming.fadeSeconds = 1e-9; // pictures are compared
  const tileset = await (await fetch(address)).arrayBuffer();
  const onError = ({ message }) => failures.push(message);
  const model = await openModel(kernels, tileset, address, {
    ...options, source: address, onChange() {}, onError,
  });
  const renderer = new Renderer(kernels);
  renderer.setScene(model.sets);
  const frames = [];
  const counted = ["createBuffer", "createBindGroup", "createComputePipelineAsync"];
  for (const camera of cameras) {
    await model.update({}, camera);
    for (let frame = 0; frame < 2; frame++) await renderer.draw(camera);
    const created = [];
    for (const name of counted) {
      device[name] = (...rest) => created.push(name) && GPUDevice.prototype[name].apply(device, rest);
    }
    const levels = [];
    for (await model.update({}, camera); model.loading; await model.update({}, camera)) {
      await renderer.draw(camera);
      levels.push(model.drawn.length);
      await new Promise((resolve) => setTimeout(resolve, 100));
    }
    for (const name of counted) delete device[name];
    await renderer.drawWhole(camera);
    const live = model.sets.reduce((sum, { buffers }) => sum + buffers.count, 0);
    const image = textOf(await renderer.readImage("color"));
    const drawn = model.drawn.flatMap(({ uris }) => uris).sort();
    frames.push({ drawn, live, created, levels, image });
  }
  renderer.destroy();
  model.destroy();
  return { frames, failures, extent: model.extent, up: model.up, errors: errors.splice(0) };
}

/** Fly from one camera to another that is known before, then share the slots with a second tileset. */
export async function knownPathAndBudget(address, [first, last], options) {
  const { errors, kernels } = await opening();
  kernels.plans.streaming.fadeSeconds = 0.25;
  const tileset = await (await fetch(address)).arrayBuffer();
  const failures = [];
  const open = () => {
    const onError = ({ message }) => failures.push(message);
    return openModel(kernels, tileset, address, { ...options, source: address, onChange() {}, onError });
  };
  const model = await open();
  const settle = async (...words) => {
    for (let frame = 0; frame < 20 || model.loading; frame++) {
      await model.update({}, ...words);
      await new Promise((resolve) => setTimeout(resolve, 20));
    }
    return { ...model.statistics, slots: model.sets.length };
  };
  const opacities = () => model.sets.filter(({ buffers }) => buffers.count).map(({ opacityScale }) => opacityScale);
  const alone = await settle(first);
  const ahead = await settle(first, (seconds) => (seconds < 4 ? first : last));
  await model.update({}, last);
  const fades = [opacities()];
  const arrived = { ...model.statistics };
  await settle(last);
  fades.push(opacities());
  const other = await open();
  const shared = [await settle(last), { slots: other.sets.length }];
  other.destroy();
  await other.update({}, last); // as of a scene that goes in the midst of a frame
  shared.push({ slots: other.sets.length });
  const again = await settle(last);
  model.destroy();
  return { alone, ahead, arrived, fades, shared, again, failures, errors: errors.splice(0) };
}

/**
 * Stream a tileset along a journey; return the files that are drawn at some moments.
 * @param {{address: string, views: number[][], rate: number, moments: number[], camera: any, slowness: number, options: any, isKnown?: boolean}} journey
 *     `views` are world → camera, so many a second, which the tileset knows before or not. The page's
 *     clock goes slower, as the server does.
 */
export async function streamedJourney({ address, views, rate, moments, camera, slowness, options, isKnown = false }) {
  const { kernels } = await opening();
  performance.now = () => Performance.prototype.now.call(performance) / slowness;
  const tileset = await (await fetch(address)).arrayBuffer();
  const failures = [];
  const onError = ({ message }) => failures.push(message);
  const begin = performance.now();
  const model = await openModel(kernels, tileset, address, { ...options, source: address, onChange() {}, onError });
  const [shots, left] = [[], [...moments]];
  let [frame, frames, holes, entries, hits] = [-1, 0, 0, 0, 0];
  let wanted = new Set(); // tiles that are seen and not refined
  const misses = { "not asked for": 0, "on the way": 0, decoded: 0 };
  const cameraAt = (time) => ({ ...camera, view: views[Math.min(Math.floor(time * rate), views.length - 1)] });
  for (;;) {
    const now = (performance.now() - begin) / 1000;
    const next = Math.floor(now * rate);
    if (next >= views.length) break;
    if (next > frame) {
      frame = next;
      await model.update({}, cameraAt(now), isKnown ? (seconds) => cameraAt(now + seconds) : null);
      [frames, holes] = [frames + 1, holes + Number(model.statistics.holes > 0)];
      const { seen, refined } = model._shown;
      const before = wanted;
      wanted = new Set([...seen.keys()].filter((tile) => tile.uris.length && !refined.has(tile)));
      const entered = [...wanted].filter((tile) => !before.has(tile));
      [entries, hits] = [entries + entered.length, hits + entered.filter(({ slots }) => slots).length];
      for (const tile of entered.filter(({ slots }) => !slots)) {
        const flight = model._planner.pending.get(tile);
        misses[flight ? (flight.isRead ? "decoded" : "on the way") : "not asked for"] += 1;
      }
      if (now >= left[0]) {
        const files = model.drawn.flatMap(({ quality, files: names, uris }) => names[quality]?.uri ?? uris);
        shots.push({ moment: left.shift(), now, files });
      }
    }
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
  delete performance.now;
  const { statistics } = model;
  const unseen = [...model._planner._unseen.values()].reduce((sum, bytes) => sum + bytes, statistics.wasted);
  model.destroy();
  return { shots, failures, frames, holes, statistics, hitRate: hits / entries, waste: unseen / statistics.received, misses };
}

/** Draw sets in several sizes with one renderer; return the images, and how many buffers each size took. */
export async function drawInSizes({ sets, cameras, sizes }) {
  const { plans, device, errors, kernels } = await opening();
  const placed = sets.map(({ splats, ...rest }) => {
    return { buffers: buffersOf(device, plans, splats), ...rest };
  });
  const renderer = new Renderer(kernels);
  renderer.setScene(placed);
  const { createBuffer } = device;
  let labels = [];
  device.createBuffer = (description) => {
    labels.push(description.label);
    return createBuffer.call(device, description);
  };
  const counted = async (camera) => {
    labels = [];
    await renderer.configure(camera, ["color"]);
    return labels.length;
  };
  const frames = [];
  try {
    for (const camera of cameras) {
      const created = await counted(camera);
      await renderer.drawWhole(camera, { outputs: ["color"] });
      frames.push({ created, image: textOf(await renderer.readImage("color")) });
    }
    const created = [];
    for (const [width, height] of sizes) created.push(await counted({ ...cameras[0], width, height }));
    return { frames, created, errors: errors.splice(0) };
  } finally {
    delete device.createBuffer;
    renderer.destroy();
    for (const { buffers } of placed) buffers.destroy();
  }
}
