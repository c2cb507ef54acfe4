"""Check the house rules that no standard tool knows: sizes, names, phrases, copies, whole shaders.

Prints a line for each rule with its figure and its bar, and the violations of those that fail.
Exits 1 if one fails.

    .venv/bin/python scripts/check_house.py [PATH…]
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CODE = ("contract", "sdk", "runtime", "reference_plugins", "tools", "scripts")
MOST_MODULES, MOST_FILE_LINES, MOST_FUNCTION_LINES, MOST_FIELDS = 15, 500, 80, 4
EXCEPTIONS = {  # check → files that it leaves out, each with a reason
    # One module for each group of rules that its models break; the groups are the contract's.
    "folders": ("contract/gsgen/conformance/fixtures/invalid/",),
    # An oracle that imported the kernels' numbers could not find a wrong one.
    "constants": ("runtime/gsgen/runtime/oracle/",),
    "fields": ("scripts/draw_data_flow.py",),  # a table of boxes, one a line
}

PUBLIC_MODULES = re.compile(
    r"gsgen(?:\.(?:conformance(?:\.fixtures)?|contract(?:\.(?:errors|layout|manifest|rule))?|formats"
    r"|reference_plugins\.(?:samples|synthetic)|runtime|sdk(?:\.(?:binding|inputs|math))?|tiles))?"
)
"""The modules that users import."""

PLACEHOLDERS = re.compile(
    "ones?|each|every|some|such|things?|stuff|its|theirs|ours|own|them|others|rest|more|what|why"
    "|which|how|there|here|at|places?|made|done|came|began|found|seen|saw|shown|looked|told|said"
    "|asked|named|wants?|wanted|given|taken|fed|put|kept|left|held|chosen|gone|lost|spent|plain|wide"
    "|lone|bare|bad|beside|again|away|still|mend"
)
"""Names that do not say which thing a variable holds."""

_BE = r"(?:is|are|was|were)"
PHRASES = re.compile(
    rf"\b{_BE} none\b|\bnone {_BE}\b"
    rf"|(?<!\b[Tt]here )\b{_BE} no (?!longer\b|more than\b|less than\b|later than\b)\w+"
    rf"|\b[Ww]hat {_BE}\b(?![^.\n]*\?)"
    r"|\b[Ww]hat (?:came|comes|became|becomes|lies|stands|follows|belongs|goes|stays)\b"
    r"|\b[Aa]s (?:told|asked)\b|\b[Ww]h(?:oever|atever)\b|\b(?:[Nn]o|[Ss]ome|[Ee]very)body\b"
    r"|\b[Aa]new\b|\b(?:lie|lies|lay|lying|stand|stands) beside\b"
    r"|\b(?:[Ss]ays?|[Ss]aid|[Tt]ells?|[Tt]old) whether\b|\b[Mm]end(?:s|ed|ing)?\b"
    r"|\b(?:[Uu]n)?[Jj]udg(?:e|es|ed|ing)\b"
)
"""Relative clauses without a noun, and words with a term of the field."""


DISTINCTIVE = re.compile(r"""-?0*\.?0*[1-9][\d.]{2,}|['"].{4,}['"]$|frozenset\(|\{.{8,}""")


@dataclass(frozen=True, slots=True)
class Source:
    """A file of the checkout; the syntax tree is empty for all but Python."""

    path: str
    text: str
    tree: ast.Module


Found = tuple[list[str], int]
"""Violations as ``path:line: text``, and the number of searched words or names."""


def read_sources(root: Path) -> list[Source]:
    """Return the Python files, shaders and pages of a checkout."""
    paths = [path for folder in CODE for path in (root / folder).rglob("*")]
    paths += [*root.glob("*.md"), *(root / "docs").rglob("*.md"), *(root / "docs").rglob("*.py")]
    sources = []
    for path in sorted(paths):
        if path.suffix in (".py", ".wgsl", ".md") and path.name != "CHANGELOG.md":
            text = path.read_text("utf-8")
            tree = ast.parse(text if path.suffix == ".py" else "")
            sources.append(Source(path.relative_to(root).as_posix(), text, tree))
    return sources


