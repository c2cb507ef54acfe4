"""Finds banned phrases, such as relative clauses without a noun."""

__all__ = ["PHRASES", "Phrase", "phrases"]

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate

from house.prose import Passage, page_passages, python_passages, shader_passages, word_count
from house.repository import Repository
from house.violation import Measurement, Violation


@dataclass(frozen=True, slots=True)
class Phrase:
    """A banned pattern of prose, and the wording to use instead."""

    name: str
    pattern: str
    hint: str


_BE = r"(?:is|are|was|were)"

PHRASES = (
    # "None" is a value of Python, "none" a pronoun: the case tells them apart.
    Phrase("is none", rf"\b{_BE} none\b|\bnone {_BE}\b",
           "name the noun: 'is not valid', 'the list is empty'"),
    Phrase("is no X",
           rf"(?<!\b[Tt]here )\b{_BE} no (?!longer\b|more than\b|less than\b|later than\b)\w+",
           "say what it is not: 'is not a valid X', 'is not an X', 'has no X'"),
    # A question may begin so.
    Phrase("what is", rf"\b[Ww]hat {_BE}\b(?![^.\n]*\?)",
           "name the noun: 'the inputs that …', 'the reason', 'the missing rows'"),
    Phrase("what came of",
           r"\b[Ww]hat (?:came|comes|became|becomes|lies|stands|follows|belongs|goes|stays)\b",
           "name the noun: 'the result', 'the following lines', 'the remaining rows'"),
    Phrase("as told", r"\b[Aa]s (?:told|asked)\b", "'as configured', 'as requested'"),
    Phrase("whoever", r"\b[Ww]hoever\b", "name who: 'the caller', 'a user who'"),
    Phrase("whatever", r"\b[Ww]hatever\b", "'any', 'regardless of', 'all'"),
    Phrase("nobody", r"\b(?:[Nn]obody|[Ss]omebody|[Ee]verybody)\b",
           "name who or what: 'no caller', 'no other module'"),
    Phrase("anew", r"\b[Aa]new\b", "'again', or the verb with re-: 'recompute', 'rewrite'"),
    Phrase("lies beside", r"\b(?:lie|lies|lay|lying|stand|stands) beside\b",
           "'is in the same folder as', 'next to'"),
    Phrase("say whether", r"\b(?:[Ss]ays?|[Ss]aid|[Tt]ells?|[Tt]old) whether\b",
           "'return whether', 'check whether'"),
    Phrase("mend", r"\b[Mm]end(?:s|ed|ing)?\b", "'hint', 'fix', 'repair'"),
    Phrase("judge", r"\b(?:[Uu]n)?[Jj]udg(?:e|es|ed|ing)\b", "'check', 'evaluate', 'measure'"),
)  # fmt: skip
"""What is banned in docstrings, messages, comments and pages, each with the words to use."""

_COMPILED = [(phrase, re.compile(phrase.pattern)) for phrase in PHRASES]


def phrases(repository: Repository) -> Measurement:
    """Find banned phrases in the product's prose and in the pages of the documentation."""
    passages = list(_passages(repository))
    violations = [violation for passage in passages for violation in _violations(passage)]
    violations.sort(key=lambda violation: (violation.path, violation.line))
    return Measurement(violations, word_count(passages))


def _passages(repository: Repository) -> Iterator[Passage]:
    for file in repository.product:
        if repository.selects(file.path):
            yield from python_passages(file)
    for shader in repository.shaders:
        if repository.selects(shader.path):
            yield from shader_passages(shader)
    for page in repository.pages:
        if repository.selects(page.path):
            yield from page_passages(page)


def _violations(passage: Passage) -> Iterator[Violation]:
    words = list(re.finditer(r"\S+", passage.text))
    text = " ".join(word[0] for word in words)  # a phrase may go over the end of a line
    starts = list(accumulate((len(word[0]) + 1 for word in words), initial=0))
    for phrase, pattern in _COMPILED:
        for match in pattern.finditer(text):
            word = words[bisect_right(starts, match.start()) - 1]
            context = text[max(0, match.start() - 30) : match.end() + 30]
            yield Violation(
                path=passage.path,
                line=passage.line + passage.text.count("\n", 0, word.start()),
                subject=phrase.name,
                actual=f"“{match[0]}” in “… {context.strip()} …”",
                expected="a subject, a verb and the field's noun",
                hint=phrase.hint,
            )
