// How rules are declared and run: each names the rules that must hold before it is looked at.

/** What the targets of targets.md add (T6, T7). */
export const TARGETS = {
  core: {opset: [13, 26], ir: 13, severities: {}},
  webgpu: {opset: [13, 26], ir: 13, capture: true, binding: 2 ** 27, buffer: 2 ** 28, rows: 65535 * 256,
    split: 7, frame: 2 ** 26, severities: {GG003: 'error', GG016: 'error'}},
  visionary: {opset: [13, 22], ir: 10, capture: true, binding: 2 ** 27, buffer: 2 ** 28,
    rows: 65535 * 256, split: 7, concat: 7, frame: 2 ** 26,
    severities: {GG003: 'error', GG016: 'error', GO009: 'error', GM001: 'warning'}},
  gsgen: {opset: [13, 26], ir: 13, rows: 65535 * 256, severities: {}},
};

const GENERATOR = ['gaussian-generator'];
export const ALL = ['gaussian-generator', 'post-process', 'trajectory-predictor'];
const MANIFEST = ['GM001', 'GM002', 'GM003'];

/** A list of rules; `add` declares one.
 *
 * A rule of `kinds` needs a manifest that was read; one with `kinds: null` looks at the file alone.
 * `when` is asked with the target. `check` returns what is wrong, or nothing:
 * a text, or an object with it and the certainty of the finding (V14). */
export class Rules {
  constructor(level) {
    this.level = level;
    this.list = [];
  }

  add(id, severity, {kinds = GENERATOR, needs = [], when = () => true} = {}, check) {
    const before = kinds ? [...MANIFEST, ...needs] : needs;
    this.list.push({id, severity, level: this.level, kinds, needs: before, when, check});
  }

  /** Both lists as one, each rule behind those that it needs. */
  merged(other) {
    const all = new Rules(this.level);
    const waiting = [...this.list, ...other.list];
    while (waiting.length) {
      const open = new Set(waiting.map(({id}) => id));
      const next = waiting.findIndex(({needs}) => !needs.some((id) => open.has(id)));
      all.list.push(...waiting.splice(next, 1));
    }
    return all;
  }

  /** Check `subject`, and add to `report`: the findings, and the rules that do not hold. */
  async run(subject, report) {
    const target = TARGETS[subject.target];
    for (const rule of this.list) {
      if (!rule.when(target, subject.target)) continue;
      if (rule.needs.some((id) => report.blocked.has(id))) { // V18: one cause makes one finding
        report.blocked.add(rule.id);
        continue;
      }
      if (rule.kinds && !rule.kinds.includes(subject.manifest.kind)) continue;
      const problem = await rule.check(subject);
      if (!problem) continue;
      const {message = problem, certainty = 'confirmed'} = problem;
      report.blocked.add(rule.id);
      const severity = target.severities[rule.id] ?? rule.severity;
      report.findings.push({rule: rule.id, severity, certainty, message});
    }
  }
}
