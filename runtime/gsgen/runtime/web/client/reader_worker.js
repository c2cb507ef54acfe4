/** The worker that reads files: takes requests, and posts what readers say to their sinks. */

import { GsgenError } from "./errors.js";
import { readRequest } from "./splat_files.js";

const MOST_UNTAKEN = 8; // batches of rows that the page has not taken yet

/** @type {Map<number, {stop: AbortController, untaken: number, proceed: () => void}>} */
const readings = new Map();

/** @param {any} message @param {ArrayBufferLike[]} [owned] Buffers that change hands. */
function post(message, owned = []) {
  /** @type {any} */ (self).postMessage(message, owned);
}

async function read(id, request) {
  const reading = { stop: new AbortController(), untaken: 0, proceed: () => {} };
  const { signal } = reading.stop;
  readings.set(id, reading);
  let parts = 0;
  const tell = (call, args, owned) => post({ id, call, args }, owned);
  const sink = {
    begin(facts) {
      tell("begin", [facts]);
      return parts++;
    },
    async write(part, first, rows, appearance) {
      tell("write", [part, first, rows, appearance], rows ? [rows.buffer, appearance.buffer] : [appearance.buffer]);
      if (++reading.untaken < MOST_UNTAKEN) return;
      await new Promise((resolve) => (reading.proceed = () => resolve(null)));
      signal.throwIfAborted();
    },
    grow: (...args) => tell("grow", args),
    end: (...args) => tell("end", args),
  };
  try {
    const result = await readRequest(request, sink, (...args) => tell("progress", args), signal);
    tell("resolve", [result], result.bytes ? [result.bytes.buffer] : []);
  } catch (error) {
    const { message, stack, where, hint, rule, findings, isTransient } = error;
    const isOurs = error instanceof GsgenError;
    if (!signal.aborted) tell("reject", [{ isOurs, message, stack, where, hint, rule, findings, isTransient }]);
  } finally {
    readings.delete(id);
  }
}

self.onmessage = ({ data: { id, request, isAborted } }) => {
  if (request) return read(id, request);
  const reading = readings.get(id);
  if (isAborted) reading?.stop.abort();
  else if (reading) reading.untaken -= 1;
  reading?.proceed();
};
post({ call: "ready" });
