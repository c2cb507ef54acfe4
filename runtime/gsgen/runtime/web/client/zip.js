/** Reads the directory of zip archives, and unpacks their files. */

import { ByteSource } from "./byte_source.js";
import { failing } from "./errors.js";

const [END, END_BYTES, ENTRY_BYTES, HEADER_BYTES] = [0x06054b50, 22, 46, 30];
const DEFLATED = 8;

/**
 * Return the files of a zip archive by name, in its order; each is a function that opens it.
 * @param {Uint8Array} data
 * @returns {Map<string, {size: number, open: () => ByteSource}>}
 */
export function filesOfZip(data, name) {
  const fail = failing(name, "Copy or download the file again.");
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  let end = data.length - END_BYTES;
  while (end >= 0 && view.getUint32(end, true) !== END) end--;
  if (end < 0) fail("is a damaged or cut off ZIP archive: it has no directory");
  const files = new Map();
  try {
    let entry = view.getUint32(end + 16, true);
    for (let index = 0; index < view.getUint16(end + 10, true); index++) {
      const [method, length, ...others] = [10, 28, 30, 32].map((i) => view.getUint16(entry + i, true));
      const [packed, size, local] = [20, 24, 42].map((i) => view.getUint32(entry + i, true));
      const file = new TextDecoder().decode(data.subarray(entry + ENTRY_BYTES, entry + ENTRY_BYTES + length));
      const lengths = [26, 28].map((i) => view.getUint16(local + i, true));
      const first = local + HEADER_BYTES + lengths[0] + lengths[1];
      const open = () => {
        const source = ByteSource.of(data.subarray(first, first + packed), `${name}/${file}`);
        return method === DEFLATED ? source.unpacked("deflate-raw") : source;
      };
      files.set(file, { size, open });
      entry += ENTRY_BYTES + length + others[0] + others[1];
    }
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    fail(`is a damaged or cut off ZIP archive: ${error.message}`);
  }
  return files;
}
