"""The element in pages whose policies forbid what it could do without."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gsgen.formats import write_spz
from gsgen.reference_plugins.writing.knot import torus_knot
from support.web.pages import WebSite

pytestmark = pytest.mark.slow

_STRICT = "default-src 'none'; script-src 'self'; connect-src 'self'"
_POLICIES = {
    # Headers of a page, and what it shows.
    "none": ({}, "knot.spz"),
    "strict": ({"Content-Security-Policy": _STRICT}, "knot.spz"),
    "no styles": ({"Content-Security-Policy": f"{_STRICT}; style-src 'none'"}, "knot.spz"),
    "trusted types": (
        {"Content-Security-Policy": f"{_STRICT}; require-trusted-types-for 'script'; trusted-types 'none'"},
        "knot.spz",
    ),
    "trusted types with the policy of the reader": (
        {"Content-Security-Policy": f"{_STRICT}; require-trusted-types-for 'script'; trusted-types gsgen"},
        "knot.spz",
    ),
    "a nonce": (
        {"Content-Security-Policy": "default-src 'none'; script-src 'nonce-abc' 'strict-dynamic'; connect-src 'self'"},
        "knot.spz",
    ),
    "a sandbox": ({"Content-Security-Policy": "sandbox allow-scripts"}, "knot.spz"),
    "a strict sandbox": (
        {"Content-Security-Policy": "sandbox allow-scripts; default-src 'none'; script-src HOST; connect-src HOST"},
        "knot.spz",
    ),
    "isolation": (
        {"Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp"},
        "knot.spz",
    ),
    "no referrer, no base": (
        {"Referrer-Policy": "no-referrer", "Content-Security-Policy": f"{_STRICT}; base-uri 'none'"},
        "knot.spz",
    ),
    "WebAssembly under strict rules": (
        {
            "Content-Security-Policy": "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; connect-src 'self';"
            " style-src 'none'; require-trusted-types-for 'script'; trusted-types 'none'"
        },
        "walk.onnx",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def policies(site: WebSite, tmp_path_factory: pytest.TempPathFactory, walking_person: bytes) -> Iterator[WebSite]:  # fmt: skip
    path: Path = tmp_path_factory.mktemp("knot") / "knot.spz"
    write_spz(path, torus_knot(300, degree=0))
    site.contents["/knot.spz"], site.contents["/walk.onnx"] = path.read_bytes(), walking_person
    yield site
    site.open()  # other tests expect the page without policies


def shown(site: WebSite, headers: dict[str, str], model: str) -> Any:
    """Open a page with a model, and return the element's state, its size, and its error."""
    site.contents["/policy.html"] = f"""<!doctype html><meta charset=utf-8>
      <script type=module src=/client/gsgen.js nonce=abc></script>
      <gsgen-model src={model} poster=/poster.png alt=Model loading=eager></gsgen-model>""".encode()
    site.headers["/policy.html"] = {
        name: value.replace("HOST", site.address) for name, value in headers.items()
    }
    site.open("/policy.html")
    return site.page.evaluate(
        """async () => {
          const element = document.querySelector("gsgen-model");
          while (!element.report) await new Promise((resolve) => setTimeout(resolve, 50));
          const canvas = element.shadowRoot.querySelector("canvas");
          const { width, height } = canvas.getBoundingClientRect();
          const [error = {}] = element.report.errors;
          return [element.state, getComputedStyle(canvas).position, width > 600 && height > 300, error.message, error.hint];
        }"""
    )


@pytest.mark.parametrize("name", _POLICIES)
def test_the_element_shows_its_model_under_a_policy(
    name: str, policies: WebSite, request: pytest.FixtureRequest
) -> None:
    headers, model = _POLICIES[name]
    if model.endswith(".onnx"):
        request.getfixturevalue("ort")
    result = shown(policies, headers, model)
    assert result == ["ready", "absolute", True, None, None]
    policy_errors = [error for error in policies.errors if "style" in error or "rusted" in error]
    if "trusted-types 'none'" in headers.get("Content-Security-Policy", ""):
        # Files are then read without a worker. There is no way to ask before.
        policy_errors = [
            error for error in policy_errors if "TrustedTypePolicy named 'gsgen'" not in error
        ]
    assert policy_errors == []


def test_a_page_without_webassembly_is_told_so(policies: WebSite, ort: None) -> None:
    """And not that its model is wrong."""
    state, _, _, message, hint = shown(policies, {"Content-Security-Policy": _STRICT}, "walk.onnx")
    assert state == "failed"
    assert message.startswith("this page may not run WebAssembly")
    assert "'wasm-unsafe-eval'" in hint


def test_a_policy_that_forbids_the_file_is_an_error_of_its_address(policies: WebSite) -> None:
    policy = "default-src 'none'; script-src 'self'; connect-src 'self'"
    state, _, _, message, hint = shown(
        policies, {"Content-Security-Policy": policy}, "http://127.0.0.2:9/knot.spz"
    )
    assert state == "failed"
    assert message.startswith("http://127.0.0.2:9/knot.spz: cannot be loaded")
    assert "CORS" in hint
