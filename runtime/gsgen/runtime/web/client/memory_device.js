/** A device whose buffers lie in the page's memory, so that models without WebGPU are filled as others are. */

/** @typedef {{size: number, bytes: ArrayBuffer, numbers: Float32Array | null}} MemoryBuffer */

/** Return a device that holds and writes buffers, and computes nothing. */
export function memoryDevice(limits) {
  /** @type {any} */
  const device = {
    limits,
    createBuffer: ({ size }) => ({ size, bytes: new ArrayBuffer(size), numbers: null, destroy() {} }),
    queue: {
      writeBuffer(buffer, offset, source, first = 0, size = source.byteLength - first) {
        new Uint8Array(buffer.bytes, offset, size).set(new Uint8Array(source, first, size));
        buffer.numbers = null;
      },
    },
  };
  return device;
}

/** Return the numbers of a buffer; the same array until they change. @param {any} buffer */
export function numbersOf(buffer) {
  return (buffer.numbers ??= new Float32Array(buffer.bytes));
}
