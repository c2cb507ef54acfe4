/** Reads PLY files of splats, plain or compressed, and of coloured points. */

import { readCompressed } from "./compressed_ply.js";
import { failing } from "./errors.js";
import { ByteSource } from "./byte_source.js";
import { columnsOf, readHeader, skipElement } from "./ply_header.js";
import { RowWriter, constantTerm, logit } from "./row_writer.js";

const CONVERT = "Convert it: gsgen convert FILE model.spz";
const COLORS = [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];
const CONSTANT = ["f_dc_0", "f_dc_1", "f_dc_2"];
const SHAPE = ["rot_0", "rot_1", "rot_2", "rot_3", "scale_0", "scale_1", "scale_2", "opacity"];
const MOVING = /^(motion_\d+|omega_\d+|trbf_\w+|binding_\d+|scale_t|t_scale|rot_r_\d+|rotation_r_\d+)$/;
const COLOR_SPACE = "color_space"; // the element, and its property, of SHARP
const MOST_OFFSET = 16384; // of a coordinate, beyond which float32 has steps of over 1/1000
const ORIGIN_STEP = 1000;
const LEAST_LOSS = 1e-4;
const NINE_DIGITS = 5.001e-9; // the largest relative error of nine digits, which identify a float32

const { fround } = Math;

/** @param {import("./byte_source.js").ByteSource} source @param {import("./splat_files.js").Context} context */
export async function readPly(source, { sink }) {
  const header = await readHeader(source);
  const fail = failing(source.name, CONVERT);
  const index = header.elements.findIndex(({ name }) => name === "vertex");
  if (index < 0) fail("has no element vertex");
  const vertex = header.elements[index];
  const names = vertex.properties.map(({ name }) => name);
  if (!vertex.count) fail("has 0 rows");
  if (names.includes("packed_position")) return readCompressed(source, header, sink);
  if (vertex.hasLists) fail("has lists in its rows");
  const moving = names.filter((name) => MOVING.test(name));
  if (moving.length) fail(`has ${moving.slice(0, 6).join(", ")}: splats that move or follow triangles`, "Export a generator: gsgen export");
  let isLinear = false;
  for (const element of header.elements.slice(0, index)) {
    if (element.name === COLOR_SPACE) isLinear = Boolean(await isLinearSpace(source, header, element));
    else await skipElement(source, header, element);
  }
  const isOfSplats = [...CONSTANT, ...SHAPE].some((name) => names.includes(name)) || names.some((name) => /^f_rest_\d+$/.test(name));
  if (!isOfSplats) return readPoints(source, header, vertex, sink, fail);
  return readRows(source, header, index, isLinear, sink, fail);
}

function typeOf(vertex, name) {
  return vertex.properties.find((property) => property.name === name)?.type;
}

