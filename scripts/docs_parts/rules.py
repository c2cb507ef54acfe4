"""Rules in tables, and the page of a rule."""

import re
from collections import defaultdict
from functools import cache
from pathlib import Path

from docs_parts.pages import bad_and_good, thresholds
from docs_parts.tables import table
from gsgen.contract.reporters.rule_pages import FAMILY_TITLES
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.tiles.validation.rules import all_rules


@cache
def ours() -> Registry:
    """Return the rules of this project, without those of installed third parties.

    Ids of third parties' rules begin with a name and a slash.
    """
    registry = all_rules()
    contract_rules = [rule for rule in registry.rules.values() if "/" not in rule.id]
    return Registry.from_rules(contract_rules, registry.backends.values())


def by_level() -> str:
    """Return a table of the number and the families of rules of each level."""
    rows = []
    for level in Level:
        level_rules = [rule for rule in ours().rules.values() if rule.level is level]
        families = list(dict.fromkeys(rule.family for rule in level_rules))
        rows.append((f"`{level.word}`", str(len(level_rules)), ", ".join(families) or "–"))
    return table(("level", "rules", "families"), rows)


_DOCS = Path(__file__).parents[2] / "docs"
_SIDES = "Left: a right scene. Right: the example that breaks the rule."
_FRAMES = "Four frames of each. Above: a right scene. Below: the example that breaks the rule."


@cache
def _statements() -> dict[str, list[str]]:
    """Return the links to the statements that each rule checks, from their table."""
    result = defaultdict(list)
    for line in (_DOCS / "spec" / "requirements.md").read_text("utf-8").splitlines():
        if statement := re.match(r"\| \[([A-Z][\d.]+)\]\((.+?)\) \|", line):
            for rule in re.findall(r"rules/(\w+)\.md", line):
                result[rule].append(f"[{statement[1]}](../spec/{statement[2]})")
    return result


def _picture(rule: Rule) -> str:
    """Return the part of a rule's page with its picture; empty without one."""
    pictures = sorted((_DOCS / "assets" / "rules").glob(f"{rule.id}*.png"))
    return "".join(
        "\n## Right and wrong\n\n"
        f"![a right scene, and one that breaks the rule](../assets/rules/{picture.name})\n\n"
        f"{_FRAMES if 'frames' in picture.stem else _SIDES}\n"
        for picture in pictures
    )


def page(rule: Rule) -> str:
    """Return the page of a rule: what must hold, bad and good code, why, the repair, and links."""
    target = rule.target or (f"targets with a limit {rule.limit}" if rule.limit else "every target")
    level = f"level [{rule.level.word}](../spec/levels.md)"
    kinds, statements = ", ".join(rule.kinds), " ".join(dict.fromkeys(_statements()[rule.id]))
    title = FAMILY_TITLES[rule.family]
    anchor = re.sub(r"[-\s]+", "-", f"{title}-{rule.family}".lower())
    family = f"[{title}](index.md#{anchor})"
    facts = [family, rule.severity.word, level, kinds, target, f"specified in {statements}"]
    needs = ", ".join(f"[{id}]({id}.md)" for id in rule.needs)
    ids = list(ours().rules)
    place = ids.index(rule.id)
    before, after = (f"[{id}]({id}.md)" for id in (ids[place - 1], ids[(place + 1) % len(ids)]))
    links = [f"{before} ← [all rules](index.md) → {after}"]
    links += [f"checked where these hold: {needs}"] if needs else []
    links += ["[Reading a report](../guides/reading-a-report.md)", "[Drop a model](../drop.md)"]
    parts = [
        f"# {rule.id} {rule.slug}\n\n{rule.statement}\n\n*{' · '.join(facts)}*\n",
        _picture(rule) or bad_and_good.section(rule.id),
        f"\n## Why\n\n{rule.rationale}\n\n## How to repair it\n\n{rule.hint}\n",
        f"\n## Evidence\n\n{rule.evidence}\n" if rule.evidence else "",
        thresholds.section(rule),
        f"\n---\n\n{' · '.join(links)}\n",
    ]
    return "".join(parts)
