"""How many hints mend a model that breaks one rule, followed by a mechanical reader.

    PYTHONPATH=tools:tests .venv/bin/python tests/bench/bench_hints_that_mend.py [SEED | all | NAME…]

Models are the example models and the mutations of manifest fields that break one rule; 60 of them
are drawn by a seed. The reader (``hint_reader``) does what the words of the first finding say;
models whose words it does not know are not read, and so not mended. With ``all``, every model is
followed, and what is not mended is counted by rule.

Two bars, both printed: 50 of 60 mended, and none made worse, which is an error that was not there.
"""

import json
import random
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import onnx
from hint_reader import Draft, mend, run_commands

from gsgen.conformance.fixtures import find, fixtures
from gsgen.conformance.fixtures.field_mutations import FIELD_MUTATIONS, mutated_model
from gsgen.contract.errors import GsgenError
from gsgen.contract.model.model_file import MANIFEST_KEY, NEUTRAL_KEY
from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.exporting.repair import repair

DRAWN, SEED, MIN_SHARE = 60, 42, 50 / 60
# Findings of one rule that are followed one after another, such as those of several nodes.
MAX_FINDINGS = 4


def broken_models(folder: Path) -> list[tuple[str, Path, Settings, Level]]:
    """Write all models that break one rule; return name, path, settings and level of each."""
    levels = {rule.id: min(rule.level, Level.BEHAVIOUR) for rule in builtin_rules()}
    models = []
    for fixture in fixtures():
        if fixture.rule and fixture.suffix == ".onnx" and fixture.level >= Level.BEHAVIOUR:
            path = fixture.write(folder)
            models.append((fixture.name, path, fixture.settings, levels[fixture.rule]))
    for mutation in FIELD_MUTATIONS:
        path = folder / f"{mutation.field}.onnx"
        mutated_model(mutation, find(mutation.base).draw()).write(path)
        settings = find(mutation.base).settings
        models.append((mutation.field, path, settings, levels[mutation.rule]))
    return models


def follow(path: Path, finding: Finding, settings: Settings) -> bool:
    """Do to a model what a finding says; return False if the reader does not know its words."""
    if "`gsgen fix MODEL -o" in finding.hint:
        try:
            repair(path, path.with_suffix(".mended.onnx"), settings=settings)
        except GsgenError:
            return False
        path.with_suffix(".mended.onnx").replace(path)
        return True
    if run_commands(path, finding.hint):
        return True
    model = onnx.load(path, load_external_data=False)
    entries = [entry for entry in model.metadata_props if entry.key in (MANIFEST_KEY, NEUTRAL_KEY)]
    try:
        manifest = json.loads(entries[0].value) if entries else {}
    except ValueError:
        return False
    draft = Draft(model, manifest, finding, path.parent)
    if not mend(draft):
        return False
    entries = [entry for entry in model.metadata_props if entry.key in (MANIFEST_KEY, NEUTRAL_KEY)]
    for entry in entries or [model.metadata_props.add(key=MANIFEST_KEY)]:
        entry.value = json.dumps(draft.manifest)
    path.write_bytes(model.SerializeToString())
    return True


def outcome_of(path: Path, settings: Settings, level: Level) -> tuple[str, str]:
    """Follow the findings of a model's first rule; return the outcome, and the first finding."""
    before = validate(path, replace(settings, level=level))
    if not before.findings:
        return "no finding", f"{path.stem} has none"
    first = finding = before.findings[0]
    words = f"{first.rule} {first.where}: {first.message} | {first.hint}"
    rules = {entry.rule for entry in before.findings}
    for _ in range(MAX_FINDINGS):
        if not follow(path, finding, settings):
            return ("not read" if finding is first else "not mended"), words
        after = validate(path, settings)
        new = [f for f in after.findings if f.rule not in rules and f.severity is Severity.ERROR]
        if new:
            return "worse", f"{words}\n    now {new[0].rule} {new[0].where}: {new[0].message}"
        same_rule = [entry for entry in after.findings if entry.rule == first.rule]
        if not same_rule:
            return "mended", words
        if same_rule[0] == finding:
            break
        finding = same_rule[0]
    return "not mended", words


def main() -> None:
    """Print what became of the models, and whether the bars hold."""
    counts: Counter[str] = Counter()
    unmended_rules: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        models = broken_models(Path(folder))
        names, seed = sys.argv[1:], SEED
        if not names or names[0].isdecimal():
            seed = int(names[0]) if names else SEED
            names = [model[0] for model in random.Random(seed).sample(models, DRAWN)]
        for name, path, settings, level in models:
            if name not in names and names != ["all"]:
                continue
            result, words = outcome_of(path, settings, level)
            counts[result] += 1
            if result != "mended":
                unmended_rules[words.split(" ")[0]] += 1
            print(f"{result}: {name}: {words}", flush=True)
    mended, total = counts["mended"], counts.total()
    source = f"the seed {seed}" if not sys.argv[2:] and total == DRAWN else "the names given"
    print(f"{dict(counts)}, of {source}; not mended by rule: {dict(unmended_rules.most_common())}")
    bars = {
        f"mended: {mended} of {total}, {mended / max(total, 1):.0%} (bar {MIN_SHARE:.0%})": (
            mended >= MIN_SHARE * total
        ),
        f"made worse: {counts['worse']} (bar 0)": not counts["worse"],
    }
    for words, is_met in bars.items():
        print(f"{'met' if is_met else 'missed'}: {words}")
    sys.exit(not all(bars.values()))


if __name__ == "__main__":
    main()