def crowded_folders(sources: list[Source]) -> Found:
    """Find folders of more than 15 modules."""
    modules: dict[str, int] = defaultdict(int)
    for source in sources:
        folder, _, name = source.path.rpartition("/")
        modules[folder] += name.endswith(".py") and name != "__init__.py"
    crowded = [f"{name}:0: {n} modules" for name, n in modules.items() if n > MOST_MODULES]
    return crowded, len(modules)


def long_code(sources: list[Source]) -> Found:
    """Find Python files of more than 500 lines, and functions of more than 80 below the docstring."""
    violations = []
    for source in sources:
        length = len(source.text.splitlines())
        if length > MOST_FILE_LINES and source.path.endswith(".py"):
            violations.append(f"{source.path}:{MOST_FILE_LINES}: {length} lines")
        for node in ast.walk(source.tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                first = node.body[:2][-1] if ast.get_docstring(node) else node.body[0]
                length = (node.end_lineno or 0) - first.lineno + 1
                if length > MOST_FUNCTION_LINES:
                    violations.append(f"{source.path}:{node.lineno}: {node.name}, {length} lines")
    return violations, 0


def placeholder_names(sources: list[Source]) -> Found:
    """Find variables and parameters with placeholder names, each once per file."""
    violations, total = [], 0
    for source in sources:
        lines: dict[str, int] = {}
        for node in ast.walk(source.tree):
            if isinstance(node, ast.arg):
                lines.setdefault(node.arg, node.lineno)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                lines.setdefault(node.id, node.lineno)
        total += len(lines)
        violations += [
            f"{source.path}:{line}: {name}"
            for name, line in lines.items()
            if PLACEHOLDERS.fullmatch(name.strip("_").rstrip("0123456789").lower())
        ]
    return violations, total


def positional_fields(sources: list[Source]) -> Found:
    """Find dataclasses of more than four fields that are not built by keyword."""
    violations = []
    for source in sources:
        for node in ast.walk(source.tree):
            if not isinstance(node, ast.ClassDef):
                continue
            decorators = " ".join(ast.unparse(entry) for entry in node.decorator_list)
            fields = [ast.unparse(part) for part in node.body if isinstance(part, ast.AnnAssign)]
            by_position = [f for f in fields if "kw_only=True" not in f and "init=False" not in f]
            has_keywords = "kw_only=True" in decorators or any("KW_ONLY" in f for f in fields)
            if "dataclass" in decorators and not has_keywords and len(by_position) > MOST_FIELDS:
                violations.append(f"{source.path}:{node.lineno}: {node.name} is not kw_only")
    return violations, 0


def copied_constants(sources: list[Source]) -> Found:
    """Find constants of one name and one value that several modules define."""
    homes: dict[tuple[str, str], list[str]] = defaultdict(list)
    for source in (source for source in sources if source.path.startswith(CODE)):
        for node in source.tree.body:
            name, _, value = ast.unparse(node).partition(" = ")
            name = name.partition(":")[0].strip("_")
            if re.fullmatch(r"[A-Z][A-Z0-9_]+", name) and DISTINCTIVE.match(value):
                homes[name, value].append(f"{source.path}:{node.lineno}: {name} = {value[:40]}")
    return [home for group in homes.values() if len(group) > 1 for home in group], len(homes)


def broken_shaders(sources: list[Source]) -> Found:
    """Find shaders that open what they do not close, or include a file inside a function."""
    violations = []
    shaders = [source for source in sources if source.path.endswith(".wgsl")]
    for source in shaders:
        depth = 0
        for number, line in enumerate(source.text.splitlines(), start=1):
            if depth and line.lstrip().startswith("//!include"):
                violations.append(f"{source.path}:{number}: an include inside a function")
            code = line.partition("//")[0]
            depth += code.count("{") - code.count("}")
        if depth:
            violations.append(f"{source.path}:{number}: {depth} brackets stay open")
    return violations, len(shaders)


def banned_phrases(sources: list[Source]) -> Found:
    """Find banned phrases in docstrings, messages, comments and pages."""
    violations, total = [], 0
    for source in sources:
        for line, text in _prose(source):
            plain_text = re.sub(r"(`+).+?\1", "…", text, flags=re.DOTALL)
            total += len(re.findall(r"[A-Za-z][A-Za-z'’-]*", plain_text))
            for match in PHRASES.finditer(re.sub(r"\s+", " ", plain_text)):
                violations.append(f"{source.path}:{line}: “{match[0]}”")
    return violations, total


def _prose(source: Source) -> Iterator[tuple[int, str]]:
    """Yield each string of two words and each comment, or the text of a page without code."""
    if source.path.startswith("docs/rules/"):
        return  # written from docstrings
    if source.path.endswith(".md"):
        text = re.sub(r"<!-- generated:.*?<!-- end generated -->", "", source.text, flags=re.DOTALL)
        yield 1, re.sub(r"^[ \t]*```.*?^[ \t]*```|\]\([^)]*\)", "", text, flags=re.M | re.DOTALL)
    elif source.path.endswith(".wgsl"):
        yield 1, "\n".join(re.findall(r"//(?!!)([^\n]*)", source.text))
    elif not source.path.startswith("docs/") and source.path != "scripts/check_house.py":
        for node in ast.walk(source.tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
                yield node.lineno, node.value
        yield 1, "\n".join(re.findall(r"(?:^|  )[ ]*# (.*)$", source.text, flags=re.M))


def private_imports(sources: list[Source]) -> Found:
    """Find code of the documentation that imports a module which is not public."""
    violations, total = [], 0
    for source in sources:
        blocks = re.findall(r"^[ \t]*```py.*?^[ \t]*```", source.text, flags=re.M | re.DOTALL)
        code = source.text if source.path.startswith("docs/examples/") else "\n".join(blocks)
        if source.path.startswith("docs/") or source.path == "README.md":
            modules = re.findall(
                r"^[ \t>.]*(?:from|import) (gsgen(?:\.[.\w]+)?)\b(?= )", code, flags=re.M
            )
            total += len(modules)
            violations += [
                f"{source.path}:0: {m}" for m in modules if not PUBLIC_MODULES.fullmatch(m)
            ]
    return violations, total


CHECKS: dict[str, tuple[Callable[[list[Source]], Found], float, int]] = {
    "folders": (crowded_folders, 0, 0),
    "lengths": (long_code, 0, 0),
    "placeholders": (placeholder_names, 1.0, 100),
    "fields": (positional_fields, 0, 0),
    "constants": (copied_constants, 0, 0),
    "shaders": (broken_shaders, 0, 0),
    "phrases": (banned_phrases, 3.0, 10_000),
    "imports": (private_imports, 0, 0),
}
"""Name → what finds violations, the largest figure, and per how many things; 0: their number."""


def run_checks(sources: list[Source], paths: Iterable[str] = ()) -> int:
    """Print the figures of all checks and the violations of failing ones; return the exit code."""
    failed = False
    for name, (find, bar, per) in CHECKS.items():
        selected = [s for s in sources if s.path.startswith(tuple(paths) or "")]
        violations, total = find(
            [s for s in selected if not s.path.startswith(EXCEPTIONS.get(name, ()))]
        )
        figure = len(violations) * per / max(total, 1) if per else len(violations)
        verdict = "pass" if figure <= bar else "FAIL"
        failed |= verdict == "FAIL"
        print(
            "".join(f"{name}: {line}\n" for line in violations) if verdict == "FAIL" else "", end=""
        )
        print(f"{verdict}  {name:14}{figure:8.2f}{f' in {per}' if per else ''}; bar {bar:g}")
    return int(failed)


if __name__ == "__main__":
    chosen = [Path(word).resolve().relative_to(ROOT).as_posix() for word in sys.argv[1:]]
    sys.exit(run_checks(read_sources(ROOT), chosen))
