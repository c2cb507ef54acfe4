"""The browser client: its size, what a first picture loads, and what 200 frames leave behind."""

import gzip
import time
from pathlib import Path

from gsgen.formats import write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.web.pages import ModelView, client_file, client_names
from gsgen.runtime.web.serving import ModelServer
from support.web import pages
from support.web.steady_frames import steady_frames

GAUSSIANS = 75_000  # of degree 3: one megabyte as SPZ
FRAMES = 200


def bench_the_first_picture_and_200_frames(tmp_path: Path) -> None:
    texts = {name: client_file(name) for name in client_names()}
    written = ("contract_rules.js",)
    scripts = b"".join(
        text for name, text in texts.items() if name.endswith(".js") and name not in written
    )
    print(f"\nclient: {scripts.count(10):,} lines, {len(gzip.compress(scripts)):,} bytes gzipped")
    print(f"rules: {len(gzip.compress(texts['contract_rules.js'])):,} bytes gzipped")
    print(f"plans: {len(gzip.compress(texts['plans.json'])):,} bytes gzipped")
    path = tmp_path / "knot.spz"
    write_spz(path, torus_knot(GAUSSIANS, degree=3))
    server = ModelServer([path], ModelView(), ort=None)
    with pages.chromium() as browser, pages.running(server) as address:
        page = browser.new_context(viewport={"width": 400, "height": 340}).new_page()
        page.set_default_timeout(600_000)
        sizes: list[int] = []
        page.on("response", lambda response: sizes.append(len(response.body())))
        start_time = time.perf_counter()
        page.goto(address)
        page.wait_for_function("document.querySelector('gsgen-model').report")
        seconds = time.perf_counter() - start_time
        print(f"scene of {path.stat().st_size:,} bytes: first picture after {seconds:.1f} s, "
              f"{len(sizes)} requests, {sum(sizes):,} bytes")  # fmt: skip
        result = steady_frames(page, FRAMES)
        print(f"{FRAMES} frames: made {result.made or 'nothing'}, {result.in_flight} in flight, "
              f"heap grew by {result.heap_growth:,} bytes")  # fmt: skip
    assert result.made == {}
    assert result.heap_growth < 1 << 20
