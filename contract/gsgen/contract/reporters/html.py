"""HTML validation report: one file without scripts or links to other files.

Texts from a model are escaped, and the page's own policy forbids scripts and requests.
"""

__all__ = ["to_html"]

import base64
from collections.abc import Iterable, Sequence
from importlib.resources import files

from gsgen.contract._safe_text import for_html
from gsgen.contract.reporters.plots import histogram, number_line
from gsgen.contract.reporters.rule_pages import drop_url, help_url
from gsgen.contract.reporters.summary import plural, summary_line, verdict_line, verdict_word
from gsgen.contract.spec.units import format_bytes
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Entry, Outcome, Picture, Report, Unreadable

_SECURITY_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_EXPECTED_SEPARATOR = "; expected "


def to_html(entries: Sequence[Entry]) -> str:
    """Return all validation reports as one HTML page."""
    style = files("gsgen.contract.reporters").joinpath("report.css").read_text("utf-8")
    title = summary_line(entries) if len(entries) != 1 else entries[0].path
    sections = "\n".join(_report_section(entry, number) for number, entry in enumerate(entries, 1))
    index = _index_html(entries) if len(entries) > 1 else ""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_SECURITY_POLICY}">
<title>gsgen: {for_html(title)}</title>
<style>
{style}</style>
</head>
<body>
<header><h1>gsgen validate</h1><p>{for_html(summary_line(entries))}</p></header>
<main>
{index}{sections}
</main>
</body>
</html>"""


def _index_html(entries: Sequence[Entry]) -> str:
    items = "".join(
        f'<li><a href="#model-{number}">{for_html(entry.path)}</a> {_verdict(entry)}</li>'
        for number, entry in enumerate(entries, 1)
    )
    return f"<nav><ol>{items}</ol></nav>\n"


def _verdict(entry: Entry) -> str:
    if isinstance(entry, Unreadable):
        return '<span class="chip error">unreadable</span>'
    passes = entry.verdict == "conforms" and not entry.unchecked
    kind = "pass" if passes else "error"
    return f'<span class="chip {kind}">{for_html(verdict_word(entry))}</span>'


def _report_section(entry: Entry, number: int) -> str:
    head = f'<section id="model-{number}"><h2>{for_html(entry.path)} {_verdict(entry)}</h2>'
    if isinstance(entry, Unreadable):
        return f"{head}<pre>{for_html(str(entry.error))}</pre></section>"
    counted_findings = [finding for finding in entry.findings if finding.counts]
    remaining = [finding for finding in entry.findings if not finding.counts]
    parts = [
        head,
        f"<p>{for_html(verdict_line(entry))}</p>",
        _facts_html(entry),
        _picture(entry.picture),
        *(_unchecked_html(outcome) for outcome in entry.unchecked),
        *(_finding_html(finding, entry) for finding in counted_findings),
    ]
    if url := drop_url(entry.docs_url):
        parts.append(f'<p>See it in a browser: <a href="{for_html(url)}">drop the model</a>.</p>')
    if remaining:
        finding_cards = "".join(_finding_html(finding, entry) for finding in remaining)
        title = f"{plural(len(remaining), 'finding')} waived or known"
        parts.append(f"<details><summary>{title}</summary>{finding_cards}</details>")
    return "\n".join([*parts, _rules_table(entry), "</section>"])


def _facts_html(report: Report) -> str:
    size = format_bytes(report.size)
    if report.external_size:
        size += f" and {format_bytes(report.external_size)} external data"
    unrun_level_texts = [
        f"{level.level.word}: {level.reason}" for level in report.levels if not level.ran
    ]
    runs = [f"{level.level.word}: {level.runs}" for level in report.levels if level.runs]
    facts = {
        "kind": report.kind or "unknown",
        "name": report.name,
        "contract": report.contract,
        "capacity": f"{report.capacity:,} rows" if report.capacity else "",
        "size": size,
        "validated for": f"{report.target.label} at level {report.level.word}",
        "did not run": "; ".join(unrun_level_texts),
        "runs of the model": "; ".join(runs),
        "took": f"{report.seconds:.2f} s" if report.timed else "",
    }
    return _definition_list((name, for_html(value)) for name, value in facts.items() if value)


def _definition_list(items: Iterable[tuple[str, str]]) -> str:
    rows = "".join(f"<dt>{name}</dt><dd>{value}</dd>" for name, value in items)
    return f"<dl>{rows}</dl>"


def _picture(picture: Picture | None) -> str:
    if picture is None or not picture.png:
        problem = picture.problem if picture else "pictures were not asked for"
        return f'<p class="note">Not drawn: {for_html(problem)}.</p>'
    data, label = base64.b64encode(picture.png).decode(), for_html(picture.probe)
    image = f'<img alt="The model at probe {label}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>Probe {label}, drawn by gsgen.</figcaption></figure>"


def _unchecked_html(outcome: Outcome) -> str:
    name = for_html(f"{outcome.rule.id} {outcome.rule.slug}")
    reason = for_html(f"{outcome.status}: {outcome.reason}")
    severity_chip = '<span class="chip error">required</span>'
    return f"<article><h3>{severity_chip} {name}</h3><p>Not checked. {reason}</p></article>"


def _finding_html(finding: Finding, report: Report) -> str:
    actual, _, expected = finding.message.rpartition(_EXPECTED_SEPARATOR)
    rule = next(o.rule for o in report.outcomes if o.rule.id == finding.rule)
    url = help_url(rule, report.docs_url)
    name = for_html(f"{finding.rule} {finding.slug}")
    title = f'<a href="{for_html(url)}">{name}</a>' if url else name
    certainty_text = ", possible" if finding.certainty == "possible" else ""
    severity = finding.severity.word
    facts = [
        ("where", for_html(str(finding.where))),
        ("actual", for_html(actual or finding.message)),
        ("expected", for_html(expected)),
        ("why", for_html(rule.rationale)),
        ("hint", for_html(finding.hint)),
        ("waived", for_html(finding.waiver)),
    ]
    plots = [histogram(finding.distribution, str(finding.where)) if finding.distribution else ""]
    plots += [number_line(finding.statistic) if finding.statistic else ""]
    severity_chip = f'<span class="chip {severity}">{severity}{certainty_text}</span>'
    body = _definition_list((name, value) for name, value in facts if value)
    return f"<article><h3>{severity_chip} {title}</h3>{body}{''.join(plots)}</article>"


def _rules_table(report: Report) -> str:
    rows = "".join(
        f"<tr><td>{for_html(o.rule.id)}</td><td>{for_html(o.rule.slug)}</td>"
        f"<td>{for_html(o.status)}</td><td>{for_html(o.reason)}</td></tr>"
        for o in report.outcomes
    )
    head = "<tr><th>rule</th><th>name</th><th>status</th><th>reason</th></tr>"
    table = f'<div class="wide"><table>{head}{rows}</table></div>'
    return f"<details><summary>{plural(len(report.outcomes), 'rule')}</summary>{table}</details>"
