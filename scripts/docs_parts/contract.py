"""Facts of the contract as tables: roles, layout, targets, configuration, probes."""

from typing import Any

import numpy as np

from docs_parts.rules import ours
from docs_parts.tables import code, table
from gsgen.conformance.fixtures.field_mutations import (
    FIELD_MUTATIONS,
    UNTESTED_FIELDS,
    manifest_fields,
)
from gsgen.contract.probing.probes import default_probes
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.fields.roles import ROLES, shapes_of
from gsgen.contract.spec.layout import APPEARANCE_CHANNELS, CELL_FIELDS, FIELDS, WORD_BYTES
from gsgen.contract.spec.manifest import (
    Bounds,
    GeneratorManifest,
    GeneratorOutputs,
    Input,
    Space,
    Tolerances,
)
from gsgen.contract.spec.reader_needs import READER_PROFILES
from gsgen.contract.spec.spherical_harmonics import degree_of
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings, config_schema

_TARGETS = ("core", "webgpu", "visionary", "gsgen")
_SIZES = {"float32": 4, "float16": 2}

# What a limit bounds, where the rule that asks for it does not say so.
_LIMITS = {
    "binding_bytes": "Bytes of one storage buffer binding.",
    "buffer_bytes": "Bytes of one buffer.",
    "workgroups": "Workgroups of one dispatch along an axis.",
    "workgroup_size": "Rows that one workgroup visits; times `workgroups`, the most rows.",
    "split_outputs": "Outputs of one Split.",
    "concat_inputs": "Inputs of one Concat; newer releases than the viewer's join any number.",
    "graph_capture": "1: kernels are recorded once and replayed, so what cannot be is reported.",
}


def roles(kind: str) -> str:
    """Return the roles that a kind of model may take."""
    rows = [
        (
            f"`{role.name}`",
            " or ".join(role.dtype),
            " or ".join(f"[{', '.join(map(str, shape))}]" for shape in shapes_of(role, kind)),
            "required" if role.needs_range else "optional",
            code(role.conventions) or "–",
            role.summary,
        )
        for role in ROLES.values()
        if kind in role.kinds
    ]
    return table(("role", "dtype", "shape", "`range`", "`convention`", "meaning"), rows)


def operator_profiles() -> str:
    """Return the operator profiles: operator sets and operators."""
    rows = [
        (
            f"`{profile.name}`",
            f"{profile.opset[0]} to {profile.opset[1]}",
            f"{profile.summary} {', '.join(sorted(profile.operators))}",
        )
        for profile in READER_PROFILES.values()
    ]
    return table(("profile", "operator sets", "operators"), rows)


def field_mutations() -> str:
    """Return every manifest field with a wrong value and the rule that notices, or the reason."""
    mutations = {mutation.field: mutation for mutation in FIELD_MUTATIONS}
    rows = []
    for name in manifest_fields():
        part, _, field = name.partition(".")
        label = f"`{part}.{field.rstrip('_')}`"
        if name in mutations:
            rule = mutations[name].rule
            rows.append((label, mutations[name].words, f"[{rule}](../rules/{rule}.md)"))
        else:
            rows.append((label, "–", f"no rule: {UNTESTED_FIELDS[name]}"))
    return table(("field", "wrong value", "noticed by"), rows)


def row(of: str = "gaussians") -> str:
    """Return the offset of each field of a packed row, of Gaussians or of cells."""
    rows = [
        (str(column), f"`{name}`", str(4 * column), str(2 * column))
        for column, name in enumerate(CELL_FIELDS if of == "cells" else FIELDS)
    ]
    sizes = [str(size * len(FIELDS)) for size in _SIZES.values()]
    head = ("column", "field", "byte in float32", "byte in float16")
    return table(head, [*rows, ("", "bytes a row", *sizes)])


