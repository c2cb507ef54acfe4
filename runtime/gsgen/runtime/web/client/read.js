/** Reads GPU buffers back, outside of a frame's path. */

/**
 * Return a copy of the first numbers of a buffer.
 * @template {ArrayBufferView} T
 * @param {GPUDevice} device
 * @param {GPUBuffer} buffer
 * @param {new (bytes: ArrayBuffer, offset?: number, count?: number) => T} Numbers
 * @param {number} count
 * @returns {Promise<T>}
 */
export async function readBuffer(device, buffer, Numbers, count) {
  const bytes = /** @type {any} */ (Numbers).BYTES_PER_ELEMENT * count;
  const size = Math.ceil(bytes / 4) * 4;
  const usage = GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST;
  const copy = device.createBuffer({ label: "read", size, usage });
  const encoder = device.createCommandEncoder({ label: "read" });
  encoder.copyBufferToBuffer(buffer, 0, copy, 0, size);
  device.queue.submit([encoder.finish()]);
  try {
    await copy.mapAsync(GPUMapMode.READ);
    return new Numbers(copy.getMappedRange().slice(0), 0, count);
  } finally {
    copy.destroy();
  }
}
