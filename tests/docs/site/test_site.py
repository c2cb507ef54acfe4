"""The built site in a real browser: it fits a phone, and is readable, linked and searchable."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import urldefrag, urlsplit

import pytest

from support.browser import launched, require_chromium, serving
from support.commands import ROOT

pytestmark = pytest.mark.slow


PHONE, DESKTOP = (390, 844), (1440, 900)
LEAST_CONTRAST = 4.5  # of text, WCAG 2.1 AA
# What somebody of the field types, and a page that has to be among the first five found.
TERMS = {
    "spherical harmonics": "spec/layout",
    "quaternion": "guides/coordinate-systems-and-cameras",
    "covariance": "spec/layout",
    "opacity sigmoid": "rules/GV003",
    "graph capture": "guides/why-does-capture-fail",
    "COLMAP": "guides/coordinate-systems-and-cameras",
    "SPZ": "guides/splat-formats",
    "SMPL": "plugins/gauhuman",
    "3D Tiles": "spec/tilesets",
    "float16": "commands",
    "onnxruntime-gpu": "install",
    "checkpoint": "plugins",
    "panorama": "guides/coordinate-systems-and-cameras",
    "turntable": "quickstart",
    "level of detail": "guides/a-city-in-tiles",
    "FLAME": "plugins/gaussian-avatars",
    "anchors": "plugins/scaffold-gs",
    "hexplane": "plugins/hexplane-4dgs",
    "SARIF": "guides/validate-in-ci",
    "quads": "guides/how-the-renderer-works",
}

_EMPTY_INDEX = b'{"config": {"separator": " "}, "items": []}'
# Python's default of 700 spends an eighth of the build on looking for garbage.
_ZENSICAL = """import gc, runpy
gc.set_threshold(100_000)
runpy.run_module("zensical", run_name="__main__", alter_sys=True)"""
# Pages load in a frame that is not painted: pixels take time, and are not asked for.
_FRAME = b"""<!doctype html><body style="margin: 0"><iframe name="site" style="
  display: block; width: 100vw; height: 100vh; border: 0; visibility: hidden"></iframe>"""
_MEASURE = """() => {
  const article = document.querySelector('article');
  const all = [...article.querySelectorAll('*')];
  const scrolls = element => {
    for (let e = element.parentElement; e; e = e.parentElement)
      if (getComputedStyle(e).overflowX !== 'visible') return true;
    return false;
  };
  const channels = text => (text.match(/[\\d.]+/g) || []).map(Number);
  const linear = c => (c /= 255) <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const over = (front, back) => {
    const a = front.length > 3 ? front[3] : 1;
    return [0, 1, 2].map(i => a * front[i] + (1 - a) * back[i]);
  };
  const known = new Map([[null, [255, 255, 255]]]);
  const behind = element => {
    if (!known.has(element)) {
      const layer = channels(getComputedStyle(element).backgroundColor);
      known.set(element, over(layer, behind(element.parentElement)));
    }
    return known.get(element);
  };
  const contrast = element => {
    const back = behind(element);
    const front = over(channels(getComputedStyle(element).color), back);
    const [low, high] = [luminance(front), luminance(back)].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  };
  const written = all.filter(e => e.matches('p, li, td, th, h1, h2, h3, h4, a:not(.headerlink), code')
    && e.textContent.trim());
  return JSON.stringify({
    width: document.documentElement.scrollWidth,
    wide: all.filter(e => e.getBoundingClientRect().right > innerWidth + 1 && !scrolls(e))
      .slice(0, 3).map(e => e.outerHTML.slice(0, 120)),
    cut: all.filter(e => e.tagName === 'TABLE' && !e.closest('.highlighttable')).filter(table => {
      for (let e = table; e !== article; e = e.parentElement)
        if (e.scrollWidth > e.clientWidth + 3 && getComputedStyle(e).overflowX !== 'visible') return true;
      return false;
    }).map(table => table.textContent.trim().slice(0, 40)),
    roles: article.textContent.match(/:(attr|class|exc|func|meth|mod|obj):\\S*/g) || [],
    unlabelled: all.filter(e => e.tagName === 'IMG' && !e.alt).map(e => e.src),
    headings: all.filter(e => /^H[1-6]$/.test(e.tagName)).map(e => Number(e.tagName[1])),
    faint: written.map(e => [contrast(e), e.textContent.trim().slice(0, 40)])
      .filter(([value]) => !(value >= LEAST)).slice(0, 3),
    links: [...article.querySelectorAll('a[href], img[src]')].map(e => e.href || e.src),
    ids: [...document.querySelectorAll('[id]')].map(e => e.id),
  });
}""".replace("LEAST", str(LEAST_CONTRAST))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site, as ``make docs`` does, from a copy of its sources."""
    require_chromium()
    if find_spec("zensical") is None:
        pytest.skip("zensical is missing: pip install --group docs")
    folder = tmp_path_factory.mktemp("site")
    # Copies: a link to the configuration would be resolved, and build into the repository.
    shutil.copytree(ROOT / "docs", folder / "docs")
    shutil.copy(ROOT / "mkdocs.yml", folder)
    for name in ("contract", "sdk", "reference_plugins", "runtime", "scripts"):
        (folder / name).symlink_to(ROOT / name)
    command = [sys.executable, "-c", _ZENSICAL, "build", "--clean"]
    completed = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    assert completed.returncode == 0, completed.stdout + completed.stderr
    subprocess.run([sys.executable, ROOT / "scripts/name_files.py", folder / "site"], check=True)
    return folder / "site"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with launched(require_chromium(), ("--no-sandbox", "--disable-gpu")) as browser:
        yield browser


@pytest.fixture(scope="module")
def measured(site: Path, browser: Any) -> dict[str, dict[str, Any]]:
    """Return what the browser measured of every page; of the rules' pages, every tenth."""
    written = [path.relative_to(site) for path in site.rglob("index.html")]
    # Examples in HTML are copied as they are: no pages of the documentation.
    folders = sorted(
        path.parent.as_posix() for path in written if not (ROOT / "docs" / path).is_file()
    )
    rules = [name for name in folders if name.startswith("rules/")]
    names = [name for name in folders if name not in rules] + rules[::10]
    results = {}
    # Every page reads the index, a megabyte, in case that the reader searches.
    contents = {"/site/search.json": _EMPTY_INDEX, "/frame.html": _FRAME}
    with serving({"site": site}, contents) as address:
        page = browser.new_page()
        page.set_default_timeout(180_000)
        page.goto(f"{address}/frame.html")
        frame = page.frame("site")
        for number, name in enumerate(names):
            page.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
            frame.goto(f"{address}/site/{'' if name == '.' else f'{name}/'}")
            results[f"{name} at {PHONE[0]}"] = json.loads(frame.evaluate(_MEASURE))
            if number < 30:
                page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
                frame.evaluate("() => new Promise(requestAnimationFrame)")
                results[f"{name} at {DESKTOP[0]}"] = json.loads(frame.evaluate(_MEASURE))
        page.close()
    assert len(results) > 100
    return results


