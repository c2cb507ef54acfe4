/**
 * Python's operations on values, for the rules that `make web` translates to contract_rules.js.
 *
 * Lists and tuples are arrays, dicts are maps, None is null, integers are numbers. A Python float
 * is a Number object, or a number with decimals: 1.0 is written otherwise than 1.
 */

const keyOf = (value) => (Array.isArray(value) ? JSON.stringify(value) : value?.valueOf() ?? null);
const isFloat = (value) => value instanceof Number || (typeof value === "number" && !Number.isInteger(value));

/** A dataclass: static `fields` are name, class of JSON values, and default of each. */
export class Record {
  /** @type {[string, any, any][]} */
  static fields = [];
  static get __dataclass_fields__() {
    return this.fields.map(([name]) => name);
  }
  constructor(...values) {
    const { fields } = /** @type {typeof Record} */ (this.constructor);
    for (const [i, [name, , makeDefault]] of fields.entries()) {
      this[name] = values[i] === undefined ? (makeDefault?.() ?? null) : values[i];
    }
  }
}

/** Return a property of an object, which is computed once. */
export const cached = (owner, name, compute) => {
  return Object.defineProperty(owner, name, { value: compute.call(owner) })[name];
};

/** Return the record that a JSON value describes; numbers of the kind Number become floats. */
export function fromJson(kind, value) {
  if (Array.isArray(value)) return value.map((entry) => fromJson(kind, entry));
  if (typeof value?.valueOf() === "number") return kind === Number ? float(value) : value.valueOf();
  if (!kind?.fields || value == null) return value;
  const field = ([name, kindOf]) => fromJson(kindOf?.(), value.get(name.replace(/_$/, "")));
  return new kind(...kind.fields.map(field));
}

/** Return a violation of a rule. */
export const violation = (where, actual, expected, certainty = "confirmed") => {
  return { where, actual, expected, certainty };
};

// Types and conversions.
export const float = (value) => Object(Number(value));
export const int = (value) => Math.trunc(Number(value));
export const list = (values = []) => [...iter(values)];
export const set = (values = []) => new Set(map(keyOf, values));
export const dict = (entries) => new Map(entries instanceof Map ? entries : map(([key, value]) => [keyOf(key), value], entries));

export function bool(value) {
  if (value == null || value instanceof Record) return value != null;
  return Boolean(value.length ?? value.size ?? value.valueOf());
}

export function isinstance(value, kind) {
  if (Array.isArray(kind)) return kind.some((entry) => isinstance(value, entry));
  if (kind === int) return typeof value === "number" && !isFloat(value);
  if (kind === float) return isFloat(value);
  if (kind === bool) return typeof value === "boolean";
  if (kind === str) return typeof value === "string";
  if (kind === list) return Array.isArray(value);
  return value instanceof (kind === dict ? Map : kind);
}

// Texts.
export function str(value) {
  return typeof value === "string" ? value : repr(value);
}

export function repr(value) {
  if (value == null) return "None";
  if (value.__str__) return value.__str__();
  if (isFloat(value)) return floatText(Number(value));
  if (typeof value === "boolean") return value ? "True" : "False";
  if (Array.isArray(value)) return `[${value.map(repr).join(", ")}]`;
  if (value instanceof Map) return `{${[...value].map((pair) => pair.map(repr).join(": ")).join(", ")}}`;
  if (typeof value !== "string") return value.message ?? String(value);
  const quote = value.includes("'") && !value.includes('"') ? '"' : "'";
  const escaped = JSON.stringify(value).slice(1, -1).replaceAll('\\"', '"');
  return quote + (quote === "'" ? escaped.replaceAll("'", "\\'") : escaped) + quote;
}

/** Return the shortest digits of a float, as Python writes them. */
function floatText(value) {
  const [digits, exponent] = value.toExponential().split("e");
  if (value && (Number(exponent) < -4 || Number(exponent) > 15)) return digits + exponentText(exponent);
  return Number.isInteger(value) ? `${value}.0` : String(value);
}

function exponentText(exponent) {
  return `e${exponent[0]}${exponent.slice(1).padStart(2, "0")}`;
}

/** Return a number in a format: `g`, `.3g` or `.1f`. */
export function format(value, spec) {
  const precision = Number(/\.(\d+)/.exec(spec)?.[1] ?? 6);
  if (spec.endsWith("f")) return fixed(Number(value), precision);
  const [digits, exponent] = Number(value).toExponential(precision - 1).split("e");
  const trimmed = (text) => (text.includes(".") ? text.replace(/\.?0+$/, "") : text);
  const power = Number(exponent);
  if (power < -4 || power >= precision) return trimmed(digits) + exponentText(exponent);
  return trimmed(fixed(Number(value), precision - 1 - power));
}

