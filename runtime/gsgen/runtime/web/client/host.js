/**
 * Executes frame plans on a GPU device.
 *
 * Pipelines are compiled once per device, and all at once. Buffers and bind groups belong to one
 * drawing. Buffers only grow: a smaller image has parts of them.
 */

import { failing } from "./errors.js";
import { remembered } from "./once.js";
import { choosePlan, evaluate } from "./plan.js";

const BINDING_TYPES = { u: "uniform", r: "read-only-storage", w: "storage" };

/**
 * Consecutive Gaussians in GPU buffers.
 * @typedef {object} Page
 * @property {string} kind How the appearance is stored, as plans name it.
 * @property {number} capacity Number of rows.
 * @property {GPUBuffer} rows
 * @property {number} rowsOffset Bytes before the page's first row.
 * @property {GPUBuffer} appearance
 * @property {number} appearanceOffset
 * @property {number} firstRow The page's first row in its set.
 * @property {GPUBuffer} [cells] The cells of its set, for weighted sums.
 * @property {number} [setCells]
 */
/**
 * What is drawn, from how many pages, with at most how many pairs of a splat and a tile.
 * @typedef {{outputs: string[], panorama: boolean, deep: boolean, weighted: boolean,
 *     layers: number, width: number, height: number, pairs: number, pages: Page[]}} Drawing
 */

const ROOM = 1.25; // of a buffer that grows: its new size to the last one

/** Return what plans have in common that draw the same in several sizes. @param {import("./plan.js").Plan} plan */
const shapeOf = ({ outputs, panorama, deep, weighted, layers }) => JSON.stringify([outputs, panorama, deep, weighted, layers]);

/** Return the first page of each set. @param {Page[]} pages */
const setsOf = (pages) => pages.filter((page) => page.firstRow === 0);

/** The compiled kernels of a device. */
export class KernelCache {
  /** @param {GPUDevice} device @param {import("./plan.js").PlanDocument} plans */
  constructor(device, plans) {
    this.device = device;
    this.plans = plans;
    /** Opens generators where the device only holds buffers. @type {((data: any, name: string) => Promise<any>) | null} */
    this.openGenerator = null;
    this._modules = new Map();
    this._layouts = new Map();
    this._pipelines = new Map();
  }

  module(row) {
    return remembered(this._modules, row, () => {
      const { label, constants, text } = this.plans.modules[row];
      return this.device.createShaderModule({ label, code: constants + this.plans.texts[text] });
    });
  }

  /** @param {string} kinds One letter per binding. @returns {GPUBindGroupLayout} */
  layout(kinds) {
    return remembered(this._layouts, kinds, () => {
      const visibility = GPUShaderStage.COMPUTE;
      const entries = [...kinds].map((kind, binding) => {
        return { binding, visibility, buffer: { type: BINDING_TYPES[kind] } };
      });
      return this.device.createBindGroupLayout({ label: kinds, entries });
    });
  }

  pipeline(row) {
    return remembered(this._pipelines, row, () => {
      const { label, module, entry, groups } = this.plans.pipelines[row];
      const bindGroupLayouts = groups.map((kinds) => this.layout(kinds));
      const layout = this.device.createPipelineLayout({ bindGroupLayouts });
      const compute = { module: this.module(module), entryPoint: entry };
      return this.device.createComputePipelineAsync({ label, layout, compute });
    });
  }

  /**
   * Return the bind groups of a pipeline.
   * @param {number} pipeline Its row in the plans.
   * @param {GPUBufferBinding[][]} groups The resources of each bind group.
   */
  bound(pipeline, groups) {
    const kinds = this.plans.pipelines[pipeline].groups;
    return groups.map((resources, index) => {
      const entries = resources.map((resource, binding) => ({ binding, resource }));
      return this.device.createBindGroup({ layout: this.layout(kinds[index]), entries });
    });
  }