def offending(measured: dict[str, dict[str, Any]], key: str) -> dict[str, object]:
    return {name: page[key] for name, page in measured.items() if page[key]}


def test_no_page_is_wider_than_the_screen(measured: dict[str, dict[str, Any]]) -> None:
    widths = {name: page["width"] for name, page in measured.items()}
    assert {name for name, width in widths.items() if width > int(name.split()[-1])} == set()
    assert offending(measured, "wide") == {}


def test_no_table_is_cut(measured: dict[str, dict[str, Any]]) -> None:
    assert offending(measured, "cut") == {}


def test_no_role_of_a_docstring_is_raw(measured: dict[str, dict[str, Any]]) -> None:
    assert offending(measured, "roles") == {}


def test_every_picture_has_an_alt_text(measured: dict[str, dict[str, Any]]) -> None:
    assert offending(measured, "unlabelled") == {}


def test_headings_come_in_order(measured: dict[str, dict[str, Any]]) -> None:
    for name, page in measured.items():
        levels = page["headings"]
        assert levels[0] == 1, name
        assert levels.count(1) == 1, name
        assert [(a, b) for a, b in pairwise(levels) if b > a + 1] == [], name


def test_text_stands_out_from_its_background(measured: dict[str, dict[str, Any]]) -> None:
    assert offending(measured, "faint") == {}


def test_no_link_of_the_site_is_broken(measured: dict[str, dict[str, Any]], site: Path) -> None:
    anchors = {name.partition(" at ")[0]: set(page["ids"]) for name, page in measured.items()}
    broken = set()
    for name, page in measured.items():
        for link in page["links"]:
            address, anchor = urldefrag(link)
            parts = urlsplit(address)
            if parts.hostname != "127.0.0.1":
                continue
            target = site / parts.path.removeprefix("/site/")
            is_page = (target / "index.html").is_file()
            # `make docs` adds what scripts/write_live.py writes.
            is_added = parts.path.startswith("/site/live/")
            if not is_page and not is_added and not target.is_file():
                broken.add((name, link))
            known = anchors.get(target.relative_to(site).as_posix())
            if anchor and known is not None and anchor not in known:
                broken.add((name, link))
    assert broken == set()


def test_a_code_block_shows_the_name_of_its_file(site: Path) -> None:
    """As the comment in front of it gives it, which the browser does not show."""
    for page in (ROOT / "docs" / "guides").glob("*.md"):
        marked = re.findall(
            r"^<!-- (?:test|family|example|lgm): ([\w./-]+\.\w+) -->$",
            page.read_text("utf-8"),
            re.M,
        )
        html = (site / "guides" / page.stem / "index.html").read_text("utf-8")
        assert re.findall(r'<span class="filename">(.*?)</span>', html) == marked, page.stem


def test_the_search_finds_the_terms_of_the_field(site: Path, browser: Any) -> None:
    missed_terms = {}
    with serving({"site": site}, {}) as address:
        page = browser.new_page(viewport={"width": DESKTOP[0], "height": DESKTOP[1]})
        page.goto(f"{address}/site/")
        page.locator(".md-search__button").click()
        field = page.locator("input[role=combobox]")
        for term, expected in TERMS.items():
            field.fill("")
            field.fill(term)
            # Links carry the new term before the results of the last one are replaced.
            for _ in range(100):
                links = page.locator("a[role=option]").evaluate_all("all => all.map(a => a.href)")
                paths = [urlsplit(link).path.removeprefix("/site/").strip("/") for link in links]
                first = list(dict.fromkeys(paths))[:5]
                if expected in first:
                    break
                page.wait_for_timeout(100)
            else:
                missed_terms[term] = first
        page.close()
    assert missed_terms == {}
