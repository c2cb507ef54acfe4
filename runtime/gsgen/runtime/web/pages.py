"""Web pages that show models: one that a server delivers, and one in a single HTML file."""

__all__ = [
    "ModelView",
    "PageFile",
    "client_file",
    "client_names",
    "files_shown",
    "model_bytes",
    "scene_bytes",
    "served_page",
    "single_file_page",
]

import base64
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any, Final, final

from gsgen.contract._safe_text import for_html
from gsgen.contract.model.model_file import open_model
from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.spec.manifest_io import loads
from gsgen.formats import FormatError, PackedRows, PointCloud, Splats, open_splats, write_ply
from gsgen.formats.codecs import recognise_codec
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.runtime.errors import SceneUnreadable
from gsgen.runtime.sources.mesh_files import is_mesh
from gsgen.runtime.sources.scene_file import is_scene_file, read_scene
from gsgen.runtime.web.mesh_bytes import mesh_bytes
from gsgen.runtime.web.three_js import import_map, inlined_modules

_CLIENT_FOLDER: Final = files("gsgen.runtime.web").joinpath("client")
_MODULE_PREFIX: Final = "gsgen/"
_PAGE_FORMATS: Final = ("ply", "compressed-ply", "spz", "glb", "sog", "ksplat", "splat")
"""The formats that pages read, where all of a scene is in one file."""
_SOUND: Final = re.compile(
    rb"RIFF.{4}WAVE|ID3|\xff[\xe2\xe3\xf1-\xf3\xf9-\xfb]|fLaC|OggS|.{4}ftyp|\x1aE\xdf\xa3|(\xef\xbb\xbf)?WEBVTT",
    re.DOTALL,
)
"""The first bytes of recordings, and of captions."""
_HEAD_BYTES: Final = 12  # that tell a recording
_TEXT_START: Final = b"{"  # of a .gltf or meta.json, which name other files
_PAGE_STYLE: Final = """
body { margin: 0; background: #16181c; color: #e8eaed; font: 16px/1.5 system-ui, sans-serif }
main { display: grid; gap: 1rem; min-height: 100vh; box-sizing: border-box; padding: 1rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)) }
figure { margin: 0; display: grid; grid-template-rows: 1fr auto; gap: .3rem }
figcaption { color: #9aa0a6; font-size: .85rem }
gsgen-model, gsgen-scene { aspect-ratio: auto; min-height: 20rem; height: 100% }
"""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ModelView:
    """Settings of a web page that shows models, such as the background and the controls.

    Attributes:
        background: Red, green, blue from 0 to 1; None for black.
        fov: Vertical field of view, in degrees.
        up: The world's upward axis, such as ``-y``; None for the model's.
        time: Fixed time of generators; None plays it.
        play: Whether the time is played.
        images: Addresses of the pictures that generators are computed from.
        image_cameras: Address of a file of their cameras; empty without cameras.
    """

    background: tuple[float, float, float] | None = None
    fov: float | None = None
    up: str | None = None
    time: float | None = None
    play: bool = True
    images: tuple[str, ...] = ()
    image_cameras: str = ""

    def attributes(self) -> str:
        """Return the HTML attributes of the element ``gsgen-model`` for a page's view settings."""
        attribute_names = ["camera-controls", "loop", "file-drop"]
        if self.background is not None:
            attribute_names.append(
                f'background="{" ".join(f"{part:g}" for part in self.background)}"'
            )
        if self.images:
            attribute_names.append(f'images="{for_html(" ".join(self.images))}"')
        if self.image_cameras:
            attribute_names.append(f'image-cameras="{for_html(self.image_cameras)}"')
        if self.fov is not None:
            attribute_names.append(f'field-of-view="{self.fov:g}"')
        if self.up is not None:
            attribute_names.append(f'up="{for_html(self.up)}"')
        if self.time is not None:
            attribute_names.append(f'time="{self.time:g}"')
        elif self.play:
            attribute_names.append("autoplay")
        return " ".join(attribute_names)


@cache
def client_names() -> tuple[str, ...]:
    """Return the names of the browser client's files: ES modules and recorded GPU plans."""
    names = (file.name for file in _CLIENT_FOLDER.iterdir())
    return tuple(sorted(name for name in names if name.endswith((".js", ".json"))))


def client_file(name: str) -> bytes:
    """Return the bytes of a file of the browser client; see :func:`client_names`."""
    return _CLIENT_FOLDER.joinpath(name).read_bytes()


SplatReader = Callable[..., Splats | PointCloud | PackedRows]
"""Reads a file of splats, as ``open_splats`` of gsgen.formats or of gsgen.tiles does."""


