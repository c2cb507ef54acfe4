"""How many hints mend a model that breaks one rule, followed by a mechanical reader.

    PYTHONPATH=tests .venv/bin/python tests/bench/bench_hints_that_mend.py

Models are the example models and the mutations of manifest fields that break one rule. The reader
(``hint_reader``) does what the words of the first finding say, or runs ``gsgen fix`` where they name
it; models whose words it does not know are counted, not read. Bars: 60 models read, five of six
mended, none worse: no error that was not there.
"""

import json
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import onnx
from hint_reader import Draft, mend

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

MIN_READ, MIN_SHARE = 60, 50 / 60


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
    if "`gsgen fix" in finding.hint:
        try:
            repair(path, path.with_suffix(".mended.onnx"), settings=settings)
        except GsgenError:
            return False
        path.with_suffix(".mended.onnx").replace(path)
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
    """Follow the first finding of a model; return what became of it, and what the finding was."""
    before = validate(path, replace(settings, level=level))
    if not before.findings:
        return "no finding", ""
    finding = before.findings[0]
    words = f"{finding.rule} {finding.where}: {finding.message} | {finding.hint}"
    if not follow(path, finding, settings):
        return "not read", words
    after = validate(path, settings)
    rules = {entry.rule for entry in before.findings}
    new = [f for f in after.findings if f.rule not in rules and f.severity is Severity.ERROR]
    if new:
        return "worse", f"{words}\n    now {new[0].rule} {new[0].where}: {new[0].message}"
    is_there = any(f.rule == finding.rule and f.where == finding.where for f in after.findings)
    return ("not mended" if is_there else "mended"), words


def main() -> None:
    """Print what became of the models, and whether the bars hold."""
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for name, path, settings, level in broken_models(Path(folder)):
            if sys.argv[1:] and name not in sys.argv[1:]:
                continue
            result, words = outcome_of(path, settings, level)
            counts[result] += 1
            if result != "mended":
                print(f"{result}: {name}: {words}")
    read = counts["mended"] + counts["not mended"] + counts["worse"]
    share = counts["mended"] / max(read, 1)
    print(f"{read} of {counts.total()} models read (bar {MIN_READ})")
    print(
        f"{counts['mended']} mended, {share:.0%} (bar {MIN_SHARE:.0%}), {counts['worse']} worse (bar 0)"
    )
    sys.exit(not (read >= MIN_READ and share >= MIN_SHARE and not counts["worse"]))


if __name__ == "__main__":
    main()
