"""The main thread of a page while a PLY file loads: its longest task, and its rest afterwards.

Tasks are told by CPU time, which does not depend on what else the machine does. Memory and the first
picture beside other engines are in ``bench_peers.py``; with ``GSGEN_PEERS="gsgen playcanvas"`` and
``-k 1m`` it measures the large file beside PlayCanvas alone.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gsgen.formats import write_ply
from gsgen.reference_plugins.writing.knot import torus_knot
from support.browser import GPU_FLAGS, launched, require_chromium, serving
from support.measures import print_figure
from support.web.pages import CLIENT

FILES = {"200k": (200_000, 3), "1m": (1_000_000, 0)}
TASK_BAR = 100  # CPU milliseconds
REST_BAR = 0.01  # CPU seconds a second
REST_SECONDS = 5
_CATEGORIES = ("devtools.timeline", "disabled-by-default-devtools.timeline", "v8.execute")
_DRAWN = "document.querySelector('gsgen-model')._shown.kernels.device.queue.onSubmittedWorkDone()"
_PAGE = b"""<!doctype html><meta charset=utf-8>
  <style>gsgen-model { width: 640px; height: 360px; aspect-ratio: auto }</style>
  <script type=module src=/client/gsgen.js></script>
  <gsgen-model src=/splats.ply></gsgen-model>"""


@dataclass(frozen=True, slots=True)
class Task:
    """A task of a page's main thread: CPU milliseconds, and the longest of each kind of part."""

    milliseconds: float
    parts: dict[str, float]


def longest_tasks(trace: bytes, address: str, count: int) -> list[Task]:
    """Return the longest tasks of the main thread of a page; Chromium has pages of its own, too."""
    events = json.loads(trace)["traceEvents"]
    requests = [event for event in events if event["name"] == "ResourceSendRequest"]
    pages = {event["pid"] for event in requests if address in event["args"]["data"]["url"]}
    mains = {
        (event["pid"], event["tid"])
        for event in events
        if event["name"] == "thread_name" and event["args"]["name"] == "CrRendererMain"
        if event["pid"] in pages
    }
    timed = [event for event in events if "tdur" in event and (event["pid"], event["tid"]) in mains]
    tasks = [event for event in timed if event["name"] == "RunTask"]
    results = []
    for task in sorted(tasks, key=lambda event: -event["tdur"])[:count]:
        parts: dict[str, float] = {}
        for event in timed:
            is_inner = task["ts"] <= event["ts"] < task["ts"] + task["dur"] and event is not task
            if is_inner and event["pid"] == task["pid"]:
                parts[event["name"]] = max(parts.get(event["name"], 0), event["tdur"] / 1000)
        results.append(Task(task["tdur"] / 1000, parts))
    return results


def cpu_of(session: Any) -> float:
    """Return the CPU seconds of all processes of a browser."""
    processes = session.send("SystemInfo.getProcessInfo")["processInfo"]
    return sum(float(process["cpuTime"]) for process in processes)


@pytest.mark.parametrize("file", FILES)
def bench_a_page_that_loads(file: str, tmp_path: Path) -> None:
    count, degree = FILES[file]
    path = tmp_path / "splats.ply"
    write_ply(path, torus_knot(count, degree=degree))
    contents = {"/page.html": _PAGE, "/splats.ply": path.read_bytes()}
    with (
        serving({"client": CLIENT}, contents) as address,
        launched(require_chromium(), GPU_FLAGS) as browser,
    ):
        page = browser.new_context(viewport={"width": 640, "height": 360}).new_page()
        page.set_default_timeout(600_000)
        browser.start_tracing(page=page, categories=list(_CATEGORIES))
        page.goto(f"{address}/page.html")
        page.wait_for_function("document.querySelector('gsgen-model').state === 'ready'")
        tasks = longest_tasks(browser.stop_tracing(), address, 3)
        session = browser.new_browser_cdp_session()
        page.evaluate(_DRAWN)
        page.wait_for_timeout(3000)
        start = cpu_of(session)
        page.wait_for_timeout(1000 * REST_SECONDS)
        rest = (cpu_of(session) - start) / REST_SECONDS
    for task in tasks:
        parts = sorted(task.parts.items(), key=lambda part: -part[1])[:4]
        words = ", ".join(f"{name} {milliseconds:.0f}" for name, milliseconds in parts)
        print_figure(f"{file}: a task of {task.milliseconds:.0f} CPU-ms: {words}")
    for what, figure, bar in (
        ("longest task, CPU-ms", tasks[0].milliseconds, TASK_BAR),
        ("at rest, CPU-s/s", rest, REST_BAR),
    ):
        print_figure(f"{file}: {what}: {figure:.3f}, bar {bar}{'' if figure <= bar else ' MISSED'}")