def model_bytes(path: Path, read: SplatReader = open_splats) -> bytes:
    """Return a model file's bytes for a web page; splats that no page reads become a PLY.

    Raises:
        SceneUnreadable: The file cannot be read, or holds no splats that a page draws.
        ModelUnreadable: The file is called a model, and is something else.
    """
    try:
        if path.suffix.lower() == MODEL_SUFFIX:
            open_model(path)  # which names a file of another kind
            return path.read_bytes()
        if is_mesh(path):
            hint = 'Name it in "meshes" of a scene file, which pages draw.'
            message = "is a mesh, expected splats or a generator"
            raise SceneUnreadable(message, where=str(path), hint=hint)
        content = read(path, drop_invalid=True)
        raw = path.read_bytes() if path.is_file() else b""  # else a folder, or standard input
    except (OSError, FormatError) as error:
        raise SceneUnreadable(str(error)) from error
    codec = recognise_codec(BytesIO(raw)) if raw else None
    is_near = not isinstance(content, PackedRows) and content.origin == NO_ORIGIN
    is_whole = is_near and not raw.startswith(_TEXT_START)
    if codec is not None and codec.name in _PAGE_FORMATS and is_whole:
        return raw
    if not isinstance(content, Splats):
        hint = "A page shows splats, points and generators; draw others with gsgen view."
        raise SceneUnreadable("holds no splats", where=str(path), hint=hint)
    with temporary_folder() as folder:
        target = folder / "splats.ply"
        write_ply(target, replace(content, origin=NO_ORIGIN))
        return target.read_bytes()


@final
@dataclass(frozen=True, slots=True)
class PageFile:
    """A file that a page shows.

    Attributes:
        path: The file.
        is_mesh: Whether three.js reads it, as a mesh of a scene file.
        is_sound: Whether the browser reads it, as a recording or its captions.
    """

    path: Path
    is_mesh: bool = False
    is_sound: bool = False

    def content(self, read: SplatReader = open_splats) -> bytes:
        """Return the file's bytes for a web page; see :func:`model_bytes` and ``mesh_bytes``.

        Raises:
            SceneUnreadable: The file cannot be read, or holds nothing that a page shows.
        """
        if not self.is_sound:
            return mesh_bytes(self.path) if self.is_mesh else model_bytes(self.path, read)
        try:
            with open(self.path, "rb") as file:
                head = file.read(_HEAD_BYTES)
                if _SOUND.match(head):
                    return head + file.read()
        except (OSError, ValueError) as error:
            message = getattr(error, "strerror", None) or str(error)
            raise SceneUnreadable(message, where=str(self.path)) from error
        # Scene files of others may name any file: what no browser plays is not given to pages.
        message = (
            "is no sound, expected WAV, MP3, AAC, FLAC, Ogg, MP4 or WebM, and captions in WebVTT"
        )
        raise SceneUnreadable(message, where=str(self.path))


def files_shown(paths: Iterable[Path]) -> list[PageFile]:
    """Return the files that a page shows: those of scene files, and the others.

    Of a scene file first the models, then the meshes, the post-process models, and the sound.

    Raises:
        SceneUnreadable: A scene file cannot be read.
        GsgenError: A scene file is invalid.
    """
    shown: list[PageFile] = []
    for path in paths:
        if is_scene_file(path):
            scene = read_scene(path)
            shown += [PageFile(file) for model in scene.models for file in model.paths]
            shown += [PageFile(mesh.path, is_mesh=True) for mesh in scene.meshes]
            shown += [PageFile(post.path) for post in scene.posts]
            if scene.sound is not None:
                sound = filter(None, [scene.sound.path, scene.sound.captions])
                shown += [PageFile(file, is_sound=True) for file in sound]
        else:
            shown.append(PageFile(path))
    return shown


def scene_bytes(path: Path, addresses: Sequence[str]) -> bytes:
    """Return a scene file whose files have other addresses, one for each of ``files_shown``."""
    document = json.loads(path.read_text("utf-8"))
    remaining = iter(addresses)

    def moved(part: str | dict[str, Any]) -> dict[str, Any]:
        own = part if isinstance(part, dict) else {}
        if own.get("segments"):
            return {**own, "segments": [moved(segment) for segment in own["segments"]]}
        return {**own, "path": next(remaining)}

    for field in ("models", "meshes", "posts"):
        document[field] = [moved(part) for part in document.get(field) or []]
    for field in ("path", "captions"):
        if (document.get("sound") or {}).get(field):
            document["sound"][field] = next(remaining)
    return json.dumps(document).encode()


def served_page(models: Mapping[str, Path], view: ModelView, three: str | None = None) -> str:
    """Return the HTML page that shows the models at the given addresses of a server.

    ``three`` is the address of three.js's folder, with a slash at its end.
    """
    figures_html = [_figure_html(address, path, view) for address, path in models.items()]
    head = [] if three is None else [_import_map_html(import_map(three))]
    head.append(f'<script type="module" src="/gsgen/{_module_of(models.values())}"></script>')
    return _page_html([path.name for path in models.values()], head, figures_html, _RELOAD_SCRIPT)


