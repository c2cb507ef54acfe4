/** The attributes of the element, each parsed as HTML or CSS parse its kind of value. */

const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?/i;
const ANGLES = { "": 1, deg: 1, rad: 180 / Math.PI, grad: 0.9, turn: 360 }; // degrees of CSS's units
const LENGTHS = { "": 1, m: 1 };
const MOST = 1e9; // of an angle or a length
const LEAST_DISTANCE = 1e-9;
const PLAIN_CHANNEL = /^[\d.]+$/;

/** @typedef {(problem: string) => void} Complain Tells what is wrong with a value. */
/**
 * @typedef {object} Attribute
 * @property {any} fallback The value without the attribute.
 * @property {(text: string, complain: Complain) => any} parse Undefined stands for the fallback.
 * @property {"parsed" | "written" | "address" | "presence"} reflects What the property returns.
 */

/** @returns {Attribute} */
const text = () => ({ fallback: "", parse: (value) => value, reflects: "written" });

/** @returns {Attribute} */
const address = () => ({
  fallback: "",
  parse: (value, complain) => value.trim() || complain("is empty, expected an address"),
  reflects: "address",
});

/** @returns {Attribute} Addresses between spaces. */
const list = () => ({
  fallback: [],
  parse: (value) => value.trim().split(/\s+/).filter(Boolean),
  reflects: "written",
});

/** @returns {Attribute} An attribute that is on where it is written, whatever its value. */
function flag() {
  const parse = (value, complain) => {
    if (/^(false|0|no|off)$/i.test(value)) complain("is on: an attribute is off where it is absent");
    return true;
  };
  return { fallback: false, parse, reflects: "presence" };
}

/** @returns {Attribute} The first keyword is the default. */
function keyword(...words) {
  const parse = (value, complain) => {
    const word = value.trim().toLowerCase();
    return words.includes(word) ? word : complain(`is none of ${words.filter(Boolean).join(", ")}`);
  };
  return { fallback: words[0], parse, reflects: "parsed" };
}

/** Return the number of a text that has one of some units; NaN of other texts. */
function parsedNumber(value, units) {
  const [digits = ""] = NUMBER.exec(value) ?? [];
  return digits ? Number(digits) * (units[value.slice(digits.length).toLowerCase()] ?? NaN) : NaN;
}

/** @returns {Attribute} */
function number(low, high, { fallback = /** @type {number | null} */ (null), units = { "": 1 }, step = 0 } = {}) {
  const expected = `${step ? "a whole number" : "a number"}${Number.isFinite(high) ? ` from ${low} to ${high}` : ""}`;
  const parse = (value, complain) => {
    const given = parsedNumber(value.trim(), /** @type {Record<string, number>} */ (units));
    if (!Number.isFinite(given)) return complain(`is not ${expected}`);
    const nearest = Math.min(Math.max(step ? Math.round(given) : given, low), high);
    if (nearest !== given) complain(`is not ${expected}; it is taken as ${nearest}`);
    return nearest;
  };
  return { fallback, parse, reflects: "parsed" };
}

/**
 * @param {string} what
 * @param {{units: Record<string, number>, least: number}[]} parts Of each number.
 * @returns {Attribute} Numbers between spaces or commas; `auto`, here null, stands for the default.
 */
function numbers(what, ...parts) {
  const parse = (value, complain) => {
    const words = value.trim().toLowerCase().split(/\s*,\s*|\s+/);
    const values = words.map((word, i) => (word === "auto" ? null : parsedNumber(word, parts[i]?.units ?? {})));
    const isGood = (part, i) => part === null || (part >= parts[i]?.least && part <= MOST);
    return values.length <= parts.length && values.every(isGood) ? values : complain(`is not ${what}`);
  };
  return { fallback: [], parse, reflects: "written" };
}

const angle = { units: ANGLES, least: -MOST };
const coordinate = { units: LENGTHS, least: -MOST };
const orbit = () =>
  numbers("azimuth, elevation (degrees) and distance, or auto", angle, angle, { units: LENGTHS, least: LEAST_DISTANCE });

/** @returns {Attribute} A colour of CSS, or red, green and blue from 0 to 1. */
function color() {
  const parse = (value, complain) => {
    // A relative colour computes to the numbers of any colour, however it is written.
    const relative = (origin) => `color(from ${origin} srgb r g b / alpha)`;
    const channels = value.trim().split(/\s*,\s*|\s+/);
    const isPlain = channels.length === 3 && channels.every((channel) => PLAIN_CHANNEL.test(channel));
    if (isPlain && channels.some((channel) => Number(channel) > 1)) {
      complain(`has numbers above 1; it is taken as rgb(${channels.join(" ")})`);
      return relative(`rgb(${channels.join(" ")})`);
    }
    const found = relative(isPlain ? `color(srgb ${channels.join(" ")})` : value);
    if (CSS.supports("color", found)) return found;
    return complain("is no colour of CSS, such as white, #102030 or transparent");
  };
  return { fallback: null, parse, reflects: "written" };
}

/** Return red, green, blue and alpha of a parsed colour, as CSS computes it for an element. */
export function computedColor(element, relative) {
  element.style.color = relative;
  const words = getComputedStyle(element).color.match(/[-\d.]+(e[-+]?\d+)?|none/g) ?? [];
  const [red = 0, green = 0, blue = 0, alpha = 1] = words.map((word) => Number(word) || 0);
  return [red, green, blue, alpha].map((part) => Math.min(Math.max(part, 0), 1));
}

/** @type {Record<string, Attribute>} */
export const ATTRIBUTES = {
  src: address(),
  alt: text(),
  name: text(),
  poster: address(),
  images: list(),
  posts: list(),
  "image-cameras": address(),
  loading: keyword("lazy", "eager"),
  "camera-controls": flag(),
  "file-drop": flag(),
  autoplay: flag(),
  loop: flag(),
  time: number(-Infinity, Infinity),
  "camera-orbit": orbit(),
  "camera-target": numbers("a point x y z, or auto", coordinate, coordinate, coordinate),
  "min-camera-orbit": orbit(),
  "max-camera-orbit": orbit(),
  "field-of-view": number(1, 170, { fallback: 50, units: ANGLES }),
  "auto-rotate": flag(),
  "rotation-per-second": number(-360, 360, { fallback: 12, units: ANGLES }),
  up: keyword("", "x", "y", "z", "+x", "+y", "+z", "-x", "-y", "-z"),
  background: color(),
  "min-render-scale": number(0.1, 1, { fallback: 0.5 }),
  mode: keyword("color", "depth", "median", "normal", "alpha"),
  target: keyword("webgpu", "core", "gsgen", "visionary"),
  "max-error": number(0.01, 1e6),
  "max-splats": number(4096, 2 ** 26, { step: 1 }),
};

/** Return the property of an attribute: `cameraOrbit` of `camera-orbit`. */
export const propertyOf = (name) => name.replace(/-(.)/g, (_, letter) => letter.toUpperCase());
