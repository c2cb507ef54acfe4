"""Pages tell what a file is in the words of Python."""

import base64
import json
import subprocess
from pathlib import Path

from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, archive_kind, content_kind
from support.foreign_files import FOREIGN_FILES
from support.web.packages import require_node

_MODULE = Path(__file__).parents[3] / "runtime/gsgen/runtime/web/client/file_kinds.js"
_SCRIPT = """
import { readFileSync } from "node:fs";
const { archiveKind, contentKind } = await import(process.argv[1]);
const { heads, archives } = JSON.parse(readFileSync(0, "utf-8"));
const words = (kind) => kind && [kind.name, kind.title, kind.hint];
const texts = heads.map((head) => Buffer.from(head, "base64").toString("latin1"));
const result = { heads: texts.map((text) => words(contentKind(text))), archives: archives.map((names) => words(archiveKind(names))) };
process.stdout.write(JSON.stringify(result));
"""
_TEXTS = (
    *("", "ünï wörld\nx", "1 2 3\n4 5 nan", "v 1 2 3\nf 1 2 3", "; FBX 7", "solid a\nfacet", "<svg>", "<a>"),
    *('{"a": 1', "[1]", '[{"img_name": "a", "rotation": []}]', '{"asset": {}, "root": {"a": ["b"]}}'),
    *('{"x\\u00e9": "y"}', '{"nodes": [], "meshes": []}', '{"asset": 1, "nodes": "KHR_gaussian_splatting"}'),
    *('{"detail": "no", "a": 5, "b": "c"}', "Namespace(a=1)", "<html><TITLE>\n Hi </title>", "\r\x85line"),
)  # fmt: skip
_PLY_HEADERS = (
    "element vertex 1\nproperty uint packed_position",
    "element vertex 1\nproperty float  f_dc_0 ",
    "element vertex 1\nproperty float f_offset_0",
    "element vertex 1\nelement face 2",
    "element vertex 1\nelement face 0",
    "element edge 1",
)
_ARCHIVES = (
    [],
    ["a/"],
    ["a/data.pkl", "a/constants.pkl"],
    ["x.npy", "y.npy"],
    ["a/tileset.json"],
    ["lod-meta.json"],
    ["b/meta.json", "b/a.WEBP"],
    ["a.usdc", "b.png"],
    ["[Content_Types].xml"],
    ["a", "b", "c.txt", ".d", "e."],
)


def test_a_file_is_called_in_a_page_what_python_calls_it() -> None:
    node = require_node()
    contents = [content for content, _ in FOREIGN_FILES.values()]
    contents += [f"ply\nformat ascii 1.0\n{text}\nend_header\n".encode() for text in _PLY_HEADERS]
    contents += [text.encode(encoding) for text in _TEXTS for encoding in ("utf-8", "utf-16")]
    # Damaged beginnings: each byte of the first ones changed.
    contents += [
        content[:place] + bytes([(content[place] + 77) % 256]) + content[place + 1 :]
        for content in list(contents)
        for place in range(0, min(len(content), 12), 3)
    ]
    heads = [content[:RECOGNITION_BYTES] for content in contents]
    request = {"heads": [base64.b64encode(head).decode() for head in heads], "archives": _ARCHIVES}
    command = [node, "--input-type=module", "--eval", _SCRIPT, str(_MODULE)]
    result = subprocess.run(
        command, input=json.dumps(request), capture_output=True, encoding="utf-8", check=True
    )
    answers = json.loads(result.stdout)
    for head, answer in zip(heads, answers["heads"], strict=True):
        kind = content_kind(head)
        assert answer == (kind and [kind.name, kind.title, kind.hint]), head[:80]
    for names, answer in zip(_ARCHIVES, answers["archives"], strict=True):
        kind = archive_kind(names)
        assert answer == [kind.name, kind.title, kind.hint], names