_RELOAD_SCRIPT: Final = """
<script type="module">
let known = null;
for (;;) {
  const response = await fetch("/versions").catch(() => null);
  const versions = response?.ok ? await response.json() : null;
  for (const model of document.querySelectorAll("gsgen-model, gsgen-scene")) {
    const address = model.getAttribute("src").split("?")[0];
    const version = versions?.[address];
    if (known && version && version !== known[address]) model.setAttribute("src", `${address}?${version}`);
  }
  known = versions ?? known;
  await new Promise((resolve) => setTimeout(resolve, 1000));
}
</script>
"""


def single_file_page(
    paths: Iterable[Path],
    view: ModelView,
    ort: Path | None,
    read: SplatReader = open_splats,
    three: Path | None = None,
) -> str:
    """Return an HTML page that opens from disk: it embeds the models and the browser client.

    Args:
        paths: The models.
        view: How they are shown.
        ort: Folder of ONNX Runtime Web, for generators.
        read: Reads files of splats.
        three: Folder of three.js, for meshes, and for browsers without WebGPU.

    Raises:
        SceneUnreadable: A model cannot be read.
    """
    models = list(paths)
    modules = _inlined_modules() | ({} if three is None else inlined_modules(three))
    head = [_import_map_html(modules)]
    head.append(_inline_script("gsgen-plans", client_file("plans.json")))
    if ort is not None:
        # The build for all browsers: which one opens the page is not known.
        head.append(_inline_script("gsgen-ort", (ort / "ort.webgpu.bundle.min.mjs").read_bytes()))
        wasm = (ort / "ort-wasm-simd-threaded.asyncify.wasm").read_bytes()
        head.append(_inline_script("gsgen-ort-wasm", wasm))
    for i, path in enumerate(models):
        if not is_scene_file(path):
            head.append(_inline_script(f"model-{i}", model_bytes(path, read)))
            continue
        parts = {f"model-{i}-{k}": part for k, part in enumerate(files_shown([path]))}
        head += [_inline_script(name, part.content(read)) for name, part in parts.items()]
        head.append(_inline_script(f"model-{i}", scene_bytes(path, [f"#{name}" for name in parts])))
    figures_html = [_figure_html(f"#model-{i}", path, view) for i, path in enumerate(models)]
    start = f'<script type="module">import "gsgen/{_module_of(models)}";</script>'
    return _page_html([path.name for path in models], head, figures_html, start)


def _inlined_modules() -> dict[str, str]:
    """Return each ES module's text as a data URL, by the name under which it is imported."""
    modules = {}
    for name in client_names():
        if name.endswith(".js"):
            text = client_file(name).decode("utf-8")
            # A module without an address cannot import its neighbours by relative names.
            text = re.sub(r'(from |import\(|import )"\./', rf'\1"{_MODULE_PREFIX}', text)
            encoded = base64.b64encode(text.encode()).decode()
            modules[_MODULE_PREFIX + name] = f"data:text/javascript;base64,{encoded}"
    return modules


def _import_map_html(imports: Mapping[str, str]) -> str:
    return f'<script type="importmap">{json.dumps({"imports": imports})}</script>'


def _module_of(paths: Iterable[Path]) -> str:
    """Return the module of the client that defines the elements of a page."""
    return "scene.js" if any(map(is_scene_file, paths)) else "gsgen.js"


def _inline_script(identifier: str, content: bytes) -> str:
    text = base64.b64encode(content).decode()
    return f'<script type="text/plain" id="{identifier}">{text}</script>'


def _figure_html(address: str, path: Path, view: ModelView) -> str:
    name = for_html(path.name)
    caption = name
    if _takes_pictures(path):
        caption += f' <input type="file" accept="image/*" multiple aria-label="Pictures of {name}">'
    else:
        view = replace(view, images=(), image_cameras="")
    tag = "gsgen-scene" if is_scene_file(path) else "gsgen-model"
    return (
        f'<figure><{tag} src="{for_html(address)}" name="{name}" alt="{name}" '
        f"{view.attributes()}></{tag}><figcaption>{caption}</figcaption></figure>"
    )


def _takes_pictures(path: Path) -> bool:
    """Return whether a file is a generator that computes its Gaussians from pictures."""
    if path.suffix.lower() != MODEL_SUFFIX:
        return False
    text = open_model(path).manifest_text
    return text is not None and any(entry.role == "image" for entry in loads(text).inputs)


_PICTURES_SCRIPT: Final = """
<script type="module">
for (const input of document.querySelectorAll("figcaption input")) {
  const model = input.closest("figure").querySelector("gsgen-model");
  input.addEventListener("change", () => (model.pictures = [...input.files]));
}
</script>
"""


def _page_html(names: list[str], head: list[str], figures_html: list[str], end: str) -> str:
    title = for_html(", ".join(names))
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{title}</title>\n<style>{_PAGE_STYLE}</style>",
            *head,
            "<main>",
            *figures_html,
            "</main>",
            end,
            _PICTURES_SCRIPT if any("<input" in figure for figure in figures_html) else "",
            "</html>\n",
        ]
    )
