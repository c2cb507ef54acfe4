// Facts about a graph: producers, dependencies, and the shapes, dtypes and ranges of tensors.

import {attribute, DTYPE, DTYPE_BYTES, numbers} from './onnx_file.mjs';
import {COMPARISONS, ELEMENTWISE, VALUE_SHAPED} from './operators.mjs';

const product = (sizes) => sizes.reduce((total, size) => total * size, 1);

/** The dtype and shape that the file declares: sizes are numbers, or null where they are open. */
function declared(value) {
  const tensor = value.type?.tensor;
  const shape = tensor?.shape?.dims.map((dim) => dim.size ?? null);
  return {dtype: tensor?.dtype, shape};
}

export class Graph {
  constructor(model) {
    const graph = model.graph;
    this.nodes = graph.nodes;
    this.outputs = graph.outputs;
    this.weights = new Map(graph.initializers.map((tensor) => [tensor.name, tensor]));
    // I17: initialisers that are also listed as inputs are weights.
    this.inputs = new Map(graph.inputs.filter((value) => !this.weights.has(value.name))
      .map((value) => [value.name, declared(value)]));
    this.declarations = [...graph.values, ...graph.inputs, ...graph.outputs]
      .map((value) => [value.name, declared(value)]);
    this.declared = new Map(this.declarations);
    this.conflicts = []; // operators whose inputs do not fit each other
    this.producer = new Map();
    for (const node of this.nodes) for (const name of node.outputs) this.producer.set(name, node);
    this.functions = new Set(model.functions.map((body) => `${body.domain}:${body.name}`));
    // One walk in the file's order, which ONNX requires to be topological.
    this.sources = new Map([...this.inputs.keys()].map((name) => [name, new Set([name])]));
    this.computed = new Map(this.inputs);
    for (const [name, tensor] of this.weights) {
      this.computed.set(name, {dtype: tensor.dtype, shape: tensor.dims});
    }
    for (const node of this.nodes) {
      const sources = new Set();
      for (const name of reads(node)) for (const s of this.sources.get(name) ?? []) sources.add(s);
      const results = this.functions.has(`${node.domain}:${node.op}`) ? [] : this.infer(node);
      for (const [i, name] of node.outputs.entries()) {
        this.sources.set(name, node.op === 'Shape' && this.shape(node.inputs[0])?.every(Boolean)
          ? new Set() : sources);
        this.computed.set(name, results[i] ?? {});
      }
    }
  }

  /** The graph's inputs that the values of a tensor depend on. */
  dependencies(name) {
    return this.sources.get(name) ?? new Set();
  }

  output(name) {
    const value = this.outputs.find((entry) => entry.name === name);
    return value && declared(value);
  }

  /** The declared sizes of an output, open ones as operators compute them (I22.5). */
  filledShape(name) {
    const computed = this.computed.get(name)?.shape;
    return this.output(name)?.shape?.map((size, i) => size ?? computed?.[i] ?? null);
  }

  shape(name) {
    return this.computed.get(name)?.shape ?? this.declared.get(name)?.shape;
  }

  dtype(name) {
    return this.computed.get(name)?.dtype ?? this.declared.get(name)?.dtype;
  }

  bytes(name) {
    const shape = this.shape(name);
    return shape?.every((size) => size !== null) ? product(shape) * DTYPE_BYTES[this.dtype(name)] : 0;
  }

  /** The numbers of a constant that lies inside the file. */
  constant(name) {
    if (this.weights.has(name)) return numbers(this.weights.get(name));
    const node = this.producer.get(name);
    if (node?.op === 'Constant') {
      const value = attribute(node, 'value');
      if (value?.dims) return numbers(value);
      return [attribute(node, 'value_ints') ?? attribute(node, 'value_int')].flat();
    }
    if (node?.op === 'Shape' && this.shape(node.inputs[0])?.every((n) => n !== null)) {
      return this.shape(node.inputs[0]);
    }
    return undefined;
  }

  /** The axes of a node, from its attribute (up to operator set 12) or its second input. */
  axes(node) {
    return attribute(node, 'axes') ?? (node.inputs[1] ? this.constant(node.inputs[1]) : []);
  }

