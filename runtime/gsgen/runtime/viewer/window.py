"""Windows: a viewer in whatever shows pictures and takes events, through rendercanvas."""

__all__ = ["attach", "open_window", "require_display", "take_drops", "view"]

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from gsgen.runtime.errors import DisplayUnavailable
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.viewer.viewer import Viewer

_EVENTS: Final = (
    "key_down",
    "key_up",
    "pointer_down",
    "pointer_move",
    "pointer_up",
    "double_click",
    "wheel",
    "resize",
)
_FASTEST: Final = 60.0  # pictures a second
_LARGEST: Final = (1920, 1080)  # pixels that a window begins with, whatever a camera says


def attach(viewer: Viewer, canvas: Any) -> Callable[[], Exception | None]:
    """Show a viewer on a canvas, and let it take the canvas's events.

    Args:
        viewer: What draws.
        canvas: A rendercanvas canvas, of any backend.

    Returns:
        What says why drawing came to an end, if something went wrong.
    """
    context = canvas.get_wgpu_context()
    ended: list[Exception] = []

    def draw() -> None:
        if viewer.closed or ended:
            canvas.close()
            return
        try:
            is_unfinished = viewer.draw(context)
        except (
            Exception
        ) as error:  # rendercanvas would log it, and ask for the next picture
            ended.append(error)
            canvas.request_draw()
            raise
        if is_unfinished or viewer.closed:
            canvas.request_draw()

    def take(event: dict[str, Any]) -> None:
        viewer.handle(event)
        canvas.request_draw()

    canvas.add_event_handler(take, *_EVENTS)
    canvas.request_draw(draw)
    return lambda: ended[0] if ended else None


def require_display() -> None:
    """Make sure that a window can be opened.

    Raises:
        DisplayUnavailable: There is no screen, or glfw or rendercanvas is not installed.
    """
    try:
        import glfw
        import rendercanvas  # noqa: F401
    except ImportError as error:
        raise DisplayUnavailable(
            f"a window needs {error.name}, which is not installed",
            hint="pip install 'gsgen[runtime]'",
        ) from error
    reasons: list[str] = []
    reporter: Any = glfw  # its stubs say of errors that they are str; they are bytes
    before = reporter.set_error_callback(
        lambda _, text: reasons.append(text.decode("utf-8", "replace"))
    )
    works = glfw.init()
    reporter.set_error_callback(before)
    if not works:
        raise DisplayUnavailable(": ".join(["no window can be opened here", *reasons[-1:]]))


def open_window(viewer: Viewer, title: str, size: tuple[int, int]) -> None:
    """Show a viewer in a window of its own, and return when it is closed.

    Args:
        viewer: What draws.
        title: Of the window.
        size: Width and height of what it shows, in pixels of the desktop.

    Raises:
        DisplayUnavailable: No window can be opened.
        GsgenError: What :meth:`Viewer.draw` raises.
    """
    require_display()
    from rendercanvas.glfw import GlfwRenderCanvas, loop

    shrink = min(1.0, _LARGEST[0] / size[0], _LARGEST[1] / size[1])
    width, height = (max(1, round(side * shrink)) for side in size)
    canvas = GlfwRenderCanvas(size=(width, height), title=title, max_fps=_FASTEST)
    failure = attach(viewer, canvas)
    take_drops(viewer, canvas)
    loop.run()
    if (error := failure()) is not None:
        raise error


def take_drops(viewer: Viewer, canvas: Any) -> None:
    """Let files be dropped on a window.

    rendercanvas 2.7 has no such event; the window that its glfw canvas holds does.
    """
    import glfw

    window = getattr(canvas, "_window", None)
    if window is None:
        return

    def dropped(_: Any, paths: Any, *__: Any) -> None:
        viewer.drop([Path(path) for path in paths])
        canvas.request_draw()

    glfw.set_drop_callback(window, dropped)


def view(
    scene: Scene | SplatData | str | Path | Sequence[str | Path],
    *,
    camera: str | None = None,
    size: tuple[int, int] = (960, 540),
    canvas: Any = None,
) -> Any:
    """Show a scene in a notebook, or in a window of your own event loop.

    In a notebook the canvas that is returned is a widget: leave it as the last line of a cell.
    In a script, run its loop: ``from rendercanvas.auto import loop; loop.run()``.

    Args:
        scene: A scene, Gaussians, or files as ``gsgen view`` takes them.
        camera: As ``gsgen view --camera``.
        size: Of the canvas, in pixels.
        canvas: A rendercanvas canvas; one that suits the surroundings where absent.

    Returns:
        The canvas.

    Raises:
        DisplayUnavailable: There is neither a notebook's widget nor a window to be had.
        GsgenError: A file cannot be read, or there is nothing to draw with.
    """
    from gsgen.runtime.playback.camera_options import viewpoint
    from gsgen.runtime.sources.scene_source import sources_of
    from gsgen.runtime.viewer.live_playback import LivePlayback

    window_canvas = canvas if canvas is not None else _canvas(size)
    stage = LivePlayback(sources_of(scene))
    viewer = Viewer(stage, viewpoint(camera, *size), say=lambda text: _print(text))
    attach(viewer, window_canvas)
    return window_canvas


def _canvas(size: tuple[int, int]) -> Any:
    try:
        from rendercanvas.auto import RenderCanvas
    except (ImportError, RuntimeError) as error:
        raise DisplayUnavailable(
            f"there is no canvas: {error}",
            hint="In a notebook: pip install anywidget. Elsewhere: pip install 'gsgen[runtime]'.",
        ) from error
    return RenderCanvas(size=size, title="gsgen", max_fps=_FASTEST)


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