async function readRows(source, header, index, isLinear, sink, fail) {
  const vertex = header.elements[index];
  const names = vertex.properties.map(({ name }) => name);
  const hasConstant = CONSTANT.some((name) => names.includes(name));
  const colors = hasConstant ? null : COLORS.find((group) => group.every((name) => names.includes(name)));
  const higher = names.filter((name) => /^f_rest_\d+$/.test(name)).length;
  const coefficients = 1 + higher / 3;
  if (![1, 4, 9, 16, 25].includes(coefficients)) fail(`has ${higher} columns f_rest_*, expected 0, 9, 24, 45 or 72`);
  const drawn = Math.min(coefficients, 16);
  // f_rest holds all red coefficients, then all green, then all blue.
  const rest = Array.from({ length: 3 * (drawn - 1) }, (_, i) => `f_rest_${(i % 3) * (coefficients - 1) + Math.floor(i / 3)}`);
  const filter = names.includes("filter_3D") ? ["filter_3D"] : [];
  const columns = ["x", "y", "z", ...SHAPE, ...filter, ...(colors ?? CONSTANT), ...rest];
  const missing = columns.filter((name) => !names.includes(name));
  if (missing.length) fail(`has no ${missing.join(", ")}`, `A PLY of Gaussians has x y z f_dc_* opacity scale_* rot_*. ${CONVERT}`);
  const isWide = isWideAt(header, vertex);
  const later = header.elements.slice(index + 1);
  const space = later.findIndex(({ name }) => name === COLOR_SPACE);
  let origin = [0, 0, 0];
  if (isWide || space >= 0) {
    const bytes = await source.rest();
    const again = () => ByteSource.of(bytes, source.name);
    if (isWide) origin = await originOf(again(), header, vertex);
    if (space >= 0) {
      const end = again();
      for (const element of [vertex, ...later.slice(0, space)]) await skipElement(end, header, element);
      isLinear = Boolean(await isLinearSpace(end, header, later[space]));
    }
    source = again();
  }
  const { isMip, up } = header;
  const antialias = isMip || filter.length > 0;
  const writer = new RowWriter(sink, source.name, {
    count: vertex.count, coefficients, antialias, isLinear, up, transform: movedTo(origin),
  });
  const width = columns.length;
  const firstHarmonic = 11 + filter.length;
  const divisor = colors && typeOf(vertex, colors[0]) === "Uint8" ? 255 : 1;
  for await (const t of columnsOf(source, header, vertex, columns, writer.batch)) {
    for (let row = 0, i = 0; row < t.length / width; row++, i += width) {
      let [scale0, scale1, scale2, opacity] = [t[i + 7], t[i + 8], t[i + 9], t[i + 10]];
      if (filter.length) [scale0, scale1, scale2, opacity] = smoothed(scale0, scale1, scale2, opacity, t[i + 11]);
      let base = writer.place(
        t[i] - origin[0], t[i + 1] - origin[1], t[i + 2] - origin[2],
        t[i + 3], t[i + 4], t[i + 5], t[i + 6], scale0, scale1, scale2, opacity,
      );
      for (let k = firstHarmonic; k < width; k++) writer.appearance[base++] = t[i + k];
      if (colors) {
        base -= width - firstHarmonic;
        for (let c = 0; c < 3; c++) {
          const color = fround(t[i + firstHarmonic + c] / divisor);
          if (!(color >= 0 && color <= 1)) fail(`has the colour ${color} in row ${row}, expected 0 to 1`);
          writer.appearance[base + c] = constantTerm(color);
        }
      }
      writer.keep();
    }
    await writer.flush();
  }
  writer.end();
}

/** Apply the filter of Mip-Splatting (Yu et al. 2023, equation 7): a variance s² becomes s² + f². */
function smoothed(scale0, scale1, scale2, opacity, size) {
  size = fround(size);
  if (size === 0) return [scale0, scale1, scale2, opacity];
  const width = 2 * Math.log(Math.abs(size));
  const widened = [scale0, scale1, scale2].map((scale) => {
    const own = 2 * fround(scale);
    const [low, high] = [Math.min(own, width), Math.max(own, width)];
    return (high + Math.log1p(Math.exp(low - high))) / 2;
  });
  const change = [scale0, scale1, scale2].reduce((sum, scale, i) => sum + fround(scale) - widened[i], 0);
  const share = fround(1 / (1 + Math.exp(-fround(opacity)))) * Math.exp(change);
  return [...widened, logit(share)];
}