  /**
   * Return a dispatch of a kernel that stands in the plans by itself.
   * @param {{pipeline: number, groups: import("./plan.js").Formula[]}} kernel
   * @param {import("./plan.js").Sizes} sizes
   * @param {GPUBufferBinding[][]} groups The resources of each bind group.
   */
  async step({ pipeline, groups: counts }, sizes, ...groups) {
    return {
      pipeline: await this.pipeline(pipeline),
      groups: this.bound(pipeline, groups),
      counts: counts.map((count) => evaluate(count, sizes)),
    };
  }

  /** The pipeline that shows an image on a canvas, whose format is the same for all. @returns {GPURenderPipeline} */
  get presenting() {
    return remembered(this._pipelines, -1, () => {
      const { vertex, fragment, module: row } = this.plans.present;
      const module = this.module(row);
      const format = navigator.gpu.getPreferredCanvasFormat();
      return this.device.createRenderPipeline({
        label: "present",
        layout: "auto",
        vertex: { module, entryPoint: vertex },
        fragment: { module, entryPoint: fragment, targets: [{ format }] },
      });
    });
  }
}

/**
 * Encode dispatches in one pass.
 * @param {GPUCommandEncoder} encoder
 * @param {any[]} steps Pipeline, bind groups, and counts or an indirect buffer of each dispatch.
 */
export function encodePass(encoder, label, steps) {
  const pass = encoder.beginComputePass({ label });
  for (const { pipeline, groups, counts, indirect } of steps) {
    pass.setPipeline(pipeline);
    groups.forEach((group, index) => pass.setBindGroup(index, group));
    if (indirect) pass.dispatchWorkgroupsIndirect(indirect[0], indirect[1]);
    else pass.dispatchWorkgroups(counts[0], counts[1], counts[2]);
  }
  pass.end();
}

/** The buffers, bind groups and commands of a drawing. */
export class PlanHost {
  /** @param {KernelCache} kernels */
  constructor(kernels) {
    this.kernels = kernels;
    this.device = kernels.device;
    this.plans = kernels.plans;
    /** @type {Map<number, GPUBuffer>} */
    this._buffers = new Map();
    /** @type {Map<string, {resources: any[], group: GPUBindGroup}>} */
    this._groups = new Map();
    /** @type {{label: string, steps: any[]}[]} */
    this._passes = [];
    /** @type {import("./plan.js").Plan | null} */
    this.plan = null;
  }

  /**
   * Prepare all that a drawing needs; frames can be encoded when the promise resolves.
   * @param {Drawing} drawing
   */
  async configure(drawing) {
    const sizes = {
      width: drawing.width,
      height: drawing.height,
      pairs: drawing.pairs,
      pages: drawing.pages.length,
      gaussians: drawing.pages.reduce((sum, page) => sum + page.capacity, 0),
      cells: setsOf(drawing.pages).reduce((sum, page) => sum + (page.setCells ?? 0), 0),
    };
    const plan = choosePlan(this.plans, drawing, sizes);
    const stages = Object.entries(plan.stages).map(([label, entries]) => {
      return { label, steps: entries.flatMap((entry) => this._stepsOf(entry, drawing.pages)) };
    });
    const rows = stages.flatMap(({ steps }) => steps.map(({ step }) => step.pipeline));
    /** @type {Map<number, GPUComputePipeline>} */
    const pipelines = new Map();
    await Promise.all(
      [...new Set(rows)].map(async (row) => pipelines.set(row, await this.kernels.pipeline(row))),
    );
    this._allocate(plan, sizes);
    const used = new Set();
    this._passes = stages.map(({ label, steps }) => ({
      label,
      steps: steps.map(({ step, page, slot }) => {
        const all = { ...sizes, slot, capacity: page?.capacity ?? 0, set_cells: page?.setCells ?? 0 };
        return {
          pipeline: pipelines.get(step.pipeline),
          groups: step.binds.map((row) => this._group(row, page, slot, all, used)),
          counts: step.groups && step.groups.map((count) => evaluate(count, all)),
          indirect: step.indirect && [this._buffer(step.indirect[0]), step.indirect[1]],
        };
      }),
    }));
    for (const key of this._groups.keys()) if (!used.has(key)) this._groups.delete(key);
    this.plan = plan;
    this.sizes = sizes;
  }