  /** The dtypes and shapes of a node's outputs, as far as simple rules tell them. */
  infer(node) {
    const [first, second, third] = node.inputs.map((name) => this.computed.get(name) ?? {});
    const [a, b] = [first?.shape, second?.shape];
    const dtype = first?.dtype;
    const axis = (rank, value = attribute(node, 'axis') ?? 0) => (value < 0 ? value + rank : value);
    if (COMPARISONS.has(node.op) || ELEMENTWISE.has(node.op)) {
      const names = node.inputs.filter(Boolean);
      const shapes = names.map((name) => this.shape(name));
      const dtypes = new Set(names.map((name) => this.dtype(name)).filter(Boolean));
      if (clash(shapes) || (dtypes.size > 1 && node.op !== 'Pow')) this.conflicts.push(node);
      return [{dtype: COMPARISONS.has(node.op) ? DTYPE.bool : dtype, shape: broadcast(shapes)}];
    }
    switch (node.op) {
      case 'Where': return [{dtype: second?.dtype, shape: broadcast([a, b, third?.shape])}];
      case 'Cast': return [{dtype: attribute(node, 'to'), shape: a}];
      case 'Softmax': case 'LogSoftmax': case 'Dropout': case 'LayerNormalization':
      case 'BatchNormalization': case 'InstanceNormalization': case 'GroupNormalization':
      case 'LpNormalization': case 'CumSum': return [{dtype, shape: a}];
      case 'Shape': return [{dtype: DTYPE.int64, shape: a && [a.length]}];
      case 'NonZero': return [{dtype: DTYPE.int64, shape: a && [a.length, null]}];
      case 'Constant': {
        const value = attribute(node, 'value');
        return value?.dims ? [{dtype: value.dtype, shape: value.dims}] : [];
      }
      case 'Concat': {
        const shapes = node.inputs.map((name) => this.shape(name));
        if (!shapes.every(Boolean)) return [{dtype}];
        const at = axis(a.length);
        const others = shapes.map((shape) => shape.map((n, i) => (i === at ? 1 : n)));
        if (shapes.some((shape) => shape.length !== a.length) || at >= a.length
          || others.some((shape) => shape.some((n, i) => n && others[0][i] && n !== others[0][i]))) {
          this.conflicts.push(node);
          return [{dtype}];
        }
        const sizes = shapes.map((shape) => shape[at]);
        const size = sizes.includes(null) ? null : sizes.reduce((x, y) => x + y, 0);
        return [{dtype, shape: a.map((n, i) => (i === at ? size : n))}];
      }
      case 'MatMul': {
        if (!a?.length || !b?.length) return [{dtype}];
        const [inner, other] = [a.at(-1), b.length > 1 ? b.at(-2) : b[0]];
        if (inner !== null && other !== null && inner !== other) this.conflicts.push(node);
        if (second.dtype !== dtype) this.conflicts.push(node);
        const batch = broadcast([a.slice(0, -2), b.slice(0, -2)]);
        return [{dtype, shape: batch && [...batch, ...(a.length > 1 ? [a.at(-2)] : []),
          ...(b.length > 1 ? [b.at(-1)] : [])]}];
      }
      case 'Gather': {
        const at = a && axis(a.length);
        return [{dtype, shape: a && b && [...a.slice(0, at), ...b, ...a.slice(at + 1)]}];
      }
      case 'Transpose': {
        const order = attribute(node, 'perm') ?? a?.map((_, i) => a.length - 1 - i);
        return [{dtype, shape: a && order.map((i) => a[i])}];
      }
      case 'Flatten': {
        const at = a && axis(a.length, attribute(node, 'axis') ?? 1);
        return [{dtype, shape: a?.every((n) => n !== null)
          ? [product(a.slice(0, at)), product(a.slice(at))] : undefined}];
      }
      case 'Reshape': {
        const sizes = this.constant(node.inputs[1])?.map((n, i) => (n === 0 ? a?.[i] : n));
        if (!sizes || sizes.includes(undefined)) return [{dtype}];
        const rest = product(sizes.filter((n) => n >= 0));
        return [{dtype, shape: sizes.map((n) => (n >= 0 ? n
          : a?.every((m) => m !== null) ? product(a) / rest : null))}];
      }
      case 'Expand': {
        const sizes = this.constant(node.inputs[1]);
        return [{dtype, shape: sizes && broadcast([a, sizes])}];
      }
      case 'Unsqueeze': {
        const axes = this.axes(node);
        if (!a || !axes) return [{dtype}];
        const rank = a.length + axes.length;
        const places = new Set(axes.map((n) => axis(rank, n)));
        const rest = [...a];
        return [{dtype, shape: Array.from({length: rank}, (_, i) => (places.has(i) ? 1 : rest.shift()))}];
      }
      case 'Squeeze': {
        const axes = this.axes(node);
        const places = new Set(axes?.map((n) => axis(a?.length, n)));
        return [{dtype, shape: a && axes && a.filter((n, i) => (axes.length ? !places.has(i) : n !== 1))}];
      }
      default:
    }
    if (node.op.startsWith('Reduce')) {
      const axes = this.axes(node);
      if (!a || !axes) return [{dtype}];
      if (!axes.length && attribute(node, 'noop_with_empty_axes')) return [{dtype, shape: a}];
      const places = new Set((axes.length ? axes : [...a.keys()]).map((n) => axis(a.length, n)));
      const keep = attribute(node, 'keepdims') ?? 1;
      return [{dtype, shape: a.map((n, i) => (places.has(i) ? (keep ? 1 : undefined) : n))
        .filter((n) => n !== undefined)}];
    }
    return [];
  }

