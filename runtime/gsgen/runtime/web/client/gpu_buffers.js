/** Buffers in GPU memory, and reading them back outside of a frame's path. */

// Without WebGPU buffers lie in memory, whose use nobody asks.
const { STORAGE, UNIFORM, COPY_SRC, COPY_DST, MAP_READ } = /** @type {any} */ (globalThis.GPUBufferUsage ?? {});

/** Return a storage buffer of at least some bytes. @returns {GPUBuffer} */
export function storageBuffer(device, label, bytes) {
  const usage = STORAGE | COPY_DST | COPY_SRC;
  return device.createBuffer({ label, size: Math.max(16, Math.ceil(bytes / 16) * 16), usage });
}

/** Return a buffer of uniforms. @returns {GPUBuffer} */
export function uniformBuffer(device, label, size) {
  return device.createBuffer({ label, size, usage: UNIFORM | COPY_DST });
}

/** Return a buffer through which others are read. @returns {GPUBuffer} */
export function readingBuffer(device, label, size) {
  return device.createBuffer({ label, size, usage: MAP_READ | COPY_DST });
}

/**
 * Return a copy of some numbers of a buffer, from an offset in bytes on.
 * @template {ArrayBufferView} T
 * @param {GPUDevice} device
 * @param {GPUBuffer} buffer
 * @param {new (bytes: ArrayBuffer, offset?: number, count?: number) => T} Numbers
 * @returns {Promise<T>}
 */
export async function readBuffer(device, buffer, Numbers, count, offset = 0) {
  const bytes = /** @type {any} */ (Numbers).BYTES_PER_ELEMENT * count;
  const size = Math.ceil(bytes / 4) * 4;
  const copy = readingBuffer(device, "read", size);
  const encoder = device.createCommandEncoder({ label: "read" });
  encoder.copyBufferToBuffer(buffer, offset, copy, 0, size);
  device.queue.submit([encoder.finish()]);
  try {
    await copy.mapAsync(GPUMapMode.READ);
    return new Numbers(copy.getMappedRange().slice(0), 0, count);
  } finally {
    copy.destroy();
  }
}
