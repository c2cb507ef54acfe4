// The drop page: shows files of this computer by <gsgen-scene>, with what its rules find, and what
// to type next. Dropped files have addresses of a host that does not exist, which `fetch` answers
// from memory: nothing is uploaded, and files find those beside them.

const HOST = "https://dropped.invalid/";
const SPLATS = /\.(ply|spz|sog|splat|ksplat|glb|gltf)$/i;
const MOST_FINDINGS = 50;

/** @type {Map<string, File>} */
const files = new Map();
const network = globalThis.fetch;
globalThis.fetch = async (request, options) => {
  const address = String(request?.url ?? request);
  if (!address.startsWith(HOST)) return network(request, options);
  const file = files.get(decodeURIComponent(new URL(address).pathname));
  if (!file) return new Response(null, { status: 404, statusText: "was not dropped with the others" });
  return new Response(file, { headers: { "Content-Length": String(file.size) } });
};
// A worker would ask its own `fetch`.
Object.defineProperty(globalThis, "Worker", { value: undefined, configurable: true });

const page = document.querySelector("#drop");
const model = page.querySelector("gsgen-scene");
const report = page.querySelector("#drop-report");
const status = page.querySelector("#drop-status");
let drops = 0;

/** Return an element with a text or children; texts of files are never parsed as HTML. */
function element(tag, attributes = {}, ...children) {
  const result = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) result.setAttribute(name, value);
  result.append(...children);
  return result;
}

/** Yield the files of a dropped entry with their paths: of a folder, all that are in it. */
async function* filesOf(entry) {
  if (entry.isFile) {
    yield [entry.fullPath, await new Promise((resolve, reject) => entry.file(resolve, reject))];
    return;
  }
  const reader = entry.createReader();
  for (;;) {
    const entries = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!entries.length) return;
    for (const inner of entries) yield* filesOf(inner);
  }
}

/** Return what kind of file a path looks like, the best to show first. */
async function kindOf(path, file) {
  const name = path.split("/").pop();
  if (/\.onnx$/i.test(name)) return [0, "model"];
  if (/\.json$/i.test(name) && file.size < 1e8) {
    const text = await file.text();
    if (/"geometricError"/.test(text)) return [name === "tileset.json" ? 1 : 3, "tileset"];
    if (/"gsgen_scene"|"models"\s*:/.test(text)) return [0, "scene"];
    if (/"means"/.test(text)) return [2, "splats"];
    return [9, ""];
  }
  return SPLATS.test(name) || /\.zip$/i.test(name) ? [2, "splats"] : [9, ""];
}

const bytes = (size) => (size < 1e6 ? `${(size / 1e3).toFixed(1)} kB` : `${(size / 1e6).toFixed(1)} MB`);
const quoted = (path) => (/^[\w./-]+$/.test(path) ? path : `'${path.replaceAll("'", "'\\''")}'`);

/** Return the commands that come next. */
function commandsOf(kind, path, errors) {
  const file = quoted(path.slice(1));
  const shown = [`gsgen render ${file} -o picture.png`, `gsgen view ${file}`];
  if (kind === "tileset") return [`gsgen validate ${file}`, `gsgen tiles info ${file}`, ...shown];
  if (kind === "scene") return [...shown, `gsgen export html ${file} -o page.html`];
  if (kind === "splats") return [...shown, `gsgen convert ${file} smaller.sog`, `gsgen export html ${file} -o page.html`];
  const rules = errors.filter(({ rule }) => rule).map(({ rule }) => `gsgen explain ${rule}`);
  return [`gsgen validate ${file}`, ...new Set(rules), ...(rules.length ? [`gsgen fix ${file} -o fixed.onnx`] : [...shown, `gsgen bake ${file} -o splats.ply`])];
}

/** Return a table; its cells are texts or elements. */
function table(head, rows) {
  const row = (cells, tag) => element("tr", {}, ...cells.map((cell) => element(tag, {}, cell ?? "")));
  return element("table", {}, element("thead", {}, row(head, "th")), element("tbody", {}, ...rows.map((cells) => row(cells, "td"))));
}

/** Return the name of a rule, which leads to its page where the site is around. */
function ruleLink(rule) {
  const root = page.dataset.root;
  return root && rule ? element("a", { href: `${root}rules/${rule}/` }, rule) : rule;
}

