"""Public names for authors of rules: declare a rule, report violations, add a backend.

A check receives one of :class:`InspectedModel`, :class:`ProbeRuns`, :class:`ModelOutputs`,
:class:`Rows`, :class:`DrawnSample`, :class:`Behaviour` or :class:`Review`, as its rule's scope
requires.
"""

__all__ = [
    "Behaviour",
    "Check",
    "Comparison",
    "DrawnSample",
    "InspectedModel",
    "Level",
    "LevelBackend",
    "LevelContext",
    "LevelUnavailable",
    "Location",
    "ModelOutputs",
    "ProbeRun",
    "ProbeRuns",
    "Registry",
    "Review",
    "Rows",
    "Rule",
    "Scope",
    "Severity",
    "Statistic",
    "Violation",
    "backends_in",
    "builtin_rules",
    "installed_rules",
    "rule",
    "rules_in",
]

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.probing.run_comparison import Behaviour, Comparison, ProbeRun, ProbeRuns
from gsgen.contract.rules.catalogue import builtin_rules, installed_rules
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Location, Statistic, Violation
from gsgen.contract.validation.level_backend import LevelBackend, LevelContext, LevelUnavailable
from gsgen.contract.validation.rule import Check, Registry, Rule, Scope, backends_in, rule, rules_in
from gsgen.contract.validation.waivers import Review
