/** Opens or makes what a page needs once, such as its graphics device. */

/**
 * Return a function that opens something at its first call, and returns the same promise later.
 * @template T
 * @param {() => Promise<T>} open
 * @param {(value: T) => Promise<any>} [loss] After a failure or a loss, the next call opens again.
 * @returns {() => Promise<T>}
 */
export function once(open, loss = () => new Promise(() => {})) {
  /** @type {Promise<T> | null} */
  let current = null;
  return () => {
    if (!current) {
      const opening = open();
      const forget = () => {
        if (current === opening) current = null;
      };
      current = opening;
      opening.then(loss).then(forget, forget);
    }
    return current;
  };
}

/** Return a function that runs tasks one after the other, and returns the promise of each. */
export function inTurns() {
  let last = /** @type {Promise<any>} */ (Promise.resolve());
  return (task) => {
    const result = last.then(task);
    last = result.catch(() => {}); // who asked for a task gets its error
    return result;
  };
}

/** Return the value of a key in a map, which is made if it is absent. */
export function remembered(map, key, make) {
  if (!map.has(key)) map.set(key, make());
  return map.get(key);
}