  /** Return the steps of a stage's entry: one, or one of each page or set. */
  _stepsOf(entry, pages) {
    if (typeof entry === "number") return [{ step: this.plans.steps[entry], page: null, slot: 0 }];
    const repeated = "set" in entry ? setsOf(pages) : pages;
    return repeated.map((page, slot) => {
      return { step: this.plans.steps[entry.set ?? entry[page.kind]], page, slot };
    });
  }

  /** Make the buffers that are too small, and release those that such drawings lack. */
  _allocate(plan, sizes) {
    const isSameShape = this.plan && shapeOf(this.plan) === shapeOf(plan);
    for (const [row, buffer] of this._buffers) {
      if (isSameShape || plan.buffers.includes(row)) continue;
      buffer.destroy();
      this._buffers.delete(row);
    }
    for (const row of plan.buffers) {
      const { label, size, usage, data, sizes: words = [] } = this.plans.buffers[row];
      const last = this._buffers.get(row);
      const bytes = evaluate(size, sizes);
      const isNew = !last || last.size < bytes;
      if (isNew) {
        last?.destroy();
        this._buffers.set(row, this._create(label, bytes, last?.size ?? 0, usage));
      }
      if (data && (isNew || words.length)) {
        const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
        const view = new DataView(bytes.buffer);
        for (const [offset, name] of words) view.setUint32(offset, sizes[name], true);
        this.device.queue.writeBuffer(this._buffer(row), 0, bytes);
      }
    }
  }

  /** Create a buffer; one that grows gets room, so that it seldom does. */
  _create(label, size, last, usage) {
    const { maxStorageBufferBindingSize, maxBufferSize } = this.device.limits;
    const most = Math.min(maxStorageBufferBindingSize, maxBufferSize);
    if (size > most) {
      failing(label, "Show fewer Gaussians or a smaller image.")(`would take ${size} bytes; this device binds at most ${most}`);
    }
    const roomy = Math.min(16 * Math.ceil((ROOM * last) / 16), most);
    return this.device.createBuffer({ label, size: Math.max(size, roomy), usage });
  }

  _buffer(row) {
    return /** @type {GPUBuffer} */ (this._buffers.get(row));
  }

  /** Return a bind group of a table row, made anew if one of its buffers was. */
  _group(row, page, slot, sizes, used) {
    const key = page ? `${row}/${slot}` : `${row}`;
    used.add(key);
    const { kinds, entries } = this.plans.binds[row];
    const resources = entries.map(([name, offset, size]) => {
      const first = typeof name === "string" ? (page[`${name}Offset`] ?? 0) : 0;
      const buffer = typeof name === "string" ? page[name] : this._buffer(name);
      // Shaders measure what is bound: of a buffer that has room, only the part in use.
      const whole = typeof name === "string" ? buffer.size : this.plans.buffers[name].size;
      const bytes = evaluate(size ?? whole, sizes);
      return { buffer, offset: first + evaluate(offset, sizes), size: bytes };
    });
    const known = this._groups.get(key);
    const isSame = (resource, index) => {
      const other = known.resources[index];
      return ["buffer", "offset", "size"].every((name) => resource[name] === other[name]);
    };
    if (known && resources.every(isSame)) return known.group;
    const group = this.device.createBindGroup({
      label: key,
      layout: this.kernels.layout(kinds),
      entries: resources.map((resource, binding) => ({ binding, resource })),
    });
    this._groups.set(key, { resources, group });
    return group;
  }

  /** Encode all passes of a frame. @param {GPUCommandEncoder} encoder */
  encode(encoder) {
    for (const [row, offset, size] of this.plan.clears) {
      encoder.clearBuffer(this._buffer(row), offset, size ?? undefined);
    }
    for (const { label, steps } of this._passes) encodePass(encoder, label, steps);
  }

  image(output) {
    return this._buffer(this.plan.images[output]);
  }

  input(name) {
    return this._buffer(this.plan.inputs[name]);
  }

  /** Release all buffers. */
  destroy() {
    for (const buffer of this._buffers.values()) buffer.destroy();
    this._buffers.clear();
    this._groups.clear();
  }
}
