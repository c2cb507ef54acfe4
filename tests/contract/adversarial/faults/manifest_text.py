"""Manifests that are not where a reader looks, or that are not JSON."""

import json
from collections.abc import Callable
from functools import partial
from typing import Any

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import static
from contract.adversarial.scenes import scene

FAMILY = "manifest"

Manifest = dict[str, Any]

KEY = Sentence("index.md", "A generator must carry it")
MODEL_LEVEL = Sentence("index.md", "Metadata of the graph, of nodes or of values does not count")
JSON_TEXT = Sentence("manifest.md", "The manifest is a JSON document (RFC 8259)")
FINITE = Sentence("manifest.md", "Numbers are finite; an integer may be written `3.0`.")
NO_REPEATS = Sentence("manifest.md", "Keys must not repeat within an object.")
SAME = Sentence("manifest.md", "`capacity` and `dtype` equal those of the graph.")


def _scene(kind: str = "surface") -> Draft:
    return static(scene(kind, seed=20))


def _text(write: Callable[[Manifest], str]) -> Draft:
    draft = _scene()
    assert isinstance(draft.manifest, dict)
    return Draft(draft.proto, write(draft.manifest))


def _elsewhere(store: Callable[[Any, str], None]) -> Draft:
    draft = _scene()
    store(draft.proto, json.dumps(draft.manifest))
    return Draft(draft.proto)


MISSING = (r"no manifest|manifest.{0,40}(missing|absent|lacks|under|key|found)|has no",)
PLACES: list[tuple[str, str, Callable[[Any, str], Any], Sentence, tuple[str, ...]]] = [
    ("manifest_forgotten", "Forgot the manifest.", lambda p, t: None, KEY, MISSING),
    (
        "manifest_in_graph_metadata",
        "Stored the manifest in the metadata of the graph.",
        lambda p, t: p.graph.metadata_props.add(key="gsgen.manifest", value=t),
        MODEL_LEVEL,
        (r"(metadata|properties) of the graph|graph('s)? metadata|model.level",),
    ),
    (
        "manifest_under_another_key",
        "Stored the manifest under the key `manifest`.",
        lambda p, t: p.metadata_props.add(key="manifest", value=t),
        KEY,
        (r"[^.]['`\"]manifest['`\"]",),
    ),
    (
        "manifest_key_in_capitals",
        "Stored the manifest under `GSGEN.Manifest`.",
        lambda p, t: p.metadata_props.add(key="GSGEN.Manifest", value=t),
        KEY,
        (r"(?-i:GSGEN\.Manifest)|capital|case",),
    ),
    (
        "manifest_as_doc_string",
        "Stored the manifest as the model's doc string.",
        lambda p, t: setattr(p, "doc_string", t),
        KEY,
        (r"doc.?string",),
    ),
]
for name, mistake, store, sentence, cause in PLACES:
    fault(
        name,
        FAMILY,
        mistake,
        *cause,
        build=partial(_elsewhere, store),
        sentence=sentence,
        level="static",
    )


def _stale_second() -> Draft:
    draft = _scene()
    assert isinstance(draft.manifest, dict)
    draft.proto.metadata_props.add(key="gsgen.manifest", value=json.dumps(draft.manifest))
    stale = json.loads(json.dumps(draft.manifest))
    stale["outputs"]["gaussians"]["capacity"] = 4096
    return Draft(draft.proto, stale)


fault(
    "manifest_stored_twice",
    FAMILY,
    "Appended the new manifest while an older one was there, and the older one holds.",
    r"twice|more than once|repeat|2 times|duplicate|last one",
    build=_stale_second,
    sentence=SAME,
    level="static",
    checker=False,
)

SYNTAX: list[tuple[str, str, Callable[[Manifest], str], Sentence, str]] = [
    (
        "manifest_is_python_text",
        "Stored str(manifest), with Python's quotes.",
        str,
        JSON_TEXT,
        r"json|quote",
    ),
    (
        "manifest_has_a_trailing_comma",
        "Wrote the JSON by hand with a comma too much.",
        lambda m: json.dumps(m)[:-1] + ",}",
        JSON_TEXT,
        r"json|comma",
    ),
    (
        "manifest_has_comments",
        "Left a comment in the JSON.",
        lambda m: "// exported\n" + json.dumps(m),
        JSON_TEXT,
        r"json|comment",
    ),
    (
        "manifest_encoded_twice",
        "Called json.dumps twice, so the document is one string.",
        lambda m: json.dumps(json.dumps(m)),
        JSON_TEXT,
        r"string|twice|object",
    ),
    (
        "manifest_has_a_byte_order_mark",
        "Read the manifest from a file with a byte order mark.",
        lambda m: "\ufeff" + json.dumps(m),
        JSON_TEXT,
        r"byte.?order|\bbom\b|json",
    ),
    (
        "manifest_has_nan",
        "json.dumps wrote NaN for a bound that was not measured.",
        lambda m: json.dumps(m).replace(str(m["bounds"]["min"][0]), "NaN", 1),
        FINITE,
        r"\bnan\b|finite",
    ),
    (
        "manifest_repeats_a_key",
        "Merged two exports by hand, so `name` stands there twice.",
        lambda m: json.dumps(m)[:-1] + ', "name": "other"}',
        NO_REPEATS,
        r"repeat|twice|duplicate",
    ),
    (
        "manifest_repeats_an_inner_key",
        "Wrote `capacity` twice within the output.",
        lambda m: json.dumps(m).replace('"capacity": 64', '"capacity": 32, "capacity": 64'),
        NO_REPEATS,
        r"repeat|twice|duplicate",
    ),
    ("manifest_is_empty", "Stored an empty string.", lambda m: "", JSON_TEXT, r"empty|json"),
]
for name, mistake, write, sentence, cause_words in SYNTAX:
    fault(
        name,
        FAMILY,
        mistake,
        cause_words,
        build=partial(_text, write),
        sentence=sentence,
        level="static",
    )
