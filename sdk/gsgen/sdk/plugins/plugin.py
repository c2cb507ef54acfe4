"""Plugins: each declares one published method, and converts its files to an ONNX generator.

A package registers an object of :class:`Plugin` under the entry point group ``gsgen.generators``.
If it needs an extra, the entry point names the extra in square brackets.
"""

__all__ = [
    "Demo", "Plugin", "Publication", "find_plugins", "installed_plugins", "words_of_plugins",
]  # fmt: skip

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gsgen.contract._entry_points import Extension, ExtensionUnusable, find_extensions

if TYPE_CHECKING:
    import numpy as np

    from gsgen.sdk.authoring.generator import GaussianGenerator
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.exporting.pipeline import GraphSource

_ENTRY_POINT_GROUP = "gsgen.generators"

# Returns the module or scene to export; called with the options that its signature declares.
Build = Callable[..., "GaussianGenerator | PostProcess | GraphSource"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Publication:
    """Paper, code and licence of a published method.

    Attributes:
        paper: Authors and year; empty if there is no paper.
        arxiv: Number of the paper at arxiv.org.
        code: Address of the method's own code.
        licence: Licence of that code. None of the code is used here.
    """

    paper: str = ""
    arxiv: str = ""
    code: str = ""
    licence: str = ""

    def describe(self) -> str:
        """Return paper, code and licence of a method in one line; empty without any."""
        arxiv = f"https://arxiv.org/abs/{self.arxiv}" if self.arxiv else ""
        paper = ", ".join(filter(None, (self.paper, arxiv)))
        code = ", ".join(filter(None, (self.code, self.licence)))
        return "; code: ".join(filter(None, (paper, code)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """A plugin's demo: synthetic files of the method, exported and rendered.

    Attributes:
        write: Writes the files into a folder, and returns the method's arguments for
            ``gsgen export``. Import torch inside. Image models take 240 × 240 pixels.
        caption: Says what differs from picture to picture.
        view: Where the camera is: ``orbit`` around a scene, ``recede`` from it, ``still`` before
            it, before a ``person``, around a ``head``, or to both sides of a picture (``swing``).
        degrade_image: For image models, makes the model's input from a drawn picture, both uint8
            [H, W, 3]. The picture itself is the input if this is absent.
        pictures: For generators of pictures, writes those that Gaussians are computed from into a
            folder, and returns their paths.
    """

    write: Callable[[Path], list[str]]
    caption: str
    view: Literal["orbit", "recede", "still", "person", "head", "swing"] = "orbit"
    degrade_image: "Callable[[np.ndarray], np.ndarray] | None" = None
    pictures: Callable[[Path], list[Path]] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Plugin:
    """The declaration of a method's plugin, with a function that builds or exports the model.

    Attributes:
        name: The word after ``gsgen export``.
        words: Other words that people type for it, separated by spaces. A word of one plugin
            alone exports by it; a word of several makes an error that names them.
        title: The method's own name; empty if it has none.
        summary: One sentence that says what the plugin exports.
        reads: The files it reads, for ``gsgen export --help``.
        inputs: The roles of the inputs of the exported models.
        publication: Paper, code and licence of the method.
        recognises: Returns True if a training run is certainly of this method. Called with the
            folder of the run and the folder of one iteration, which may be the same.
        demo: An example for the demo and the pictures of the documentation.
        command: The typer function behind ``gsgen export NAME``.
        build: Returns the generator. Its parameters, declared as typer does, become arguments
            and options of ``gsgen export NAME``; ``-o``, ``--dtype``, ``--capacity`` and the
            other options of every export are added. Import torch inside.

    Raises:
        TypeError: Both or neither of ``command`` and ``build`` are given.
    """

    name: str
    words: str = ""
    title: str = ""
    summary: str
    reads: str
    inputs: tuple[str, ...]
    publication: Publication = Publication()
    recognises: Callable[[Path, Path], bool] | None = None
    demo: Demo | None = None
    command: Callable[..., Any] | None = None
    build: Build | None = None

    def __post_init__(self) -> None:
        if (self.command is None) == (self.build is None):
            raise TypeError(
                f"plugin {self.name!r} has both or neither of command and build, expected exactly one"
            )

    @property
    def headline(self) -> str:
        """The summary of a plugin, followed by the method's name in parentheses."""
        return f"{self.summary.removesuffix('.')} ({self.title})." if self.title else self.summary


def find_plugins() -> dict[str, Extension]:
    """Return every registered plugin by name, even if its dependencies are missing."""
    return find_extensions(_ENTRY_POINT_GROUP)


def installed_plugins() -> Iterator[Plugin]:
    """Yield every registered plugin whose dependencies are installed."""
    for extension in find_plugins().values():
        with suppress(ExtensionUnusable):
            plugin = extension.load()
            if isinstance(plugin, Plugin):
                yield plugin


def words_of_plugins() -> dict[str, str]:
    """Return the words for every plugin that can be imported, by its name; it imports them all."""
    words = {}
    for name, extension in find_plugins().items():
        # The declaration is imported even where packages that the export needs are missing.
        module = extension.point.value.partition("[")[0].strip()
        bare_point = EntryPoint(name, module, _ENTRY_POINT_GROUP)
        with suppress(ExtensionUnusable):
            plugin = Extension(name, bare_point).load()
            if isinstance(plugin, Plugin):
                words[name] = plugin.words
    return words