/** Return a number with decimals; a half is rounded to an even digit. */
function fixed(value, decimals) {
  const halves = 2 * value * 10 ** decimals;
  const isHalf = Number.isInteger(value * 2 ** (decimals + 1)) && Math.abs(halves % 4) === 1;
  return (isHalf ? (halves - Math.sign(halves)) / 2 / 10 ** decimals : value).toFixed(decimals);
}

/** Return the value of a JSON text; objects are maps, numbers with a point floats. */
export function loads(text) {
  /** @type {(key: string, value: any, context?: {source: string}) => any} */
  const revive = (_, value, context) => {
    if (typeof value === "number" && /[.eE]/.test(context?.source ?? "")) return float(value);
    return value && Object.getPrototypeOf(value) === Object.prototype ? new Map(Object.entries(value)) : value;
  };
  return JSON.parse(text, revive);
}

export function dumps(value) {
  if (Array.isArray(value)) return `[${value.map(dumps).join(", ")}]`;
  if (value instanceof Map) return `{${[...value].map((pair) => pair.map(dumps).join(": ")).join(", ")}}`;
  return isFloat(value) ? repr(value) : JSON.stringify(value);
}


// Operators.
export const plus = (a, b) => (Array.isArray(a) ? [...a, ...b] : a + b);
export const minus = (a, b) => (a instanceof Set ? new Set([...a].filter((each) => !b.has(each))) : a - b);
export const union = (a, b) => (a instanceof Map ? new Map([...a, ...b]) : new Set([...a, ...b]));
export const or = (first, ...others) => others.reduce((value, next) => (bool(value) ? value : next()), first);
export const and = (first, ...others) => others.reduce((value, next) => (bool(value) ? next() : value), first);

export function eq(a, b) {
  if (a instanceof Set && b instanceof Set) return a.size === b.size && [...a].every((key) => b.has(key));
  if (!Array.isArray(a) || !Array.isArray(b)) return keyOf(a) === keyOf(b);
  return a.length === b.length && a.every((entry, i) => eq(entry, b[i]));
}

/** Return a negative number if a comes before b, 0 if they are equal, else a positive one. */
export function compare(a, b) {
  if (!Array.isArray(a)) return a < b ? -1 : Number(a > b);
  const first = a.findIndex((entry, i) => i >= b.length || !eq(entry, b[i]));
  return first < 0 || first >= b.length ? a.length - b.length : compare(a[first], b[first]);
}

// Bytes: texts of a character each.
export const fromBytes = (bytes) => [...bytes].reduceRight((number, byte) => 256 * number + byte.charCodeAt(0), 0);

/** Return the text of a file's first bytes, the last of which may be cut off. */
export function decoded(bytes) {
  const encoding = { "\xff\xfe": "utf-16le", "\xfe\xff": "utf-16be" }[bytes.slice(0, 2)] ?? "utf-8";
  const numbers = Uint8Array.from(bytes, (byte) => byte.charCodeAt(0));
  return new TextDecoder(encoding).decode(numbers, { stream: true });
}

export const endsWith = (text, ends) => [ends].flat().some((end) => text.endsWith(end));
export const startsWith = (text, starts) => [starts].flat().some((start) => text.startsWith(start));

export function partition(text, mark) {
  const place = text.indexOf(mark);
  return place < 0 ? [text, "", ""] : [text.slice(0, place), mark, text.slice(place + mark.length)];
}

export function rpartition(text, mark) {
  const place = text.lastIndexOf(mark);
  return place < 0 ? ["", "", text] : [text.slice(0, place), mark, text.slice(place + mark.length)];
}

// Containers.
export const iter = (values) => (values instanceof Map ? values.keys() : values);
export const len = (values) => values.length ?? values.size;
export const get = (map, key, fallback = null) => map.get(keyOf(key)) ?? fallback;
export const count = (values, value) => [...values].filter((each) => eq(each, value)).length;
export const counter = (values) => dict([...values].map((value, _, all) => [value, count(all, value)]));
export const slice = (values, low, high) => values.slice(low ?? 0, high ?? undefined);

export function item(values, key) {
  const value = values instanceof Map ? values.get(keyOf(key)) : values.at(key);
  if (value === undefined) throw new RangeError(`no item ${repr(key)}`);
  return value;
}

export function contains(values, value) {
  if (typeof values === "string") return values.includes(value);
  return Array.isArray(values) ? values.some((each) => eq(each, value)) : values.has(keyOf(value));
}

// Functions of iterables.
export function* map(convert, values) {
  for (const value of iter(values)) yield convert(value);
}
export const zip = (first, ...others) => first.map((value, i) => [value, ...others.map((other) => other[i])]);
export const sorted = (values, keyed = (value) => value) => [...iter(values)].sort((a, b) => compare(keyed(a), keyed(b)));
export const [min, max] = [-1, 1].map((sign) => (values, fallback) => {
  const better = (best, value) => (sign * compare(value, best) > 0 ? value : best);
  const [first = fallback, ...others] = iter(values);
  return others.reduce(better, first);
});
