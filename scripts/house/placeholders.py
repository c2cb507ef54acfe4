"""Finds placeholder names, which do not say what a variable holds."""

__all__ = ["WORDS", "placeholders", "placeholders_in_tests"]

from collections.abc import Iterable

from house.bindings import Binding, bindings
from house.repository import PythonFile, Repository
from house.violation import Measurement, Violation

_NOUN = "the noun of the element: entry, node, path, rule"
_RESULT = "the noun of the result: result, model, array, report"
_MATCHES = "matches, or the noun of what was searched for"
_MESSAGE = "message, text, reason, or the noun of the value"
_EXPECTED = "expected, requested, or the noun of what is requested"
_INPUTS = "inputs, options, arguments, or the noun of the value"
_RETAINED = "retained, or the noun of the elements that remain"
_INDEX = "index, offset, position, location"
_OWNER = "the noun with its owner: node_inputs, parent_shape"
_REMAINDER = "remaining, tail, remainder, or the noun of the elements"
_PARTICIPLE = "the participle with its noun: declared_inputs, selected_nodes"
_QUESTION = "the noun that answers the question: reason, rule_id, count"

WORDS: dict[str, str] = {
    # Pronouns and determiners stand for a noun that the reader does not have.
    "one": _NOUN, "ones": _NOUN, "each": _NOUN, "every": _NOUN, "some": _NOUN, "such": _NOUN,
    "thing": _NOUN, "things": _NOUN, "stuff": _NOUN,
    "its": _OWNER, "theirs": _OWNER, "ours": _OWNER, "own": _OWNER, "them": _OWNER,
    "other": _REMAINDER, "others": _REMAINDER, "rest": _REMAINDER, "more": _REMAINDER,
    "what": _MESSAGE, "why": "reason, cause", "which": _QUESTION, "how": _QUESTION,
    "there": _INDEX, "here": _INDEX, "at": _INDEX, "place": _INDEX, "places": _INDEX,
    # Participles say what happened to a thing, not which thing it is.
    "made": _RESULT, "done": _RESULT, "came": _RESULT, "began": "start, start_time",
    "found": _MATCHES, "seen": "visited, known_ids, or the noun of the elements",
    "saw": "actual", "shown": _PARTICIPLE, "looked": _PARTICIPLE,
    "told": _MESSAGE, "said": _MESSAGE, "asked": _EXPECTED, "named": _PARTICIPLE,
    "wanted": _EXPECTED, "want": "expected", "wants": _EXPECTED,
    "given": _INPUTS, "taken": _INPUTS, "fed": _INPUTS, "put": _PARTICIPLE,
    "kept": _RETAINED, "left": _RETAINED, "held": _RETAINED, "chosen": _PARTICIPLE,
    "gone": _PARTICIPLE, "lost": _PARTICIPLE, "spent": "elapsed, cost",
    # Adjectives and adverbs without their noun.
    "plain": "the noun with what distinguishes it: unencoded, base_values, text",
    "wide": "the noun: width, wide_nodes, float64_values",
    "lone": "single_entry, or the noun", "bare": "the noun with what it lacks",
    "bad": "invalid, or the noun with `invalid_`", "beside": "sibling, neighbour",
    "again": "repeat, second_run", "away": "distance, direction, or the noun",
    "still": "is_static, unchanged, or the noun",
    # Words that were replaced by the field's term.
    "mend": "hint",
}  # fmt: skip
"""Names that say nothing about what is bound, with what stands in their stead."""

_PROTOCOL = {"other"}  # the data model's own name for the second operand
_SIDES = {"right", "top", "bottom"}  # beside one of these, left is a side


def placeholders(repository: Repository) -> Measurement:
    """Find placeholder names in the product's code and in the scripts."""
    return _measure(file for file in repository.selected if file.root not in ("tests", "docs"))


def placeholders_in_tests(repository: Repository) -> Measurement:
    """Find placeholder names in the tests."""
    return _measure(file for file in repository.selected if file.root == "tests")


def _measure(files: Iterable[PythonFile]) -> Measurement:
    violations: list[Violation] = []
    total = 0
    for file in files:
        names = list(bindings(file.tree))
        total += len(names)
        sides = {name.scope for name in names if _word(name) in _SIDES}
        violations += [
            _violation(file, name)
            for name in names
            if _is_placeholder(name) and not (name.scope in sides and _word(name) == "left")
        ]
    violations.sort(key=lambda violation: (violation.path, violation.line))
    return Measurement(violations, total)


def _is_placeholder(binding: Binding) -> bool:
    word = _word(binding)
    function = binding.scope.rpartition(".")[2]
    if word in _PROTOCOL and binding.kind == "parameter" and function.startswith("__"):
        return False
    return word in WORDS


def _word(binding: Binding) -> str:
    """Return a name without underscores, digits and case."""
    return binding.name.strip("_").rstrip("0123456789").lower()


def _violation(file: PythonFile, binding: Binding) -> Violation:
    scope = binding.scope or "the module"
    return Violation(
        path=file.path,
        line=binding.line,
        subject=binding.name,
        actual=f"{binding.kind} {binding.name!r} of {scope}",
        expected="a name after the thing it holds",
        hint=WORDS[_word(binding)],
    )
