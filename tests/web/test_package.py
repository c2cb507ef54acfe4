"""The browser client as a package of npm: its files, its types, and pages that import it."""

import json
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gsgen.formats import write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from gsgen.runtime.web.pages import client_file, client_names
from support.browser import serving
from support.commands import ROOT
from support.web.packages import package
from web_client.package import pack

pytestmark = pytest.mark.slow

_PROJECT = Path(__file__).parents[1] / "support/web/frameworks"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, ort_folder: Path) -> Path:
    """Return a project with the packed client among its packages, and ONNX Runtime Web beside it."""
    packages = package("frameworks", needs_node=True) / "node_modules"
    gpu_types = package("types-0.1.74")
    package("typescript-5.9.3")
    folder = tmp_path_factory.mktemp("project")
    shutil.copytree(_PROJECT, folder, dirs_exist_ok=True)
    modules = folder / "node_modules"
    modules.mkdir()
    for path in packages.iterdir():
        (modules / path.name).symlink_to(path)
    (modules / "@webgpu").mkdir()
    (modules / "@webgpu/types").symlink_to(gpu_types)
    shutil.unpack_archive(pack(tmp_path_factory.mktemp("archive")), modules)
    (modules / "package").rename(modules / "gsgen")
    (modules / "gsgen/ort").mkdir()
    for name in ORT_FILES:
        (modules / "gsgen/ort" / name).symlink_to(ort_folder / name)
    return folder


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory, walking_person: bytes) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("knot") / "knot.spz"
    write_spz(path, torus_knot(300, degree=0))
    return {"/knot.spz": path.read_bytes(), "/walk.onnx": walking_person}


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, encoding="utf-8")


def test_the_package_has_the_files_and_the_version_of_the_wheel(installed: Path) -> None:
    folder = installed / "node_modules/gsgen"
    description = json.loads((folder / "package.json").read_text("utf-8"))
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    assert description["version"] == project["version"]
    assert description["license"] == project["license"]
    for name in client_names():
        assert (folder / name).read_bytes() == client_file(name), name
    entries = [
        path
        for entry in description["exports"].values()
        for path in (entry.values() if isinstance(entry, dict) else [entry])
    ]
    assert [path for path in entries if not (folder / path).is_file()] == []


@pytest.mark.parametrize("resolution", ["bundler", "nodenext"])
def test_typescript_knows_the_element(resolution: str, installed: Path) -> None:
    """Good uses pass, and each misuse is an error of its own line."""
    settings = {
        "compilerOptions": {
            "strict": True,
            "noEmit": True,
            "target": "esnext",
            "lib": ["esnext", "dom"],
            "module": "nodenext" if resolution == "nodenext" else "esnext",
            "moduleResolution": resolution,
            "types": [],
        },
        "files": ["consumer.ts", "misuse.ts"],
    }
    config = installed / f"tsconfig.{resolution}.json"
    config.write_text(json.dumps(settings), "utf-8")
    compiler = package("typescript-5.9.3") / "lib/tsc.js"
    result = run(installed, "node", str(compiler), "--project", str(config))
    lines = result.stdout.splitlines()
    errors = [line.split(",")[0] for line in lines if "error" in line]
    first = (installed / "misuse.ts").read_text("utf-8").splitlines().index("") + 3
    last = len((installed / "misuse.ts").read_text("utf-8").splitlines())
    assert errors == [f"misuse.ts({line}" for line in range(first, last + 1)], result.stdout


def test_a_server_imports_the_package(installed: Path) -> None:
    result = run(installed, "node", "server.js")
    assert result.stderr == ""
    html = '<gsgen-model src="knot.spz" camera-controls=""></gsgen-model>'
    assert json.loads(result.stdout) == [html, True, "function", True]


