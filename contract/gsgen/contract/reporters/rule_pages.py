"""Renders the documentation of a rule from its declaration: page, list entry, JSON."""

__all__ = ["drop_url", "help_path", "help_url", "index", "page", "to_dict"]

from functools import cache
from importlib.metadata import metadata
from typing import Any

from gsgen.contract.validation.rule import Registry, Rule

FAMILY_TITLES = {
    "GM": "Manifest",
    "GI": "Inputs",
    "GO": "Outputs",
    "GG": "Graph",
    "GV": "Values",
    "GB": "Behaviour",
    "GL": "Limits",
    "GS": "Safety",
    "TV": "The Visionary viewer",
    "GW": "Waivers",
    "GT": "Tilesets",
    "GC": "Scene files",
}


def help_path(rule: Rule) -> str:
    """Return the path of a rule's documentation page; empty for third-party validation rules."""
    return "" if "/" in rule.id else f"rules/{rule.id}.md"


def help_url(rule: Rule, docs_url: str = "") -> str:
    """Return the web address of a rule's page; empty where no documentation is published.

    Args:
        rule: The rule.
        docs_url: Root of the documentation; by default, the one that the package names.
    """
    path = help_path(rule)
    return _page_url(path.removesuffix(".md"), docs_url) if path else ""


def drop_url(docs_url: str = "") -> str:
    """Return the web address of the page that shows dropped files; empty as of :func:`help_url`."""
    return _page_url("drop", docs_url)


def _page_url(path: str, docs_url: str) -> str:
    root = docs_url or _published_docs()
    return f"{root.rstrip('/')}/{path}/" if root else ""


@cache
def _published_docs() -> str:
    """Return the web address of the documentation, from the package's metadata."""
    for line in metadata("gsgen").get_all("Project-URL") or ():
        label, _, url = line.partition(",")
        if label.strip().lower() == "documentation":
            return str(url).strip()
    return ""


def page(rule: Rule, registry: Registry, example: str) -> str:
    """Return the Markdown documentation page of ``rule``; ``example`` is a model that breaks it."""
    rule_facts = [
        ("severity", rule.severity.word),
        ("level", rule.level.word),
        ("applies to", ", ".join(rule.kinds)),
        ("target", rule.target or (f"those with a limit {rule.limit}" if rule.limit else "all")),
        ("needs", ", ".join(f"{id} {registry.rules[id].slug}" for id in rule.needs)),
        ("example that breaks it", f"`{example}`" if example else ""),
    ]
    rule_fact_lines = "\n".join(f"- {name}: {value}" for name, value in rule_facts if value)
    text = (
        f"# {rule.id} {rule.slug}\n\n{rule.statement}\n\n{rule_fact_lines}\n\n"
        f"## Why\n\n{rule.rationale}\n\n## How to repair it\n\n{rule.hint}\n"
    )
    return f"{text}\n## Evidence\n\n{rule.evidence}\n" if rule.evidence else text


def index(registry: Registry) -> str:
    """Return the Markdown list of all rules, grouped by rule family."""
    lines = ["# Rules", "", f"{len(registry.rules)} rules, one page each.", ""]
    family = ""
    for rule in registry.rules.values():
        if rule.family != family:
            family = rule.family
            lines += ["", f"## {FAMILY_TITLES.get(family, family)} ({family})", ""]
            lines += ["| rule | severity | level | what must hold |", "|---|---|---|---|"]
        name = f"[{rule.id} {rule.slug}]({rule.id.replace('/', '-')}.md)"
        lines.append(f"| {name} | {rule.severity.word} | {rule.level.word} | {rule.statement} |")
    return "\n".join(lines) + "\n"


def to_dict(rule: Rule, example: str) -> dict[str, Any]:
    """Convert the declaration of ``rule`` to JSON types; ``example`` is a model that breaks it."""
    return {
        "id": rule.id,
        "slug": rule.slug,
        "severity": rule.severity.word,
        "level": rule.level.word,
        "statement": rule.statement,
        "why": rule.rationale,
        "hint": rule.hint,
        "fixture": example,
        "needs": list(rule.needs),
        "kinds": list(rule.kinds),
        "target": rule.target or None,
        "evidence": rule.evidence or None,
    }