def rows_of_color() -> str:
    """Return every appearance row: channels, bytes, and whether it is allowed."""
    rows = []
    for space, choices in APPEARANCE_CHANNELS.items():
        for channels in choices:
            degree = str(degree_of(channels // 3)) if space == "sh" else "–"
            cells = [f"`{space}`", degree, str(channels)]
            for size in _SIZES.values():
                whole = (channels * size) % WORD_BYTES == 0
                cells.append(f"{channels * size} B" if whole else "not allowed")
            rows.append(tuple(cells))
    return table(("`space`", "`degree`", "channels", "float32", "float16"), rows)


def targets() -> str:
    """Return the targets that come with gsgen."""
    known = [load_target(name) for name in _TARGETS]
    rows = [
        (
            f"`{target.name}`",
            target.version,
            f"{target.opset[0]} to {target.opset[1]}",
            f"up to {target.ir}",
            code(sorted(domain for domain in target.domains if domain)),
            target.summary,
        )
        for target in known
    ]
    head = ("target", "version", "operator set", "IR version", "domains", "what it is")
    return table(head, rows)


def limits() -> str:
    """Return the limits of each target."""
    known = [load_target(name) for name in _TARGETS]
    names = list(dict.fromkeys(name for target in known for name in target.limits))
    rows = []
    for name in names:
        asked_by = [rule for rule in ours().rules.values() if rule.limit == name]
        text = _LIMITS.get(name) or (asked_by[0].statement if asked_by else "–")
        values = [f"{target.limits[name]:,}" if name in target.limits else "–" for target in known]
        links = ", ".join(_link(rule.id) for rule in asked_by)
        rows.append((f"`{name}`", *values, f"{text} {links}".strip()))
    return table(("limit", *(f"`{target.name}`" for target in known), "meaning, and rule"), rows)


def severities() -> str:
    """Return a table of the severities that targets change, and of their own rules."""
    registry = ours()
    rows = []
    for name in _TARGETS:
        target = load_target(name)
        rule_ids = [rule.id for rule in registry.rules.values() if rule.target == name]
        changed = [
            f"{_link(id)} {registry.rules[id].severity.word} → {severity.word}"
            for id, severity in target.severities.items()
        ]
        links = ", ".join(_link(id) for id in rule_ids)
        rows.append((f"`{name}`", ", ".join(changed) or "–", links or "–"))
    return table(("target", "severities it changes", "rules of its own"), rows)


def _link(id: str) -> str:
    return f"[{id}](../rules/{id}.md)"


def config_keys() -> str:
    """Return the keys of ``[validate]`` in ``gsgen.toml``."""
    schema: Any = config_schema(ours())
    defaults = Settings()
    values = {
        "level": f'"{defaults.level.word}"',
        "target": f'"{defaults.target.name}"',
        "fail_on": f'"{defaults.fail_on.word}"',
        "ignore": "[]",
        "only": "[]",
        "require_rules": "[]",
        "docs_url": "–",
        "timeout": f"{defaults.limits.seconds:g}",
        "memory_mib": str(defaults.limits.memory >> 20),
        "strict": "false",
        "seed": str(defaults.seed),
    }
    section = schema["properties"]["validate"]["properties"]
    rows = [
        (f"`{key}`", _kind(entry), f"`{values[key]}`", entry["description"])
        for key, entry in section.items()
    ]
    return table(("key of `[validate]`", "type", "if absent", "meaning"), rows)


def waiver_keys() -> str:
    """Return the keys of a ``[[waive]]`` table in ``gsgen.toml``."""
    schema: Any = config_schema(ours())
    items = schema["properties"]["waive"]["items"]
    rows = [
        (
            f"`{key}`",
            _kind(entry),
            "required" if key in items["required"] else "–",
            entry["description"],
        )
        for key, entry in items["properties"].items()
    ]
    return table(("key of `[[waive]]`", "type", "if absent", "meaning"), rows)


def _kind(entry: dict[str, Any]) -> str:
    """Return the type of a key of ``gsgen.toml`` in words."""
    if "enum" in entry:
        return code(f'"{word}"' for word in entry["enum"])
    kind = {"array": "array of strings"}.get(entry["type"], entry["type"])
    kind = str(entry.get("format", kind))
    if "minimum" in entry:
        kind += f" ≥ {entry['minimum']}"
    if "exclusiveMinimum" in entry:
        kind += f" > {entry['exclusiveMinimum']}"
    return kind


def tolerances() -> str:
    """Return a table of the default tolerances."""
    rows = [(f"`{name}`", f"{value:g}") for name, value in to_json(Tolerances()).items()]
    return table(("field", "if absent"), rows)


def probes() -> str:
    """Return the probes of a model with a camera and time, for bounds of ±1."""
    entries = (
        Input(name="camera", role="view"),
        Input(name="proj", role="projection"),
        Input(name="eye", role="camera_position"),
        Input(name="viewport", role="viewport"),
        Input(name="time", role="time", range=(0.0, 1.0)),
    )
    manifest = GeneratorManifest(
        name="probed",
        inputs=entries,
        outputs=GeneratorOutputs(),
        space=Space(),
        bounds=Bounds((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
    )
    shapes = {"camera": (4, 4), "proj": (4, 4), "eye": (3,), "viewport": (2,), "time": (1,)}
    probe_list = default_probes(manifest, shapes, dict.fromkeys(shapes, "float32"))
    rows = []
    for probe in probe_list:
        eye, lens = probe.inputs["eye"], probe.inputs["proj"]
        fov = "–" if probe.zeros else f"{2 * np.degrees(np.arctan(1 / lens[0, 0])):.1f}°"
        width, height = probe.inputs["viewport"]
        position = " ".join(f"{value:.3f}" for value in eye.tolist())
        size, when = f"{width:g} × {height:g}", f"{probe.inputs['time'].item():.3f}"
        rows.append((f"`{probe.label}`", position, fov, size, when))
    head = ("label", "camera centre", "horizontal field of view", "viewport", "time")
    return table(head, rows)
