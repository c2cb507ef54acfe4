// Reads the manifest's text, and holds it against a published JSON Schema.

export class NotTheManifest extends Error {}

const MAX_CHARACTERS = 4194304; // M4.5

/** Return the document of `text`, with the strictness of M4.
 *
 * `JSON.parse` reads RFC 8259 (M1.1): no NaN, no comments. It lets pass three things that M4
 * forbids: repeated keys (M4.6), halves of surrogate pairs (M4.8) and numbers beyond float64
 * (M4.9). A walk over the tokens of a text that is known to be JSON finds those. */
export function readDocument(text) {
  if ([...text].length > MAX_CHARACTERS) throw new NotTheManifest('more than 4,194,304 characters');
  let value;
  try {
    value = JSON.parse(text); // refuses a byte order mark, too: M4.7
  } catch (error) {
    throw new NotTheManifest(`not JSON: ${error.message}`);
  }
  const tokens = /"(?:[^"\\]|\\.)*"|-?\d[\d.eE+-]*|[{}[\],]/g;
  const open = []; // for each open object the keys so far, for each open array null
  let isKey = false;
  for (const [token] of text.matchAll(tokens)) {
    if (token === '{' || token === '[') open.push(token === '{' ? new Set() : null);
    else if (token === '}' || token === ']') open.pop();
    else if (token[0] === '"') {
      const word = JSON.parse(token);
      if (!word.isWellFormed()) throw new NotTheManifest(`half a surrogate pair in ${token}`);
      if (isKey) {
        if (open.at(-1).has(word)) throw new NotTheManifest(`the key ${token} is repeated`);
        open.at(-1).add(word);
      }
    } else if (token !== ',' && !Number.isFinite(Number(token))) {
      throw new NotTheManifest(`${token} is beyond float64`);
    }
    isKey = token === '{' || (token === ',' && open.at(-1) !== null);
  }
  if (value === null || typeof value !== 'object' || Array.isArray(value)) {
    throw new NotTheManifest('not an object');
  }
  return value;
}

const TYPES = {
  object: (v) => v !== null && typeof v === 'object' && !Array.isArray(v),
  array: Array.isArray,
  string: (v) => typeof v === 'string',
  number: (v) => typeof v === 'number',
  integer: Number.isInteger, // M4.4: 3.0 is an integer
  boolean: (v) => typeof v === 'boolean',
};

/** Return the first place where `value` breaks `schema`, or undefined; `root` has the $defs.
 *
 * These are all keywords of draft 2020-12 that the published schemas use. */
export function breach(value, schema, root = schema, where = 'manifest', newerMinor = false) {
  if (schema === true) return undefined;
  if (schema === false) return where;
  if (schema.$ref) {
    return breach(value, root.$defs[schema.$ref.split('/').at(-1)], root, where, newerMinor);
  }
  if (schema.anyOf) {
    const fits = schema.anyOf.some((part) => !breach(value, part, root, where, newerMinor));
    return fits ? undefined : where;
  }
  if (schema.type && !TYPES[schema.type](value)) return `${where} is not of type ${schema.type}`;
  if (schema.enum && !schema.enum.includes(value)) return `${where} is none of ${schema.enum}`;
  if (typeof value === 'string') {
    if ([...value].length < (schema.minLength ?? 0)) return `${where} is empty`;
    if (schema.pattern && !new RegExp(schema.pattern, 'u').test(value)) return `${where}: ${value}`;
  } else if (typeof value === 'number') {
    const {minimum = -Infinity, maximum = Infinity, exclusiveMinimum = -Infinity} = schema;
    if (!(value >= minimum && value <= maximum && value > exclusiveMinimum)) return `${where}: ${value}`;
  } else if (Array.isArray(value)) {
    if (value.length < (schema.minItems ?? 0)) return `${where} has ${value.length} items`;
    if (value.length > (schema.maxItems ?? Infinity)) return `${where} has ${value.length} items`;
    for (const [i, item] of value.entries()) {
      const found = schema.items && breach(item, schema.items, root, `${where}[${i}]`, newerMinor);
      if (found) return found;
    }
  } else if (TYPES.object(value)) {
    for (const key of schema.required ?? []) if (!(key in value)) return `${where}.${key} is missing`;
    for (const [key, item] of Object.entries(value)) {
      const patterns = Object.entries(schema.patternProperties ?? {});
      const part = Object.hasOwn(schema.properties ?? {}, key) ? schema.properties[key]
        : patterns.find(([pattern]) => new RegExp(pattern, 'u').test(key))?.[1]
          // M74: fields that came with a newer minor version are ignored.
          ?? (newerMinor ? true : schema.additionalProperties ?? true);
      const found = breach(item, part, root, `${where}.${key}`, newerMinor);
      if (found) return found;
    }
  }
  return undefined;
}
