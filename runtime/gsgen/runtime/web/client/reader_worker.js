/** The worker that reads files: takes requests, and posts what readers say to their sinks. */

import { GsgenError } from "./errors.js";
import { readRequest } from "./splat_files.js";

/** @type {Map<number, AbortController>} */
const stops = new Map();

/** @param {any} message @param {ArrayBufferLike[]} [owned] Buffers that change hands. */
function post(message, owned = []) {
  /** @type {any} */ (self).postMessage(message, owned);
}

async function read(id, request) {
  const stop = new AbortController();
  stops.set(id, stop);
  let parts = 0;
  const tell = (call, args, owned) => post({ id, call, args }, owned);
  const sink = {
    begin(facts) {
      tell("begin", [facts]);
      return parts++;
    },
    write(part, first, rows, appearance) {
      tell("write", [part, first, rows, appearance], rows ? [rows.buffer, appearance.buffer] : [appearance.buffer]);
    },
    end: (...args) => tell("end", args),
  };
  try {
    const result = await readRequest(request, sink, (...args) => tell("progress", args), stop.signal);
    tell("resolve", [result], result.bytes ? [result.bytes.buffer] : []);
  } catch (error) {
    const { message, stack, where, hint, rule, findings } = error;
    if (!stop.signal.aborted) tell("reject", [{ isOurs: error instanceof GsgenError, message, stack, where, hint, rule, findings }]);
  } finally {
    stops.delete(id);
  }
}

self.onmessage = ({ data: { id, request, isAborted } }) => {
  if (isAborted) stops.get(id)?.abort();
  else read(id, request);
};
post({ call: "ready" });
