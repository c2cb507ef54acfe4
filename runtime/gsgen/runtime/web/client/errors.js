/** Errors that a visitor of a page can act on. */

/** What is wrong with a model, a file or the browser: where, the problem, and what helps. */
export class GsgenError extends Error {
  /**
   * @param {string} message The problem, with the actual and the expected value.
   * @param {{where?: string, hint?: string, rule?: string, findings?: any[],
   *     isTransient?: boolean}} [details] Transient is what another attempt may not meet.
   */
  constructor(message, { where = "", hint = "", rule = "", findings = [], isTransient = false } = {}) {
    super(where ? `${where}: ${message}` : message);
    this.name = "GsgenError";
    this.where = where;
    this.hint = hint;
    this.rule = rule;
    this.findings = findings;
    this.isTransient = isTransient;
  }
}

/** Return a function that throws the error of a file or model: its problem, and what helps. */
export function failing(where, usual = "") {
  return (message, hint = usual, rule = "") => {
    throw new GsgenError(message, { where, hint, rule });
  };
}
