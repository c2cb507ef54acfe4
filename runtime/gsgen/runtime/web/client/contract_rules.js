// Written by `make web` from Python functions of the contract; do not edit.
// @ts-nocheck

import * as py from "./python.js";

const publishedSchema = (kind) => SCHEMAS.get(kind);
const denseWeight = ({ dims, values: { name, data_type } }) => ({ name, data_type, dims });
const noFacts = () => ({ tensors: new Map(), conflicts: [], checker: "", inference: "" });
const noHint = () => "";

class Role$roles extends py.Record {
static fields = [["name", null, null], ["dtype", null, null], ["shapes", null, null], ["summary", null, null], ["kinds", null, () => ["gaussian-generator"]], ["index", null, () => false], ["needs_range", null, () => false], ["conventions", null, () => []]];
}
class OperatorProfile$reader_needs extends py.Record {
static fields = [["name", null, null], ["opset", null, null], ["operators", null, null], ["summary", null, null]];
missing(operators) {
  const self = this;
return py.sorted((py.minus(py.set(operators), self.operators)));
}
}
class GeneratorManifest$manifest extends py.Record {
static fields = [["name", null, null], ["inputs", () => Input$inputs, () => []], ["version", null, () => "1.0.0"], ["family", null, null], ["producer", () => Producer$records, null], ["test_vectors", () => TestVector$records, () => []], ["contract", null, () => "1.0"], ["extensions_used", null, () => []], ["extensions_required", null, () => []], ["operator_profile", null, null], ["external_data", () => ExternalData$records, () => []], ["cost", () => Cost$records, () => []], ["outputs", () => GeneratorOutputs$outputs, null], ["space", () => Space$scene, null], ["bounds", () => Bounds$scene, null], ["depends_on", null, () => py.dict([])], ["antialias", null, () => "classic"], ["blend", null, () => "alpha"], ["weighted_sum", () => WeightedSum$scene, null], ["capture", () => Capture$manifest, () => new Capture$manifest(true)], ["tolerances", () => Tolerances$scene, null], ["reference_images", () => ReferenceImage$records, () => []], ["kind", null, () => "gaussian-generator"]];
depends(entry) {
  const self = this;
return py.get(self.depends_on, entry.name, py.get(self.depends_on, entry.role, true));
}
}
class TrajectoryManifest$manifest extends py.Record {
static fields = [["name", null, null], ["inputs", () => Input$inputs, () => []], ["version", null, () => "1.0.0"], ["family", null, null], ["producer", () => Producer$records, null], ["test_vectors", () => TestVector$records, () => []], ["contract", null, () => "1.0"], ["extensions_used", null, () => []], ["extensions_required", null, () => []], ["operator_profile", null, null], ["external_data", () => ExternalData$records, () => []], ["cost", () => Cost$records, () => []], ["outputs", () => TrajectoryOutputs$outputs, null], ["step_seconds", () => Number, null], ["space", () => Space$scene, null], ["tolerances", () => TrajectoryTolerances$manifest, null], ["kind", null, () => "trajectory-predictor"]];
}
class PostProcessManifest$manifest extends py.Record {
static fields = [["name", null, null], ["inputs", () => Input$inputs, () => []], ["version", null, () => "1.0.0"], ["family", null, null], ["producer", () => Producer$records, null], ["test_vectors", () => TestVector$records, () => []], ["contract", null, () => "1.0"], ["extensions_used", null, () => []], ["extensions_required", null, () => []], ["operator_profile", null, null], ["external_data", () => ExternalData$records, () => []], ["cost", () => Cost$records, () => []], ["outputs", () => PostProcessOutputs$outputs, null], ["image_range", () => Number, () => [py.float(0.0), py.float(1.0)]], ["capture", () => Capture$manifest, () => new Capture$manifest(true)], ["kind", null, () => "post-process"]];
}
class Target$targets extends py.Record {
static fields = [["name", null, null], ["version", null, null], ["summary", null, null], ["opset", null, null], ["ir", null, null], ["domains", null, null], ["limits", null, () => py.dict([])], ["severities", null, () => py.dict([])], ["operators", null, () => []], ["follows_runtime", null, () => false]];
}
class InspectedModel$inspected_model extends py.Record {
static fields = [["file", null, null], ["graph", null, null], ["parsed", null, null], ["candidate", null, null], ["target", null, null], ["limits", null, null], ["tolerances", () => Number, () => py.dict([])]];
_manifest() {
  const self = this;
if ((self.parsed != null)) {
return self.parsed.manifest;
}
return (py.bool(self.candidate) ? self.candidate.manifest : null);
}
get manifest() { return py.cached(this, "manifest", this._manifest); }
_declared_version() {
  const self = this;
  let version;
version = (py.bool(self.parsed) ? self.parsed.version : null);
return (py.bool(version) ? `${py.str(py.item(version, 0))}.${py.str(py.item(version, 1))}` : "");
}
get declared_version() { return py.cached(this, "declared_version", this._declared_version); }
_kind() {
  const self = this;
  let manifest;
manifest = self.manifest;
return (py.bool(manifest) ? manifest.kind : "");
}
get kind() { return py.cached(this, "kind", this._kind); }
_generator() {
  const self = this;
return (py.isinstance(self.manifest, GeneratorManifest$manifest) ? self.manifest : null);
}
get generator() { return py.cached(this, "generator", this._generator); }
_declared_gaussians() {
  const self = this;
return (py.bool(self.generator) ? self.generator.outputs.gaussians : null);
}
get declared_gaussians() { return py.cached(this, "declared_gaussians", this._declared_gaussians); }
_declared_appearance() {
  const self = this;
return (py.bool(self.generator) ? self.generator.outputs.appearance : null);
}
get declared_appearance() { return py.cached(this, "declared_appearance", this._declared_appearance); }
_declared_count() {
  const self = this;
return (py.bool(self.generator) ? self.generator.outputs.count : null);
}
get declared_count() { return py.cached(this, "declared_count", this._declared_count); }
_declared_cells() {
  const self = this;
return (py.bool(self.generator) ? self.generator.outputs.cells : null);
}
get declared_cells() { return py.cached(this, "declared_cells", this._declared_cells); }
_gaussians() {
  const self = this;
return self._output(self.declared_gaussians);
}
get gaussians() { return py.cached(this, "gaussians", this._gaussians); }
_appearance() {
  const self = this;
return self._output(self.declared_appearance);
}
get appearance() { return py.cached(this, "appearance", this._appearance); }
_count() {
  const self = this;
return self._output(self.declared_count);
}
get count() { return py.cached(this, "count", this._count); }
_cells() {
  const self = this;
return self._output(self.declared_cells);
}
get cells() { return py.cached(this, "cells", this._cells); }
_declared_outputs() {
  const self = this;
  let manifest, parts;
manifest = self.manifest;
parts = (py.bool(manifest) ? [...(function* () { for (const field of py.iter(_output_fields$inspected_model(manifest))) yield [field, manifest.outputs[field]]; })()] : []);
return py.list((function* () { for (const [field, part] of py.iter(parts)) if ((part != null)) yield [`outputs.${py.str(field)}`, part.name]; })());
}
get declared_outputs() { return py.cached(this, "declared_outputs", this._declared_outputs); }
_output_names() {
  const self = this;
return py.list((function* () { for (const [_, name] of py.iter(self.declared_outputs)) yield name; })());
}
get output_names() { return py.cached(this, "output_names", this._output_names); }
inputs_of(role) {
  const self = this;
  let manifest, pairs;
manifest = self.manifest;
pairs = [...(function* () { for (const i of py.iter((py.bool(manifest) ? manifest.inputs : []))) yield [i, self.graph.input(i.name)]; })()];
return [...(function* () { for (const [i, tensor] of py.iter(pairs)) if (((tensor != null) && (py.eq(i.role, role)))) yield [i, tensor]; })()];
}
path_of(entry) {
  const self = this;
return `inputs.${py.str((py.bool(self.manifest) ? self.manifest.inputs : []).indexOf(entry))}`;
}
_output(declared) {
  const self = this;
return (py.bool(declared) ? self.graph.output(declared.name) : null);
}
}
class ModelFile$model_file extends py.Record {
static fields = [["path", null, null], ["size", null, null], ["proto", null, null], ["stripped_bytes", null, null], ["external", null, null], ["external_tensors", null, () => []], ["whole", null, () => false]];
_metadata() {
  const self = this;
return py.dict((function* () { for (const entry of py.iter(self.proto.metadata_props)) yield [entry.key, entry.value]; })());
}
get metadata() { return py.cached(this, "metadata", this._metadata); }
_manifest_text() {
  const self = this;
  let metadata;
metadata = self.metadata;
return py.get(metadata, "gsgen.manifest", py.get(metadata, "gaussian-generator.manifest"));
}
get manifest_text() { return py.cached(this, "manifest_text", this._manifest_text); }
}
class Input$inputs extends py.Record {
static fields = [["name", null, null], ["role", null, null], ["shape", null, null], ["range", () => Number, null], ["default", () => Number, null], ["convention", null, null], ["loop", null, null], ["frames", null, null], ["fps", () => Number, null], ["label", null, null], ["joints", () => Joint$inputs, () => []], ["rate", () => Number, null], ["window", null, null], ["hop", null, null], ["pass_", null, null], ["background", () => Number, null]];
_is_of_scene() {
  const self = this;
return ((self.pass_ == null) ? (py.contains(PICTURE_ROLES$18, self.role)) : (py.eq(self.pass_, "scene")));
}
get is_of_scene() { return py.cached(this, "is_of_scene", this._is_of_scene); }
}
class GeneratorOutputs$outputs extends py.Record {
static fields = [["gaussians", () => GaussiansOutput$outputs, null], ["appearance", () => AppearanceOutput$outputs, null], ["count", () => CountOutput$outputs, null], ["cells", () => CellsOutput$outputs, null]];
}
class GaussiansOutput$outputs extends py.Record {
static fields = [["name", null, null], ["capacity", null, null], ["dtype", null, () => "float32"], ["layout", null, () => "packed10"]];
}
class AppearanceOutput$outputs extends py.Record {
static fields = [["name", null, null], ["space", null, null], ["degree", null, null], ["color_space", null, () => "srgb"], ["range", () => Number, null]];
}
class CountOutput$outputs extends py.Record {
static fields = [["name", null, null], ["semantics", null, () => "exact"]];
}
class Space$scene extends py.Record {
static fields = [["handedness", null, () => "right"], ["up", null, () => "-y"], ["unit", null, () => "arbitrary"], ["matrix_order", null, () => "column"], ["origin", () => Number, null], ["metres_per_unit", () => Number, null]];
}
class Candidate$manifest_io extends py.Record {
static fields = [["manifest", () => GeneratorManifest$manifest, null], ["manifest_guesses", null, null]];
}
class ParsedManifest$manifest_io extends py.Record {
static fields = [["manifest", () => GeneratorManifest$manifest, null], ["complaints", () => ManifestComplaint$manifest_io, () => []], ["version", null, null], ["is_newer_version", null, () => false]];
}
class ManifestComplaint$manifest_io extends py.Record {
static fields = [["cause", null, null], ["where", null, null], ["actual", null, null], ["expected", null, null]];
}
class SchemaFault$schema_check extends py.Record {
static fields = [["validator", null, null], ["validator_value", null, null], ["instance", null, null], ["schema", null, null], ["absolute_path", null, null], ["message", null, () => ""]];
}
class Tensor$graph extends py.Record {
static fields = [["name", null, null], ["dtype", null, null], ["dims", null, null]];
__str__() {
  const self = this;
  let dims;
dims = ((self.dims == null) ? "?" : py.list((function* () { for (const d of py.iter(self.dims)) yield ((d == null) ? "?" : py.str(d)); })()).join(", "));
return `${py.str(py.or(self.dtype, () => "?"))} [${py.str(dims)}]`;
}
}
class Graph$graph extends py.Record {
static fields = [["inputs", null, null], ["outputs", null, null], ["nodes", null, null], ["initializers", null, null], ["tensors", null, null], ["functions", null, null], ["conflicts", null, () => []], ["checker_fault", null, () => ""], ["inference_fault", null, () => ""], ["output_names", null, () => []], ["declared_outputs", null, () => []]];
_producers() {
  const self = this;
return py.dict((function* () { for (const node of py.iter(self.nodes)) for (const name of py.iter(node.output)) if (py.bool(name)) yield [name, node]; })());
}
get producers() { return py.cached(this, "producers", this._producers); }
_use_counts() {
  const self = this;
  let count, name, names, output;
count = py.dict([]);
for (names of py.iter(self._names_read_by_node.values())) {
for (name of py.iter(names)) {
count.set(name, (py.plus(py.get(count, name, 0), 1)));
}
}
for (output of py.iter(self.outputs)) {
count.set(output.name, (py.plus(py.get(count, output.name, 0), 1)));
}
return count;
}
get use_counts() { return py.cached(this, "use_counts", this._use_counts); }
__names_read_by_node() {
  const self = this;
return py.dict((function* () { for (const node of py.iter(self.nodes)) yield [node, names_read$graph(node)]; })());
}
get _names_read_by_node() { return py.cached(this, "_names_read_by_node", this.__names_read_by_node); }
output(name) {
  const self = this;
return ((function* () { for (const tensor of py.iter(self.outputs)) if ((py.eq(tensor.name, name))) yield tensor; })().next().value ?? null);
}
input(name) {
  const self = this;
return ((function* () { for (const tensor of py.iter(self.inputs)) if ((py.eq(tensor.name, name))) yield tensor; })().next().value ?? null);
}
ancestors(name) {
  const self = this;
if ((!py.contains(self._ancestors_by_name, name))) {
self._ancestors_by_name.set(name, self._trace_ancestors(name));
}
return py.item(self._ancestors_by_name, name);
}
__ancestors_by_name() {
  const self = this;
return py.dict([]);
}
get _ancestors_by_name() { return py.cached(this, "_ancestors_by_name", this.__ancestors_by_name); }
_trace_ancestors(name) {
  const self = this;
  let key, names, node, nodes, queue, visited_keys;
[names, nodes, queue] = [py.set([name]), [], [name]];
visited_keys = py.set();
while (py.bool(queue)) {
node = py.get(self.producers, queue.pop());
key = node;
if (((node == null) || (py.contains(visited_keys, key)))) {
continue;
}
visited_keys.add(key);
nodes.push(node);
for (name of py.iter(py.item(self._names_read_by_node, key))) {
if ((!py.contains(names, name))) {
names.add(name);
queue.push(name);
}
}
}
return [names, nodes];
}
varies(name) {
  const self = this;
  let _, names;
[names, _] = self.ancestors(name);
return py.list((function* () { for (const tensor of py.iter(self.inputs)) yield (py.contains(names, tensor.name)); })()).some(py.bool);
}
all_nodes() {
  const self = this;
return py.iter(self._all_nodes);
}
__all_nodes() {
  const self = this;
return [...(function* () { for (const node of py.iter(self.nodes)) for (const nested_node of py.iter(_nested_nodes$graph(node, 0))) yield nested_node; })()];
}
get _all_nodes() { return py.cached(this, "_all_nodes", this.__all_nodes); }
}
class Producer$records extends py.Record {
static fields = [["tool", null, null], ["source", null, null], ["license", null, null], ["weights_sha256", null, null]];
}
class TestVector$records extends py.Record {
static fields = [["inputs", null, null], ["expected_sha256", null, null], ["seed", null, () => 0], ["files", () => VectorFile$records, () => []], ["values", () => VectorInput$records, () => []], ["outputs", () => VectorRows$records, () => []], ["tolerances", () => Tolerances$scene, null]];
}
class ExternalData$records extends py.Record {
static fields = [["path", null, null], ["sha256", null, null]];
}
class Cost$records extends py.Record {
static fields = [["device", null, null], ["milliseconds", () => Number, null], ["bytes", null, null]];
}
class Bounds$scene extends py.Record {
static fields = [["min", () => Number, null], ["max", () => Number, null]];
}
class WeightedSum$scene extends py.Record {
static fields = [["background", () => Number, null], ["depth_range", () => Number, null], ["opacity_divisor", () => Number, () => py.float(1.0)]];
}
class Capture$manifest extends py.Record {
static fields = [["static_shapes", null, () => true]];
}
class Tolerances$scene extends py.Record {
static fields = [["position", () => Number, () => 0.001], ["covariance", () => Number, () => 0.001], ["opacity", () => Number, () => 0.002], ["appearance", () => Number, () => 0.002]];
}
class ReferenceImage$records extends py.Record {
static fields = [["path", null, null], ["sha256", null, null], ["inputs", null, null], ["view", () => Number, null], ["focal", () => Number, null], ["center", () => Number, null], ["psnr", () => Number, () => py.float(40.0)], ["from_", null, () => "model"]];
}
class TrajectoryOutputs$outputs extends py.Record {
static fields = [["future", () => FutureOutput$outputs, null], ["uncertainty", () => UncertaintyOutput$outputs, null]];
}
class TrajectoryTolerances$manifest extends py.Record {
static fields = [["position", () => Number, () => 0.001], ["rotation", () => Number, () => 0.001], ["uncertainty", () => Number, () => 0.01]];
}
class PostProcessOutputs$outputs extends py.Record {
static fields = [["image", () => ImageOutput$outputs, null]];
}
class Joint$inputs extends py.Record {
static fields = [["name", null, null], ["parent", null, null], ["rest", () => Number, null]];
}
class CellsOutput$outputs extends py.Record {
static fields = [["name", null, null], ["per_cell", null, null], ["dtype", null, () => "float32"]];
}
class VectorFile$records extends py.Record {
static fields = [["input", null, null], ["path", null, null], ["sha256", null, null]];
}
class VectorInput$records extends py.Record {
static fields = [["input", null, null], ["shape", null, null], ["values", () => Number, null]];
}
class VectorRows$records extends py.Record {
static fields = [["output", null, null], ["rows", null, null], ["values", () => Number, null]];
}
class FutureOutput$outputs extends py.Record {
static fields = [["name", null, null], ["steps", null, null], ["representation", null, null]];
}
class UncertaintyOutput$outputs extends py.Record {
static fields = [["name", null, null], ["semantics", null, () => "standard-deviation"]];
}
class ImageOutput$outputs extends py.Record {
static fields = [["name", null, null], ["dtype", null, () => "float32"], ["range", () => Number, () => [py.float(0.0), py.float(1.0)]], ["color_space", null, () => "srgb"], ["scale", null, () => 1]];
}
function* manifest_present$manifest(subject) {
  let actual, misplaced_text;
if ((subject.parsed == null)) {
misplaced_text = _misplaced_manifest$manifest(subject);
actual = (py.plus(`no key ${py.str(py.repr("gsgen.manifest"))}`, (py.bool(misplaced_text) ? `, but ${py.str(misplaced_text)}` : "")));
yield py.violation("metadata_props", actual, "a manifest under that key");
}
}
function _misplaced_manifest$manifest(subject) {
  let docs, key, owner, proto, text, value;
proto = subject.file.proto;
for ([key, value] of py.iter(subject.file.metadata.entries())) {
if ((py.eq(key.toLowerCase(), "gsgen.manifest"))) {
return `a key ${py.str(py.repr(key))}, which differs in case`;
}
if (py.bool(_looks_like_manifest$manifest(value))) {
return `a manifest under the key ${py.str(py.repr(key))}`;
}
}
if (py.list((function* () { for (const entry of py.iter(proto.graph.metadata_props)) yield _looks_like_manifest$manifest(entry.value); })()).some(py.bool)) {
return "a manifest in the metadata of the graph, which is not that of the model";
}
docs = [["model", proto.doc_string], ["graph", proto.graph.doc_string]];
for ([owner, text] of py.iter(docs)) {
if (py.bool(_looks_like_manifest$manifest(text))) {
return `a manifest in the doc string of the ${py.str(owner)}`;
}
}
return "";
}
function _looks_like_manifest$manifest(text) {
  let first_text;
first_text = py.slice(text, null, 65536).trimStart();
return py.and(py.startsWith(first_text, "{"), () => py.list((function* () { for (const kind of py.iter(MANIFEST_KINDS$0)) yield (py.contains(first_text, `"${py.str(kind)}"`)); })()).some(py.bool));
}
function* manifest_schema$manifest(subject) {
  let actual, keys, location, manifest_complaint;
keys = [...(function* () { for (const entry of py.iter(subject.file.proto.metadata_props)) yield entry.key; })()];
if ((py.compare(py.count(keys, "gsgen.manifest"), 1) > 0)) {
actual = `the key ${py.str(py.repr("gsgen.manifest"))} is repeated: ${py.str(py.count(keys, "gsgen.manifest"))} manifests`;
yield py.violation("metadata_props", actual, "one manifest");
}
for (manifest_complaint of py.iter((py.bool(subject.parsed) ? subject.parsed.complaints : []))) {
if ((py.contains(["schema", "syntax"], manifest_complaint.cause))) {
location = `manifest ${py.str(manifest_complaint.where)}`.trim();
yield py.violation(location, manifest_complaint.actual, manifest_complaint.expected, undefined, undefined, noHint(subject, manifest_complaint));
}
}
}
function* manifest_version$manifest(subject) {
  let manifest_complaint;
for (manifest_complaint of py.iter((py.bool(subject.parsed) ? subject.parsed.complaints : []))) {
if ((py.eq(manifest_complaint.cause, "version"))) {
yield py.violation(`manifest ${py.str(manifest_complaint.where)}`, manifest_complaint.actual, manifest_complaint.expected);
}
}
}
function* declared_tensors_exist$manifest(subject) {
  let inputs, manifest, outputs;
manifest = subject.manifest;
if ((manifest == null)) {
return;
}
inputs = [...(function* () { for (const [index, entry] of py.iter(py.list(manifest.inputs).entries())) yield [`inputs.${py.str(index)}`, entry.name]; })()];
yield* py.iter(_name_faults$manifest("input", inputs, [...(function* () { for (const t of py.iter(subject.graph.inputs)) yield t.name; })()]));
outputs = py.list(subject.declared_outputs);
yield* py.iter(_name_faults$manifest("output", outputs, [...(function* () { for (const t of py.iter(subject.graph.outputs)) yield t.name; })()]));
}
function* _name_faults$manifest(kind, declared, known) {
  let expected, faults, free, hint, index, is_clear, name, names, path, paths, where;
names = [...(function* () { for (const [_, name] of py.iter(declared)) yield name; })()];
free = [...(function* () { for (const name of py.iter(known)) if ((!py.contains(names, name))) yield name; })()];
faults = [...(function* () { for (const [i, n] of py.iter(py.list(names).entries())) if (((!py.contains(known, n)) || (py.contains(py.slice(names, null, i), n)))) yield n; })()];
for ([index, [path, name]] of py.iter(py.list(py.list(py.list(declared).entries())).reverse())) {
paths = (py.bool(free) ? [...(function* () { for (const [p, n] of py.iter(declared)) if (((py.eq(n, name)) && py.bool(py.endsWith(p, `.${py.str(py.item(free, 0))}`)))) yield p; })()] : []);
is_clear = (py.eq(py.len(free), py.len(faults)) && py.eq(py.len(faults), 1));
hint = (py.bool(is_clear) ? set_hint$finding(`${py.str(py.item([...py.iter(paths), path], 0))}.name`, py.item(free, 0)) : "");
if ((!py.contains(known, name))) {
expected = _one_of_names_text$manifest(known);
hint = (((py.eq(kind, "input")) && !py.bool(free)) ? `${py.str("Exporters leave out inputs that nothing depends on: export without detaching it (numpy round trips, `.item()`, Python branches), or remove")} ${py.str(path)}.` : hint);
yield py.violation(`manifest ${py.str(kind)} ${py.str(py.repr(name))}`, `no such graph ${py.str(kind)}`, expected, undefined, undefined, hint);
} else {
if ((py.contains(py.slice(names, null, index), name))) {
[where, expected] = [`manifest name ${py.str(py.repr(name))}`, "one role per tensor"];
if ((!py.bool(hint) && py.bool(py.startsWith(path, _OPTIONAL_PATHS$1)))) {
hint = remove_hint$finding(path, "name the tensor that is meant");
}
yield py.violation(where, "declared more than once", expected, undefined, undefined, hint);
}
}
}
}
function set_hint$finding(path, value) {
return `Set ${py.str(path)} to ${py.str(py.dumps(value, false))}.`;
}
function remove_hint$finding(path, alternative) {
return `Remove ${py.str(path)}, or ${py.str(alternative)}.`;
}
function _one_of_names_text$manifest(names) {
  let names_text;
names_text = (py.plus(py.list(py.slice(names, null, 8)).join(", "), ((py.compare(py.len(names), 8) > 0) ? ", …" : "")));
return (py.bool(names) ? `one of ${py.str(names_text)}` : "a tensor that exists; the graph has none");
}
function* manifest_agrees_with_graph$manifest(subject) {
  let actual, dims, entry, shape, tensor;
for (entry of py.iter((py.bool(subject.manifest) ? subject.manifest.inputs : []))) {
tensor = subject.graph.input(entry.name);
[dims, shape] = [(py.bool(tensor) ? tensor.dims : null), entry.shape];
if ((py.bool(dims) && py.bool(shape) && ((!py.eq(py.len(dims), py.len(shape))) || py.list((function* () { for (const [a, b] of py.iter(py.zip(dims, shape))) yield py.and(py.isinstance(a, py.int), () => (!py.eq(a, b))); })()).some(py.bool)))) {
actual = `graph has ${py.str(py.list(dims))}`;
yield py.violation(`input ${py.str(entry.name)}`, actual, `the declared shape ${py.str(py.list(shape))}`);
}
}
yield* py.iter(_dtypes_agree$manifest(subject.declared_gaussians, subject.gaussians));
yield* py.iter(_gaussians_agree$manifest(subject));
yield* py.iter(_appearance_agrees$manifest(subject));
yield* py.iter(_dtypes_agree$manifest(subject.declared_cells, subject.cells));
}
function* _dtypes_agree$manifest(declared, tensor) {
  let actual, expected;
if (((declared == null) || (tensor == null))) {
return;
}
if (((py.contains(ITEMSIZE$2, tensor.dtype)) && (!py.eq(tensor.dtype, declared.dtype)))) {
[actual, expected] = [`graph has ${py.str(tensor.dtype)}`, `the declared dtype ${py.str(declared.dtype)}`];
yield py.violation(`output ${py.str(tensor.name)}`, actual, expected);
}
}
function* _gaussians_agree$manifest(subject) {
  let declared, expected, first, is_inferred, known, location, tensor;
[declared, tensor] = [subject.declared_gaussians, subject.gaussians];
if (((declared == null) || (tensor == null) || (tensor.dims == null))) {
return;
}
location = `output ${py.str(tensor.name)}`;
first = (py.bool(tensor.dims) ? py.item(tensor.dims, 0) : null);
is_inferred = (subject.candidate != null);
known = py.and((py.eq(py.len(tensor.dims), 2)), () => py.isinstance(first, py.int), () => (py.compare(first, 0) > 0));
if ((py.bool(known) && !py.bool(is_inferred) && (!py.eq(first, declared.capacity)))) {
expected = `the declared capacity ${py.str(declared.capacity)}`;
yield py.violation(location, `graph has ${py.str(first)} rows`, expected);
}
}
function* _appearance_agrees$manifest(subject) {
  let actual, channels, declared, expected, expected_channels, tensor, valid_channel_counts;
[declared, tensor] = [subject.declared_appearance, subject.appearance];
if (((declared == null) || (tensor == null) || (tensor.dims == null) || (!py.eq(py.len(tensor.dims), 2)) || (!py.contains(ITEMSIZE$2, tensor.dtype)))) {
return;
}
channels = py.item(tensor.dims, (-1));
if (((!py.eq(declared.space, "sh")) || !py.isinstance(channels, py.int))) {
return;
}
if ((declared.degree == null)) {
actual = "no degree is declared";
yield py.violation(`output ${py.str(tensor.name)}`, actual, `the degree of ${py.str(channels)} SH channels`);
return;
}
expected_channels = appearance_channels$layout("sh", declared.degree, 4);
valid_channel_counts = py.set((function* () { for (const degree of py.iter(Array(4).keys())) yield appearance_channels$layout("sh", degree, 4); })());
if (((py.contains(valid_channel_counts, channels)) && (!py.eq(channels, expected_channels)))) {
expected = `${py.str(expected_channels)} channels, as SH degree ${py.str(declared.degree)} has`;
yield py.violation(`output ${py.str(tensor.name)}`, `graph has ${py.str(channels)} channels`, expected);
}
}
function appearance_channels$layout(space, degree, itemsize) {
if ((py.eq(space, "sh"))) {
return (3 * coefficients$spherical_harmonics(py.or(degree, () => 0)));
}
return ((py.eq(((3 * itemsize) - 4 * Math.floor((3 * itemsize) / 4)), 0)) ? 3 : 4);
}
function coefficients$spherical_harmonics(degree) {
return ((py.plus(degree, 1)) ** 2);
}
function* coordinate_frame_declared$manifest(subject) {
if (((subject.candidate == null) && py.bool(subject.generator) && (subject.generator.space == null))) {
yield py.violation("manifest space", "not declared", "up, unit and matrix_order");
}
}
function* sh_declared_as_sh$declarations(subject) {
  let actual, declared;
declared = subject.declared_appearance;
if (((declared != null) && (py.eq(declared.space, "rgb")) && (declared.degree != null))) {
actual = `space rgb with degree ${py.str(declared.degree)}`;
yield py.violation("manifest outputs.appearance", actual, "sh, or no degree");
}
}
function* color_space_declared$declarations(subject) {
  let appearance_document;
if (((subject.declared_appearance == null) || (subject.file.manifest_text == null))) {
return;
}
appearance_document = py.item(py.item(py.loads(subject.file.manifest_text), "outputs"), "appearance");
if ((!py.contains(appearance_document, "color_space"))) {
yield py.violation("manifest outputs.appearance", "no color_space", "srgb or linear");
}
}
function* bounds_declared$manifest(subject) {
  let generator;
generator = subject.generator;
if (((subject.candidate == null) && (generator != null) && (generator.bounds == null))) {
yield py.violation("manifest bounds", "not declared", "min and max corners");
}
}
function* time_domain$declarations(subject) {
  let entry, is_single_instant, location;
for (entry of py.iter((py.bool(subject.manifest) ? subject.manifest.inputs : []))) {
location = `manifest input ${py.str(entry.name)}`;
if (((py.eq(entry.role, "time")) && (entry.range == null))) {
yield py.violation(location, "no range", "\"range\": [first, last]");
}
is_single_instant = py.and((entry.range != null), () => (py.eq(py.item(entry.range, 0), py.item(entry.range, 1))));
if (((py.contains(["time", "frame_index"], entry.role)) && py.bool(is_single_instant))) {
yield py.violation(location, `range ${py.str(py.list(py.or(entry.range, () => [])))}`, "first < last");
}
}
}
function* provenance_readable$declarations(subject) {
  let producer;
producer = (py.bool(subject.manifest) ? subject.manifest.producer : null);
if ((producer == null)) {
return;
}
if (((producer.license != null) && !py.bool(_SPDX$3.exec(producer.license)))) {
yield py.violation("manifest producer.license", py.repr(producer.license), "an SPDX expression");
}
if (!py.list((function* () { for (const char of py.iter(producer.tool)) yield /^\d+$/.test(char); })()).some(py.bool)) {
yield py.violation("manifest producer.tool", py.repr(producer.tool), "name and version");
}
}
function* manifest_at_model_level$declarations(subject) {
  let contract_keys, graph, keys, metadata_keys, name;
graph = subject.file.proto.graph;
metadata_keys = [...(function* () { for (const tensors of py.iter([graph.input, graph.output, graph.value_info])) for (const tensor of py.iter(tensors)) yield [tensor.name, [...(function* () { for (const entry of py.iter(tensor.metadata_props)) yield entry.key; })()]]; })()];
metadata_keys = (py.plus(metadata_keys, [...(function* () { for (const w of py.iter(graph.initializer)) yield [w.name, [...(function* () { for (const entry of py.iter(w.metadata_props)) yield entry.key; })()]]; })()]));
for ([name, keys] of py.iter(metadata_keys)) {
contract_keys = [...(function* () { for (const key of py.iter(keys)) if (py.bool(py.startsWith(key, "gsgen."))) yield key; })()];
if (py.bool(contract_keys)) {
yield py.violation(`tensor ${py.str(name)}`, `key ${py.str(py.repr(py.item(contract_keys, 0)))}`, "the manifest");
}
}
}
function* manifest_minor_known$manifest(subject) {
  let major, minor;
if (((subject.parsed != null) && py.bool(subject.parsed.is_newer_version) && py.bool(subject.parsed.version))) {
[major, minor] = subject.parsed.version;
yield py.violation("manifest contract", `${py.str(major)}.${py.str(minor)}`, `${py.str("1.0")} or older`, undefined, undefined, noHint(subject));
}
}
function* dependencies_are_inputs$declarations(subject) {
  let actual, generator, known, known_text, role;
generator = subject.generator;
if (((generator == null) || (subject.candidate != null))) {
return;
}
known = py.dict(py.map((key) => [key, null], (function* () { for (const entry of py.iter(generator.inputs)) for (const name of py.iter([entry.name, entry.role])) yield name; })()));
for (role of py.iter(generator.depends_on)) {
if ((!py.contains(known, role))) {
actual = ((py.contains(ROLES$4, role)) ? "no input has this role" : "neither an input nor a role");
known_text = py.or(py.list(known).join(", "), () => "none: there are no inputs");
yield py.violation(`manifest depends_on ${py.str(py.repr(role))}`, actual, `one of ${py.str(known_text)}`, ((py.contains(ROLES$4, role)) ? "possible" : "confirmed"));
}
}
}
function* weighted_sum_complete$cells(subject) {
  let declarations, generator, missing_text, present_text;
generator = subject.generator;
if ((generator == null)) {
return;
}
declarations = py.dict([["blend: wsr", (py.eq(generator.blend, "wsr"))], ["weighted_sum", (generator.weighted_sum != null)], ["outputs.cells", (generator.outputs.cells != null)]]);
if ((py.list(declarations.values()).some(py.bool) && !py.list(declarations.values()).every(py.bool))) {
[present_text, missing_text] = (function* () { for (const is_declared_cells of py.iter([true, false])) yield py.list((function* () { for (const [name, value] of py.iter(declarations.entries())) if ((value === is_declared_cells)) yield name; })()).join(" and "); })();
yield py.violation("manifest", `${py.str(present_text)} without ${py.str(missing_text)}`, "all three, or none");
}
}
function* contract_version_released$manifest(subject) {
if (((subject.parsed != null) && (py.contains(UPGRADE_BY_VERSION$5, subject.parsed.version)))) {
yield py.violation("manifest contract", subject.declared_version, "1.0");
}
}
function released$upgrades(document) {
return (py.union(document, py.dict([["contract", "1.0"]])));
}
function* bounds_are_a_box$manifest(subject) {
  let actual, declared, expected, generator, high, low;
[generator, declared] = [subject.generator, subject.declared_gaussians];
if (((generator == null) || (generator.bounds == null) || (declared == null))) {
return;
}
[low, high] = [generator.bounds.min, generator.bounds.max];
actual = `min ${py.str(py.list(low))}, max ${py.str(py.list(high))}`;
if (!py.list((function* () { for (const [a, b] of py.iter(py.zip(low, high))) yield (py.compare(a, b) <= 0); })()).every(py.bool)) {
yield py.violation("manifest bounds", actual, "min <= max on every axis");
} else {
if (((py.eq(low, high)) && (py.compare(declared.capacity, 1) > 0))) {
expected = "a box; these bounds are a point";
yield py.violation("manifest bounds", actual, expected, undefined, undefined, "Remove bounds, or measure them over all times and poses, as the SDK does.");
}
}
}
function* required_extensions_used$extensions(subject) {
  let actual, expected, hint, index, manifest, name, present, used_extensions;
manifest = subject.manifest;
used_extensions = (py.bool(manifest) ? manifest.extensions_used : []);
present = py.set(_field_names$extensions(py.loads(py.or(subject.file.manifest_text, () => "{}"))));
for ([index, name] of py.iter(py.list((py.bool(manifest) ? manifest.extensions_required : [])).entries())) {
if ((!py.contains(used_extensions, name))) {
[actual, expected] = [`${py.str(name)} is not in extensions_used`, `${py.str(name)} in both lists`];
hint = `Add "${py.str(name)}" to extensions_used.`;
if ((!py.contains(present, name))) {
hint = remove_hint$finding(`extensions_required.${py.str(index)}`, `write the field ${py.str(name)}`);
}
yield py.violation("manifest extensions_required", actual, expected, undefined, undefined, hint);
}
}
}
function* _field_names$extensions(value) {
  let part;
if (py.isinstance(value, py.dict)) {
yield* py.iter(value);
}
for (part of py.iter((py.isinstance(value, py.dict) ? value.values() : value))) {
if (py.isinstance(part, [py.dict, py.list])) {
yield* py.iter(_field_names$extensions(part));
}
}
}
function* required_extensions_known$extensions(subject) {
  let alternative, expected, extensions, hint, index, known, name;
extensions = (py.bool(subject.manifest) ? subject.manifest.extensions_required : []);
for ([index, name] of py.iter(py.list(extensions).entries())) {
if ((!py.contains(REGISTERED_EXTENSIONS$6, name))) {
known = py.or(py.list(REGISTERED_EXTENSIONS$6).join(", "), () => "none is registered yet");
expected = `a registered extension (${py.str(known)})`;
alternative = "register the extension as the page of extensions says";
hint = remove_hint$finding(`extensions_required.${py.str(index)}`, alternative);
yield py.violation("manifest extensions_required", name, expected, undefined, undefined, hint);
}
}
}
function* operator_profile_holds$extensions(subject) {
  let actual, expected, missing, name, opset, profile, remainder_text;
name = (py.bool(subject.manifest) ? subject.manifest.operator_profile : null);
if ((name == null)) {
return;
}
if ((!py.contains(READER_PROFILES$7, name))) {
expected = `one of ${py.str(py.list(READER_PROFILES$7).join(", "))}`;
yield py.violation("manifest operator_profile", py.repr(name), expected);
return;
}
profile = py.item(READER_PROFILES$7, name);
opset = py.max((function* () { for (const o of py.iter(subject.file.proto.opset_import)) if ((py.contains(MAIN_DOMAIN$8, o.domain))) yield o.version; })(), 0);
if (!(py.compare(py.item(profile.opset, 0), opset) <= 0 && py.compare(opset, py.item(profile.opset, 1)) <= 0)) {
expected = `${py.str(py.item(profile.opset, 0))} to ${py.str(py.item(profile.opset, 1))}, as ${py.str(name)} has`;
yield py.violation("manifest operator_profile", `operator set ${py.str(opset)}`, expected);
}
missing = profile.missing((function* () { for (const node of py.iter(subject.graph.all_nodes())) yield node.op_type; })());
if (py.bool(missing)) {
remainder_text = ((py.compare(py.len(missing), 5) > 0) ? ` and ${py.str((py.minus(py.len(missing), 5)))} more` : "");
actual = `${py.str(py.list(py.slice(missing, null, 5)).join(", "))}${py.str(remainder_text)} in the graph`;
yield py.violation("manifest operator_profile", actual, `operators of ${py.str(name)} alone`);
}
}
function* cost_plausible$extensions(subject) {
  let declared, entry, expected, frame, generator, hint, measured, number;
[generator, declared] = [subject.generator, subject.declared_gaussians];
if (((generator == null) || (declared == null))) {
return;
}
frame = ((declared.capacity * 10) * py.item(ITEMSIZE$2, declared.dtype));
for ([number, entry] of py.iter(py.list(generator.cost).entries())) {
if (((entry.bytes != null) && (py.compare(entry.bytes, frame) < 0))) {
expected = `at least ${py.str(format_bytes$units(frame))}, the packed rows`;
measured = "measure the peak memory of a session with `gsgen bench`, in bytes";
hint = remove_hint$finding(`cost.${py.str(number)}`, measured);
yield py.violation(`manifest cost.${py.str(number)}`, format_bytes$units(entry.bytes), expected, undefined, undefined, hint);
}
}
}
function format_bytes$units(size) {
if ((py.compare(size, 1024) < 0)) {
return `${py.str(size)} B`;
}
if ((py.compare(size, 1048576) < 0)) {
return `${py.format((size / 1024), `.1f`)} KiB`;
}
return `${py.format((size / 1048576), `.1f`)} MiB`;
}
function* manifest_keys_agree$extensions(subject) {
  let actual, texts;
texts = (py.minus(py.set((function* () { for (const key of py.iter(["gsgen.manifest", "gaussian-generator.manifest"])) yield py.get(subject.file.metadata, key); })()), py.set([null])));
if ((py.compare(py.len(texts), 1) > 0)) {
actual = `${py.str("gsgen.manifest")} and ${py.str("gaussian-generator.manifest")} differ`;
yield py.violation("metadata_props", actual, "one manifest");
}
}
function* unit_agrees_with_scale$extensions(subject) {
  let actual, manifest, space;
manifest = subject.manifest;
space = null;
if (py.isinstance(manifest, [GeneratorManifest$manifest, TrajectoryManifest$manifest])) {
space = manifest.space;
}
if (((space != null) && (py.eq(space.unit, "metre")) && (!py.contains([null, py.float(1.0)], space.metres_per_unit)))) {
actual = `unit metre with ${py.format(space.metres_per_unit, `g`)} metres_per_unit`;
yield py.violation("manifest space", actual, "1, or unit arbitrary");
}
}
function* used_extensions_present$extensions(subject) {
  let manifest, name, present, text;
manifest = subject.manifest;
text = subject.file.manifest_text;
if (((manifest == null) || !py.bool(manifest.extensions_used) || !py.bool(text))) {
return;
}
present = py.set(_field_names$extensions(py.loads(text)));
for (name of py.iter(manifest.extensions_used)) {
if ((!py.contains(present, name))) {
yield py.violation("manifest extensions_used", name, `a field ${py.str(name)} in the manifest`);
}
}
}
function* picture_range_rises$declarations(subject) {
  let black, hint, manifest, name, ranges, rising, white;
manifest = subject.manifest;
if (!py.isinstance(manifest, PostProcessManifest$manifest)) {
return;
}
ranges = py.dict([["image_range", manifest.image_range], ["outputs.image.range", manifest.outputs.image.range]]);
for ([name, [black, white]] of py.iter(ranges.entries())) {
if (!(py.compare(black, white) < 0)) {
rising = ((py.compare(white, black) < 0) ? [white, black] : [0, 1]);
hint = set_hint$finding(name, rising);
yield py.violation(`manifest ${py.str(name)}`, py.str([black, white]), "black below white", undefined, undefined, hint);
}
}
}
function* view_is_4x4$inputs(subject) {
yield* py.iter(_wrong_shape$inputs(subject, "view", [4, 4]));
}
function* _wrong_shape$inputs(subject, role, expected) {
  let actual, entry, hint, tensor;
for ([entry, tensor] of py.iter(subject.inputs_of(role))) {
if ((!py.eq(tensor.dims, expected))) {
[actual, hint] = [`shape ${py.str(_shape_text$inputs(tensor))}`, noHint(subject, entry, tensor)];
yield py.violation(`input ${py.str(tensor.name)}`, actual, py.str(py.list(expected)), undefined, undefined, hint);
}
}
}
function _shape_text$inputs(tensor) {
if ((tensor.dims == null)) {
return "unknown";
}
return (py.plus((py.plus("[", py.list((function* () { for (const dim of py.iter(tensor.dims)) yield ((dim == null) ? "?" : py.str(dim)); })()).join(", "))), "]"));
}
function* projection_is_4x4$inputs(subject) {
yield* py.iter(_wrong_shape$inputs(subject, "projection", [4, 4]));
}
function* time_is_1$inputs(subject) {
yield* py.iter(_wrong_shape$inputs(subject, "time", [1]));
}
function* input_dtype$inputs(subject) {
  let dtypes, entry, tensor;
for (entry of py.iter((py.bool(subject.manifest) ? subject.manifest.inputs : []))) {
tensor = subject.graph.input(entry.name);
dtypes = py.item(ROLES$4, entry.role).dtype;
if (((tensor != null) && (!py.contains(dtypes, tensor.dtype)))) {
yield py.violation(`input ${py.str(entry.name)}`, py.str(tensor.dtype), py.list(dtypes).join(" or "));
}
}
}
function* inputs_declared$inputs(subject) {
  let actual, declared, entry, expected, hint, location, manifest, role, tensor;
manifest = subject.manifest;
declared = (py.bool(manifest) ? py.dict((function* () { for (const entry of py.iter(manifest.inputs)) yield [entry.name, entry]; })()) : py.dict([]));
for (tensor of py.iter(subject.graph.inputs)) {
entry = py.get(declared, tensor.name);
location = `input ${py.str(tensor.name)}`;
if ((entry == null)) {
[actual, expected] = [`${py.str(tensor)} without a role`, "a declared role, or no such input"];
yield py.violation(location, actual, expected, undefined, undefined, noHint(subject, tensor));
continue;
}
role = py.item(ROLES$4, entry.role);
if ((py.bool(manifest) && (!py.contains(role.kinds, manifest.kind)))) {
expected = `a role that a ${py.str(manifest.kind)} may take`;
hint = noHint(subject, entry, tensor);
yield py.violation(location, `role ${py.str(entry.role)}`, expected, undefined, undefined, hint);
}
if ((py.bool(role.needs_range) && (entry.range == null))) {
yield py.violation(location, `role ${py.str(entry.role)} without a range`, "\"range\": [low, high]");
}
yield* py.iter(_feed_faults$inputs(subject, entry, tensor));
}
}
function* _feed_faults$inputs(subject, entry, tensor) {
  let actual, dims, expected, hint, kind, location, role, shapes;
[role, kind] = [entry.role, (py.bool(subject.manifest) ? subject.manifest.kind : "")];
if (((py.contains(_SHAPE_RULES$9, role)) && (py.eq(kind, "gaussian-generator")))) {
return;
}
location = `input ${py.str(tensor.name)}`;
[dims, hint] = [static_dims$graph(tensor), noHint(subject, entry, tensor)];
if ((dims == null)) {
if ((!py.eq(kind, "post-process"))) {
actual = `shape ${py.str(_shape_text$inputs(tensor))}`;
yield py.violation(location, actual, "a static shape", undefined, undefined, noHint(tensor));
} else {
if (!py.bool(_is_open_image$inputs(tensor, role))) {
shapes = _shapes_text$inputs(py.item(ROLES$4, role), kind);
expected = `${py.str(shapes)}, channels first; only height and width may be open, not the batch`;
yield py.violation(location, `shape ${py.str(_shape_text$inputs(tensor))}`, expected, undefined, undefined, hint);
}
}
return;
}
if ((matching_shape$roles(py.item(ROLES$4, role), dims, kind) == null)) {
shapes = _shapes_text$inputs(py.item(ROLES$4, role), kind);
expected = `${py.str(shapes)}, as the role ${py.str(role)} has`;
yield py.violation(location, `shape ${py.str(_shape_text$inputs(tensor))}`, expected, undefined, undefined, hint);
}
}
function static_dims$graph(tensor) {
  let sizes;
if ((tensor.dims == null)) {
return null;
}
sizes = [...(function* () { for (const dim of py.iter(tensor.dims)) if ((py.isinstance(dim, py.int) && (py.compare(dim, 0) > 0))) yield dim; })()];
return ((py.eq(py.len(sizes), py.len(tensor.dims))) ? py.list(sizes) : null);
}
function _is_open_image$inputs(tensor, role) {
  let sizes;
if ((tensor.dims == null)) {
return false;
}
sizes = py.set(["H", "W"]);
return py.list((function* () { for (const shape of py.iter(py.item(ROLES$4, role).shapes)) yield py.and((py.eq(py.len(shape), py.len(tensor.dims))), () => py.list((function* () { for (const [expected, dim] of py.iter(py.zip(shape, tensor.dims))) yield py.or((py.contains(sizes, expected)), () => py.and(py.isinstance(dim, py.int), () => (py.contains([dim, py.str(expected)], expected)))); })()).every(py.bool)); })()).some(py.bool);
}
function _shapes_text$inputs(role, kind) {
return py.list((function* () { for (const shape of py.iter(shapes_of$roles(role, kind))) yield `[${py.str(py.list(py.map(py.str, shape)).join(", "))}]`; })()).join(" or ");
}
function shapes_of$roles(entry, kind) {
return py.get(_SHAPES_BY_KIND$10, [entry.name, kind], entry.shapes);
}
function matching_shape$roles(entry, dims, kind = "") {
  let shape;
for (shape of py.iter(shapes_of$roles(entry, kind))) {
if ((py.eq(shape, ["*"]))) {
return shape;
}
if (py.bool(matches_shape$roles(shape, dims))) {
return shape;
}
}
return null;
}
function matches_shape$roles(shape, dims) {
return py.and((py.eq(py.len(shape), py.len(dims))), () => py.list((function* () { for (const [expected, dim] of py.iter(py.zip(shape, dims))) yield py.or(py.isinstance(expected, py.str), () => (py.eq(expected, dim))); })()).every(py.bool));
}
function* inputs_reach_outputs$inputs(subject) {
  let entry, expected, generator, graph, tensor, used_names;
[graph, generator] = [subject.graph, subject.generator];
used_names = py.set();
for (tensor of py.iter(graph.outputs)) {
used_names = (py.union(used_names, py.item(graph.ancestors(tensor.name), 0)));
}
for (entry of py.iter((py.bool(subject.manifest) ? subject.manifest.inputs : []))) {
expected = py.or((generator == null), () => generator.depends(entry));
if (((!py.contains(used_names, entry.name)) && py.bool(expected))) {
yield py.violation(`input ${py.str(entry.name)}`, "no output depends on it", "an input that some output depends on", undefined, undefined, ((generator != null) ? "" : noHint(subject, entry)));
}
}
}
function* weights_are_no_inputs$inputs(subject) {
  let actual, names, remainder, weights;
names = [...(function* () { for (const value of py.iter(subject.file.proto.graph.input)) yield value.name; })()];
weights = [...(function* () { for (const name of py.iter(names)) if ((py.contains(subject.graph.initializers, name))) yield name; })()];
if (py.bool(weights)) {
remainder = ((py.compare(py.len(weights), 1) > 0) ? `, like ${py.str((py.minus(py.len(weights), 1)))} more of the inputs` : "");
actual = `is also a weight${py.str(remainder)}`;
yield py.violation(`input ${py.str(py.item(weights, 0))}`, actual, "a weight that is not an input");
}
}
function* input_range_ordered$input_declarations(subject) {
  let actual, dtype, ends, entry, expected, high, highest, hint, is_int32, is_whole, low, lowest, path, tensor;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if ((entry.range == null)) {
continue;
}
[[low, high], tensor] = [entry.range, subject.graph.input(entry.name)];
actual = `range ${py.str([low, high])}`;
dtype = py.or((py.bool(tensor) ? tensor.dtype : null), () => "float32");
is_int32 = (py.eq(dtype, "int32"));
[lowest, highest] = (py.bool(is_int32) ? [(py.minus((-2147483647), 1)), 2147483647] : [(-py.float(3.4028234663852886e+38)), py.float(3.4028234663852886e+38)]);
is_whole = py.or(py.item(ROLES$4, entry.role).index, () => is_int32);
if (!(py.compare(low, high) <= 0)) {
yield py.violation(_input_location$input_declarations(entry), actual, "low <= high");
} else {
if ((py.bool(is_whole) && !(py.bool(Number.isInteger(Number(low))) && py.bool(Number.isInteger(Number(high)))))) {
yield py.violation(_input_location$input_declarations(entry), actual, "whole numbers");
} else {
if (((py.compare(low, lowest) < 0) || (py.compare(high, highest) > 0))) {
expected = `numbers of ${py.str(dtype)}, from ${py.format(lowest, `.10g`)} to ${py.format(highest, `.10g`)}`;
ends = [py.max([low, lowest]), py.min([high, highest])];
path = `${py.str(subject.path_of(entry))}.range`;
hint = set_hint$finding(path, [...(function* () { for (const end of py.iter(ends)) yield (py.bool(is_int32) ? py.int(end) : end); })()]);
yield py.violation(_input_location$input_declarations(entry), actual, expected, undefined, undefined, hint);
}
}
}
}
}
function declared_inputs$input_declarations(subject) {
return (py.bool(subject.manifest) ? subject.manifest.inputs : []);
}
function _input_location$input_declarations(entry) {
return `manifest input ${py.str(entry.name)}`;
}
function* input_default_fits$input_declarations(subject) {
  let entry, fault, shape;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
shape = shape_of$input_declarations(subject, entry);
if (((entry.default == null) || (shape == null))) {
continue;
}
fault = _default_value_fault$input_declarations(entry, shape);
if ((fault != null)) {
yield py.violation(_input_location$input_declarations(entry), ...py.iter(fault));
}
}
}
function shape_of$input_declarations(subject, entry) {
  let dims, tensor;
tensor = subject.graph.input(entry.name);
dims = (py.bool(tensor) ? static_dims$graph(tensor) : null);
return ((dims == null) ? entry.shape : py.list((function* () { for (const dim of py.iter(dims)) yield py.int(dim); })()));
}
function _default_value_fault$input_declarations(entry, shape) {
  let actual, default_, high, is_quaternion_pose, low, numbers, out_of_range, room;
default_ = entry.default;
is_quaternion_pose = py.and((py.eq(entry.role, "pose")), () => (py.eq(py.slice(shape, (-1), null), [4])));
if (((py.eq(default_, "identity")) && !((py.contains(_SQUARE_SHAPES$11, py.slice(shape, (-2), null))) || py.bool(is_quaternion_pose)))) {
return [`default identity for shape ${py.str(py.list(shape))}`, "a matrix or quaternions"];
}
if ((py.isinstance(default_, py.list) && (!py.eq(py.len(default_), py.list(shape).reduce((product, size) => product * size, 1))))) {
actual = `default of ${py.str(py.len(default_))} numbers for shape ${py.str(py.list(shape))}`;
return [actual, `${py.str(py.list(shape).reduce((product, size) => product * size, 1))} numbers`];
}
numbers = _default_numbers$input_declarations(entry);
[low, high] = py.or(entry.range, () => [py.min(numbers, 0), py.max(numbers, 0)]);
room = (1e-06 * py.max([Math.abs(low), Math.abs(high), py.float(1.0)]));
out_of_range = [...(function* () { for (const number of py.iter(numbers)) if (!(py.compare((py.minus(low, room)), number) <= 0 && py.compare(number, (py.plus(high, room))) <= 0)) yield number; })()];
if (py.bool(out_of_range)) {
return [`default ${py.format(py.item(out_of_range, 0), `g`)} beyond the range ${py.str([low, high])}`, "one within"];
}
if ((py.bool(py.item(ROLES$4, entry.role).index) && !py.list((function* () { for (const number of py.iter(numbers)) yield Number.isInteger(Number(number)); })()).every(py.bool))) {
return [`default ${py.format(py.item(numbers, 0), `g`)} of an input that counts`, "a whole number"];
}
return null;
}
function _default_numbers$input_declarations(entry) {
  let default_, words;
words = py.dict([["zeros", [py.float(0.0)]], ["identity", [py.float(0.0), py.float(1.0)]]]);
default_ = entry.default;
if (py.isinstance(default_, py.str)) {
return py.item(words, default_);
}
return py.list(py.map(py.float, (py.isinstance(default_, py.list) ? default_ : [py.or(default_, () => py.float(0.0))])));
}
function* input_convention_known$input_declarations(subject) {
  let actual, entry, expected, joints, known, shape;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if ((entry.convention == null)) {
continue;
}
[known, shape] = [py.item(ROLES$4, entry.role).conventions, shape_of$input_declarations(subject, entry)];
actual = `convention ${py.str(py.repr(entry.convention))}`;
if ((!py.contains(known, entry.convention))) {
expected = (py.bool(known) ? `one of ${py.str(py.list(known).join(", "))}` : `none, as ${py.str(entry.role)} has`);
yield py.violation(_input_location$input_declarations(entry), actual, expected);
} else {
if (((shape != null) && !py.bool(_shape_fits_convention$input_declarations(entry, shape)))) {
expected = "a shape that can hold it";
yield py.violation(_input_location$input_declarations(entry), `${py.str(actual)} for shape ${py.str(py.list(shape))}`, expected);
} else {
if (((shape != null) && (!py.contains(py.get(JOINTS$12, entry.convention, py.slice(shape, null, 1)), py.item(shape, 0))))) {
joints = py.list(py.map(py.str, py.item(JOINTS$12, entry.convention))).join(" or ");
expected = `${py.str(joints)} joints; a skeleton of its own has no convention of SMPL`;
yield py.violation(_input_location$input_declarations(entry), `${py.str(actual)} for ${py.str(py.item(shape, 0))} joints`, expected);
}
}
}
}
}
function _shape_fits_convention$input_declarations(entry, shape) {
  let convention;
convention = entry.convention;
if ((py.contains(CONVENTION_SHAPES$13, [entry.role, convention]))) {
return matches_shape$roles(py.item(CONVENTION_SHAPES$13, [entry.role, py.str(convention)]), shape);
}
if ((py.eq(convention, "matrix"))) {
return (py.eq(shape, [3, 3]));
}
if ((py.eq(convention, "quaternion-wxyz"))) {
return (py.eq(py.slice(shape, (-1), null), [4]));
}
return py.and((py.eq(py.slice(shape, (-1), null), [3])), () => py.or((!py.eq(entry.role, "root_rotation")), () => (py.eq(py.len(shape), 1))));
}
function* input_has_a_start$input_declarations(subject) {
  let actual, entry, low;
if ((subject.candidate != null)) {
return;
}
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if (((py.contains(_USER_ROLES$14, entry.role)) && (entry.default == null))) {
low = ((entry.range == null) ? "zeros" : `${py.format(py.item(entry.range, 0), `g`)}, the low end,`);
actual = `role ${py.str(entry.role)} without a default: ${py.str(low)} would be fed`;
yield py.violation(_input_location$input_declarations(entry), actual, "\"default\"");
}
}
}
function* timing_belongs_to_time$input_declarations(subject) {
  let actual, declared, entry, timing_fields;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
timing_fields = py.dict([["loop", entry.loop], ["fps", entry.fps], ["frames", entry.frames]]);
declared = [...(function* () { for (const [name, value] of py.iter(timing_fields.entries())) if ((value != null)) yield name; })()];
if ((py.bool(declared) && (!py.contains(_TIME_ROLES$15, entry.role)))) {
actual = `role ${py.str(entry.role)} with ${py.str(py.list(declared).join(", "))}`;
yield py.violation(_input_location$input_declarations(entry), actual, "role time or frame_index");
} else {
if ((py.eq(entry.fps, 0))) {
yield py.violation(_input_location$input_declarations(entry), "fps 0", "frames per second above 0");
}
}
}
if ((py.isinstance(subject.manifest, TrajectoryManifest$manifest) && !py.bool(subject.manifest.step_seconds))) {
yield py.violation("manifest step_seconds", "0 seconds", "a time above 0");
}
}
function* angles_are_radians$input_declarations(subject) {
  let actual, entry, is_vector, shape;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
shape = shape_of$input_declarations(subject, entry);
if (((!py.contains(ROTATION_ROLES$16, entry.role)) || (entry.range == null) || (shape == null))) {
continue;
}
is_vector = py.and((py.eq(py.slice(shape, (-1), null), [3])), () => (!py.eq(entry.convention, "matrix")));
if ((py.bool(is_vector) && (!py.eq(shape, [3, 3])) && (py.compare(py.max(py.map(Math.abs, entry.range)), 6.3) > 0))) {
actual = `range ${py.str(py.list(entry.range))}, which looks like degrees`;
yield py.violation(_input_location$input_declarations(entry), actual, "radians, within ±2π (±6.28)");
}
}
}
function* frames_fit_range$input_declarations(subject) {
  let actual, entry, expected, high, low, numbers, size;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if (((!py.contains(_TIME_ROLES$15, entry.role)) || (entry.range == null) || (entry.frames == null))) {
continue;
}
[low, high] = entry.range;
if ((py.eq(entry.role, "frame_index"))) {
numbers = (py.plus(py.int((py.minus(high, low))), 1));
} else {
size = py.or(py.max([Math.abs(low), Math.abs(high)]), () => py.float(1.0));
numbers = py.max([1, py.int((((py.minus(high, low)) / size) * 8388608))]);
}
if ((py.compare(entry.frames, numbers) > 0)) {
actual = `${py.str(entry.frames)} frames in the range ${py.str(py.list(entry.range))}`;
expected = `${py.str(numbers)} distinct frames at most`;
yield py.violation(_input_location$input_declarations(entry), actual, expected, undefined, undefined, noHint(subject, entry, numbers));
}
}
}
function* joints_fit_pose$avatar_inputs(subject) {
  let entry, expected, hint, path, shape;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if (!py.bool(entry.joints)) {
continue;
}
shape = shape_of$input_declarations(subject, entry);
path = `${py.str(subject.path_of(entry))}.joints`;
hint = remove_hint$finding(path, "list one for each row, in the order of the rows, parents first");
if ((!py.eq(entry.role, "pose"))) {
yield _input_violation$avatar_inputs(entry, `role ${py.str(entry.role)} with joints`, "role pose");
} else {
if (((shape != null) && (!py.eq(py.len(entry.joints), py.item(shape, 0))))) {
expected = `${py.str(py.item(shape, 0))}, one for each row`;
yield _input_violation$avatar_inputs(entry, `${py.str(py.len(entry.joints))} joints`, expected, hint);
} else {
yield* py.iter(_order_faults$avatar_inputs(entry, hint));
}
}
}
}
function* _order_faults$avatar_inputs(entry, hint) {
  let actual, joint, preceding_input_names;
preceding_input_names = py.set();
for (joint of py.iter(entry.joints)) {
if ((py.contains(preceding_input_names, joint.name))) {
yield _input_violation$avatar_inputs(entry, `two joints ${py.str(py.repr(joint.name))}`, "different names", hint);
}
if (((joint.parent != null) && (!py.contains(preceding_input_names, joint.parent)))) {
actual = `joint ${py.str(py.repr(joint.name))} before its parent ${py.str(py.repr(joint.parent))}`;
yield _input_violation$avatar_inputs(entry, actual, "parents first", hint);
}
preceding_input_names.add(joint.name);
}
}
function _input_violation$avatar_inputs(entry, actual, expected, hint = "") {
return py.violation(`manifest input ${py.str(entry.name)}`, actual, expected, undefined, undefined, hint);
}
function* blend_weights_in_unit_range$avatar_inputs(subject) {
  let entry, high, hint, line, low;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if (((py.eq(entry.convention, "arkit-52")) && (entry.range != null))) {
[low, high] = entry.range;
if (!(py.compare(0, low) <= 0 && py.compare(low, high) <= 0 && py.compare(high, 1) <= 0)) {
line = line_hint$finding(`${py.str(entry.name)} = ${py.str(entry.name)} * ${py.format(py.max([(-low), high]), `.9g`)}`, true);
hint = `${py.str(set_hint$finding(`${py.str(subject.path_of(entry))}.range`, [0, 1]))} ${py.str(line)}`;
yield _input_violation$avatar_inputs(entry, `range ${py.str([low, high])}`, "within [0, 1]", hint);
}
}
}
}
function line_hint$finding(line, first = false) {
  let _, bracket, target;
[target, bracket, _] = py.partition(py.item(py.partition(line, " = "), 0), "[");
line = (py.bool(bracket) ? `${py.str(target)} = ${py.str(target)}.clone(); ${py.str(line)}` : line);
return (py.bool(line) ? `${py.str((py.bool(first) ? "Begin" : "End"))} \`forward\` on \`${py.str(line)}\`.` : "");
}
function* sound_described$avatar_inputs(subject) {
  let actual, declared, entry, expected, hint, is_mel, missing, required_fields, shape;
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
declared = [...(function* () { for (const name of py.iter(_SOUND_FIELDS$17)) if ((entry[name] != null)) yield name; })()];
if ((!py.eq(entry.role, "audio"))) {
if (py.bool(declared)) {
yield _input_violation$avatar_inputs(entry, `role ${py.str(entry.role)} with ${py.str(py.list(declared).join(", "))}`, "role audio");
}
continue;
}
shape = shape_of$input_declarations(subject, entry);
is_mel = py.or((py.eq(entry.convention, "mel")), () => py.and((shape != null), () => (py.compare(py.len(shape), 1) > 0)));
required_fields = (py.bool(is_mel) ? _SOUND_FIELDS$17 : py.slice(_SOUND_FIELDS$17, null, 1));
missing = [...(function* () { for (const name of py.iter(required_fields)) if ((!py.contains(declared, name))) yield name; })()];
if (py.bool(missing)) {
hint = noHint(subject.path_of(entry), entry, missing);
expected = `${py.str(py.list(required_fields).join(", "))} of the sound`;
yield _input_violation$avatar_inputs(entry, `no ${py.str(py.list(missing).join(", "))}`, expected, hint);
} else {
if ((py.bool(is_mel) && (py.compare(py.or(entry.hop, () => 0), py.or(entry.window, () => 0)) > 0))) {
actual = `hop ${py.str(entry.hop)} beyond the window ${py.str(entry.window)}`;
expected = "hop <= window, so that no sample is skipped";
hint = `Declare "hop": ${py.str(entry.window)}, or a wider window, as the model was trained.`;
yield _input_violation$avatar_inputs(entry, actual, expected, hint);
}
}
}
}
function* pictures_have_cameras$scene_inputs(subject) {
  let counts, entry, expected, pictures, shape, shapes;
pictures = [...(function* () { for (const entry of py.iter(declared_inputs$input_declarations(subject))) if ((py.contains(PICTURE_ROLES$18, entry.role))) yield entry; })()];
shapes = [...(function* () { for (const entry of py.iter(pictures)) if ((py.eq(entry.role, "image"))) yield shape_of$input_declarations(subject, entry); })()];
counts = [...(function* () { for (const shape of py.iter(shapes)) if (py.bool(shape)) yield py.item(shape, 0); })()];
for (entry of py.iter(pictures)) {
shape = shape_of$input_declarations(subject, entry);
if ((!py.bool(counts) && (!py.eq(entry.role, "image")))) {
yield _input_violation$scene_inputs(entry, `role ${py.str(entry.role)} without pictures`, "a role image");
} else {
if ((py.bool(counts) && py.bool(shape) && (!py.eq(py.item(shape, 0), py.item(counts, 0))))) {
expected = `${py.str(py.item(counts, 0))}, as the first input of pictures has`;
yield _input_violation$scene_inputs(entry, `${py.str(py.item(shape, 0))} pictures`, expected);
}
}
}
}
function _input_violation$scene_inputs(entry, actual, expected) {
return py.violation(`manifest input ${py.str(entry.name)}`, actual, expected);
}
function* pass_suits_role$scene_inputs(subject) {
  let actual, entry, kind;
kind = (py.bool(subject.manifest) ? subject.manifest.kind : "");
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if ((entry.pass_ == null)) {
continue;
}
actual = `role ${py.str(entry.role)} with the pass ${py.str(py.repr(entry.pass_))}`;
if ((!py.eq(kind, "gaussian-generator"))) {
yield _input_violation$scene_inputs(entry, actual, `no pass, as a ${py.str(kind)} has no scene`);
} else {
if (((py.eq(entry.pass_, "scene")) && (py.contains(_FRAME_ROLES$19, entry.role)))) {
yield _input_violation$scene_inputs(entry, actual, "the pass 'frame', or none");
} else {
if (((py.eq(entry.pass_, "frame")) && (py.contains(PICTURE_ROLES$18, entry.role)))) {
yield _input_violation$scene_inputs(entry, actual, "the pass 'scene', or none");
}
}
}
}
}
function* background_suits_pictures$scene_inputs(subject) {
  let actual, entry, kind;
kind = (py.bool(subject.manifest) ? subject.manifest.kind : "");
for (entry of py.iter(declared_inputs$input_declarations(subject))) {
if ((entry.background == null)) {
continue;
}
if (((!py.eq(entry.role, "image")) || (!py.eq(kind, "gaussian-generator")))) {
actual = `role ${py.str(entry.role)} of a ${py.str(kind)} with a background`;
yield _input_violation$scene_inputs(entry, actual, "role image of a gaussian-generator");
} else {
if (!py.list((function* () { for (const channel of py.iter(entry.background)) yield (py.compare(0, channel) <= 0 && py.compare(channel, 1) <= 0); })()).every(py.bool)) {
yield _input_violation$scene_inputs(entry, `background ${py.str(py.list(entry.background))}`, "red, green, blue from 0 to 1");
}
}
}
}
function* scene_pass_computes$scene_inputs(subject) {
  let actual, entries, entry, frame_names, generator, names, node, scene_names;
entries = declared_inputs$input_declarations(subject);
generator = subject.generator;
scene_names = py.set((function* () { for (const entry of py.iter(entries)) if (py.bool(entry.is_of_scene)) yield entry.name; })());
frame_names = py.set((function* () { for (const entry of py.iter(entries)) if ((!py.bool(entry.is_of_scene) && ((generator == null) || py.bool(generator.depends(entry))))) yield entry.name; })());
if ((!py.bool(scene_names) || !py.bool(frame_names))) {
return;
}
for (node of py.iter(subject.graph.nodes)) {
names = names_read$graph(node);
if (py.list((function* () { for (const name of py.iter(names)) yield (py.contains(frame_names, name)); })()).some(py.bool)) {
py.list(node.output).forEach((entry) => frame_names.add(entry));
} else {
if (py.list((function* () { for (const name of py.iter(names)) yield (py.contains(scene_names, name)); })()).some(py.bool)) {
return;
}
}
}
for (entry of py.iter(entries)) {
if (py.bool(entry.is_of_scene)) {
actual = "every operator on it needs an input of the frame, too";
yield _input_violation$scene_inputs(entry, actual, "an operator on scene inputs alone");
}
}
}
function names_read$graph(node) {
  let attribute, graph, names, nested_node;
names = py.list(py.list(node.input).filter(py.bool));
for (attribute of py.iter(node.attribute)) {
for (graph of py.iter(subgraphs$model_file(attribute))) {
for (nested_node of py.iter(graph.node)) {
names.push(...py.iter(names_read$graph(nested_node)));
}
names.push(...py.iter((function* () { for (const output of py.iter(graph.output)) yield output.name; })()));
}
}
return names;
}
function subgraphs$model_file(attribute) {
return [...py.iter((py.bool(attribute.HasField("g")) ? [attribute.g] : [])), ...py.iter(attribute.graphs)];
}
function* gaussians_declared$outputs(subject) {
  let actual, expected, outputs;
if ((subject.gaussians != null)) {
return;
}
outputs = py.or(py.list((function* () { for (const tensor of py.iter(subject.graph.outputs)) yield py.str(tensor); })()).join(", "), () => "nothing");
[actual, expected] = [`no packed Gaussians among ${py.str(outputs)}`, `one [N, ${py.str(10)}] output`];
yield py.violation("outputs", actual, expected, undefined, undefined, noHint(subject, "gaussians"));
}
function* gaussians_rank_2$outputs(subject) {
  let expected, is_rank_1, tensor;
tensor = subject.gaussians;
if (((tensor != null) && ((tensor.dims == null) || (!py.eq(py.len(tensor.dims), 2))))) {
is_rank_1 = py.and((tensor.dims != null), () => (py.eq(py.len(tensor.dims), 1)));
expected = (py.plus("two axes, [N, 10]", (py.bool(is_rank_1) ? "; these rows are flattened" : "")));
yield py.violation(`output ${py.str(tensor.name)}`, `shape ${py.str(tensor)}`, expected);
}
}
function* gaussian_row_has_10$outputs(subject) {
  let expected, tensor;
tensor = subject.gaussians;
if (((tensor != null) && (!py.eq(_dim_of_axis$outputs(tensor, (-1)), 10)))) {
expected = (py.plus(`[N, ${py.str(10)}]`, _likely_columns$outputs(tensor)));
yield py.violation(`output ${py.str(tensor.name)}`, `shape ${py.str(tensor)}`, expected);
}
}
function _dim_of_axis$outputs(tensor, axis) {
return (((tensor != null) && py.bool(tensor.dims)) ? py.item(tensor.dims, axis) : null);
}
function _likely_columns$outputs(tensor) {
  let columns;
columns = _dim_of_axis$outputs(tensor, (-1));
if ((py.eq(_dim_of_axis$outputs(tensor, 0), 10))) {
return "; this one is transposed, channels first";
}
if ((py.isinstance(columns, py.int) && (py.contains(COLUMN_MEANINGS$20, columns)))) {
return `; ${py.str(columns)} columns usually are ${py.str(py.item(COLUMN_MEANINGS$20, columns))}`;
}
return "";
}
function* capacity_static$outputs(subject) {
  let declared, expected, first, hint, names, tensor;
tensor = subject.gaussians;
first = _dim_of_axis$outputs(tensor, 0);
if (((tensor != null) && !(py.isinstance(first, py.int) && (py.compare(first, 0) > 0)))) {
yield py.violation(`output ${py.str(tensor.name)}`, `shape ${py.str(tensor)}`, "a fixed, positive number of rows", undefined, undefined, noHint(subject, tensor.name));
return;
}
names = [...(function* () { for (const part of py.iter([tensor, subject.appearance])) if ((part != null)) yield part.name; })()];
for (declared of py.iter(subject.graph.declared_outputs)) {
if (((py.contains(names, declared.name)) && !py.list((function* () { for (const d of py.iter(py.or(declared.dims, () => []))) yield py.isinstance(d, py.int); })()).every(py.bool))) {
expected = "static sizes in place of symbols, although they can be inferred";
hint = noHint(subject, declared.name);
yield py.violation(`output ${py.str(declared.name)}`, `shape ${py.str(declared)}`, expected, undefined, undefined, hint);
}
}
}
function* appearance_declared$outputs(subject) {
  let expected;
if ((subject.appearance == null)) {
expected = "one [N, channels] output";
yield py.violation("outputs", "no appearance", expected, undefined, undefined, noHint(subject, "appearance"));
}
}
function* appearance_channels$outputs(subject) {
  let allowed_channels, channels, declared, degree, expected, hint, others, tensor;
[tensor, declared] = [subject.appearance, subject.declared_appearance];
if (((tensor == null) || (declared == null))) {
return;
}
allowed_channels = py.item(APPEARANCE_CHANNELS$21, declared.space);
channels = _dim_of_axis$outputs(tensor, (-1));
if (((tensor.dims == null) || (!py.eq(py.len(tensor.dims), 2)) || (!py.contains(allowed_channels, channels)))) {
expected = `[N, C] with C in ${py.str(py.list(allowed_channels))} for ${py.str(declared.space)}`;
if (((py.eq(declared.space, "sh")) && py.isinstance(channels, py.int) && (py.contains(allowed_channels, (py.plus(channels, 3)))))) {
expected = (py.plus(expected, `; ${py.str(channels)} is f_rest without the constant term f_dc`));
} else {
if (((tensor.dims != null) && (py.eq(py.len(tensor.dims), 3)))) {
expected = (py.plus(expected, "; reshape the last two axes into one"));
}
}
others = [...(function* () { for (const [s, sizes] of py.iter(APPEARANCE_CHANNELS$21.entries())) if (((py.contains(sizes, channels)) && (py.compare(channels, 4) > 0))) yield s; })()];
hint = "";
if (((py.eq(declared.space, "rgb")) && (py.eq(others, ["sh"])) && py.isinstance(channels, py.int))) {
degree = set_hint$finding("outputs.appearance.degree", degree_of$spherical_harmonics((Math.floor(channels / 3))));
hint = `${py.str(set_hint$finding("outputs.appearance.space", "sh"))} ${py.str(degree)}`;
} else {
if ((py.isinstance(channels, py.int) && (!py.contains(allowed_channels, (py.plus(channels, 3)))))) {
hint = noHint(declared, channels);
}
}
yield py.violation(`output ${py.str(tensor.name)}`, `shape ${py.str(tensor)}`, expected, undefined, undefined, hint);
}
}
function degree_of$spherical_harmonics(count) {
if ((!py.contains(SH_COEFFICIENT_COUNTS$22, count))) {
throw new Error(`${py.str(count)} is not a number of SH coefficients: expected one of ${py.str(SH_COEFFICIENT_COUNTS$22)}`);
}
return SH_COEFFICIENT_COUNTS$22.indexOf(count);
}
function* appearance_rows$outputs(subject) {
  let fill, hint, missing, row_count, rows, tensor;
[tensor, rows] = [subject.appearance, _dim_of_axis$outputs(subject.gaussians, 0)];
row_count = _dim_of_axis$outputs(tensor, 0);
if (((tensor != null) && py.isinstance(rows, py.int) && (!py.eq(row_count, rows)))) {
hint = "Pad both outputs to the same capacity.";
if (py.isinstance(row_count, py.int)) {
missing = `rows.new_zeros(${py.str((py.minus(rows, row_count)))}, rows.shape[1])`;
fill = ((py.compare(rows, row_count) > 0) ? `torch.cat([rows, ${py.str(missing)}])` : `rows[:${py.str(rows)}]`);
hint = (py.plus(hint, ` ${py.str(line_hint$finding(`rows = ${py.str(fill)}`))}`));
}
yield py.violation(`output ${py.str(tensor.name)}`, `${py.str(row_count)} rows`, `${py.str(rows)} rows`, undefined, undefined, hint);
}
}
function* output_dtype$outputs(subject) {
  let hint, tensor;
for (tensor of py.iter([subject.gaussians, subject.appearance, subject.cells])) {
if (((tensor != null) && (!py.contains(ITEMSIZE$2, tensor.dtype)))) {
hint = ((py.eq(tensor.dtype, "uint8")) ? "Divide the bytes by 255 in float32." : "");
yield py.violation(`output ${py.str(tensor.name)}`, py.str(tensor.dtype), "float32 or float16", undefined, undefined, hint);
}
}
}
function* output_dtypes_match$outputs(subject) {
  let color, rows;
[rows, color] = [subject.gaussians, subject.appearance];
if (((rows != null) && (color != null) && (!py.eq(rows.dtype, color.dtype)))) {
yield py.violation(`output ${py.str(color.name)}`, py.str(color.dtype), `${py.str(rows.dtype)}, as ${py.str(rows.name)}`);
}
}
function* count_declared$outputs(subject) {
  let expected, hint;
if ((subject.count == null)) {
expected = "one int32 [1] output, usually num_points";
hint = py.or(noHint(subject, "count"), () => noHint(subject));
yield py.violation("outputs", "no row count", expected, undefined, undefined, hint);
}
}
function* count_is_int32$outputs(subject) {
  let tensor;
tensor = subject.count;
if (((tensor != null) && ((!py.eq(tensor.dtype, "int32")) || (!py.eq(tensor.dims, [1]))))) {
yield py.violation(`output ${py.str(tensor.name)}`, py.str(tensor), "int32 [1]");
}
}
function* outputs_are_computed$graph_outputs(subject) {
  let count, is_count, tensor;
count = subject.declared_count;
for (tensor of py.iter(subject.graph.outputs)) {
is_count = py.and((count != null), () => (py.eq(tensor.name, count.name)));
if (((py.contains(subject.graph.initializers, tensor.name)) && !py.bool(is_count))) {
yield py.violation(`output ${py.str(tensor.name)}`, "a weight", "the result of an operator");
}
}
}
function* outputs_are_distinct$graph_outputs(subject) {
  let count, name;
for ([name, count] of py.iter(py.counter(subject.graph.output_names).entries())) {
if ((py.compare(count, 1) > 0)) {
yield py.violation(`output ${py.str(name)}`, `listed ${py.str(count)} times`, "listed once");
}
}
}
function* rows_fill_words$outputs(subject) {
  let actual, channels, size, tensor;
for (tensor of py.iter([subject.gaussians, subject.appearance])) {
channels = _dim_of_axis$outputs(tensor, (-1));
if (((tensor == null) || !py.isinstance(channels, py.int))) {
continue;
}
size = (channels * py.get(ITEMSIZE$2, py.or(tensor.dtype, () => ""), 4));
if (py.bool((size - 4 * Math.floor(size / 4)))) {
actual = `${py.str(channels)} channels of ${py.str(tensor.dtype)}, ${py.str(size)} bytes a row`;
yield py.violation(`output ${py.str(tensor.name)}`, actual, `a multiple of ${py.str(4)} bytes`);
}
}
}
function* visionary_finds_gaussians$visionary(subject) {
  let actual, first_match, tensor;
tensor = subject.gaussians;
first_match = ((function* () { for (const t of py.iter(subject.graph.outputs)) if (py.bool(py.startsWith(t.name, "gauss"))) yield t.name; })().next().value ?? null);
if (((tensor != null) && (!py.eq(first_match, tensor.name)))) {
actual = (py.bool(first_match) ? `the viewer takes ${py.str(py.repr(first_match))}` : "the viewer finds none");
yield py.violation(`output ${py.str(tensor.name)}`, actual, "a name that starts with 'gauss', first");
}
}
function* visionary_finds_color$visionary(subject) {
  let actual, candidates, first_match, tensor;
tensor = subject.appearance;
candidates = [...(function* () { for (const t of py.iter(subject.graph.outputs)) if ((py.list((function* () { for (const word of py.iter(_COLOR_OUTPUT_WORDS$23)) yield (py.contains(t.name, word)); })()).some(py.bool) && py.bool(t.dims) && (py.contains(_COLOR_CHANNELS$24, py.item(t.dims, (-1)))))) yield t.name; })()];
first_match = (py.bool(candidates) ? py.item(candidates, 0) : null);
if (((tensor != null) && (!py.eq(first_match, tensor.name)))) {
actual = (py.bool(first_match) ? `the viewer takes ${py.str(py.repr(first_match))}` : "the viewer finds none");
yield py.violation(`output ${py.str(tensor.name)}`, actual, "a name with 'color', 'sh' or 'rgb', first");
}
}
function* outputs_declared$graph_outputs(subject) {
  let declared, is_graph_input, name;
declared = subject.output_names;
for (name of py.iter(py.dict(py.map((key) => [key, null], subject.graph.output_names)))) {
is_graph_input = (subject.graph.input(name) != null);
if ((py.bool(declared) && (!py.contains(declared, name)) && !py.bool(is_graph_input))) {
yield py.violation(`output ${py.str(name)}`, "not declared", `only ${py.str(py.list(declared).join(", "))}`);
}
}
}
function* image_out_as_in$companions(subject) {
  let _, declared, expected, hint, input_image, location, manifest, tensor, times;
manifest = subject.manifest;
if (!py.isinstance(manifest, PostProcessManifest$manifest)) {
return;
}
[declared, tensor] = _image$companions(subject, manifest);
if ((tensor == null)) {
return;
}
location = `output ${py.str(tensor.name)}`;
if (((tensor.dtype != null) && (!py.eq(tensor.dtype, declared.dtype)))) {
expected = `the declared dtype ${py.str(declared.dtype)}`;
yield py.violation(location, `graph has ${py.str(tensor.dtype)}`, expected);
}
for ([_, input_image] of py.iter(subject.inputs_of("image"))) {
if (!py.bool(_sizes_agree$companions(input_image, tensor, declared.scale))) {
times = ((py.eq(declared.scale, 1)) ? "" : `${py.str(declared.scale)} times the size of `);
expected = `${py.str(times)}${py.str(input_image)}, as ${py.str(input_image.name)} has, with 3 or 4 channels`;
hint = noHint(input_image, tensor, declared.scale);
yield py.violation(location, `shape ${py.str(tensor)}`, expected, undefined, undefined, hint);
}
}
}
function _image$companions(subject, manifest) {
  let declared;
declared = manifest.outputs.image;
return [declared, subject.graph.output(declared.name)];
}
function _sizes_agree$companions(input_image, output_image, scale) {
  let channels, known, sizes;
if (((input_image.dims == null) || (output_image.dims == null))) {
return true;
}
if (((!py.eq(py.len(input_image.dims), py.len(output_image.dims))) || (!py.eq(py.len(output_image.dims), 4)))) {
return false;
}
sizes = [[1, py.item(input_image.dims, 0), py.item(output_image.dims, 0)]];
sizes = (py.plus(sizes, [...(function* () { for (const a of py.iter([2, 3])) yield [scale, py.item(input_image.dims, a), py.item(output_image.dims, a)]; })()]));
known = py.list((function* () { for (const [k, x, y] of py.iter(sizes)) if ((py.isinstance(x, py.int) && py.isinstance(y, py.int))) yield (py.eq((k * x), y)); })()).every(py.bool);
channels = py.item(output_image.dims, 1);
return py.and(known, () => py.or(!py.isinstance(channels, py.int), () => (py.contains([3, 4], channels))));
}
function* states_as_declared$companions(subject) {
  let doubt_size, entry, expected, future, graph, hint, manifest, name, state, tensor, uncertainty_output;
manifest = subject.manifest;
if (!py.isinstance(manifest, TrajectoryManifest$manifest)) {
return;
}
[future, uncertainty_output] = [manifest.outputs.future, manifest.outputs.uncertainty];
[state, graph] = [py.item(STATE_SIZES$25, future.representation), subject.graph];
doubt_size = py.item(_doubt_sizes$companions(state), uncertainty_output.semantics);
for ([name, expected] of py.iter([[future.name, state], [uncertainty_output.name, doubt_size]])) {
hint = _states_hint$companions(subject, manifest, (py.eq(name, future.name)));
yield* py.iter(_check_size$companions(graph.output(name), `output ${py.str(name)}`, [future.steps, expected], hint));
}
for ([entry, tensor] of py.iter(subject.inputs_of("camera_history"))) {
yield* py.iter(_check_size$companions(tensor, `input ${py.str(entry.name)}`, [null, state]));
}
}
function _doubt_sizes$companions(state) {
return py.dict([["standard-deviation", state], ["covariance-upper", (Math.floor((state * (py.plus(state, 1))) / 2))]]);
}
function _states_hint$companions(subject, manifest, is_future) {
  let declared, field, fitting, future, is_same, rows, shapes, size, sizes, state, tensors, uncertainty;
[future, uncertainty] = [manifest.outputs.future, manifest.outputs.uncertainty];
tensors = [...(function* () { for (const part of py.iter([future, uncertainty])) yield subject.graph.output(part.name); })()];
shapes = [...(function* () { for (const tensor of py.iter(tensors)) yield (py.bool(tensor) ? py.or(tensor.dims, () => []) : []); })()];
if (py.list((function* () { for (const shape of py.iter(shapes)) yield (!py.eq(py.len(shape), 2)); })()).some(py.bool)) {
return "";
}
[rows, size] = py.item(shapes, (py.bool(is_future) ? 0 : 1));
if ((py.isinstance(rows, py.int) && (!py.eq(rows, future.steps)))) {
is_same = (py.eq(py.item(py.item(shapes, 0), 0), py.item(py.item(shapes, 1), 0)));
return (py.bool(is_same) ? set_hint$finding("outputs.future.steps", rows) : "");
}
state = py.item(STATE_SIZES$25, future.representation);
[field, declared, sizes] = (py.bool(is_future) ? ["future.representation", future.representation, STATE_SIZES$25] : ["uncertainty.semantics", uncertainty.semantics, _doubt_sizes$companions(state)]);
fitting = [...(function* () { for (const name of py.iter(sizes)) if ((py.eq(py.item(sizes, name), size) && !py.eq(size, py.item(sizes, declared)))) yield name; })()];
return (py.bool(fitting) ? set_hint$finding(`outputs.${py.str(field)}`, py.item(fitting, 0)) : "");
}
function* _check_size$companions(tensor, location, expected, hint = "") {
  let expected_shape, has_fitting_shape;
if (((tensor == null) || (tensor.dims == null))) {
return;
}
expected_shape = `[${py.str(((py.item(expected, 0) == null) ? "T" : py.item(expected, 0)))}, ${py.str(py.item(expected, 1))}]`;
has_fitting_shape = py.and((py.eq(py.len(tensor.dims), 2)), () => py.list((function* () { for (const [dim, size] of py.iter(py.zip(tensor.dims, expected))) yield py.or((size == null), () => !py.isinstance(dim, py.int), () => (py.eq(dim, size))); })()).every(py.bool));
if (!py.bool(has_fitting_shape)) {
yield py.violation(location, `shape ${py.str(tensor)}`, `${py.str(expected_shape)}, as the manifest fixes`, undefined, undefined, hint);
} else {
if ((!py.contains([null, "float32"], tensor.dtype))) {
yield py.violation(location, py.str(tensor.dtype), "float32");
}
}
}
function* cell_row_has_10$cells(subject) {
  let dims, expected, has_row_count, hint, rows, tensor;
tensor = subject.cells;
if ((tensor == null)) {
return;
}
dims = py.or(tensor.dims, () => []);
rows = (py.bool(dims) ? py.item(dims, 0) : null);
has_row_count = py.and(py.isinstance(rows, py.int), () => (py.compare(rows, 0) > 0));
if (!((py.eq(py.len(dims), 2)) && (py.eq(py.item(dims, 1), 10)) && py.bool(has_row_count))) {
expected = `[C, ${py.str(10)}] with a fixed C`;
hint = noHint(subject, tensor);
yield py.violation(`output ${py.str(tensor.name)}`, `shape ${py.str(tensor)}`, expected, undefined, undefined, hint);
}
}
function* cells_hold_all_rows$cells(subject) {
  let actual, capacity, cells, declared, expected, hint, rows, tensor;
[declared, tensor, rows] = [subject.declared_cells, subject.cells, subject.gaussians];
if (((declared == null) || (tensor == null) || (rows == null))) {
return;
}
[cells, capacity] = [py.item(tensor.dims, 0), py.item(rows.dims, 0)];
if ((py.isinstance(cells, py.int) && (!py.eq((cells * declared.per_cell), capacity)))) {
actual = `${py.str(cells)} cells of ${py.str(declared.per_cell)} rows`;
hint = noHint(cells, declared.per_cell, capacity);
expected = `cells for ${py.str(capacity)} rows`;
yield py.violation(`output ${py.str(tensor.name)}`, actual, expected, undefined, undefined, hint);
}
}
function* opset_supported$graph(subject) {
  let high, hint, low, opset, proto;
[low, high] = subject.target.opset;
proto = subject.file.proto;
opset = declared_opset$model_file(proto);
if ((opset == null)) {
yield py.violation("opset_import", "no version of the ONNX operator set", `${py.str(low)} to ${py.str(high)}`);
} else {
if (!(py.compare(low, opset) <= 0 && py.compare(opset, high) <= 0)) {
hint = noHint(subject, opset, high);
yield py.violation("opset_import", `operator set ${py.str(opset)}`, `${py.str(low)} to ${py.str(high)}`, undefined, undefined, hint);
}
}
if ((py.compare(proto.ir_version, subject.target.ir) > 0)) {
yield py.violation("ir_version", py.str(proto.ir_version), `${py.str(subject.target.ir)} at most`, undefined, undefined, "`gsgen fix MODEL -o COPY` sets the version that the operator set and the types of the weights need; if that is too high, export at operator set 18, in float32.");
}
}
function declared_opset$model_file(proto) {
  let versions;
versions = py.dict((function* () { for (const entry of py.iter(proto.opset_import)) yield [entry.domain, entry.version]; })());
return ((function* () { for (const domain of py.iter(MAIN_DOMAIN$8)) if ((py.contains(versions, domain))) yield py.item(versions, domain); })().next().value ?? null);
}
function* standard_operators$graph(subject) {
  let actual, allowed_domains, graph, known, node;
[graph, allowed_domains] = [subject.graph, subject.target.domains];
for (node of py.iter(graph.all_nodes())) {
known = py.or((py.contains(allowed_domains, node.domain)), () => (py.contains(graph.functions, [node.domain, node.op_type])));
if (!py.bool(known)) {
actual = `domain ${py.str(py.repr(node.domain))}`;
yield py.violation(_node_location$graph(node), actual, "the ONNX domain, or a function in the model");
}
}
}
function _node_location$graph(node) {
return `node ${py.str(py.or(node.name, () => node.op_type))} (${py.str(node.op_type)})`;
}
function* no_control_flow$graph(subject) {
  let node;
for (node of py.iter(subject.graph.all_nodes())) {
if (((py.contains(CONTROL_FLOW$26, node.op_type)) && (py.contains(MAIN_DOMAIN$8, node.domain)))) {
yield py.violation(_node_location$graph(node), node.op_type, "a graph without control flow");
}
}
}
function* no_random_operators$repeatability(subject) {
  let actual, has_seed_attribute, node;
for (node of py.iter(_all_nodes$repeatability(subject))) {
if ((py.contains(RANDOM_OPERATORS$27, node.op_type))) {
has_seed_attribute = py.list((function* () { for (const attribute of py.iter(node.attribute)) yield (py.eq(attribute.name, "seed")); })()).some(py.bool);
actual = (py.bool(has_seed_attribute) ? "draws on from run to run despite its seed" : "no seed");
yield py.violation(_location$repeatability(node), actual, "stored numbers");
}
}
}
function* _all_nodes$repeatability(subject) {
  let functions, graph, idle_nodes, needed_nodes, node;
graph = subject.graph;
needed_nodes = py.set((function* () { for (const tensor of py.iter(graph.outputs)) for (const node of py.iter(py.item(graph.ancestors(tensor.name), 1))) yield node; })());
idle_nodes = (py.minus(py.set((function* () { for (const node of py.iter(graph.nodes)) yield node; })()), needed_nodes));
functions = (function* () { for (const function_ of py.iter(subject.file.proto.functions)) for (const node of py.iter(function_.node)) yield node; })();
for (node of py.iter([graph.all_nodes(), functions].flatMap((part) => py.list(part)))) {
if (((py.contains(MAIN_DOMAIN$8, node.domain)) && (!py.contains(idle_nodes, node)))) {
yield node;
}
}
}
function _location$repeatability(node) {
return `node ${py.str(py.or(node.name, () => (py.bool(node.output) ? py.item(node.output, 0) : "")))} (${py.str(node.op_type)})`;
}
function* names_are_clean$naming(subject) {
  let actual, count, hint, kind, name, names, tensor, tensors, where;
names = py.counter((function* () { for (const node of py.iter(subject.graph.nodes)) if (py.bool(node.name)) yield node.name; })());
for ([name, count] of py.iter(names.entries())) {
if ((py.compare(count, 1) > 0)) {
yield py.violation(`node ${py.str(name)}`, `${py.str(count)} nodes have this name`, "unique node names");
}
}
for ([kind, tensors] of py.iter([["input", subject.graph.inputs], ["output", subject.graph.outputs]])) {
for (tensor of py.iter(tensors)) {
if (!py.bool(is_plain_name$_safe_text(tensor.name))) {
[where, actual] = [`${py.str(kind)} ${py.str(py.repr(tensor.name))}`, "the name contains a blank"];
hint = noHint(tensor.name);
yield py.violation(where, actual, "a name without blanks", undefined, undefined, hint);
}
}
}
}
function is_plain_name$_safe_text(name) {
return py.and(!/[\p{C}\p{Zl}\p{Zp}]|(?! )\p{Zs}/u.test(name), () => (!py.contains(name, " ")));
}
function* outputs_survive_replay$capture(subject) {
  let actual, graph, location, node, producer, tensor;
graph = subject.graph;
for (tensor of py.iter(graph.outputs)) {
location = `output ${py.str(tensor.name)}`;
if (py.bool(graph.input(tensor.name))) {
yield py.violation(location, "an input passed through", "the result of an operator", undefined, undefined, noHint(subject, tensor.name));
continue;
}
if (!py.bool(graph.varies(tensor.name))) {
continue;
}
producer = py.get(graph.producers, tensor.name);
if (((producer != null) && py.bool(_does_copy_input$capture(graph, producer)))) {
yield py.violation(location, `made by ${py.str(producer.op_type)}`, "an operator that computes");
}
for (node of py.iter(py.item(graph.ancestors(tensor.name), 1))) {
if (((py.contains(_SCATTER_OPERATORS$30, node.op_type)) && py.bool(_does_share_base$capture(graph, node)))) {
location = `node ${py.str(py.or(node.name, () => node.op_type))} (${py.str(node.op_type)})`;
actual = "updates a tensor that others read";
yield py.violation(location, actual, "Where or Concat");
}
}
}
}
function _does_copy_input$capture(graph, node) {
  let are_axes_empty, axes, axes_inputs, has_axes_attribute, is_noop_with_empty_axes;
if ((!py.contains(MAIN_DOMAIN$8, node.domain))) {
return false;
}
is_noop_with_empty_axes = py.list((function* () { for (const attribute of py.iter(node.attribute)) yield py.and((py.eq(attribute.name, "noop_with_empty_axes")), () => attribute.i); })()).some(py.bool);
has_axes_attribute = py.list((function* () { for (const attribute of py.iter(node.attribute)) yield py.and((py.eq(attribute.name, "axes")), () => attribute.ints); })()).some(py.bool);
axes_inputs = [...(function* () { for (const name of py.iter(py.slice(node.input, 1, 2))) if (py.bool(name)) yield name; })()];
axes = (py.bool(axes_inputs) ? py.get(graph.tensors, py.item(axes_inputs, 0)) : null);
are_axes_empty = py.or(!py.bool(axes_inputs), () => py.and((axes != null), () => (axes.dims != null), () => (py.contains(axes.dims, 0))));
return is_copy$provider_placement(node.op_type, py.len(node.input), py.and(is_noop_with_empty_axes, () => are_axes_empty, () => !py.bool(has_axes_attribute)));
}
function is_copy$provider_placement(operator, inputs, keeps_all_axes) {
if ((py.contains(VIEW_OPERATORS$28, operator))) {
return true;
}
if (py.bool(py.startsWith(operator, "Reduce"))) {
return keeps_all_axes;
}
return py.and((py.contains(VARIADIC$29, operator)), () => (py.eq(inputs, 1)));
}
function _does_share_base$capture(graph, node) {
  let base;
base = py.item(node.input, 0);
return py.or((!py.contains(graph.producers, base)), () => (py.compare(py.get(graph.use_counts, base, 0), 1) > 0));
}
function* fits_buffer$limits(subject) {
yield* py.iter(_oversized_buffers$limits(subject, py.item(subject.target.limits, "buffer_bytes")));
}
function* _oversized_buffers$limits(subject, limit) {
  let location, size;
for ([location, size] of py.iter(_buffers$limits(subject))) {
if ((py.compare(size, limit) > 0)) {
yield py.violation(location, _mebibyte_text$limits(size), `${py.str(_mebibyte_text$limits(limit))} at most`);
}
}
}
function* _buffers$limits(subject) {
  let graph, name, tensor;
graph = subject.graph;
for (tensor of py.iter(graph.outputs)) {
yield [`output ${py.str(tensor.name)}`, tensor_bytes$graph(tensor)];
}
for ([name, tensor] of py.iter(graph.initializers.entries())) {
yield [`weight ${py.str(name)}`, tensor_bytes$graph(tensor)];
}
for (tensor of py.iter(_constant_tensors$limits(graph))) {
yield [`tensor ${py.str(tensor.name)}, computed from weights`, tensor_bytes$graph(tensor)];
}
}
function tensor_bytes$graph(tensor) {
  let bits, dim, dims;
dims = static_dims$graph(tensor);
if ((dims == null)) {
return 0;
}
bits = py.get(_DTYPE_BITS$31, py.or(tensor.dtype, () => ""), 32);
for (dim of py.iter(dims)) {
bits = (bits * py.int(dim));
}
return (-(Math.floor((-bits) / 8)));
}
function* _constant_tensors$limits(graph) {
  let executed_nodes, frame_tensors, name, outputs, tensor;
executed_nodes = frame_nodes$provider_placement(graph);
frame_tensors = py.set((function* () { for (const node of py.iter(executed_nodes)) for (const name of py.iter(node.output)) yield name; })());
outputs = py.set((function* () { for (const tensor of py.iter(graph.outputs)) yield tensor.name; })());
for (name of py.iter(py.dict(py.map((key) => [key, null], (function* () { for (const node of py.iter(executed_nodes)) for (const name of py.iter(names_read$graph(node))) yield name; })())))) {
if (((py.contains(graph.producers, name)) && (!py.contains(frame_tensors, name)) && (!py.contains(outputs, name)))) {
tensor = py.get(graph.tensors, name);
if ((tensor != null)) {
yield tensor;
}
}
}
}
function frame_nodes$provider_placement(graph) {
  let changing_tensors, executed_nodes, is_random, names, needed_tensors, node, nodes, resized_tensors, varying_tensors;
varying_tensors = py.set((function* () { for (const tensor of py.iter(graph.inputs)) yield tensor.name; })());
resized_tensors = py.set();
executed_nodes = [];
for (node of py.iter(graph.nodes)) {
names = names_read$graph(node);
is_random = py.and((py.contains(RANDOM_OPERATORS$27, node.op_type)), () => (py.contains(MAIN_DOMAIN$8, node.domain)));
changing_tensors = ((py.contains(_SHAPE_OPERATORS$32, node.op_type)) ? resized_tensors : varying_tensors);
if ((py.bool(is_random) || !py.bool(!py.list(names).some((entry) => changing_tensors.has(entry))))) {
py.list(node.output).forEach((entry) => varying_tensors.add(entry));
executed_nodes.push(node);
if (((py.contains(DATA_SIZED_OPERATORS$33, node.op_type)) || !py.bool(!py.list(names).some((entry) => resized_tensors.has(entry))))) {
py.list(node.output).forEach((entry) => resized_tensors.add(entry));
}
}
}
needed_tensors = py.set((function* () { for (const tensor of py.iter(graph.outputs)) yield tensor.name; })());
nodes = [];
for (node of py.iter(py.list(executed_nodes).reverse())) {
if (!py.bool(!py.list(node.output).some((entry) => needed_tensors.has(entry)))) {
py.list(names_read$graph(node)).forEach((entry) => needed_tensors.add(entry));
nodes.push(node);
}
}
return py.list(nodes).reverse();
}
function _mebibyte_text$limits(size) {
return `${py.str(format_mebibytes$units(size))} (${py.str(size)} bytes)`;
}
function format_mebibytes$units(size, digits = 1) {
return `${py.format((size / 1048576), `.${py.str(digits)}f`)} MiB`;
}
function* fits_binding$limits(subject) {
yield* py.iter(_oversized_buffers$limits(subject, py.item(subject.target.limits, "binding_bytes")));
}
function* fits_dispatch$limits(subject) {
  let limits, max_invocations, rows, tensor;
limits = subject.target.limits;
max_invocations = (py.item(limits, "workgroups") * py.item(limits, "workgroup_size"));
tensor = subject.gaussians;
rows = (((tensor != null) && py.bool(tensor.dims)) ? py.item(tensor.dims, 0) : 0);
if (((tensor != null) && py.isinstance(rows, py.int) && (py.compare(rows, max_invocations) > 0))) {
yield py.violation(`output ${py.str(tensor.name)}`, `${py.str(rows)} rows`, `${py.str(max_invocations)} rows at most`);
}
}
function* frame_is_small$capacity(subject) {
  let actual, declared, limit, rate, size;
limit = py.item(subject.target.limits, "frame_bytes");
declared = (function* () { for (const name of py.iter(subject.output_names)) yield subject.graph.output(name); })();
size = py.list((function* () { for (const tensor of py.iter(declared)) if ((tensor != null)) yield tensor_bytes$graph(tensor); })()).reduce(py.plus, 0);
if ((py.compare(size, limit) > 0)) {
rate = (((2 * size) * 60) / py.float(1000000000.0));
actual = `${py.str(format_mebibytes$units(size))} a frame, ${py.format(rate, `.1f`)} GB/s at ${py.str(60)} frames a second`;
yield py.violation("outputs", actual, `${py.str(format_mebibytes$units(limit, 0))} at most`);
}
}
function* visionary_binds_inputs$visionary(subject) {
  let actual, entry, expected, hint, viewer_role, where;
for (entry of py.iter((py.bool(subject.manifest) ? subject.manifest.inputs : []))) {
viewer_role = bound_role$visionary(entry.name);
if ((!py.eq(viewer_role, entry.role))) {
actual = (py.bool(viewer_role) ? `will receive the ${py.str(viewer_role)}` : "will never be fed");
hint = noHint(entry.name, entry.role);
[where, expected] = [`input ${py.str(entry.name)}`, `the ${py.str(entry.role)}`];
yield py.violation(where, actual, expected, undefined, undefined, hint);
}
}
}
function bound_role$visionary(name) {
  let lower;
lower = name.toLowerCase();
if (py.list((function* () { for (const word of py.iter(["camera", "view", "matrix"])) yield (py.contains(lower, word)); })()).some(py.bool)) {
return "view";
}
if (((py.contains(lower, "time")) || (py.eq(name, "t")))) {
return "time";
}
return ((py.contains(lower, "proj")) ? "projection" : "");
}
function* visionary_reads_color$visionary(subject) {
  let actual, channels, declared, hint, line, rows, tensor, zeros;
[tensor, declared] = [subject.appearance, subject.declared_appearance];
if (((tensor == null) || (declared == null) || !py.bool(tensor.dims))) {
return;
}
channels = py.item(tensor.dims, (-1));
if (((py.eq(declared.space, "sh")) && (!py.eq(channels, 48)))) {
[hint, rows] = ["", py.item(tensor.dims, 0)];
if ((py.isinstance(channels, py.int) && py.isinstance(rows, py.int) && (py.compare(channels, 48) < 0))) {
zeros = `torch.zeros(${py.str(rows)}, ${py.str((py.minus(48, channels)))}, dtype=rows.dtype)`;
line = line_hint$finding(`rows = torch.cat([rows, ${py.str(zeros)}], 1)`);
hint = `Pad SH with zeros. ${py.str(line)} ${py.str(set_hint$finding("outputs.appearance.degree", 3))}`;
}
actual = `SH with ${py.str(channels)} channels`;
yield py.violation(`output ${py.str(tensor.name)}`, actual, "48 channels", undefined, undefined, hint);
}
if (((py.eq(declared.space, "rgb")) && (!py.eq([channels, tensor.dtype], [4, "float16"])))) {
actual = `RGB as ${py.str(tensor.dtype)} with ${py.str(channels)} channels`;
hint = noHint(subject, channels);
yield py.violation(`output ${py.str(tensor.name)}`, actual, "float16 with 4 channels", undefined, undefined, hint);
}
}
function* visionary_ignores_count$visionary_drawing(subject) {
  let declared;
declared = subject.declared_count;
if (((declared != null) && py.bool(subject.graph.varies(declared.name)))) {
yield py.violation(`output ${py.str(declared.name)}`, "the count varies", "a constant count");
}
}
function* visionary_time_range$visionary(subject) {
  let _, entry, high, hint, is_mended, line, low, range_hint;
for ([entry, _] of py.iter(subject.inputs_of("time"))) {
if (((entry.range != null) && (!py.eq(entry.range, [py.float(0.0), py.float(1.0)])))) {
[low, high] = entry.range;
line = line_hint$finding(`${py.str(entry.name)} = ${py.format(low, `.9g`)} + ${py.str(entry.name)} * ${py.format((py.minus(high, low)), `.9g`)}`, true);
is_mended = (py.contains([null, "zeros", py.float(0.0)], entry.default));
range_hint = set_hint$finding(`${py.str(subject.path_of(entry))}.range`, [0, 1]);
hint = (py.bool(is_mended) ? `${py.str(line)} ${py.str(range_hint)}` : "");
yield py.violation(`input ${py.str(entry.name)}`, `range ${py.str([low, high])}`, "[0, 1]", undefined, undefined, hint);
}
}
}
function* visionary_shows_srgb$visionary_drawing(subject) {
  let declared, hint, where;
declared = subject.declared_appearance;
if (((declared != null) && (!py.eq(declared.color_space, "srgb")))) {
[where, hint] = [`output ${py.str(declared.name)}`, noHint(declared.space)];
yield py.violation(where, declared.color_space, "srgb", undefined, undefined, hint);
}
}
function* visionary_sorts$visionary_drawing(subject) {
  let generator;
generator = subject.generator;
if (((generator != null) && (!py.eq(generator.blend, "alpha")))) {
yield py.violation("manifest blend", generator.blend, "alpha");
}
}
function infer_manifest$manifest_inference(graph, name) {
  let inputs, manifest, manifest_guesses, outputs, unknown;
manifest_guesses = [];
inputs = py.list((function* () { for (const tensor of py.iter(graph.inputs)) if (py.bool(_role_of$manifest_inference(tensor))) yield _input$manifest_inference(tensor, manifest_guesses); })());
unknown = [...(function* () { for (const tensor of py.iter(graph.inputs)) if (!py.bool(_role_of$manifest_inference(tensor))) yield tensor.name; })()];
manifest_guesses = (py.plus(manifest_guesses, [...(function* () { for (const name of py.iter(unknown)) yield `input ${py.str(py.repr(name))} has no recognisable role: add it by hand`; })()]));
outputs = new GeneratorOutputs$outputs(_gaussians$manifest_inference(graph, manifest_guesses), _appearance$manifest_inference(graph, manifest_guesses), _count$manifest_inference(graph, manifest_guesses));
manifest = new GeneratorManifest$manifest(name, inputs, undefined, undefined, undefined, undefined, undefined, undefined, undefined, undefined, undefined, undefined, outputs, new Space$scene());
manifest_guesses.push("space: -y up, arbitrary unit, column matrix order (the usual for 3DGS)");
manifest_guesses.push("bounds: unknown, add the box that holds the Gaussians");
return new Candidate$manifest_io(manifest, py.list(manifest_guesses));
}
function _role_of$manifest_inference(tensor) {
  let lower_name;
lower_name = tensor.name.toLowerCase();
return ((function* () { for (const [role, names] of py.iter(_INPUT_NAMES$34.entries())) if ((py.contains(names, lower_name))) yield role; })().next().value ?? null);
}
function _input$manifest_inference(tensor, manifest_guesses) {
  let entry, fixed_dims, has_free_shape, has_named_axes, role, span;
role = _role_of$manifest_inference(tensor);
manifest_guesses.push(`input ${py.str(py.repr(tensor.name))} is the ${py.str(role)}, by its name`);
fixed_dims = static_dims$graph(tensor);
entry = py.item(ROLES$4, role);
has_free_shape = py.and((fixed_dims != null), () => (matching_shape$roles(entry, fixed_dims) != null));
has_named_axes = py.list((function* () { for (const shape of py.iter(entry.shapes)) for (const dim of py.iter(shape)) yield py.isinstance(dim, py.str); })()).some(py.bool);
span = (((py.eq(role, "time")) || py.bool(entry.needs_range)) ? [py.float(0.0), py.float(1.0)] : null);
if (py.bool(span)) {
manifest_guesses.push(`input ${py.str(py.repr(tensor.name))} has the range [0, 1]`);
}
return new Input$inputs(tensor.name, role, ((py.bool(has_free_shape) && py.bool(has_named_axes)) ? _fixed_sizes$manifest_inference(fixed_dims) : null), span, "zeros");
}
function _fixed_sizes$manifest_inference(dims) {
return ((dims != null) ? py.list((function* () { for (const dim of py.iter(dims)) yield py.int(dim); })()) : null);
}
function _gaussians$manifest_inference(graph, manifest_guesses) {
  let capacity, first, packed_outputs, tensor;
tensor = _find_named$manifest_inference(graph, _GAUSSIAN_NAMES$35);
packed_outputs = [...(function* () { for (const tensor of py.iter(graph.outputs)) if ((py.eq(_last_dim$manifest_inference(tensor), 10))) yield tensor; })()];
if (((tensor == null) && (py.eq(py.len(packed_outputs), 1)))) {
tensor = py.item(packed_outputs, 0);
}
if ((tensor == null)) {
manifest_guesses.push(`no output is named like packed Gaussians or is the only one ending in ${py.str(10)}`);
return null;
}
manifest_guesses.push(`output ${py.str(py.repr(tensor.name))} holds the packed Gaussians`);
first = (py.bool(tensor.dims) ? py.item(tensor.dims, 0) : null);
capacity = ((py.isinstance(first, py.int) && (py.compare(first, 0) > 0)) ? first : 1);
return new GaussiansOutput$outputs(tensor.name, capacity, _float_dtype$manifest_inference(tensor));
}
function _find_named$manifest_inference(graph, names) {
return ((function* () { for (const t of py.iter(graph.outputs)) if ((py.contains(names, t.name.toLowerCase()))) yield t; })().next().value ?? null);
}
function _last_dim$manifest_inference(tensor) {
  let dim;
dim = (py.bool(tensor.dims) ? py.item(tensor.dims, (-1)) : null);
return (py.isinstance(dim, py.int) ? dim : 0);
}
function _float_dtype$manifest_inference(tensor) {
return ((py.eq(tensor.dtype, "float16")) ? "float16" : "float32");
}
function _appearance$manifest_inference(graph, manifest_guesses) {
  let channels, degree, tensor;
tensor = _find_named$manifest_inference(graph, _COLOR_NAMES$36);
if ((tensor == null)) {
manifest_guesses.push("no output is named like an appearance");
return null;
}
channels = _last_dim$manifest_inference(tensor);
if (((py.contains(py.item(APPEARANCE_CHANNELS$21, "sh"), channels)) && (!py.eq(channels, 3)))) {
degree = degree_of$spherical_harmonics((Math.floor(channels / 3)));
manifest_guesses.push(`output ${py.str(py.repr(tensor.name))} holds SH of degree ${py.str(degree)}, by its ${py.str(channels)} channels`);
return new AppearanceOutput$outputs(tensor.name, "sh", degree);
}
manifest_guesses.push(`output ${py.str(py.repr(tensor.name))} holds raw RGB, by its ${py.str(py.or(channels, () => "?"))} channels`);
return new AppearanceOutput$outputs(tensor.name, "rgb");
}
function _count$manifest_inference(graph, manifest_guesses) {
  let tensor;
tensor = _find_named$manifest_inference(graph, _COUNT_NAMES$37);
if ((tensor == null)) {
manifest_guesses.push("no output is named like a row count");
return null;
}
manifest_guesses.push(`output ${py.str(py.repr(tensor.name))} is the number of live rows`);
return new CountOutput$outputs(tensor.name);
}
function parse$manifest_io(text) {
if ((py.compare(py.len(text), 4194304) > 0)) {
return _failed_parse$manifest_io("syntax", "", `${py.str(py.len(text))} characters`, `at most ${py.str(4194304)}`);
}
try {
return _parse_document$manifest_io(text);
} catch (error) {
if (!(error instanceof RangeError)) throw error;
return _failed_parse$manifest_io("syntax", "", _shorten$manifest_io(text), "fewer brackets inside each other");
}
}
function _failed_parse$manifest_io(cause, where, actual, expected) {
return new ParsedManifest$manifest_io(null, [new ManifestComplaint$manifest_io(cause, where, actual, expected)]);
}
function _shorten$manifest_io(text) {
text = py.or(text, () => "an empty text");
return ((py.compare(py.len(text), 60) <= 0) ? text : `${py.str(py.slice(text, null, 57))}…`);
}
function _parse_document$manifest_io(text) {
  let actual, document, error, manifest_complaint, reason, version;
try {
document = py.loads(text, _parse_number$manifest_io, _parse_integer$manifest_io, _parse_number$manifest_io, _unique_keys$manifest_io);
py.dumps(document, false);
} catch (error) {
if (!(error instanceof SyntaxError)) throw error;
reason = py.or(_encoding_fault$manifest_io(text), () => py.str(error));
return _failed_parse$manifest_io("syntax", "", _excerpt$manifest_io(text, reason), `a JSON document (${py.str(reason)})`);
}
if (!py.isinstance(document, py.dict)) {
return _failed_parse$manifest_io("schema", "", _json_text$manifest_io(document), "a JSON object");
}
version = _version$manifest_io(py.get(document, "contract"));
if ((version == null)) {
actual = ((py.contains(document, "contract")) ? _json_text$manifest_io(py.item(document, "contract")) : "nothing");
return _failed_parse$manifest_io("version", "contract", actual, "a version such as \"1.0\"");
}
if ((!py.eq(py.item(version, 0), py.item(CURRENT_VERSION$38, 0)))) {
manifest_complaint = new ManifestComplaint$manifest_io("version", "contract", _version_text$manifest_io(version), `major version ${py.str(py.item(CURRENT_VERSION$38, 0))}`);
return new ParsedManifest$manifest_io(null, [manifest_complaint], version);
}
return _parse_body$manifest_io(document, version);
}
function _encoding_fault$manifest_io(text) {
if ((py.contains(py.slice(text, null, 4), "\u0000"))) {
return "this is UTF-16: store it as UTF-8";
}
if (py.bool(py.startsWith(text, "﻿"))) {
return "it begins with a byte order mark: store it as UTF-8 without one";
}
return "";
}
function _excerpt$manifest_io(text, reason) {
  let begin, excerpt, match, place;
match = new RegExp("(?:char|position) (\\d+)").exec(reason);
if (((match == null) || !py.bool(text))) {
return _shorten$manifest_io(text);
}
place = py.int(py.item(match, 1));
begin = py.max([0, (py.minus(place, 40))]);
excerpt = `${py.str(py.slice(text, begin, place))}^${py.str(py.slice(text, place, (py.plus(place, 20))))}`.replace("\n", " ");
return excerpt;
}
function _parse_number$manifest_io(text) {
  let value;
value = py.float(text);
if (!py.bool(Number.isFinite(value))) {
throw new Error(`${py.str(_shorten$manifest_io(text))} is not a finite number`);
}
return value;
}
function _parse_integer$manifest_io(text) {
_parse_number$manifest_io(text);
return py.int(text);
}
function _unique_keys$manifest_io(pairs) {
  let document, keys, repeated_key;
document = py.dict(pairs);
if ((!py.eq(py.len(document), py.len(pairs)))) {
keys = [...(function* () { for (const [key, _] of py.iter(pairs)) yield key; })()];
repeated_key = ((function* () { for (const key of py.iter(keys)) if ((py.compare(py.count(keys, key), 1) > 0)) yield key; })().next().value ?? null);
throw new Error(`the key ${py.str(_shorten$manifest_io(repeated_key))} is repeated within an object`);
}
return document;
}
function _json_text$manifest_io(value) {
return _shorten$manifest_io(py.dumps(value, false, py.str));
}
function _version$manifest_io(value) {
  let parts;
parts = (py.isinstance(value, py.str) ? value.split(".") : []);
if (((!py.eq(py.len(parts), 2)) || !py.list((function* () { for (const p of py.iter(parts)) yield py.and(/^[\0-\x7f]*$/.test(p), () => /^\d+$/.test(p), () => (py.compare(py.len(p), 6) < 0)); })()).every(py.bool))) {
return null;
}
return [py.int(py.item(parts, 0)), py.int(py.item(parts, 1))];
}
function _version_text$manifest_io(version) {
return `${py.str(py.item(version, 0))}.${py.str(py.item(version, 1))}`;
}
function _parse_body$manifest_io(document, version) {
  let complaints, faults, is_newer_version, kind, manifest;
kind = py.get(document, "kind");
if ((!py.contains(MANIFEST_KINDS$0, kind))) {
return _failed_parse$manifest_io("schema", "kind", _json_text$manifest_io(kind), `one of ${py.str(py.list(MANIFEST_KINDS$0).join(", "))}`);
}
is_newer_version = py.and((py.compare(version, CURRENT_VERSION$38) > 0), () => (!py.contains(UPGRADE_BY_VERSION$5, version)));
document = upgrade$upgrades(document, version);
faults = py.list(schema_faults$schema_check(document, publishedSchema(kind)));
if (py.bool(is_newer_version)) {
faults = [...(function* () { for (const fault of py.iter(faults)) if ((!py.eq(fault.validator, "additionalProperties"))) yield fault; })()];
}
complaints = py.list((function* () { for (const fault of py.iter(py.sorted(faults, _fault_path$manifest_io))) yield _complaint_from_fault$manifest_io(fault); })());
if (py.bool(complaints)) {
return new ParsedManifest$manifest_io(null, complaints, version, is_newer_version);
}
manifest = py.fromJson(manifest_type$manifest(kind), document);
return new ParsedManifest$manifest_io(manifest, [], version, is_newer_version);
}
function upgrade$upgrades(document, version) {
  let major, minor;
while ((py.contains(UPGRADE_BY_VERSION$5, version))) {
document = py.item(UPGRADE_BY_VERSION$5, version)(document);
[major, minor] = py.item(document, "contract").split(".");
version = [py.int(major), py.int(minor)];
}
return document;
}
function* schema_faults$schema_check(document, schema) {
yield* py.iter(_schema_faults$schema_check(document, schema, [], py.get(schema, "$defs", py.dict([]))));
}
function* _schema_faults$schema_check(value, schema, path, definitions) {
  let entry, item, name, number, options, word;
if (py.isinstance(schema, py.bool)) {
return;
}
for ([word, entry] of py.iter(schema.entries())) {
if ((py.contains(_ANNOTATION_KEYWORDS$39, word))) {
continue;
}
if ((py.eq(word, "$ref"))) {
yield* py.iter(_schema_faults$schema_check(value, py.item(definitions, py.item(entry.split("/"), (-1))), path, definitions));
} else {
if ((py.eq(word, "items"))) {
for ([number, item] of py.iter(py.list((py.isinstance(value, py.list) ? value : [])).entries())) {
yield* py.iter(_schema_faults$schema_check(item, entry, [...py.iter(path), number], definitions));
}
} else {
if ((py.eq(word, "required"))) {
for (name of py.iter((py.isinstance(value, py.dict) ? entry : []))) {
if ((!py.contains(value, name))) {
yield _schema_fault$schema_check(word, value, schema, path, py.repr(name));
}
}
} else {
if ((py.contains(["properties", "patternProperties", "additionalProperties"], word))) {
if (py.isinstance(value, py.dict)) {
yield* py.iter(_member_faults$schema_check(word, value, schema, path, definitions));
}
} else {
if ((py.eq(word, "anyOf"))) {
options = [...(function* () { for (const option of py.iter(entry)) yield py.list(_schema_faults$schema_check(value, option, path, definitions)); })()];
if (py.list(options).every(py.bool)) {
yield _schema_fault$schema_check(word, value, schema, path);
}
} else {
if (!py.bool(_is_constraint_met$schema_check(word, entry, value))) {
yield _schema_fault$schema_check(word, value, schema, path);
}
}
}
}
}
}
}
}
function _is_constraint_met$schema_check(word, bound, value) {
  let is_bool, is_number;
is_number = py.and(py.isinstance(value, [py.int, py.float]), () => !py.isinstance(value, py.bool));
if ((py.eq(word, "type"))) {
return _is_type$schema_check(bound, value);
}
if ((py.eq(word, "enum"))) {
is_bool = py.isinstance(value, py.bool);
return py.list((function* () { for (const option of py.iter(bound)) yield py.and((py.eq(py.isinstance(option, py.bool), is_bool)), () => (py.eq(option, value))); })()).some(py.bool);
}
if ((py.contains(["minimum", "maximum", "exclusiveMinimum"], word))) {
if (!py.bool(is_number)) {
return true;
}
if ((py.eq(word, "maximum"))) {
return py.bool((py.compare(value, bound) <= 0));
}
return py.bool(((py.eq(word, "minimum")) ? (py.compare(value, bound) >= 0) : (py.compare(value, bound) > 0)));
}
if ((py.contains(["minItems", "maxItems"], word))) {
if (!py.isinstance(value, py.list)) {
return true;
}
return py.bool(((py.eq(word, "minItems")) ? (py.compare(py.len(value), bound) >= 0) : (py.compare(py.len(value), bound) <= 0)));
}
if ((py.contains(["minLength", "pattern"], word))) {
if (!py.isinstance(value, py.str)) {
return true;
}
return py.bool(((py.eq(word, "minLength")) ? (py.compare(py.len(value), bound) >= 0) : new RegExp(bound).exec(value)));
}
return false;
}
function _is_type$schema_check(name, value) {
  let is_number;
is_number = py.and(py.isinstance(value, [py.int, py.float]), () => !py.isinstance(value, py.bool));
if ((py.eq(name, "integer"))) {
return py.and(is_number, () => py.bool((py.eq(value, py.int(value)))));
}
if ((py.eq(name, "number"))) {
return is_number;
}
if ((py.eq(name, "object"))) {
return py.isinstance(value, py.dict);
}
if ((py.eq(name, "array"))) {
return py.isinstance(value, py.list);
}
if ((py.eq(name, "string"))) {
return py.isinstance(value, py.str);
}
return ((py.eq(name, "boolean")) ? py.isinstance(value, py.bool) : py.and((py.eq(name, "null")), () => (value == null)));
}
function _schema_fault$schema_check(word, value, schema, path, message = "") {
return new SchemaFault$schema_check(word, py.item(schema, word), value, schema, path, message);
}
function* _member_faults$schema_check(word, value, schema, path, definitions) {
  let matching_rules, name, part, patterns, properties, rule, rules;
[properties, patterns] = [py.get(schema, "properties", py.dict([])), py.get(schema, "patternProperties", py.dict([]))];
for ([name, part] of py.iter(value.entries())) {
matching_rules = [...(function* () { for (const [pattern, rule] of py.iter(patterns.entries())) if (py.bool(new RegExp(pattern).exec(name))) yield rule; })()];
rules = ((py.eq(word, "patternProperties")) ? matching_rules : []);
if (((py.eq(word, "properties")) && (py.contains(properties, name)))) {
rules = [py.item(properties, name)];
} else {
if (((py.eq(word, "additionalProperties")) && (!py.contains(properties, name)) && !py.bool(matching_rules))) {
if ((py.item(schema, word) === false)) {
yield _schema_fault$schema_check(word, value, schema, path);
return;
}
rules = [py.item(schema, word)];
}
}
for (rule of py.iter(rules)) {
yield* py.iter(_schema_faults$schema_check(part, rule, [...py.iter(path), name], definitions));
}
}
}
function _fault_path$manifest_io(fault) {
return fault.absolute_path;
}
function _complaint_from_fault$manifest_io(fault) {
  let expected, fault_detail, known, missing, options, unmatched_entries, where;
where = py.list((function* () { for (const part of py.iter(fault.absolute_path)) yield py.str(part); })()).join(".");
expected = (py.isinstance(fault.schema, py.dict) ? py.get(fault.schema, "description") : null);
if ((py.eq(fault.validator, "required"))) {
missing = py.item(fault.message.split("'"), 1);
return new ManifestComplaint$manifest_io("schema", where, `no field ${py.str(py.repr(missing))}`, `${py.str(py.repr(missing))} to be present`);
}
if ((py.eq(fault.validator, "additionalProperties"))) {
known = py.list(py.get(fault.schema, "properties", py.dict([]))).join(", ");
unmatched_entries = py.list((function* () { for (const name of py.iter(fault.instance)) if (py.bool(_is_unknown$manifest_io(name, fault))) yield py.repr(name); })()).join(", ");
return new ManifestComplaint$manifest_io("schema", where, _shorten$manifest_io(unmatched_entries), `only the fields ${py.str(known)}`);
}
if ((py.eq(fault.validator, "enum"))) {
options = py.list((function* () { for (const option of py.iter(fault.validator_value)) yield py.str(option); })()).join(", ");
return new ManifestComplaint$manifest_io("schema", where, _json_text$manifest_io(fault.instance), `one of ${py.str(options)}`);
}
fault_detail = `${py.str(fault.validator)} ${py.str(fault.validator_value)}`;
return new ManifestComplaint$manifest_io("schema", where, _json_text$manifest_io(fault.instance), (py.bool(expected) ? `${py.str(expected)} (${py.str(fault_detail)})` : fault_detail));
}
function _is_unknown$manifest_io(name, fault) {
  let known, patterns;
patterns = py.get(fault.schema, "patternProperties", []);
known = (py.contains(py.get(fault.schema, "properties", []), name));
return py.and(!py.bool(known), () => !py.list((function* () { for (const pattern of py.iter(patterns)) yield new RegExp(pattern).exec(name); })()).some(py.bool));
}
function manifest_type$manifest(kind) {
if ((!py.contains(_MANIFEST_TYPES$40, kind))) {
throw new Error("kind");
}
return py.item(_MANIFEST_TYPES$40, kind);
}
function read_graph$graph(file) {
  let facts, graph, inputs, outputs, weights;
graph = file.proto.graph;
facts = noFacts(file);
weights = py.dict((function* () { for (const tensor of py.iter(graph.initializer)) yield [tensor.name, _weight_tensor$graph(tensor)]; })());
weights = (py.union(weights, py.dict((function* () { for (const s of py.iter(graph.sparse_initializer)) yield [s.values.name, _weight_tensor$graph(denseWeight(s))]; })())));
inputs = py.list((function* () { for (const v of py.iter(graph.input)) if ((!py.contains(weights, v.name))) yield _value_tensor$graph(v); })());
outputs = py.list((function* () { for (const v of py.iter(graph.output)) yield _merge_declared$graph(_value_tensor$graph(v), py.get(facts.tensors, v.name)); })());
return new Graph$graph(inputs, outputs, py.list(graph.node), weights, (py.union((py.union(facts.tensors, weights)), py.dict((function* () { for (const t of py.iter([...py.iter(inputs), ...py.iter(outputs)])) yield [t.name, t]; })()))), py.set((function* () { for (const f of py.iter(file.proto.functions)) yield [f.domain, f.name]; })()), facts.conflicts, facts.checker, facts.inference, py.list((function* () { for (const v of py.iter(graph.output)) yield v.name; })()), py.list(py.map(_value_tensor$graph, graph.output)));
}
function _weight_tensor$graph(tensor) {
return new Tensor$graph(tensor.name, py.get(_DTYPE_NAMES$41, tensor.data_type), py.list(tensor.dims));
}
function _value_tensor$graph(value) {
  let dims, kind;
kind = value.type.tensor_type;
if (!py.bool(value.type.HasField("tensor_type"))) {
return new Tensor$graph(value.name, null, null);
}
dims = null;
if (py.bool(kind.HasField("shape"))) {
dims = py.list((function* () { for (const d of py.iter(kind.shape.dim)) yield (py.bool(d.HasField("dim_value")) ? d.dim_value : py.or(d.dim_param, () => null)); })());
}
return new Tensor$graph(value.name, py.get(_DTYPE_NAMES$41, kind.elem_type), dims);
}
function _merge_declared$graph(declared, inferred) {
  let dims, known, pairs;
if (((declared == null) || (inferred == null))) {
known = py.or(declared, () => inferred);
return known;
}
dims = declared.dims;
if ((dims == null)) {
dims = inferred.dims;
} else {
if (((inferred.dims != null) && (py.eq(py.len(inferred.dims), py.len(dims))))) {
pairs = py.zip(dims, inferred.dims);
dims = py.list((function* () { for (const [a, b] of py.iter(pairs)) yield (py.isinstance(a, py.int) ? a : (py.isinstance(b, py.int) ? b : py.or(a, () => b))); })());
}
}
return new Tensor$graph(declared.name, py.or(declared.dtype, () => inferred.dtype), dims);
}
function _output_fields$inspected_model(manifest) {
return py.list(manifest.outputs.constructor.__dataclass_fields__);
}
function* _nested_nodes$graph(node, depth) {
  let attribute, graph, nested_node;
yield node;
if ((py.compare(depth, 64) < 0)) {
for (attribute of py.iter(node.attribute)) {
for (graph of py.iter(subgraphs$model_file(attribute))) {
for (nested_node of py.iter(graph.node)) {
yield* py.iter(_nested_nodes$graph(nested_node, (py.plus(depth, 1))));
}
}
}
}
}
const SCHEMAS = py.loads("{\"gaussian-generator\": {\"$schema\": \"https://json-schema.org/draft/2020-12/schema\", \"title\": \"gsgen manifest: gaussian-generator\", \"type\": \"object\", \"description\": \"The manifest of a Gaussian Generator: frame inputs → packed Gaussians.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"What people call the model.\", \"minLength\": 1}, \"inputs\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Input\"}, \"default\": []}, \"version\": {\"type\": \"string\", \"description\": \"The model's own version.\", \"default\": \"1.0.0\"}, \"family\": {\"type\": \"string\", \"description\": \"Method family: static, mlp, 4d, avatar, …\"}, \"producer\": {\"$ref\": \"#/$defs/Producer\"}, \"test_vectors\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/TestVector\"}, \"default\": []}, \"contract\": {\"type\": \"string\", \"description\": \"Contract version, major.minor.\", \"pattern\": \"^[0-9]+\\\\.[0-9]+$\", \"default\": \"1.0\"}, \"extensions_used\": {\"type\": \"array\", \"items\": {\"type\": \"string\", \"description\": \"The field of its data: x-writer-name.\", \"pattern\": \"^x-[a-z0-9]+(-[a-z0-9]+)*$\"}, \"description\": \"Registered extensions that the manifest uses.\", \"default\": []}, \"extensions_required\": {\"type\": \"array\", \"items\": {\"type\": \"string\", \"description\": \"The field of its data: x-writer-name.\", \"pattern\": \"^x-[a-z0-9]+(-[a-z0-9]+)*$\"}, \"description\": \"Those without which the model is misread.\", \"default\": []}, \"operator_profile\": {\"type\": \"string\", \"description\": \"The operators that suffice to run it: a profile's name.\"}, \"external_data\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/ExternalData\"}, \"default\": []}, \"cost\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Cost\"}, \"default\": []}, \"outputs\": {\"$ref\": \"#/$defs/GeneratorOutputs\"}, \"space\": {\"$ref\": \"#/$defs/Space\"}, \"bounds\": {\"$ref\": \"#/$defs/Bounds\"}, \"depends_on\": {\"type\": \"object\", \"additionalProperties\": {\"type\": \"boolean\"}, \"description\": \"Input or role → does any output change with it; absent means yes.\"}, \"antialias\": {\"enum\": [\"classic\", \"mip\"], \"description\": \"`classic`: 0.3 px dilation. `mip`: compensated.\", \"default\": \"classic\"}, \"blend\": {\"enum\": [\"alpha\", \"wsr\"], \"description\": \"`alpha`: sorted. `wsr`: weighted sum with cells.\", \"default\": \"alpha\"}, \"weighted_sum\": {\"$ref\": \"#/$defs/WeightedSum\"}, \"capture\": {\"$ref\": \"#/$defs/Capture\"}, \"tolerances\": {\"$ref\": \"#/$defs/Tolerances\"}, \"reference_images\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/ReferenceImage\"}, \"default\": []}, \"kind\": {\"enum\": [\"gaussian-generator\"], \"default\": \"gaussian-generator\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"contract\", \"kind\", \"name\", \"outputs\"], \"$defs\": {\"AppearanceOutput\": {\"type\": \"object\", \"description\": \"The output with the Gaussians' colours, [capacity, channels].\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"space\": {\"enum\": [\"sh\", \"rgb\"], \"description\": \"`sh`: coefficient-major, RGB innermost. `rgb`: raw colour.\"}, \"degree\": {\"type\": \"integer\", \"description\": \"SH degree; required for `sh`.\", \"minimum\": 0, \"maximum\": 3}, \"color_space\": {\"enum\": [\"srgb\", \"linear\"], \"default\": \"srgb\"}, \"range\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Lowest and highest `rgb`; [0, 1] if absent.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\", \"space\"]}, \"Bounds\": {\"type\": \"object\", \"description\": \"An axis-aligned box of all Gaussian centres for all inputs, checked with test inputs.\", \"properties\": {\"min\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Lower corner, x y z.\"}, \"max\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Upper corner, x y z.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"min\", \"max\"]}, \"Capture\": {\"type\": \"object\", \"description\": \"The model's promises to a runtime that records its GPU kernels once (graph capture).\", \"properties\": {\"static_shapes\": {\"type\": \"boolean\", \"default\": true}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"CellsOutput\": {\"type\": \"object\", \"description\": \"The output with cells (groups of Gaussians) for weighted blending, [capacity / per_cell, 10].\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"per_cell\": {\"type\": \"integer\", \"description\": \"Rows of Gaussians in a row to one cell.\", \"minimum\": 1}, \"dtype\": {\"enum\": [\"float32\", \"float16\"], \"default\": \"float32\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\", \"per_cell\"]}, \"Cost\": {\"type\": \"object\", \"description\": \"The declared time and memory that one frame takes on one device.\", \"properties\": {\"device\": {\"type\": \"string\", \"description\": \"The device, as its driver calls it.\", \"minLength\": 1}, \"milliseconds\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Median time of one run.\"}, \"bytes\": {\"type\": \"integer\", \"description\": \"Peak memory of a session, weights included.\", \"minimum\": 0}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"device\"]}, \"CountOutput\": {\"type\": \"object\", \"description\": \"The output with the number of live Gaussian rows, int32 [1]; later rows are padding.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"semantics\": {\"enum\": [\"exact\", \"upper-bound\"], \"description\": \"`exact`: every row before it is drawn. `upper-bound`: some of them may be inert.\", \"default\": \"exact\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\"]}, \"ExternalData\": {\"type\": \"object\", \"description\": \"A file with external weights of the model, and the file's digest.\", \"properties\": {\"path\": {\"type\": \"string\", \"description\": \"As the model writes it: its `location`.\", \"minLength\": 1}, \"sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"path\", \"sha256\"]}, \"GaussiansOutput\": {\"type\": \"object\", \"description\": \"The output with packed Gaussians, [capacity, 10]: x y z opacity xx xy xz yy yz zz.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"capacity\": {\"type\": \"integer\", \"description\": \"Rows of the tensor, padding included.\", \"minimum\": 1}, \"dtype\": {\"enum\": [\"float32\", \"float16\"], \"default\": \"float32\"}, \"layout\": {\"enum\": [\"packed10\"], \"default\": \"packed10\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\", \"capacity\"]}, \"GeneratorOutputs\": {\"type\": \"object\", \"description\": \"The outputs of a Gaussian Generator: Gaussians, appearance, row count, cells (groups).\", \"properties\": {\"gaussians\": {\"$ref\": \"#/$defs/GaussiansOutput\"}, \"appearance\": {\"$ref\": \"#/$defs/AppearanceOutput\"}, \"count\": {\"$ref\": \"#/$defs/CountOutput\"}, \"cells\": {\"$ref\": \"#/$defs/CellsOutput\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"Input\": {\"type\": \"object\", \"description\": \"One model input that a runtime feeds in every frame.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"role\": {\"type\": \"string\", \"description\": \"What the input means.\", \"enum\": [\"view\", \"projection\", \"time\", \"frame_index\", \"camera_position\", \"viewport\", \"pose\", \"shape\", \"root_translation\", \"root_rotation\", \"expression\", \"appearance_id\", \"audio\", \"condition\", \"control\", \"image\", \"image_view\", \"image_intrinsics\", \"timestep\", \"conditioning\", \"camera_history\"]}, \"shape\": {\"type\": \"array\", \"items\": {\"type\": \"integer\", \"minimum\": 1}, \"description\": \"Static size of every axis.\"}, \"range\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Smallest and largest meaningful value, both included.\"}, \"default\": {\"anyOf\": [{\"type\": \"number\"}, {\"enum\": [\"zeros\", \"identity\"]}, {\"type\": \"array\", \"items\": {\"type\": \"number\"}}], \"description\": \"What a runtime feeds if it has nothing better; row-major where a list.\"}, \"convention\": {\"type\": \"string\", \"description\": \"Which of the role's conventions it follows.\"}, \"loop\": {\"type\": \"boolean\", \"description\": \"Time: the end of the range continues at its start.\"}, \"frames\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Time: how many distinct frames there are.\"}, \"fps\": {\"type\": \"number\", \"description\": \"Time: frames per second at natural speed.\", \"minimum\": 0}, \"label\": {\"type\": \"string\", \"description\": \"What a user interface calls it.\"}, \"joints\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Joint\"}, \"description\": \"Pose: one joint for each row, in order.\", \"default\": []}, \"rate\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"Audio: samples per second.\"}, \"window\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Audio, mel: samples under the window of one column.\"}, \"hop\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Audio, mel: samples from one column to the next.\"}, \"pass\": {\"enum\": [\"scene\", \"frame\"], \"description\": \"When its value changes: with the scene or with the frame; see `Passes`.\"}, \"background\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Image: RGB from 0 to 1 under transparent pixels; black if absent.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\", \"role\"]}, \"Joint\": {\"type\": \"object\", \"description\": \"One joint of a skeleton; joints are listed in the order of a pose's rows.\", \"properties\": {\"name\": {\"type\": \"string\", \"minLength\": 1}, \"parent\": {\"type\": \"string\", \"description\": \"Name of its parent; absent for a root.\"}, \"rest\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Its position in the rest pose, in local units.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\"]}, \"Producer\": {\"type\": \"object\", \"description\": \"The author of the model, its sources, and its licence.\", \"properties\": {\"tool\": {\"type\": \"string\", \"description\": \"Program and version.\"}, \"source\": {\"type\": \"string\"}, \"license\": {\"type\": \"string\", \"description\": \"An SPDX expression.\"}, \"weights_sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"tool\"]}, \"ReferenceImage\": {\"type\": \"object\", \"description\": \"A reference picture of the model, and the camera from which a render matches it.\", \"properties\": {\"path\": {\"type\": \"string\", \"description\": \"A PNG in the model's folder or below it.\", \"minLength\": 1}, \"sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}, \"inputs\": {\"type\": \"string\", \"description\": \"Which probe, by its label.\", \"minLength\": 1}, \"view\": {\"type\": \"array\", \"items\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 4, \"maxItems\": 4}, \"description\": \"World to camera: the first three rows of the matrix.\"}, \"focal\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Focal lengths in x and y, in pixels.\"}, \"center\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Principal point, in pixels from the corner.\"}, \"psnr\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"Least peak signal-to-noise ratio, in decibels.\", \"default\": 40.0}, \"from\": {\"enum\": [\"model\", \"source\"], \"description\": \"`source`: drawn by the training code. `model`: by this model, as it was then.\", \"default\": \"model\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"path\", \"sha256\", \"inputs\", \"view\", \"focal\", \"center\"]}, \"Space\": {\"type\": \"object\", \"description\": \"The coordinate frame of Gaussians, cameras and bounds.\", \"properties\": {\"handedness\": {\"enum\": [\"right\"], \"default\": \"right\"}, \"up\": {\"enum\": [\"+x\", \"-x\", \"+y\", \"-y\", \"+z\", \"-z\"], \"description\": \"The world's upward axis.\", \"default\": \"-y\"}, \"unit\": {\"enum\": [\"metre\", \"arbitrary\"], \"description\": \"What one unit of length is; SfM scenes: arbitrary.\", \"default\": \"arbitrary\"}, \"matrix_order\": {\"enum\": [\"column\", \"row\"], \"description\": \"`column`: the [4,4] tensor holds Mᵀ, as column-major bytes do. `row`: it holds M.\", \"default\": \"column\"}, \"origin\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Where the local origin lies in the author's world, in units, as float64.\"}, \"metres_per_unit\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"Length of one unit, in metres.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"TestVector\": {\"type\": \"object\", \"description\": \"A named set of test inputs, and the digest of the outputs that the model promises for it.\", \"properties\": {\"inputs\": {\"type\": \"string\", \"description\": \"Which probe, by its label.\"}, \"expected_sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}, \"seed\": {\"type\": \"integer\", \"description\": \"Seed of the probe set.\", \"minimum\": 0, \"default\": 0}, \"files\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorFile\"}, \"description\": \"The inputs as files, for readers without the probe set.\", \"default\": []}, \"values\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorInput\"}, \"description\": \"The inputs themselves, instead of the probe's.\", \"default\": []}, \"outputs\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorRows\"}, \"description\": \"Rows of the source's outputs for `values`.\", \"default\": []}, \"tolerances\": {\"$ref\": \"#/$defs/Tolerances\", \"description\": \"For `outputs`; absent: the manifest's.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"inputs\", \"expected_sha256\"]}, \"Tolerances\": {\"type\": \"object\", \"description\": \"The largest allowed differences between two runs of the model, each field in its unit.\", \"properties\": {\"position\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"In standard deviations of the Gaussian.\", \"default\": 0.001}, \"covariance\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Relative to the covariance's trace.\", \"default\": 0.001}, \"opacity\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Absolute.\", \"default\": 0.002}, \"appearance\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Absolute, of the colour seen from a direction.\", \"default\": 0.002}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"VectorFile\": {\"type\": \"object\", \"description\": \"The file with one input of a test vector: an ONNX TensorProto.\", \"properties\": {\"input\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"path\": {\"type\": \"string\", \"description\": \"A file in the model's folder or below it.\", \"minLength\": 1}, \"sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"input\", \"path\", \"sha256\"]}, \"VectorInput\": {\"type\": \"object\", \"description\": \"The numbers of one input of a test vector, inside the manifest.\", \"properties\": {\"input\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"shape\": {\"type\": \"array\", \"items\": {\"type\": \"integer\"}}, \"values\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"description\": \"All numbers, in row-major order.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"input\", \"shape\", \"values\"]}, \"VectorRows\": {\"type\": \"object\", \"description\": \"Some rows of one output, as the original (torch) model computed them for a test vector.\", \"properties\": {\"output\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"rows\": {\"type\": \"array\", \"items\": {\"type\": \"integer\", \"minimum\": 0}, \"description\": \"Row numbers, along the first axis.\"}, \"values\": {\"type\": \"array\", \"items\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}}, \"description\": \"The numbers of each row, in the order of `rows`.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"output\", \"rows\", \"values\"]}, \"WeightedSum\": {\"type\": \"object\", \"description\": \"Parameters of weighted-sum blending per cell (group of Gaussians), for `blend: wsr`.\", \"properties\": {\"background\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Weight of the background.\"}, \"depth_range\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"Depth at which weights reach 0, in units of length; absent: they do not fall.\"}, \"opacity_divisor\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"What opacity is divided by before it takes light away.\", \"default\": 1.0}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"background\"]}}}, \"post-process\": {\"$schema\": \"https://json-schema.org/draft/2020-12/schema\", \"title\": \"gsgen manifest: post-process\", \"type\": \"object\", \"description\": \"The manifest of a post-process model: image (and conditioning) → image.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"What people call the model.\", \"minLength\": 1}, \"inputs\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Input\"}, \"default\": []}, \"version\": {\"type\": \"string\", \"description\": \"The model's own version.\", \"default\": \"1.0.0\"}, \"family\": {\"type\": \"string\", \"description\": \"Method family: static, mlp, 4d, avatar, …\"}, \"producer\": {\"$ref\": \"#/$defs/Producer\"}, \"test_vectors\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/TestVector\"}, \"default\": []}, \"contract\": {\"type\": \"string\", \"description\": \"Contract version, major.minor.\", \"pattern\": \"^[0-9]+\\\\.[0-9]+$\", \"default\": \"1.0\"}, \"extensions_used\": {\"type\": \"array\", \"items\": {\"type\": \"string\", \"description\": \"The field of its data: x-writer-name.\", \"pattern\": \"^x-[a-z0-9]+(-[a-z0-9]+)*$\"}, \"description\": \"Registered extensions that the manifest uses.\", \"default\": []}, \"extensions_required\": {\"type\": \"array\", \"items\": {\"type\": \"string\", \"description\": \"The field of its data: x-writer-name.\", \"pattern\": \"^x-[a-z0-9]+(-[a-z0-9]+)*$\"}, \"description\": \"Those without which the model is misread.\", \"default\": []}, \"operator_profile\": {\"type\": \"string\", \"description\": \"The operators that suffice to run it: a profile's name.\"}, \"external_data\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/ExternalData\"}, \"default\": []}, \"cost\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Cost\"}, \"default\": []}, \"outputs\": {\"$ref\": \"#/$defs/PostProcessOutputs\"}, \"image_range\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Values of black and white in the input image.\", \"default\": [0.0, 1.0]}, \"capture\": {\"$ref\": \"#/$defs/Capture\"}, \"kind\": {\"enum\": [\"post-process\"], \"default\": \"post-process\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"contract\", \"kind\", \"name\", \"outputs\"], \"$defs\": {\"Capture\": {\"type\": \"object\", \"description\": \"The model's promises to a runtime that records its GPU kernels once (graph capture).\", \"properties\": {\"static_shapes\": {\"type\": \"boolean\", \"default\": true}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"Cost\": {\"type\": \"object\", \"description\": \"The declared time and memory that one frame takes on one device.\", \"properties\": {\"device\": {\"type\": \"string\", \"description\": \"The device, as its driver calls it.\", \"minLength\": 1}, \"milliseconds\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Median time of one run.\"}, \"bytes\": {\"type\": \"integer\", \"description\": \"Peak memory of a session, weights included.\", \"minimum\": 0}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"device\"]}, \"ExternalData\": {\"type\": \"object\", \"description\": \"A file with external weights of the model, and the file's digest.\", \"properties\": {\"path\": {\"type\": \"string\", \"description\": \"As the model writes it: its `location`.\", \"minLength\": 1}, \"sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"path\", \"sha256\"]}, \"ImageOutput\": {\"type\": \"object\", \"description\": \"The image output of a post-process model, [1, 3 or 4, H, W], ``scale`` times its input's size.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"dtype\": {\"enum\": [\"float32\", \"float16\"], \"default\": \"float32\"}, \"range\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Values of black and white.\", \"default\": [0.0, 1.0]}, \"color_space\": {\"enum\": [\"srgb\", \"linear\"], \"default\": \"srgb\"}, \"scale\": {\"type\": \"integer\", \"description\": \"Height and width, as multiples of those of the input image.\", \"minimum\": 1, \"default\": 1}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\"]}, \"Input\": {\"type\": \"object\", \"description\": \"One model input that a runtime feeds in every frame.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"role\": {\"type\": \"string\", \"description\": \"What the input means.\", \"enum\": [\"view\", \"projection\", \"time\", \"frame_index\", \"camera_position\", \"viewport\", \"pose\", \"shape\", \"root_translation\", \"root_rotation\", \"expression\", \"appearance_id\", \"audio\", \"condition\", \"control\", \"image\", \"image_view\", \"image_intrinsics\", \"timestep\", \"conditioning\", \"camera_history\"]}, \"shape\": {\"type\": \"array\", \"items\": {\"type\": \"integer\", \"minimum\": 1}, \"description\": \"Static size of every axis.\"}, \"range\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Smallest and largest meaningful value, both included.\"}, \"default\": {\"anyOf\": [{\"type\": \"number\"}, {\"enum\": [\"zeros\", \"identity\"]}, {\"type\": \"array\", \"items\": {\"type\": \"number\"}}], \"description\": \"What a runtime feeds if it has nothing better; row-major where a list.\"}, \"convention\": {\"type\": \"string\", \"description\": \"Which of the role's conventions it follows.\"}, \"loop\": {\"type\": \"boolean\", \"description\": \"Time: the end of the range continues at its start.\"}, \"frames\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Time: how many distinct frames there are.\"}, \"fps\": {\"type\": \"number\", \"description\": \"Time: frames per second at natural speed.\", \"minimum\": 0}, \"label\": {\"type\": \"string\", \"description\": \"What a user interface calls it.\"}, \"joints\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Joint\"}, \"description\": \"Pose: one joint for each row, in order.\", \"default\": []}, \"rate\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"Audio: samples per second.\"}, \"window\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Audio, mel: samples under the window of one column.\"}, \"hop\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Audio, mel: samples from one column to the next.\"}, \"pass\": {\"enum\": [\"scene\", \"frame\"], \"description\": \"When its value changes: with the scene or with the frame; see `Passes`.\"}, \"background\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Image: RGB from 0 to 1 under transparent pixels; black if absent.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\", \"role\"]}, \"Joint\": {\"type\": \"object\", \"description\": \"One joint of a skeleton; joints are listed in the order of a pose's rows.\", \"properties\": {\"name\": {\"type\": \"string\", \"minLength\": 1}, \"parent\": {\"type\": \"string\", \"description\": \"Name of its parent; absent for a root.\"}, \"rest\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Its position in the rest pose, in local units.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\"]}, \"PostProcessOutputs\": {\"type\": \"object\", \"description\": \"The output of a post-process model.\", \"properties\": {\"image\": {\"$ref\": \"#/$defs/ImageOutput\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"image\"]}, \"Producer\": {\"type\": \"object\", \"description\": \"The author of the model, its sources, and its licence.\", \"properties\": {\"tool\": {\"type\": \"string\", \"description\": \"Program and version.\"}, \"source\": {\"type\": \"string\"}, \"license\": {\"type\": \"string\", \"description\": \"An SPDX expression.\"}, \"weights_sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"tool\"]}, \"TestVector\": {\"type\": \"object\", \"description\": \"A named set of test inputs, and the digest of the outputs that the model promises for it.\", \"properties\": {\"inputs\": {\"type\": \"string\", \"description\": \"Which probe, by its label.\"}, \"expected_sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}, \"seed\": {\"type\": \"integer\", \"description\": \"Seed of the probe set.\", \"minimum\": 0, \"default\": 0}, \"files\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorFile\"}, \"description\": \"The inputs as files, for readers without the probe set.\", \"default\": []}, \"values\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorInput\"}, \"description\": \"The inputs themselves, instead of the probe's.\", \"default\": []}, \"outputs\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorRows\"}, \"description\": \"Rows of the source's outputs for `values`.\", \"default\": []}, \"tolerances\": {\"$ref\": \"#/$defs/Tolerances\", \"description\": \"For `outputs`; absent: the manifest's.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"inputs\", \"expected_sha256\"]}, \"Tolerances\": {\"type\": \"object\", \"description\": \"The largest allowed differences between two runs of the model, each field in its unit.\", \"properties\": {\"position\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"In standard deviations of the Gaussian.\", \"default\": 0.001}, \"covariance\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Relative to the covariance's trace.\", \"default\": 0.001}, \"opacity\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Absolute.\", \"default\": 0.002}, \"appearance\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Absolute, of the colour seen from a direction.\", \"default\": 0.002}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"VectorFile\": {\"type\": \"object\", \"description\": \"The file with one input of a test vector: an ONNX TensorProto.\", \"properties\": {\"input\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"path\": {\"type\": \"string\", \"description\": \"A file in the model's folder or below it.\", \"minLength\": 1}, \"sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"input\", \"path\", \"sha256\"]}, \"VectorInput\": {\"type\": \"object\", \"description\": \"The numbers of one input of a test vector, inside the manifest.\", \"properties\": {\"input\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"shape\": {\"type\": \"array\", \"items\": {\"type\": \"integer\"}}, \"values\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"description\": \"All numbers, in row-major order.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"input\", \"shape\", \"values\"]}, \"VectorRows\": {\"type\": \"object\", \"description\": \"Some rows of one output, as the original (torch) model computed them for a test vector.\", \"properties\": {\"output\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"rows\": {\"type\": \"array\", \"items\": {\"type\": \"integer\", \"minimum\": 0}, \"description\": \"Row numbers, along the first axis.\"}, \"values\": {\"type\": \"array\", \"items\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}}, \"description\": \"The numbers of each row, in the order of `rows`.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"output\", \"rows\", \"values\"]}}}, \"trajectory-predictor\": {\"$schema\": \"https://json-schema.org/draft/2020-12/schema\", \"title\": \"gsgen manifest: trajectory-predictor\", \"type\": \"object\", \"description\": \"The manifest of a trajectory predictor: past camera states → future states, uncertainty.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"What people call the model.\", \"minLength\": 1}, \"inputs\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Input\"}, \"default\": []}, \"version\": {\"type\": \"string\", \"description\": \"The model's own version.\", \"default\": \"1.0.0\"}, \"family\": {\"type\": \"string\", \"description\": \"Method family: static, mlp, 4d, avatar, …\"}, \"producer\": {\"$ref\": \"#/$defs/Producer\"}, \"test_vectors\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/TestVector\"}, \"default\": []}, \"contract\": {\"type\": \"string\", \"description\": \"Contract version, major.minor.\", \"pattern\": \"^[0-9]+\\\\.[0-9]+$\", \"default\": \"1.0\"}, \"extensions_used\": {\"type\": \"array\", \"items\": {\"type\": \"string\", \"description\": \"The field of its data: x-writer-name.\", \"pattern\": \"^x-[a-z0-9]+(-[a-z0-9]+)*$\"}, \"description\": \"Registered extensions that the manifest uses.\", \"default\": []}, \"extensions_required\": {\"type\": \"array\", \"items\": {\"type\": \"string\", \"description\": \"The field of its data: x-writer-name.\", \"pattern\": \"^x-[a-z0-9]+(-[a-z0-9]+)*$\"}, \"description\": \"Those without which the model is misread.\", \"default\": []}, \"operator_profile\": {\"type\": \"string\", \"description\": \"The operators that suffice to run it: a profile's name.\"}, \"external_data\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/ExternalData\"}, \"default\": []}, \"cost\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Cost\"}, \"default\": []}, \"outputs\": {\"$ref\": \"#/$defs/TrajectoryOutputs\"}, \"step_seconds\": {\"type\": \"number\", \"description\": \"Time between two states, in seconds.\", \"minimum\": 0}, \"space\": {\"$ref\": \"#/$defs/Space\"}, \"tolerances\": {\"$ref\": \"#/$defs/TrajectoryTolerances\"}, \"kind\": {\"enum\": [\"trajectory-predictor\"], \"default\": \"trajectory-predictor\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"contract\", \"kind\", \"name\", \"outputs\", \"step_seconds\"], \"$defs\": {\"Cost\": {\"type\": \"object\", \"description\": \"The declared time and memory that one frame takes on one device.\", \"properties\": {\"device\": {\"type\": \"string\", \"description\": \"The device, as its driver calls it.\", \"minLength\": 1}, \"milliseconds\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Median time of one run.\"}, \"bytes\": {\"type\": \"integer\", \"description\": \"Peak memory of a session, weights included.\", \"minimum\": 0}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"device\"]}, \"ExternalData\": {\"type\": \"object\", \"description\": \"A file with external weights of the model, and the file's digest.\", \"properties\": {\"path\": {\"type\": \"string\", \"description\": \"As the model writes it: its `location`.\", \"minLength\": 1}, \"sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"path\", \"sha256\"]}, \"FutureOutput\": {\"type\": \"object\", \"description\": \"The output with predicted camera states, [time steps, values], nearest in time first.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"steps\": {\"type\": \"integer\", \"minimum\": 1}, \"representation\": {\"enum\": [\"position+quaternion-wxyz\", \"position+axis-angle\"]}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\", \"steps\", \"representation\"]}, \"Input\": {\"type\": \"object\", \"description\": \"One model input that a runtime feeds in every frame.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"role\": {\"type\": \"string\", \"description\": \"What the input means.\", \"enum\": [\"view\", \"projection\", \"time\", \"frame_index\", \"camera_position\", \"viewport\", \"pose\", \"shape\", \"root_translation\", \"root_rotation\", \"expression\", \"appearance_id\", \"audio\", \"condition\", \"control\", \"image\", \"image_view\", \"image_intrinsics\", \"timestep\", \"conditioning\", \"camera_history\"]}, \"shape\": {\"type\": \"array\", \"items\": {\"type\": \"integer\", \"minimum\": 1}, \"description\": \"Static size of every axis.\"}, \"range\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 2, \"maxItems\": 2, \"description\": \"Smallest and largest meaningful value, both included.\"}, \"default\": {\"anyOf\": [{\"type\": \"number\"}, {\"enum\": [\"zeros\", \"identity\"]}, {\"type\": \"array\", \"items\": {\"type\": \"number\"}}], \"description\": \"What a runtime feeds if it has nothing better; row-major where a list.\"}, \"convention\": {\"type\": \"string\", \"description\": \"Which of the role's conventions it follows.\"}, \"loop\": {\"type\": \"boolean\", \"description\": \"Time: the end of the range continues at its start.\"}, \"frames\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Time: how many distinct frames there are.\"}, \"fps\": {\"type\": \"number\", \"description\": \"Time: frames per second at natural speed.\", \"minimum\": 0}, \"label\": {\"type\": \"string\", \"description\": \"What a user interface calls it.\"}, \"joints\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/Joint\"}, \"description\": \"Pose: one joint for each row, in order.\", \"default\": []}, \"rate\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"Audio: samples per second.\"}, \"window\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Audio, mel: samples under the window of one column.\"}, \"hop\": {\"type\": \"integer\", \"minimum\": 1, \"description\": \"Audio, mel: samples from one column to the next.\"}, \"pass\": {\"enum\": [\"scene\", \"frame\"], \"description\": \"When its value changes: with the scene or with the frame; see `Passes`.\"}, \"background\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Image: RGB from 0 to 1 under transparent pixels; black if absent.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\", \"role\"]}, \"Joint\": {\"type\": \"object\", \"description\": \"One joint of a skeleton; joints are listed in the order of a pose's rows.\", \"properties\": {\"name\": {\"type\": \"string\", \"minLength\": 1}, \"parent\": {\"type\": \"string\", \"description\": \"Name of its parent; absent for a root.\"}, \"rest\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Its position in the rest pose, in local units.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\"]}, \"Producer\": {\"type\": \"object\", \"description\": \"The author of the model, its sources, and its licence.\", \"properties\": {\"tool\": {\"type\": \"string\", \"description\": \"Program and version.\"}, \"source\": {\"type\": \"string\"}, \"license\": {\"type\": \"string\", \"description\": \"An SPDX expression.\"}, \"weights_sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"tool\"]}, \"Space\": {\"type\": \"object\", \"description\": \"The coordinate frame of Gaussians, cameras and bounds.\", \"properties\": {\"handedness\": {\"enum\": [\"right\"], \"default\": \"right\"}, \"up\": {\"enum\": [\"+x\", \"-x\", \"+y\", \"-y\", \"+z\", \"-z\"], \"description\": \"The world's upward axis.\", \"default\": \"-y\"}, \"unit\": {\"enum\": [\"metre\", \"arbitrary\"], \"description\": \"What one unit of length is; SfM scenes: arbitrary.\", \"default\": \"arbitrary\"}, \"matrix_order\": {\"enum\": [\"column\", \"row\"], \"description\": \"`column`: the [4,4] tensor holds Mᵀ, as column-major bytes do. `row`: it holds M.\", \"default\": \"column\"}, \"origin\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"minItems\": 3, \"maxItems\": 3, \"description\": \"Where the local origin lies in the author's world, in units, as float64.\"}, \"metres_per_unit\": {\"type\": \"number\", \"exclusiveMinimum\": 0, \"description\": \"Length of one unit, in metres.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"TestVector\": {\"type\": \"object\", \"description\": \"A named set of test inputs, and the digest of the outputs that the model promises for it.\", \"properties\": {\"inputs\": {\"type\": \"string\", \"description\": \"Which probe, by its label.\"}, \"expected_sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}, \"seed\": {\"type\": \"integer\", \"description\": \"Seed of the probe set.\", \"minimum\": 0, \"default\": 0}, \"files\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorFile\"}, \"description\": \"The inputs as files, for readers without the probe set.\", \"default\": []}, \"values\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorInput\"}, \"description\": \"The inputs themselves, instead of the probe's.\", \"default\": []}, \"outputs\": {\"type\": \"array\", \"items\": {\"$ref\": \"#/$defs/VectorRows\"}, \"description\": \"Rows of the source's outputs for `values`.\", \"default\": []}, \"tolerances\": {\"$ref\": \"#/$defs/Tolerances\", \"description\": \"For `outputs`; absent: the manifest's.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"inputs\", \"expected_sha256\"]}, \"Tolerances\": {\"type\": \"object\", \"description\": \"The largest allowed differences between two runs of the model, each field in its unit.\", \"properties\": {\"position\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"In standard deviations of the Gaussian.\", \"default\": 0.001}, \"covariance\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Relative to the covariance's trace.\", \"default\": 0.001}, \"opacity\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Absolute.\", \"default\": 0.002}, \"appearance\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Absolute, of the colour seen from a direction.\", \"default\": 0.002}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"TrajectoryOutputs\": {\"type\": \"object\", \"description\": \"The outputs of a camera-trajectory predictor: future camera states, and uncertainty.\", \"properties\": {\"future\": {\"$ref\": \"#/$defs/FutureOutput\"}, \"uncertainty\": {\"$ref\": \"#/$defs/UncertaintyOutput\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"future\", \"uncertainty\"]}, \"TrajectoryTolerances\": {\"type\": \"object\", \"description\": \"The largest allowed differences between two runs of a trajectory predictor.\", \"properties\": {\"position\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"In units of length.\", \"default\": 0.001}, \"rotation\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Angle between two rotations, in radians.\", \"default\": 0.001}, \"uncertainty\": {\"type\": \"number\", \"minimum\": 0, \"description\": \"Relative.\", \"default\": 0.01}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": []}, \"UncertaintyOutput\": {\"type\": \"object\", \"description\": \"The output with the uncertainty of predicted camera states, one row per time step.\", \"properties\": {\"name\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"semantics\": {\"enum\": [\"standard-deviation\", \"covariance-upper\"], \"default\": \"standard-deviation\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"name\"]}, \"VectorFile\": {\"type\": \"object\", \"description\": \"The file with one input of a test vector: an ONNX TensorProto.\", \"properties\": {\"input\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"path\": {\"type\": \"string\", \"description\": \"A file in the model's folder or below it.\", \"minLength\": 1}, \"sha256\": {\"type\": \"string\", \"description\": \"SHA-256, in lower-case hex.\", \"pattern\": \"^[0-9a-f]{64}$\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"input\", \"path\", \"sha256\"]}, \"VectorInput\": {\"type\": \"object\", \"description\": \"The numbers of one input of a test vector, inside the manifest.\", \"properties\": {\"input\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"shape\": {\"type\": \"array\", \"items\": {\"type\": \"integer\"}}, \"values\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}, \"description\": \"All numbers, in row-major order.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"input\", \"shape\", \"values\"]}, \"VectorRows\": {\"type\": \"object\", \"description\": \"Some rows of one output, as the original (torch) model computed them for a test vector.\", \"properties\": {\"output\": {\"type\": \"string\", \"description\": \"The tensor's name in the graph.\", \"minLength\": 1}, \"rows\": {\"type\": \"array\", \"items\": {\"type\": \"integer\", \"minimum\": 0}, \"description\": \"Row numbers, along the first axis.\"}, \"values\": {\"type\": \"array\", \"items\": {\"type\": \"array\", \"items\": {\"type\": \"number\"}}, \"description\": \"The numbers of each row, in the order of `rows`.\"}}, \"patternProperties\": {\"^x-\": true}, \"additionalProperties\": false, \"required\": [\"output\", \"rows\", \"values\"]}}}}");
const MANIFEST_KINDS$0 = ["gaussian-generator", "post-process", "trajectory-predictor"];
const _OPTIONAL_PATHS$1 = ["inputs.", "outputs.count", "outputs.cells"];
const ITEMSIZE$2 = py.dict([["float32", 4], ["float16", 2]]);
const _SPDX$3 = new RegExp("^\\(*\\s*[A-Za-z0-9][A-Za-z0-9.+-]*(?::[A-Za-z0-9.+-]+)?\\s*\\)*(?:\\s+(?:AND|OR|WITH)\\s+\\(*\\s*[A-Za-z0-9][A-Za-z0-9.+-]*(?::[A-Za-z0-9.+-]+)?\\s*\\)*)*$", "");
const ROLES$4 = py.dict([["view", new Role$roles("view", ["float32"], [[4, 4]], "World→camera matrix; memory order as declared.", ["gaussian-generator"], false, false, [])], ["projection", new Role$roles("projection", ["float32"], [[4, 4]], "Camera→clip matrix, depth 0..1.", ["gaussian-generator"], false, false, [])], ["time", new Role$roles("time", ["float32"], [[1]], "Time, in the declared range.", ["gaussian-generator"], false, false, [])], ["frame_index", new Role$roles("frame_index", ["int32"], [[1]], "Frame number.", ["gaussian-generator"], true, true, [])], ["camera_position", new Role$roles("camera_position", ["float32"], [[3]], "Camera centre, in local space.", ["gaussian-generator"], false, false, [])], ["viewport", new Role$roles("viewport", ["float32"], [[2]], "Width and height of the image, in pixels.", ["gaussian-generator"], false, false, [])], ["pose", new Role$roles("pose", ["float32"], [["J", 3], ["J", 4]], "Joint rotations, axis-angle [J,3] in radians or quaternions (w,x,y,z) [J,4].", ["gaussian-generator"], false, false, ["smpl-axis-angle", "axis-angle", "quaternion-wxyz", "flame", "mano"])], ["shape", new Role$roles("shape", ["float32"], [["B"]], "Body shape coefficients.", ["gaussian-generator"], false, true, ["flame", "mano", "smplx-10"])], ["root_translation", new Role$roles("root_translation", ["float32"], [[3]], "Translation of the root, in local units.", ["gaussian-generator"], false, false, [])], ["root_rotation", new Role$roles("root_rotation", ["float32"], [[3], [3, 3]], "Rotation of the root, axis-angle [3] in radians or matrix [3,3].", ["gaussian-generator"], false, false, ["axis-angle", "matrix"])], ["expression", new Role$roles("expression", ["float32"], [["E"]], "Expression coefficients.", ["gaussian-generator"], false, true, ["flame", "arkit-52", "smplx-10"])], ["appearance_id", new Role$roles("appearance_id", ["int32"], [[1]], "Appearance.", ["gaussian-generator"], true, true, [])], ["audio", new Role$roles("audio", ["float32"], [["S"], ["W", "M"]], "Sound: S samples in [−1, 1], or W columns of M mel energies; newest last.", ["gaussian-generator"], false, false, ["samples", "mel"])], ["condition", new Role$roles("condition", ["float32", "int32"], [["*"]], "Numbers that another program computes, such as the tokens or the code of a text.", ["gaussian-generator"], false, true, [])], ["control", new Role$roles("control", ["float32"], [["*"]], "A named slider.", ["gaussian-generator", "post-process"], false, true, [])], ["image", new Role$roles("image", ["float32", "float16"], [[1, 3, "H", "W"], [1, 4, "H", "W"]], "Pictures, channels first: of the scene, or the rendered one.", ["gaussian-generator", "post-process"], false, false, [])], ["image_view", new Role$roles("image_view", ["float32"], [["V", 4, 4]], "World→camera matrix of each picture; memory order as declared.", ["gaussian-generator"], false, false, [])], ["image_intrinsics", new Role$roles("image_intrinsics", ["float32"], [["V", 3, 3]], "Pinhole matrix of each picture, in pixels of the `image` input.", ["gaussian-generator"], false, false, [])], ["timestep", new Role$roles("timestep", ["int32", "float32"], [[1]], "Diffusion timestep.", ["post-process"], false, true, [])], ["conditioning", new Role$roles("conditioning", ["float32", "float16"], [[1, "L", "D"], [1, "D"]], "Conditioning vectors, such as a text embedding.", ["post-process"], false, false, [])], ["camera_history", new Role$roles("camera_history", ["float32"], [["T", "S"]], "Past camera states, oldest first.", ["trajectory-predictor"], false, false, [])]]);
const UPGRADE_BY_VERSION$5 = py.dict([[[1, 1], released$upgrades], [[1, 2], released$upgrades]]);
const REGISTERED_EXTENSIONS$6 = py.dict([]);
const READER_PROFILES$7 = py.dict([["portable-1", new OperatorProfile$reader_needs("portable-1", [13, 20], py.set(["Abs", "Acos", "Acosh", "Add", "And", "ArgMax", "ArgMin", "Asin", "Asinh", "Atan", "Atanh", "AveragePool", "BatchNormalization", "Cast", "CastLike", "Ceil", "Clip", "Concat", "Constant", "Conv", "ConvTranspose", "Cos", "Cosh", "CumSum", "DepthToSpace", "DequantizeLinear", "Div", "Einsum", "Elu", "Equal", "Erf", "Exp", "Expand", "Flatten", "Floor", "Gather", "GatherElements", "GatherND", "Gemm", "GlobalAveragePool", "Greater", "GreaterOrEqual", "HardSigmoid", "HardSwish", "Identity", "InstanceNormalization", "LayerNormalization", "LeakyRelu", "Less", "LessOrEqual", "Log", "LogSoftmax", "LpNormalization", "MatMul", "Max", "MaxPool", "Min", "Mul", "Neg", "Not", "PRelu", "Pad", "Pow", "Reciprocal", "ReduceL1", "ReduceL2", "ReduceLogSumExp", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare", "Relu", "Reshape", "Resize", "ScatterElements", "ScatterND", "Shape", "Sigmoid", "Sin", "Sinh", "Slice", "Softmax", "Softplus", "Split", "Sqrt", "Squeeze", "Sub", "Tan", "Tanh", "ThresholdedRelu", "Tile", "TopK", "Transpose", "Trilu", "Unsqueeze", "Where"]), "What ONNX Runtime's WebGPU providers capture in float32; no control flow.")]]);
const MAIN_DOMAIN$8 = ["", "ai.onnx"];
const _SHAPE_RULES$9 = ["view", "projection", "time"];
const _SHAPES_BY_KIND$10 = py.dict([[["image", "gaussian-generator"], [["V", 3, "H", "W"]]]]);
const _SQUARE_SHAPES$11 = [[4, 4], [3, 3]];
const JOINTS$12 = py.dict([["smpl-axis-angle", [24, 55]]]);
const CONVENTION_SHAPES$13 = py.dict([[["pose", "flame"], [5, 3]], [["pose", "mano"], [16, 3]], [["shape", "flame"], ["B"]], [["shape", "mano"], [10]], [["shape", "smplx-10"], [10]], [["expression", "flame"], ["E"]], [["expression", "arkit-52"], [52]], [["expression", "smplx-10"], [10]], [["audio", "samples"], ["S"]], [["audio", "mel"], ["W", "M"]]]);
const _USER_ROLES$14 = ["pose", "shape", "expression", "root_translation", "root_rotation", "appearance_id", "control", "timestep", "conditioning", "audio", "condition", "image_view", "image_intrinsics"];
const _TIME_ROLES$15 = ["time", "frame_index"];
const ROTATION_ROLES$16 = ["pose", "root_rotation"];
const _SOUND_FIELDS$17 = ["rate", "window", "hop"];
const PICTURE_ROLES$18 = ["image", "image_view", "image_intrinsics"];
const _FRAME_ROLES$19 = ["view", "projection", "camera_position", "viewport", "time", "frame_index", "audio"];
const COLUMN_MEANINGS$20 = py.dict([[7, "x y z, opacity and three scales without a rotation"], [11, "x y z, opacity, three scales and a quaternion"], [13, "x y z, opacity and the full matrix of nine covariances"], [14, "x y z, colour, opacity, three log scales and a quaternion of a PLY"], [59, "x y z, SH, opacity, three log scales and a quaternion of a PLY"], [62, "x y z, normal, SH, opacity, three log scales and a quaternion of a PLY"]]);
const APPEARANCE_CHANNELS$21 = py.dict([["sh", [3, 12, 27, 48]], ["rgb", [3, 4]]]);
const SH_COEFFICIENT_COUNTS$22 = [1, 4, 9, 16];
const _COLOR_OUTPUT_WORDS$23 = ["color", "sh", "rgb"];
const _COLOR_CHANNELS$24 = [3, 4, 12, 27, 48];
const STATE_SIZES$25 = py.dict([["position+quaternion-wxyz", 7], ["position+axis-angle", 6]]);
const CONTROL_FLOW$26 = py.set(["If", "Loop", "Scan"]);
const RANDOM_OPERATORS$27 = py.set(["Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike"]);
const VIEW_OPERATORS$28 = py.set(["Flatten", "Identity", "Reshape", "Squeeze", "Unsqueeze"]);
const VARIADIC$29 = py.set(["Max", "Min"]);
const _SCATTER_OPERATORS$30 = py.set(["ScatterElements", "ScatterND"]);
const _DTYPE_BITS$31 = py.dict([["complex128", 128], ["complex64", 64], ["float64", 64], ["int64", 64], ["uint64", 64], ["float16", 16], ["bfloat16", 16], ["int16", 16], ["uint16", 16], ["int8", 8], ["uint8", 8], ["bool", 8], ["float8e4m3fn", 8], ["float8e4m3fnuz", 8], ["float8e5m2", 8], ["float8e5m2fnuz", 8], ["float8e8m0", 8], ["float6e2m3", 6], ["float6e3m2", 6], ["float4e2m1", 4], ["int4", 4], ["uint4", 4], ["int2", 2], ["uint2", 2]]);
const _SHAPE_OPERATORS$32 = py.set(["Shape", "Size"]);
const DATA_SIZED_OPERATORS$33 = py.set(["Compress", "NonMaxSuppression", "NonZero", "Unique"]);
const _INPUT_NAMES$34 = py.dict([["view", ["view", "view_matrix", "viewmatrix", "camera", "camera_matrix", "viewmat", "w2c"]], ["projection", ["proj", "projection", "projection_matrix", "proj_matrix", "projmat"]], ["time", ["time", "t", "timestamp"]], ["frame_index", ["frame", "frame_index", "frame_id"]], ["camera_position", ["camera_position", "camera_center", "campos", "cam_pos"]], ["viewport", ["viewport", "resolution", "image_size"]], ["pose", ["pose", "poses", "body_pose", "joint_rotations"]], ["shape", ["shape", "betas", "shapes"]], ["root_translation", ["trans", "root_translation", "transl", "translation"]], ["root_rotation", ["root_rotation", "global_orient", "root_orient"]], ["expression", ["expression", "expr"]], ["appearance_id", ["appearance_id", "appearance", "embedding_id"]]]);
const _GAUSSIAN_NAMES$35 = ["gaussians", "gaussian", "gaussian_f16", "gaussian_f32", "gaussian_packed"];
const _COLOR_NAMES$36 = ["color", "colors", "color_sh", "color_rgb", "sh", "shs", "rgb", "features", "sh_f16"];
const _COUNT_NAMES$37 = ["num_points", "count", "num_gaussians", "n_points"];
const CURRENT_VERSION$38 = [1, 0];
const _ANNOTATION_KEYWORDS$39 = ["$schema", "$defs", "title", "description", "default", "examples"];
const _MANIFEST_TYPES$40 = py.dict([["gaussian-generator", GeneratorManifest$manifest], ["post-process", PostProcessManifest$manifest], ["trajectory-predictor", TrajectoryManifest$manifest]]);
const _DTYPE_NAMES$41 = py.dict([[0, null], [1, "float32"], [2, "uint8"], [3, "int8"], [4, "uint16"], [5, "int16"], [6, "int32"], [7, "int64"], [8, "string"], [9, "bool"], [10, "float16"], [11, "float64"], [12, "uint32"], [13, "uint64"], [14, "complex64"], [15, "complex128"], [16, "bfloat16"], [17, "float8e4m3fn"], [18, "float8e4m3fnuz"], [19, "float8e5m2"], [20, "float8e5m2fnuz"], [21, "uint4"], [22, "int4"], [23, "float4e2m1"], [24, "float8e8m0"], [25, "uint2"], [26, "int2"], [27, "float6e2m3"], [28, "float6e3m2"]]);
/** @type {any} */
export const RULES = [
{"id": "GM001", "severity": "error", "hint": "Derive one with `gsgen inspect MODEL --emit-manifest > MANIFEST`, correct what it had to guess, and embed it with `gsgen fix MODEL --manifest MANIFEST -o COPY`.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: manifest_present$manifest},
{"id": "GM002", "severity": "error", "hint": "Correct the field named here; the schema is printed by `gsgen inspect --schema KIND`.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: manifest_schema$manifest},
{"id": "GM003", "severity": "error", "hint": "Update gsgen, or export the model for the contract version that your readers know.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: manifest_version$manifest},
{"id": "GM004", "severity": "error", "hint": "Write the names as the graph has them; `gsgen inspect MODEL` lists both.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: declared_tensors_exist$manifest},
{"id": "GM005", "severity": "error", "hint": "Take the values from the graph, or export again so that they agree.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: manifest_agrees_with_graph$manifest},
{"id": "GM006", "severity": "warning", "hint": "Add \"space\": {\"handedness\": \"right\", \"up\": …, \"unit\": …, \"matrix_order\": …}.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: coordinate_frame_declared$manifest},
{"id": "GM007", "severity": "error", "hint": "Set \"space\": \"sh\" if the rows hold coefficients; else remove the degree.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: sh_declared_as_sh$declarations},
{"id": "GM008", "severity": "info", "hint": "Add \"color_space\": \"srgb\" or \"linear\" to outputs.appearance.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: color_space_declared$declarations},
{"id": "GM009", "severity": "warning", "hint": "Add \"bounds\": {\"min\": [x, y, z], \"max\": [x, y, z]}; the SDK measures them at export.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: bounds_declared$manifest},
{"id": "GM010", "severity": "warning", "hint": "Declare \"range\": [first, last] for time.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004"], check: time_domain$declarations},
{"id": "GM013", "severity": "info", "hint": "Write \"license\": \"Apache-2.0\" or another SPDX expression, and \"tool\": \"name 1.2\".", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: provenance_readable$declarations},
{"id": "GM014", "severity": "warning", "hint": "Declare it in the manifest, under the model-level key gsgen.manifest.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: manifest_at_model_level$declarations},
{"id": "GM015", "severity": "warning", "hint": "Update gsgen.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: manifest_minor_known$manifest},
{"id": "GM016", "severity": "error", "hint": "Remove the entry, or write the name or the role as it stands in the inputs.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: dependencies_are_inputs$declarations},
{"id": "GM017", "severity": "error", "hint": "Declare the tensor of cells as outputs.cells and the weights as weighted_sum, or blend by alpha and declare neither.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: weighted_sum_complete$cells},
{"id": "GM018", "severity": "info", "hint": "Export the model again, or set \"contract\": \"1.0\".", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: contract_version_released$manifest},
{"id": "GM019", "severity": "error", "hint": "Measure the bounds over all times and poses and write the lower corner first; the SDK measures them at export.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: bounds_are_a_box$manifest},
{"id": "GM030", "severity": "error", "hint": "Add the name to \"extensions_used\".", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: required_extensions_used$extensions},
{"id": "GM031", "severity": "error", "hint": "Register the extension as the page of extensions says, or do not require it.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM030"], check: required_extensions_known$extensions},
{"id": "GM032", "severity": "error", "hint": "Replace the operators, with `gsgen rewrite` for example, or remove \"operator_profile\".", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM002", "GM003", "GG019"], check: operator_profile_holds$extensions},
{"id": "GM034", "severity": "error", "hint": "Measure the peak memory of a session with `gsgen bench`, in bytes.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM005"], check: cost_plausible$extensions},
{"id": "GM035", "severity": "error", "hint": "Keep one of the two, or write the same text under both.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: manifest_keys_agree$extensions},
{"id": "GM036", "severity": "error", "hint": "Write \"unit\": \"arbitrary\" beside a \"metres_per_unit\" other than 1.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: unit_agrees_with_scale$extensions},
{"id": "GM038", "severity": "error", "hint": "Remove the name from \"extensions_used\" and \"extensions_required\", or write its field again.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: used_extensions_present$extensions},
{"id": "GM039", "severity": "error", "hint": "Declare \"image_range\" and the output's \"range\" as [black, white], such as [0, 1] or [-1, 1].", "kinds": ["post-process"], "target": "", "limit": "", "needs": ["GM002", "GM003"], check: picture_range_rises$declarations},
{"id": "GI001", "severity": "error", "hint": "Take a [4, 4] tensor and reshape inside the model.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004"], check: view_is_4x4$inputs},
{"id": "GI002", "severity": "error", "hint": "Take a [4, 4] tensor and reshape inside the model.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004"], check: projection_is_4x4$inputs},
{"id": "GI003", "severity": "error", "hint": "Take a [1] tensor.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004"], check: time_is_1$inputs},
{"id": "GI004", "severity": "error", "hint": "Take the input in its role's dtype and cast inside the model.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: input_dtype$inputs},
{"id": "GI005", "severity": "error", "hint": "Declare it in the manifest's inputs, or bake it into the model before export.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: inputs_declared$inputs},
{"id": "GI006", "severity": "warning", "hint": "Export without detaching the input (numpy round trips, `.item()`, Python branches), remove it, or set \"depends_on\": {input or role: false}.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004", "GG019"], check: inputs_reach_outputs$inputs},
{"id": "GI012", "severity": "info", "hint": "Remove every weight from the graph's inputs; the weights stay in the model.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: weights_are_no_inputs$inputs},
{"id": "GI013", "severity": "error", "hint": "Write \"range\": [low, high]; for frame numbers, identities and timesteps with whole numbers.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: input_range_ordered$input_declarations},
{"id": "GI014", "severity": "error", "hint": "Give one number for all elements, as many as there are (row-major), \"zeros\", or \"identity\" for matrices and quaternions.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM005", "GI001", "GI002", "GI003", "GI005", "GI013"], check: input_default_fits$input_declarations},
{"id": "GI015", "severity": "error", "hint": "Name one of the role's conventions, as the page of roles lists them, or none.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004", "GI005"], check: input_convention_known$input_declarations},
{"id": "GI016", "severity": "warning", "hint": "Declare \"default\": a number, a list, \"zeros\" or \"identity\".", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: input_has_a_start$input_declarations},
{"id": "GI017", "severity": "error", "hint": "Declare loop, frames and fps for the roles time and frame_index alone, and the rate that the scene was recorded at; leave fps out if it is unknown.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: timing_belongs_to_time$input_declarations},
{"id": "GI018", "severity": "error", "hint": "Divide degrees by 180 and multiply by π, in the range and in what is fed.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004", "GI015"], check: angles_are_radians$input_declarations},
{"id": "GI025", "severity": "error", "hint": "Declare as many \"frames\" as the range has whole numbers or, where the model has more, \"range\": [0, frames - 1]; the range [0, 1] belongs to a time. Let times start at 0.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004", "GI013"], check: frames_fit_range$input_declarations},
{"id": "GI030", "severity": "error", "hint": "List one joint for each row, in the order of the rows, parents first.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004", "GI005"], check: joints_fit_pose$avatar_inputs},
{"id": "GI031", "severity": "error", "hint": "Divide by 100 in the model, and declare \"range\": [0, 1].", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004", "GI015"], check: blend_weights_in_unit_range$avatar_inputs},
{"id": "GI032", "severity": "error", "hint": "Declare \"rate\" in samples per second; for mel also \"window\" and \"hop\", in samples.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004", "GI015"], check: sound_described$avatar_inputs},
{"id": "GI033", "severity": "error", "hint": "Give `image`, `image_view` and `image_intrinsics` the same first axis, or leave the cameras out where the model assumes its own.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004", "GI005"], check: pictures_have_cameras$scene_inputs},
{"id": "GI034", "severity": "error", "hint": "Declare \"pass\": \"scene\" for inputs that stay from frame to frame, such as a condition or a body shape; leave it out elsewhere.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: pass_suits_role$scene_inputs},
{"id": "GI035", "severity": "error", "hint": "Declare \"background\": [1, 1, 1] for white, at the input of the role `image`.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: background_suits_pictures$scene_inputs},
{"id": "GI036", "severity": "warning", "hint": "Compute what depends on the scene before the inputs of the frame come in, for example by two functions of which the second takes the features of the first.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GI006", "GI034", "GG019"], check: scene_pass_computes$scene_inputs},
{"id": "GO001", "severity": "error", "hint": "Return one [N, 10] tensor and declare it as outputs.gaussians.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003", "GM004"], check: gaussians_declared$outputs},
{"id": "GO003", "severity": "error", "hint": "Drop the batch axis; reshape flattened rows to [N, 10].", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO001"], check: gaussians_rank_2$outputs},
{"id": "GO002", "severity": "error", "hint": "Pack all ten fields: the covariance is R S Sᵀ Rᵀ of scales and quaternion, and opacity comes after its sigmoid. The SDK packs for you.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO001", "GO003"], check: gaussian_row_has_10$outputs},
{"id": "GO004", "severity": "error", "hint": "Export with a fixed capacity (without dynamic_axes or dynamic_shapes), fill it with inert rows, and return the count in num_points.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO001", "GO003"], check: capacity_static$outputs},
{"id": "GO005", "severity": "error", "hint": "Return SH coefficients or RGB and declare them as outputs.appearance.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003", "GM004"], check: appearance_declared$outputs},
{"id": "GO006", "severity": "error", "hint": "Concatenate f_dc and f_rest of a PLY, pad SH to the next degree with zeros, and RGB to four channels with ones; reshape [N, K, 3] to [N, 3K].", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO005"], check: appearance_channels$outputs},
{"id": "GO007", "severity": "error", "hint": "Pad both outputs to the same capacity.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO004", "GO006"], check: appearance_rows$outputs},
{"id": "GO008", "severity": "error", "hint": "End the output on a cast to float32 or float16.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO001", "GO005"], check: output_dtype$outputs},
{"id": "GO009", "severity": "warning", "hint": "Cast both to the same dtype.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO008"], check: output_dtypes_match$outputs},
{"id": "GO010", "severity": "error", "hint": "Return an int32 [1] tensor, a constant where nothing varies, and declare it as outputs.count.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM002", "GM003", "GM004"], check: count_declared$outputs},
{"id": "GO011", "severity": "error", "hint": "Cast the count to int32 and reshape it to [1]; `gsgen explain GG016` says in which order.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO010"], check: count_is_int32$outputs},
{"id": "GO013", "severity": "warning", "hint": "End the output on an operator, such as Mul by one; Identity may be removed again.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GG019"], check: outputs_are_computed$graph_outputs},
{"id": "GO014", "severity": "error", "hint": "Remove the second entry, or give it a tensor of its own through Mul by one.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: outputs_are_distinct$graph_outputs},
{"id": "GO015", "severity": "error", "hint": "Pad float16 RGB to four channels, and SH to 12 or 48 channels.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO002", "GO006", "GO008"], check: rows_fill_words$outputs},
{"id": "TV101", "severity": "error", "hint": "Call it gaussians, as `gsgen fix MODEL --rename -o COPY` does, and list it first.", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GO001"], check: visionary_finds_gaussians$visionary},
{"id": "TV102", "severity": "error", "hint": "Call it color_sh or color_rgb, as `gsgen fix MODEL --rename -o COPY` does, and list it before other outputs.", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GO005", "TV101"], check: visionary_finds_color$visionary},
{"id": "GO017", "severity": "warning", "hint": "Remove the output from the graph.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004", "GO001", "GO005", "GO010", "TV102"], check: outputs_declared$graph_outputs},
{"id": "GO018", "severity": "error", "hint": "Resize inside the model, cast at its end, and declare the dtype and the scale of the graph.", "kinds": ["post-process"], "target": "", "limit": "", "needs": ["GM004", "GI005"], check: image_out_as_in$companions},
{"id": "GO019", "severity": "error", "hint": "Declare the number of steps and the representation that the graph has.", "kinds": ["trajectory-predictor"], "target": "", "limit": "", "needs": ["GM004"], check: states_as_declared$companions},
{"id": "GO020", "severity": "error", "hint": "Return one [C, 10] tensor; the SDK packs it from `gsgen.sdk.Cells`.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GM004", "GM017"], check: cell_row_has_10$cells},
{"id": "GO021", "severity": "error", "hint": "Give every cell the same number of rows, and fill the last ones with inert rows.", "kinds": ["gaussian-generator"], "target": "", "limit": "", "needs": ["GO020", "GO002", "GO004"], check: cells_hold_all_rows$cells},
{"id": "GG001", "severity": "error", "hint": "Export at operator set 18, which every current runtime has kernels for.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: opset_supported$graph},
{"id": "GG002", "severity": "error", "hint": "Export without custom operators; write the operation with standard ones.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: standard_operators$graph},
{"id": "GG003", "severity": "warning", "hint": "`gsgen rewrite MODEL -o COPY` unrolls loops of fixed length. Compute both branches of an If, and select with Where.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: no_control_flow$graph},
{"id": "GG010", "severity": "error", "hint": "Draw the numbers before export and store them as weights.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": ["GG025"], check: no_random_operators$repeatability},
{"id": "GG012", "severity": "error", "hint": "Rename the nodes; name inputs and outputs with letters, digits, dots, slashes and underscores.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "", "needs": [], check: names_are_clean$naming},
{"id": "GG016", "severity": "warning", "hint": "End the output on Cast, Concat, Mul by one, or Add of zero; reshape before that. `gsgen rewrite MODEL -o COPY` does so, and replaces Scatter.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "graph_capture", "needs": ["GG019"], check: outputs_survive_replay$capture},
{"id": "GL002", "severity": "error", "hint": "Use float16, fewer SH degrees or a smaller capacity, or split the model.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "buffer_bytes", "needs": [], check: fits_buffer$limits},
{"id": "GL001", "severity": "error", "hint": "Use float16, fewer SH degrees or a smaller capacity, or split the model.", "kinds": ["gaussian-generator", "post-process", "trajectory-predictor"], "target": "", "limit": "binding_bytes", "needs": ["GL002"], check: fits_binding$limits},
{"id": "GL003", "severity": "error", "hint": "Lower the capacity, or split the model.", "kinds": ["gaussian-generator"], "target": "", "limit": "workgroups", "needs": ["GO004", "GL001", "GL002"], check: fits_dispatch$limits},
{"id": "GL005", "severity": "info", "hint": "Use float16, fewer SH degrees or a smaller capacity.", "kinds": ["gaussian-generator"], "target": "", "limit": "frame_bytes", "needs": ["GM004", "GL001", "GL002"], check: frame_is_small$capacity},
{"id": "TV103", "severity": "error", "hint": "Call them camera, proj and time; bake other inputs in before export. In place of the camera position, take inputs.view() and compute gsgen.sdk.math.camera_centre(view).", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GM004", "GI005"], check: visionary_binds_inputs$visionary},
{"id": "TV104", "severity": "error", "hint": "Emit SH of degree 3 or float16 RGB with four channels.", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GO006", "GO008", "GM005"], check: visionary_reads_color$visionary},
{"id": "TV107", "severity": "info", "hint": "Nothing, if rows behind the count are zeros; do not rely on the count alone.", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GO010"], check: visionary_ignores_count$visionary_drawing},
{"id": "TV108", "severity": "warning", "hint": "Scale time inside the model, so that its range is [0, 1].", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GM004"], check: visionary_time_range$visionary},
{"id": "TV111", "severity": "warning", "hint": "Convert colours to sRGB before packing.", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GO005", "GM002", "GM003"], check: visionary_shows_srgb$visionary_drawing},
{"id": "TV112", "severity": "warning", "hint": "Export for sorting, where the method has such an option (`--blend alpha`), and compare pictures.", "kinds": ["gaussian-generator"], "target": "visionary", "limit": "", "needs": ["GM017"], check: visionary_sorts$visionary_drawing}
];
/** @type {any} */
export const TARGETS = py.dict([
["core", new Target$targets("core", "1.0", "The contract alone.", [13, 26], 13, py.set(["", "ai.onnx"]), py.dict([]), py.dict([]), [], true)],
["gsgen", new Target$targets("gsgen", "1.0", "The runtime of this project: float buffers in pages, so large outputs are fine.", [13, 26], 13, py.set(["", "ai.onnx"]), py.dict([["workgroups", 65535], ["workgroup_size", 256]]), py.dict([]), [], true)],
["visionary", new Target$targets("visionary", "1.0.1", "The Visionary web viewer 1.0.1 with onnxruntime-web 1.22.", [13, 22], 10, py.set(["", "ai.onnx"]), py.dict([["binding_bytes", 134217728], ["buffer_bytes", 268435456], ["workgroups", 65535], ["workgroup_size", 256], ["split_outputs", 7], ["concat_inputs", 7], ["graph_capture", 1], ["frame_bytes", 67108864], ["subnormal_permille", 100]]), py.dict([["GG003", "error"], ["GG016", "error"], ["GO009", "error"], ["GM001", "warning"]]), ["onnxruntime-web-1.22.0"], false)],
["webgpu", new Target$targets("webgpu", "1.0", "WebGPU default limits and ONNX Runtime's WebGPU provider, with graph capture.", [13, 26], 13, py.set(["", "ai.onnx"]), py.dict([["binding_bytes", 134217728], ["buffer_bytes", 268435456], ["workgroups", 65535], ["workgroup_size", 256], ["split_outputs", 7], ["graph_capture", 1], ["frame_bytes", 67108864], ["subnormal_permille", 100]]), py.dict([["GG003", "error"], ["GG016", "error"], ["GB014", "error"], ["GB015", "error"]]), ["onnxruntime-web-1.30.0", "ep-webgpu-0.4.0"], false)]
]);
/** @type {any} */
export const MESSAGES = {"onnx.ModelProto": [[1, "ir_version", "int", 0], [8, "opset_import", "onnx.OperatorSetIdProto", 1], [2, "producer_name", "text", 0], [3, "producer_version", "text", 0], [4, "domain", "text", 0], [5, "model_version", "int", 0], [6, "doc_string", "text", 0], [7, "graph", "onnx.GraphProto", 0], [14, "metadata_props", "onnx.StringStringEntryProto", 1], [20, "training_info", "onnx.TrainingInfoProto", 1], [25, "functions", "onnx.FunctionProto", 1], [26, "configuration", "onnx.DeviceConfigurationProto", 1]], "onnx.DeviceConfigurationProto": [[1, "name", "text", 0], [2, "num_devices", "int", 0], [3, "device", "text", 1]], "onnx.FunctionProto": [[1, "name", "text", 0], [4, "input", "text", 1], [5, "output", "text", 1], [6, "attribute", "text", 1], [11, "attribute_proto", "onnx.AttributeProto", 1], [7, "node", "onnx.NodeProto", 1], [8, "doc_string", "text", 0], [9, "opset_import", "onnx.OperatorSetIdProto", 1], [10, "domain", "text", 0], [13, "overload", "text", 0], [12, "value_info", "onnx.ValueInfoProto", 1], [14, "metadata_props", "onnx.StringStringEntryProto", 1]], "onnx.StringStringEntryProto": [[1, "key", "text", 0], [2, "value", "text", 0]], "onnx.ValueInfoProto": [[1, "name", "text", 0], [2, "type", "onnx.TypeProto", 0], [3, "doc_string", "text", 0], [4, "metadata_props", "onnx.StringStringEntryProto", 1]], "onnx.TypeProto": [[1, "tensor_type", "onnx.TypeProto.Tensor", 0], [4, "sequence_type", "onnx.TypeProto.Sequence", 0], [5, "map_type", "onnx.TypeProto.Map", 0], [9, "optional_type", "onnx.TypeProto.Optional", 0], [8, "sparse_tensor_type", "onnx.TypeProto.SparseTensor", 0], [7, "opaque_type", "onnx.TypeProto.Opaque", 0], [6, "denotation", "text", 0]], "onnx.TypeProto.Opaque": [[1, "domain", "text", 0], [2, "name", "text", 0]], "onnx.TypeProto.SparseTensor": [[1, "elem_type", "int", 0], [2, "shape", "onnx.TensorShapeProto", 0]], "onnx.TensorShapeProto": [[1, "dim", "onnx.TensorShapeProto.Dimension", 1]], "onnx.TensorShapeProto.Dimension": [[1, "dim_value", "int", 0], [2, "dim_param", "text", 0], [3, "denotation", "text", 0]], "onnx.TypeProto.Optional": [[1, "elem_type", "onnx.TypeProto", 0]], "onnx.TypeProto.Map": [[1, "key_type", "int", 0], [2, "value_type", "onnx.TypeProto", 0]], "onnx.TypeProto.Sequence": [[1, "elem_type", "onnx.TypeProto", 0]], "onnx.TypeProto.Tensor": [[1, "elem_type", "int", 0], [2, "shape", "onnx.TensorShapeProto", 0]], "onnx.OperatorSetIdProto": [[1, "domain", "text", 0], [2, "version", "int", 0]], "onnx.NodeProto": [[1, "input", "text", 1], [2, "output", "text", 1], [3, "name", "text", 0], [4, "op_type", "text", 0], [7, "domain", "text", 0], [8, "overload", "text", 0], [5, "attribute", "onnx.AttributeProto", 1], [6, "doc_string", "text", 0], [9, "metadata_props", "onnx.StringStringEntryProto", 1], [10, "device_configurations", "onnx.NodeDeviceConfigurationProto", 1]], "onnx.NodeDeviceConfigurationProto": [[1, "configuration_id", "text", 0], [2, "sharding_spec", "onnx.ShardingSpecProto", 1], [3, "pipeline_stage", "int", 0]], "onnx.ShardingSpecProto": [[1, "tensor_name", "text", 0], [2, "device", "int", 1], [3, "index_to_device_group_map", "onnx.IntIntListEntryProto", 1], [4, "sharded_dim", "onnx.ShardedDimProto", 1]], "onnx.ShardedDimProto": [[1, "axis", "int", 0], [2, "simple_sharding", "onnx.SimpleShardedDimProto", 1]], "onnx.SimpleShardedDimProto": [[1, "dim_value", "int", 0], [2, "dim_param", "text", 0], [3, "num_shards", "int", 0]], "onnx.IntIntListEntryProto": [[1, "key", "int", 0], [2, "value", "int", 1]], "onnx.AttributeProto": [[1, "name", "text", 0], [21, "ref_attr_name", "text", 0], [13, "doc_string", "text", 0], [20, "type", "int", 0], [2, "f", "float", 0], [3, "i", "int", 0], [4, "s", "bytes", 0], [5, "t", "onnx.TensorProto", 0], [6, "g", "onnx.GraphProto", 0], [22, "sparse_tensor", "onnx.SparseTensorProto", 0], [14, "tp", "onnx.TypeProto", 0], [7, "floats", "float", 1], [8, "ints", "int", 1], [9, "strings", "bytes", 1], [10, "tensors", "onnx.TensorProto", 1], [11, "graphs", "onnx.GraphProto", 1], [23, "sparse_tensors", "onnx.SparseTensorProto", 1], [15, "type_protos", "onnx.TypeProto", 1]], "onnx.SparseTensorProto": [[1, "values", "onnx.TensorProto", 0], [2, "indices", "onnx.TensorProto", 0], [3, "dims", "int", 1]], "onnx.TensorProto": [[1, "dims", "int", 1], [2, "data_type", "int", 0], [3, "segment", "onnx.TensorProto.Segment", 0], [4, "float_data", "float", 1], [5, "int32_data", "int", 1], [6, "string_data", "bytes", 1], [7, "int64_data", "int", 1], [8, "name", "text", 0], [12, "doc_string", "text", 0], [9, "raw_data", "bytes", 0], [13, "external_data", "onnx.StringStringEntryProto", 1], [14, "data_location", "int", 0], [10, "double_data", "double", 1], [11, "uint64_data", "int", 1], [16, "metadata_props", "onnx.StringStringEntryProto", 1]], "onnx.TensorProto.Segment": [[1, "begin", "int", 0], [2, "end", "int", 0]], "onnx.GraphProto": [[1, "node", "onnx.NodeProto", 1], [2, "name", "text", 0], [5, "initializer", "onnx.TensorProto", 1], [15, "sparse_initializer", "onnx.SparseTensorProto", 1], [10, "doc_string", "text", 0], [11, "input", "onnx.ValueInfoProto", 1], [12, "output", "onnx.ValueInfoProto", 1], [13, "value_info", "onnx.ValueInfoProto", 1], [14, "quantization_annotation", "onnx.TensorAnnotation", 1], [16, "metadata_props", "onnx.StringStringEntryProto", 1]], "onnx.TensorAnnotation": [[1, "tensor_name", "text", 0], [2, "quant_parameter_tensor_names", "onnx.StringStringEntryProto", 1]], "onnx.TrainingInfoProto": [[1, "initialization", "onnx.GraphProto", 0], [2, "algorithm", "onnx.GraphProto", 0], [3, "initialization_binding", "onnx.StringStringEntryProto", 1], [4, "update_binding", "onnx.StringStringEntryProto", 1]]};
/** @type {any} */
export const InspectedModel = InspectedModel$inspected_model;
/** @type {any} */
export const ModelFile = ModelFile$model_file;
/** @type {any} */
export const inferManifest = infer_manifest$manifest_inference;
/** @type {any} */
export const isCopy = is_copy$provider_placement;
/** @type {any} */
export const parseManifest = parse$manifest_io;
/** @type {any} */
export const readGraph = read_graph$graph;
