import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.html import to_html
from gsgen.contract.reporters.plots import histogram, number_line
from gsgen.contract.reporters.summary import plural
from gsgen.contract.reporters.text import render
from gsgen.contract.spec.severity import Level
from gsgen.contract.tools.pictures import with_picture
from gsgen.contract.validation.finding import Distribution, Location, Statistic
from gsgen.contract.validation.report import Picture, Unreadable
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.runtime.checks import probe_picture

PNG = b"\x89PNG\r\n\x1a\n"
VOID_ELEMENTS = {"meta", "img", "rect", "br"}


class Page(HTMLParser):
    """Elements, their attributes and texts; every element is closed in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.text = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID_ELEMENTS:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


def page(*entries):
    return Page(to_html(entries))


def test_a_page_is_one_file_without_scripts_and_requests(reports):
    text = to_html([*reports.values()])
    parsed = Page(text)
    assert not parsed.all("script")
    assert not parsed.all("link")
    sources = [a.get("src", "") for _, a in parsed.elements if "src" in a]
    assert all(source.startswith("data:") for source in sources)
    assert all(a["href"].startswith("#") for a in parsed.all("a"))
    assert "http://" not in text
    assert "https://" not in text


def test_a_finding_shows_where_actual_expected_and_hint(reports):
    report = reports["broken"]
    words = page(report).words
    for finding in report.findings:
        actual, _, expected = finding.message.rpartition("; expected ")
        for part in (f"{finding.rule} {finding.slug}", finding.where, actual, expected):
            assert " ".join(str(part).split()) in words
        assert finding.hint in words
    uncounted = sum(not finding.counts for finding in report.findings)
    assert f"{plural(uncounted, 'finding')} waived or known" in words


def test_texts_of_a_model_are_escaped(reports):
    (first, *others) = reports["broken"].findings
    injected_finding = replace(first, where=Location("output <script>alert(1)</script>\x1b[2J"))
    report = replace(
        reports["broken"], path='a"><b>.onnx', name="<i>", findings=(injected_finding, *others)
    )
    parsed = page(report)
    assert not parsed.all("script")
    assert not parsed.all("i")
    assert not parsed.all("b")
    assert r"output <script>alert(1)</script>\x1b[2J" in parsed.words


def test_an_unreadable_file_has_its_error(reports):
    error = ModelUnreadable("is empty", where="a.onnx", hint="Write it again.")
    parsed = page(reports["good"], Unreadable("a.onnx", error))
    assert "a.onnx: is empty Write it again." in parsed.words
    assert [a["href"] for a in parsed.all("a")] == ["#model-1", "#model-2"]


def test_a_rule_links_to_its_page_where_documentation_is_published(reports):
    report = replace(reports["broken"], docs_url="https://docs.example/en/")
    links = [a["href"] for a in page(report).all("a")]
    assert "https://docs.example/en/rules/GV003/" in links
    assert "https://docs.example/en/drop/" in links
    assert render(report)[-1].text == "see it in a browser: https://docs.example/en/drop/"


def test_a_picture_is_part_of_the_page_and_its_absence_has_a_reason(reports):
    drawn = replace(reports["good"], picture=Picture("time=0", PNG))
    (image,) = page(drawn).all("img")
    assert image["src"] == "data:image/png;base64,iVBORw0KGgo="
    assert image["alt"] == "The model at probe time=0"
    missing = replace(reports["good"], picture=Picture(problem="no adapter"))
    assert "Not drawn: no adapter." in page(missing).words
    assert "Not drawn" in page(reports["good"]).words


@pytest.mark.parametrize(
    ("name", "level", "problem"),
    [
        ("still_sh0", Level.STATIC, "the model did not run"),
        ("post_process", Level.STATIC, "only generators are drawn"),
        ("still_sh0", Level.VALUES, "wgpu is not installed pip install 'gsgen[runtime]'"),
    ],
)
def test_undrawable_probe_is_noted(monkeypatch, tmp_path, name, level, problem):
    monkeypatch.setattr(probe_picture, "find_spec", lambda _: None)
    settings = Settings(level=level)
    report = validate(find(name).write(tmp_path), settings)
    assert with_picture(report, settings, probe_picture.draw_probe).picture.problem.split() == (
        problem.split()
    )


def test_the_probe_of_a_finding_is_drawn(tmp_path):
    settings = Settings(level=Level.VALUES)
    report = validate(find("nan_late").write(tmp_path), settings)
    picture = with_picture(report, settings, probe_picture.draw_probe).picture
    assert picture.probe == "time=1"
    assert picture.png.startswith(PNG) or picture.problem


def test_a_histogram_has_a_bar_for_each_kind_of_row_in_a_bin():
    svg = histogram(Distribution(-1.0, 2.0, (3, 0, 1), (0, 0, 4)), "a <b>")
    assert re.findall(r'class="(\w+)"', svg) == ["valid", "valid", "invalid"]
    heights = [float(height) for height in re.findall(r'height="([0-9.]+)"/>', svg)]
    assert heights == pytest.approx([3 / 5 * 88, 1 / 5 * 88, 4 / 5 * 88], abs=0.06)
    assert "a &lt;b&gt;: 4 of 8 sampled rows break the rule" in svg
    assert ">-1</text>" in svg
    assert ">2</text>" in svg


@pytest.mark.parametrize(
    ("low", "high", "inside"), [(None, 1.0, False), (0.0, None, True), (1.0, 3.0, True)]
)
def test_a_number_stands_within_or_beside_its_limits(low, high, inside):
    svg = number_line(Statistic("mean degree", 2.04, low, high))
    edges = [
        tuple(map(float, pair))
        for pair in re.findall(r'x="([0-9.]+)" y="[0-9.]+" width="([0-9.]+)"', svg)
    ]
    (left, width), (marker_position, _) = edges
    assert (left <= marker_position + 1.5 <= left + width) is inside
    assert "mean degree: 2.04" in svg


def test_values_of_rows_become_a_distribution(tmp_path):
    report = validate(find("opacity_is_logits").write(tmp_path), Settings(level=Level.VALUES))
    (finding,) = report.findings
    assert sum(finding.distribution.invalid) == finding.count == 4
    assert sum(finding.distribution.valid) == finding.total - finding.count
    assert (finding.distribution.low, finding.distribution.high) == pytest.approx((-2.2, 5.02))
