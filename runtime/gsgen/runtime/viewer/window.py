"""Shows a viewer on a rendercanvas canvas, in a window or a notebook."""

__all__ = ["accept_dropped_files", "attach", "open_window", "require_display", "view"]

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from gsgen.runtime.errors import DisplayUnavailable
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.stream_settings import StreamOpener
from gsgen.runtime.viewer.viewer import Event, Viewer

if TYPE_CHECKING:
    from rendercanvas import BaseRenderCanvas

_EVENT_NAMES: Final = (
    "key_down",
    "key_up",
    "pointer_down",
    "pointer_move",
    "pointer_up",
    "double_click",
    "wheel",
    "resize",
)
_MAX_FPS: Final = 60.0
_MAX_SIZE: Final = (1920, 1080)  # pixels of a new window; larger cameras are scaled


def attach(
    viewer: Viewer, canvas: "BaseRenderCanvas", after_draw: Callable[[], None] = lambda: None
) -> Callable[[], Exception | None]:
    """Show a viewer on a rendercanvas canvas, and pass the canvas's events to the viewer.

    Args:
        viewer: The viewer.
        canvas: A window, a widget or an offscreen canvas.
        after_draw: Called after each picture.

    Returns:
        A function that returns the error that ended drawing, or None.
    """
    context = canvas.get_wgpu_context()
    errors: list[Exception] = []

    def draw() -> None:
        if viewer.closed or errors:
            canvas.close()
            return
        try:
            needs_another_frame = viewer.draw(context)
        except Exception as error:  # else rendercanvas logs it, and goes on drawing
            errors.append(error)
            canvas.request_draw()
            raise
        after_draw()
        if needs_another_frame or viewer.closed:
            canvas.request_draw()

    def handle(event: Event) -> None:
        viewer.handle(event)
        canvas.request_draw()

    canvas.add_event_handler(handle, *_EVENT_NAMES)
    canvas.request_draw(draw)
    return lambda: errors[0] if errors else None


def require_display() -> None:
    """Raise if no window can be opened on this machine."""
    try:
        import glfw
        import rendercanvas  # noqa: F401
    except ImportError as error:
        raise DisplayUnavailable(
            f"a window needs {error.name}, which is not installed",
            hint="pip install 'gsgen[runtime]'",
        ) from error
    reasons: list[str] = []
    reporter: Any = glfw  # its stubs declare error texts as str; they are bytes
    before = reporter.set_error_callback(
        lambda _, text: reasons.append(text.decode("utf-8", "replace"))
    )
    is_initialised = glfw.init()
    reporter.set_error_callback(before)
    if not is_initialised:
        raise DisplayUnavailable(": ".join(["no window can be opened", *reasons[-1:]]))


def open_window(
    viewer: Viewer, title: str, size: tuple[int, int], after_draw: Callable[[], None] = lambda: None
) -> None:
    """Show a viewer in a new window of ``size`` desktop pixels, until it is closed."""
    require_display()
    from rendercanvas.glfw import GlfwRenderCanvas, loop

    scale = min(1.0, _MAX_SIZE[0] / size[0], _MAX_SIZE[1] / size[1])
    width, height = (max(1, round(side * scale)) for side in size)
    canvas = GlfwRenderCanvas(size=(width, height), title=title, max_fps=_MAX_FPS)
    open_error = attach(viewer, canvas, after_draw)
    accept_dropped_files(viewer, canvas)
    loop.run()
    if (error := open_error()) is not None:
        raise error


def accept_dropped_files(viewer: Viewer, canvas: "BaseRenderCanvas") -> None:
    """Open files that are dropped on a viewer's window.

    rendercanvas 2.7 has no drop event; the glfw window of its canvas has one.
    """
    import glfw

    window = getattr(canvas, "_window", None)
    if window is None:
        return

    # glfw passes the window and the paths; its stubs declare other arguments.
    def on_drop(_window: object, paths: Any, *_: object) -> None:
        viewer.drop([Path(path) for path in paths])
        canvas.request_draw()

    glfw.set_drop_callback(window, on_drop)


def view(
    scene: Scene | SplatData | str | Path | Sequence[str | Path],
    *,
    camera: str | None = None,
    size: tuple[int, int] = (960, 540),
    canvas: "BaseRenderCanvas | None" = None,
    stream: StreamOpener | None = None,
) -> "BaseRenderCanvas":
    """Show a scene in a notebook, or in a window of your own event loop.

    In a notebook the returned canvas is a widget: make it the last line of a cell. In a script,
    run its loop: ``from rendercanvas.auto import loop; loop.run()``.

    Args:
        scene: A scene, Gaussians, or files as ``gsgen view`` takes them.
        camera: A value of ``gsgen view --camera``.
        size: Width and height of the canvas, in pixels.
        canvas: A rendercanvas canvas; by default a widget or a window, as available.
        stream: Opens tilesets, such as ``gsgen.tiles.open_stream``.

    Returns:
        The canvas.

    Raises:
        DisplayUnavailable: Neither a notebook widget nor a window can be created.
        GsgenError: A file cannot be read, or no graphics device can be opened.
    """
    from gsgen.runtime.playback.camera_options import viewpoint
    from gsgen.runtime.playback.live_playback import LivePlayback
    from gsgen.runtime.sources.scene_source import sources_of

    window_canvas = canvas if canvas is not None else _canvas(size)
    playback = LivePlayback(sources_of(scene, stream))
    viewer = Viewer(playback, viewpoint(camera, *size), print_line=_print)
    attach(viewer, window_canvas)
    return window_canvas


def _canvas(size: tuple[int, int]) -> "BaseRenderCanvas":
    try:
        from rendercanvas.auto import RenderCanvas
    except (ImportError, RuntimeError) as error:
        raise DisplayUnavailable(
            f"no canvas can be created: {error}",
            hint="In a notebook: pip install anywidget. Elsewhere: pip install 'gsgen[runtime]'.",
        ) from error
    if RenderCanvas.__module__ == "rendercanvas.glfw":  # it would abort the process
        try:
            require_display()
        except DisplayUnavailable as error:
            hint = (
                "In a notebook: pip install anywidget. Without a screen: "
                "Renderer().render(scene, camera) returns a picture."
            )
            raise DisplayUnavailable(error.message, hint=error.hint or hint) from error
    return RenderCanvas(size=size, title="gsgen", max_fps=_MAX_FPS)


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
