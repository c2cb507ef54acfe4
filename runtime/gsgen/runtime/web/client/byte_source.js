/** Bytes that arrive: taken in pieces of any size, or all that are left. */

import { GsgenError, failing } from "./errors.js";

export class ByteSource {
  /**
   * @param {ReadableStream<Uint8Array> | null} stream
   * @param {string} name Of the file, for messages.
   * @param {number} [size] Of the whole file; 0 if nobody tells it.
   */
  constructor(stream, name, size = 0) {
    this.name = name;
    this.size = size;
    this.position = 0; // bytes that were taken
    this._reader = stream?.getReader();
    /** @type {Uint8Array[]} */
    this._pieces = [];
    this._held = 0;
  }

  /** @param {ArrayBuffer | Uint8Array} bytes */
  static of(bytes, name) {
    const source = new ByteSource(null, name, bytes.byteLength);
    source._pieces.push(bytes instanceof Uint8Array ? bytes : new Uint8Array(bytes));
    source._held = bytes.byteLength;
    return source;
  }

  /** Wait for some bytes; return how many are there, which are fewer at the end of the file. */
  async fill(count) {
    while (this._held < count && this._reader) {
      const { done, value } = await this._read();
      if (done) this._reader = undefined;
      else {
        this._pieces.push(value);
        this._held += value.length;
      }
    }
    return Math.min(this._held, count);
  }

  async _read() {
    try {
      return await this._reader.read();
    } catch (error) {
      if (error.name === "AbortError" || error.hint !== undefined) throw error;
      const details = { where: this.name, hint: "Download it again.", isTransient: error.name === "TypeError" };
      throw new GsgenError(`cannot be read to its end: ${error.message}`, details);
    }
  }

  /** Return a copy of the next bytes, which stay. */
  async peek(count) {
    return this._copy(await this.fill(count), false);
  }

  /** Return the next bytes in a buffer of their own; fewer at the end of the file. */
  async take(count) {
    return this._copy(await this.fill(count), true);
  }

  /** Return the next bytes; fail if the file ends before. @returns {Promise<Uint8Array<ArrayBuffer>>} */
  async need(count, what) {
    const bytes = await this.take(count);
    if (bytes.length < count) {
      const problem = `ends within ${what}: ${this.position} bytes, expected ${this.position - bytes.length + count}`;
      failing(this.name, "Download it again.")(problem);
    }
    return bytes;
  }

  /** Pass over bytes. */
  async skip(count) {
    for (let left = count; left > 0; left -= 1 << 20) await this.need(Math.min(left, 1 << 20), "its rows");
  }

  /** Put back the end of what was taken. @param {Uint8Array} bytes */
  unread(bytes) {
    if (bytes.length) this._pieces.unshift(bytes);
    this._held += bytes.length;
    this.position -= bytes.length;
  }

  /** Return all bytes that are left. */
  async rest() {
    let bytes = new Uint8Array(Math.max(this.size - this.position, this._held));
    let length = 0;
    while (await this.fill(1)) {
      const pieces = this._pieces.splice(0);
      const needed = length + this._held;
      if (needed > bytes.length) {
        const grown = new Uint8Array(Math.max(2 * bytes.length, needed));
        grown.set(bytes.subarray(0, length));
        bytes = grown;
      }
      for (const piece of pieces) {
        bytes.set(piece, length);
        length += piece.length;
      }
      this._held = 0;
    }
    this.position += length;
    return bytes.subarray(0, length);
  }

  /** Return what unpacks the bytes that are left. @param {CompressionFormat} format */
  unpacked(format) {
    const stream = new ReadableStream({
      pull: async (controller) => {
        const count = await this.fill(1);
        if (count) controller.enqueue(await this.take(this._pieces[0].length));
        else controller.close();
      },
    });
    return new ByteSource(stream.pipeThrough(new DecompressionStream(format)), this.name);
  }

  _copy(count, isTaken) {
    const bytes = new Uint8Array(count);
    let length = 0;
    let index = 0;
    while (length < count) {
      const piece = this._pieces[index];
      const part = piece.subarray(0, count - length);
      bytes.set(part, length);
      length += part.length;
      if (part.length === piece.length) index += 1;
      else if (isTaken) this._pieces[index] = piece.subarray(part.length);
    }
    if (isTaken) {
      this._pieces.splice(0, index);
      this._held -= count;
      this.position += count;
    }
    return bytes;
  }
}