  /** Nodes whose number of output elements depends on the values of inputs (GG004, GG026). */
  *valueShaped() {
    const varies = (name) => name && this.dependencies(name).size > 0;
    for (const node of this.nodes) {
      const operands = {Expand: [1], Reshape: [1], ConstantOfShape: [0], Range: [0, 1, 2], Tile: [1],
        Slice: [1, 2, 3, 4], Pad: [1], TopK: [1], Resize: [2, 3], OneHot: [1]}[node.op] ?? [];
      if (VALUE_SHAPED.has(node.op) ? node.inputs.some(varies)
        : operands.some((i) => varies(node.inputs[i]))) yield node;
    }
  }

  /** The lowest and highest value of a tensor, with the declared ranges of inputs. */
  range(name, ranges) {
    if (ranges.has(name)) return ranges.get(name);
    const constant = this.constant(name);
    if (constant?.length) return [Math.min(...constant), Math.max(...constant)];
    const node = this.producer.get(name);
    const [a, b] = (node?.inputs ?? []).slice(0, 2).map((input) => this.range(input, ranges));
    const pairs = (f) => {
      const values = a && b && [f(a[0], b[0]), f(a[0], b[1]), f(a[1], b[0]), f(a[1], b[1])];
      return values?.every((n) => !Number.isNaN(n)) ? [Math.min(...values), Math.max(...values)] : undefined;
    };
    switch (node?.op) {
      case 'Add': return pairs((x, y) => x + y);
      case 'Sub': return pairs((x, y) => x - y);
      case 'Mul': return pairs((x, y) => x * y);
      case 'Div': return b && b[0] * b[1] > 0 ? pairs((x, y) => x / y) : undefined;
      case 'Min': return pairs(Math.min);
      case 'Max': return pairs(Math.max);
      case 'Clip': {
        const [low, high] = [1, 2].map((i) => this.constant(node.inputs[i])?.[0]);
        return low === undefined || high === undefined ? a : [low, high];
      }
      case 'Neg': return a && [-a[1], -a[0]];
      case 'Floor': case 'Ceil': case 'Round': return a && [Math.floor(a[0]), Math.ceil(a[1])];
      case 'Sigmoid': return [0, 1];
      case 'Sin': case 'Cos': case 'Tanh': return [-1, 1];
      case 'ArgMax': case 'ArgMin': case 'Shape': case 'NonZero': return [0, 2 ** 31 - 1];
      case 'Cast': case 'Identity': case 'Reshape': case 'Squeeze': case 'Unsqueeze': case 'Flatten':
      case 'Concat': case 'Gather': case 'Expand': return a;
      default: return undefined;
    }
  }
}

/** All names that a node reads, those inside its subgraphs included. */
export function reads(node) {
  const inner = node.attributes.flatMap((entry) => [entry.g, ...entry.graphs]).filter(Boolean);
  return [...node.inputs.filter(Boolean),
    ...inner.flatMap((graph) => [...graph.nodes.flatMap(reads), ...graph.outputs.map((o) => o.name)])];
}

/** Whether shapes cannot be broadcast to one. */
function clash(shapes) {
  if (!shapes.every(Boolean)) return false;
  const rank = Math.max(0, ...shapes.map((shape) => shape.length));
  return Array.from({length: rank}, (_, i) => new Set(shapes.map((shape) => shape[shape.length - 1 - i])
    .filter((n) => n > 1 || n === 0))).some((sizes) => sizes.size > 1);
}

/** NumPy's broadcasting; undefined where a rank is unknown, null for a size that is. */
function broadcast(shapes) {
  if (!shapes.every(Boolean)) return undefined;
  const rank = Math.max(...shapes.map((shape) => shape.length));
  return Array.from({length: rank}, (_, i) => {
    const sizes = shapes.map((shape) => shape.at(i - rank)).filter((n, k) => shapes[k].length >= rank - i);
    return sizes.find((n) => n !== 1 && n !== null) ?? (sizes.includes(null) ? null : 1);
  });
}