@pytest.fixture(scope="module")
def built(installed: Path, models: dict[str, bytes], browser: Any) -> Iterator[tuple[Any, str]]:
    """One build of three pages by Vite and one by webpack, served; and a page of the browser."""
    vite = package("frameworks") / "node_modules/vite/bin/vite.js"
    for command in ([str(vite), "build"], ["webpack.js"]):
        result = run(installed, "node", *command)
        assert result.returncode == 0, result.stderr
    contents = dict(models)
    for folder in (installed / "dist", installed / "packed"):
        for path in folder.rglob("*"):
            if path.is_file():
                contents[f"/{path.relative_to(folder).as_posix()}"] = path.read_bytes()
    assert any(path.endswith(".wasm") for path in contents)
    assert any(path.startswith("/assets/plans") for path in contents)
    html = (installed / "plain.html").read_bytes()
    contents["/packed.html"] = html.replace(b"./plain.js", b"./main.js")
    # The build of webpack asks for them beside the page.
    with serving({"ort": installed / "node_modules/gsgen/ort"}, contents) as address:
        context = browser.new_context(viewport={"width": 400, "height": 300})
        page = context.new_page()
        page.set_default_timeout(120_000)
        yield page, address
        context.close()


def _all_ready(page: Any) -> list[list[str]]:
    """Wait for the elements of a page, and return the errors of each."""
    return list(
        page.evaluate(
            """async () => {
              let elements = [];
              while (!elements.length || !elements.every(({ report }) => report)) {
                await new Promise((resolve) => setTimeout(resolve, 50));
                elements = [...document.querySelectorAll("gsgen-model")];
              }
              return elements.map(({ report }) => report.errors.map(({ message }) => message));
            }"""
        )
    )


@pytest.mark.parametrize("bundler", ["plain", "packed"])
def test_a_built_page_shows_splats_and_a_generator(bundler: str, built: tuple[Any, str]) -> None:
    """Read by the worker that Vite or webpack packed."""
    page, address = built
    page.goto(f"{address}/{bundler}.html")
    assert _all_ready(page) == [[], []]
    assert [worker.evaluate("modules.length") for worker in page.workers] == [8]
    assert page.evaluate("[loads, document.querySelector('gsgen-model').fieldOfView]") == [1, 30]


@pytest.mark.parametrize("framework", ["react", "svelte"])
def test_a_framework_sets_properties_and_hears_events(framework: str, built: tuple[Any, str]) -> None:  # fmt: skip
    page, address = built
    page.goto(f"{address}/{framework}.html")
    assert _all_ready(page) == [[]]
    properties = """(({ fieldOfView, cameraControls, autoplay, warnings }) =>
      [fieldOfView, cameraControls, autoplay, warnings, loads])(document.querySelector("gsgen-model"))"""
    assert page.evaluate(properties) == [70, True, False, [], 1]
    page.evaluate("narrow()")
    page.wait_for_function("document.querySelector('gsgen-model').orbit.fieldOfView === 30")


def test_an_import_map_needs_no_build(
    installed: Path, models: dict[str, bytes], browser: Any
) -> None:
    """With ONNX Runtime Web from its own package, by the guide's lines."""
    guide = (ROOT / "docs/guides/models-in-a-page.md").read_text("utf-8")
    [lines] = re.findall(r"```js\n(.*?)```", guide, re.DOTALL)
    imports = {
        "gsgen": "/node_modules/gsgen/gsgen.js",
        "onnxruntime-web/webgpu": f"/node_modules/gsgen/ort/{ORT_FILES[1]}",
    }
    contents = dict(models)
    contents["/page.html"] = f"""<!doctype html><meta charset=utf-8>
      <script type=importmap>{json.dumps({"imports": imports})}</script>
      <script type=module>{lines}</script>
      <gsgen-model src=/knot.spz loading=eager></gsgen-model>
      <gsgen-model src=/walk.onnx loading=eager></gsgen-model>""".encode()
    with serving({"node_modules": installed / "node_modules"}, contents) as address:
        context = browser.new_context(viewport={"width": 400, "height": 300})
        page = context.new_page()
        page.goto(f"{address}/page.html")
        assert _all_ready(page) == [[], []]
        context.close()