/** Return what positions are relative to: zero, unless float32 would round them to over 1/10,000. */
async function originOf(source, header, vertex) {
  const [low, high] = [Array(3).fill(Infinity), Array(3).fill(-Infinity)];
  let loss = 0;
  let isPrinted = ["x", "y", "z"].every((axis) => typeOf(vertex, axis) === "Float32");
  for await (const table of columnsOf(source, header, vertex, ["x", "y", "z"], 1 << 12)) {
    for (let i = 0; i < table.length; i += 3) {
      const error = [0, 1, 2].map((axis) => Math.abs(table[i + axis] - fround(table[i + axis])));
      isPrinted &&= error.every((own, axis) => !(own > NINE_DIGITS * Math.abs(table[i + axis])));
      if (!error.every(Number.isFinite)) continue;
      loss = Math.max(loss, ...error);
      for (let axis = 0; axis < 3; axis++) {
        low[axis] = Math.min(low[axis], table[i + axis]);
        high[axis] = Math.max(high[axis], table[i + axis]);
      }
    }
  }
  const isNear = Math.max(...[...low, ...high].map(Math.abs)) <= MOST_OFFSET;
  if (isPrinted || isNear || loss < LEAST_LOSS || low[0] > high[0]) return [0, 0, 0];
  return low.map((least, axis) => ORIGIN_STEP * roundedToEven((least + high[axis]) / 2 / ORIGIN_STEP));
}

/** @type {(origin: number[]) => number[]} */
const movedTo = ([x, y, z]) => [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1];

/** Return whether positions may have more digits than float32. */
function isWideAt({ encoding }, vertex) {
  return encoding === "ascii" || !["x", "y", "z"].every((axis) => typeOf(vertex, axis) === "Float32");
}

function roundedToEven(number) {
  const below = Math.floor(number);
  return number - below === 0.5 ? 2 * Math.round(below / 2) : Math.round(number);
}

/** Return whether the element of SHARP says that colours are linear. */
async function isLinearSpace(source, header, element) {
  if (element.count !== 1 || !typeOf(element, COLOR_SPACE)) return skipElement(source, header, element);
  let space = 0;
  for await (const [value] of columnsOf(source, header, element, [COLOR_SPACE], 1)) space = value;
  if (space !== 0 && space !== 1) failing(source.name)(`has the colour space ${space}, expected 0 or 1`);
  return space === 1;
}

async function readPoints(source, header, vertex, sink, fail) {
  const names = vertex.properties.map(({ name }) => name);
  const found = (group) => group.filter((name) => names.includes(name)).length;
  const colors = COLORS.reduce((best, group) => (found(group) > found(best) ? group : best));
  const columns = ["x", "y", "z", ...colors];
  const missing = columns.filter((name) => !names.includes(name));
  if (missing.length) fail(`has no ${missing.join(", ")}`, "A PLY of Gaussians has x y z f_dc_* opacity scale_* rot_*, one of points a colour.");
  const types = colors.map((name) => typeOf(vertex, name));
  const isBytes = types.every((type) => type === "Uint8");
  if (!isBytes && !types.every((type) => type?.startsWith("Float"))) fail(`has colours of the types ${types}, expected uchar or float`);
  const bytes = await source.rest();
  const tables = (group) => columnsOf(ByteSource.of(bytes, source.name), header, vertex, group, 1 << 12);
  const origin = isWideAt(header, vertex) ? await originOf(ByteSource.of(bytes, source.name), header, vertex) : [0, 0, 0];
  const points = new Float32Array(3 * vertex.count);
  const shades = new Float32Array(3 * vertex.count);
  let count = 0;
  for await (const table of tables(columns)) {
    for (let i = 0; i < table.length; i += 6) {
      for (let c = 0; c < 3; c++) {
        points[3 * count + c] = table[i + c] - origin[c];
        shades[3 * count + c] = fround(table[i + 3 + c]) / (isBytes ? 255 : 1);
        if (!(shades[3 * count + c] >= 0 && shades[3 * count + c] <= 1)) fail(`has the colour ${table[i + 3 + c]}, expected 0 to 1`);
      }
      if (Number.isFinite(points[3 * count] + points[3 * count + 1] + points[3 * count + 2])) count += 1;
    }
  }
  const { writePoints } = await import("./point_cloud.js");
  await writePoints(new RowWriter(sink, source.name, { count, space: "rgb", transform: movedTo(origin) }), points.subarray(0, 3 * count), shades);
}
