"""Conformance suites: named groups of rules, and the kinds of models that each group tests.

A rule belongs to the first suite that claims it among those that apply to the model, else to
``basic``. So every rule that can fail for a model is in exactly one suite, and ``gsgen validate`` accepts a
model that passes all its suites.
"""

__all__ = ["ALL_SUITES", "BASIC", "DeclaredFeatures", "Suite", "find_suite", "plan_suites"]

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from gsgen.contract.errors import UnknownName
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.roles import GENERATOR, POST_PROCESS, TRAJECTORY
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import Target
from gsgen.contract.validation.rule import Rule


@dataclass(frozen=True, slots=True)
class DeclaredFeatures:
    """The features that a manifest declares, which decide the conformance suites that apply.

    Attributes:
        kind: The kind of model; empty if the manifest cannot be read.
        roles: The roles of the inputs.
        supports_replay: Whether the model promises that its kernels can be recorded once and replayed.
    """

    kind: str
    roles: frozenset[str] = frozenset()
    supports_replay: bool = False

    @classmethod
    def from_model(cls, subject: InspectedModel) -> "DeclaredFeatures":
        """Return the features that the manifest (or the inferred manifest) of a model declares."""
        manifest = subject.manifest
        if manifest is None:
            return cls("")
        capture = getattr(manifest, "capture", None)  # a trajectory predictor has none
        roles = frozenset(entry.role for entry in manifest.inputs)
        return cls(manifest.kind, roles, bool(capture and capture.static_shapes))


@dataclass(frozen=True, slots=True)
class Suite:
    """A conformance suite: a named group of rules that are tested together.

    Attributes:
        name: The value of ``--suite``.
        summary: The subject of the suite, in one sentence.
        applies: Returns whether the suite tests a model with these facts.
        claims: Returns whether a rule is part of the suite.
    """

    name: str
    summary: str
    applies: Callable[[DeclaredFeatures], bool]
    claims: Callable[[Rule], bool]


def _is_manifest_kind(*kinds: str) -> Callable[[DeclaredFeatures], bool]:
    return lambda declared: declared.kind in kinds


def _roles_filter(*roles: str) -> Callable[[DeclaredFeatures], bool]:
    return lambda declared: declared.kind == GENERATOR and bool(declared.roles & {*roles})


def _rule_id_filter(*ids: str) -> Callable[[Rule], bool]:
    return lambda rule: rule.id in ids


def _is_tensor_rule(rule: Rule) -> bool:
    return rule.family in ("GI", "GO", "GV")


_CAPTURE_RULES = (
    *("GO004", "GG003", "GG026", "GG004", "GG005", "GG006", "GG007", "GG008", "GG009"),
    *("GG016", "GG017", "GG018"),
)

BASIC = Suite(
    "basic",
    "Rules for every model, and all rules that belong to no other suite.",
    lambda declared: True,
    lambda rule: True,
)
ALL_SUITES: tuple[Suite, ...] = (
    Suite(
        "camera",
        "Cameras have the declared form and the expected effect.",
        _roles_filter("view", "projection", "camera_position", "viewport"),
        _rule_id_filter(
            "GI001", "GI002", "GI007", "GI008", "GB007", "GB008", "GB030", "GB031", "GV059", "GV054"
        ),
    ),
    Suite(
        "time",
        "Time has the declared form, loops, and reaches every frame.",
        _roles_filter("time", "frame_index"),
        _rule_id_filter(
            *("GI003", "GM010", "GB004", "GB005", "GB006", "GB033", "GB034", "TV108", "GI025"),
            *("GB040", "GB073"),
        ),
    ),
    Suite(
        "avatar",
        "Poses and body shapes, at rest and at their extremes.",
        _roles_filter("pose", "shape", "expression", "root_translation", "root_rotation"),
        _rule_id_filter(
            "GI009", "GI010", "GB013", "GB035", "GB036", "GB041", "GB042", "GB043", "GB044"
        ),
    ),
    Suite(
        "appearance",
        "Colours have the declared layout and sensible values.",
        _is_manifest_kind(GENERATOR),
        _rule_id_filter(
            *("GM007", "GM008", "GO005", "GO006", "GO007", "GO009", "GV012", "GV013"),
            *("GV014", "GV022", "GV044", "GV045", "GV046", "GV047", "GV048", "TV102", "TV104"),
        ),
    ),
    Suite(
        "post-process", "Images in, images out.", _is_manifest_kind(POST_PROCESS), _is_tensor_rule
    ),
    Suite(
        "trajectory",
        "Camera states in, camera states with uncertainty out.",
        _is_manifest_kind(TRAJECTORY),
        _is_tensor_rule,
    ),
    Suite(
        "capture",
        "A runtime may record the kernels once and replay them.",
        lambda declared: declared.supports_replay,
        lambda rule: rule.id in _CAPTURE_RULES or rule.level == Level.LIVE,
    ),
    BASIC,
)


def find_suite(name: str, where: str = "--suite") -> Suite:
    """Return the conformance suite called ``name``.

    Raises:
        UnknownName: No suite has this name; the hint names the nearest.
    """
    by_name = {suite.name: suite for suite in ALL_SUITES}
    if name not in by_name:
        raise UnknownName.among("suite", name, by_name, where)
    return by_name[name]


def plan_suites(
    rules: Iterable[Rule], declared: DeclaredFeatures, target: Target
) -> dict[str, tuple[Rule, ...]]:
    """Return the conformance suites that apply to a model with their rules, ``basic`` first.

    Rules of other kinds of models, and of other targets, are left out: they cannot fail.
    """
    applicable_suites = [suite for suite in ALL_SUITES if suite.applies(declared)]
    rules_by_suite: dict[str, list[Rule]] = {
        suite.name: [] for suite in (BASIC, *applicable_suites)
    }
    for rule in rules:
        if _can_rule_apply(rule, declared.kind, target):
            suite = next(suite for suite in applicable_suites if suite.claims(rule))
            rules_by_suite[suite.name].append(rule)
    return {name: tuple(suite_rules) for name, suite_rules in rules_by_suite.items() if suite_rules}


def _can_rule_apply(rule: Rule, kind: str, target: Target) -> bool:
    if rule.target and rule.target != target.name:
        return False
    if rule.limit and rule.limit not in target.limits:
        return False
    return not kind or kind in rule.kinds