/** Tell what is known of the file that is shown, or why it is not. */
function tell(kind, path, total, others) {
  const { manifest, errors = [], findings = [] } = model.report ?? {};
  const count = model.state === "ready" ? model.dataset.count : "";
  const facts = [["file", path.slice(1)], ["kind", kind], ["bytes", bytes(total)]];
  if (count) facts.push(["Gaussians", Number(count).toLocaleString("en")]);
  if (manifest?.name) facts.push(["name", manifest.name]);
  for (const input of manifest?.inputs ?? []) facts.push([`input ${input.name}`, [input.role, input.range && `from ${input.range[0]} to ${input.range[1]}`].filter(Boolean).join(", ")]);
  if (others.length) facts.push(["also dropped", others.map((other) => other.slice(1)).slice(0, 9).join(", ")]);
  const unruled = errors.filter(({ rule }) => !findings.some((finding) => finding.rule === rule));
  const rows = [...unruled.map((error) => ({ severity: "error", actual: error.message, ...error })), ...findings]
    .slice(0, MOST_FINDINGS)
    .map(({ severity, rule, where, actual, expected, hint }) => [severity, ruleLink(rule), [where, [actual, expected && `expected ${expected}`].filter(Boolean).join(", ")].filter(Boolean).join(": "), hint]);
  const verdict = errors.length ? "Not drawn." : kind === "model" ? "Drawn. Rules that need no run found:" : "Drawn.";
  report.replaceChildren(
    element("h2", {}, verdict),
    ...(rows.length ? [table(["", "rule", "what", "hint"], rows)] : kind === "model" ? [element("p", {}, "Nothing. "), element("p", {}, "gsgen validate runs the model, and checks the other rules.")] : []),
    element("h2", {}, "What it is"),
    table(["", ""], facts),
    element("h2", {}, "What to type next"),
    element("pre", {}, element("code", {}, commandsOf(kind, path, errors).join("\n"))),
  );
  status.textContent = `${path.slice(1)}: ${model.state}`;
}

/** Show the files that were dropped or chosen. @param {[string, File][]} dropped */
async function show(dropped) {
  const folder = `/${++drops}`;
  files.clear();
  for (const [path, file] of dropped) files.set(folder + path, file);
  const ranked = await Promise.all(dropped.map(async ([path, file]) => ({ path, file, kind: await kindOf(path, file) })));
  ranked.sort((a, b) => a.kind[0] - b.kind[0] || a.path.length - b.path.length || b.file.size - a.file.size);
  const [first, ...rest] = ranked;
  if (!first) return;
  const images = dropped.filter(([, { type }]) => type.startsWith("image/")).map(([, file]) => file);
  const isParts = first.kind[1] === "tileset" || first.kind[1] === "scene";
  const total = dropped.reduce((sum, [, { size }]) => sum + size, 0);
  const others = isParts ? [] : rest.filter(({ kind: [rank] }) => rank < 9).map(({ path }) => path);
  status.textContent = `${first.path.slice(1)}: loading`;
  model.hidden = false;
  const ended = new Promise((resolve) => {
    const end = ({ detail }) => {
      if (detail?.count !== undefined) model.dataset.count = detail.count;
      for (const name of ["load", "recover", "error"]) model.removeEventListener(name, end);
      resolve(null);
    };
    for (const name of ["load", "recover", "error"]) model.addEventListener(name, end);
  });
  model.pictures = first.kind[1] === "model" && images.length ? images : null;
  model.setAttribute("name", first.path.slice(1));
  model.setAttribute("alt", first.path.slice(1));
  model.src = HOST.slice(0, -1) + folder + first.path.split("/").map(encodeURIComponent).join("/");
  await ended;
  tell(first.kind[1] || "unknown", first.path, isParts ? total : first.file.size, others);
}

page.addEventListener("dragover", (event) => event.preventDefault());
page.addEventListener("drop", async (event) => {
  event.preventDefault();
  const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry()).filter(Boolean);
  const dropped = [];
  for (const entry of entries) for await (const found of filesOf(entry)) dropped.push(found);
  show(dropped);
});
page.querySelector("#drop-files").addEventListener("change", ({ target }) => {
  show([...target.files].map((file) => [`/${file.name}`, file]));
});
page.querySelector("#drop-folder").addEventListener("change", ({ target }) => {
  show([...target.files].map((file) => [`/${file.webkitRelativePath}`, file]));
});
