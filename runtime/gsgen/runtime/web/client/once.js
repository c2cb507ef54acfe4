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

/** Return the value of a key in a map, made if it is absent; beyond `most`, the key that was asked for first goes. */
export function remembered(map, key, make, most = Infinity) {
  const value = map.has(key) ? map.get(key) : make();
  map.delete(key);
  map.set(key, value);
  if (map.size > most) map.delete(map.keys().next().value);
  return value;
}
