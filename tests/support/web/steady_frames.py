"""Frames of an element whose camera and time move, and what they leave behind."""

from dataclasses import dataclass
from typing import Any

_SCRIPT = """async ([count, isExecuted]) => {
  const model = document.querySelector("gsgen-model");
  const device = model._shown.renderer.device;
  const made = {};
  for (const name of Object.getOwnPropertyNames(GPUDevice.prototype)) {
    if (!name.startsWith("create") || name === "createCommandEncoder") continue;
    const own = device[name].bind(device);
    device[name] = (...rest) => { made[name] = (made[name] ?? 0) + 1; return own(...rest); };
  }
  const { playback } = model._shown;
  if (!isExecuted) device.queue.submit = () => {};
  let [finished, most] = [0, 0];
  for (let frame = 1; frame <= count; frame++) {
    model._shown.orbit.orbit(0.01, 0);
    if (playback) playback.currentTime = (playback.duration * (frame % 24)) / 24;
    model._shown.isStale = true;
    await model._draw(performance.now());
    most = Math.max(most, frame - finished);
    const done = device.queue.onSubmittedWorkDone().then(() => finished++);
    if (frame % 10 === 0) await done;
  }
  await device.queue.onSubmittedWorkDone();
  for (const owner of [device, device.queue]) {
    for (const name of Object.keys(owner)) delete owner[name];
  }
  return [made, most];
}"""


@dataclass(frozen=True, kw_only=True)
class SteadyFrames:
    """What some frames left behind.

    Attributes:
        made: GPU objects that were made, by the name of the function.
        in_flight: The most frames that were submitted and not finished.
        heap_growth: Bytes by which the page's heap and its array buffers grew, WebAssembly included.
    """

    made: dict[str, int]
    in_flight: int
    heap_growth: int


def steady_frames(page: Any, count: int, *, are_executed: bool = True) -> SteadyFrames:
    """Draw frames of a page's small element, each from another camera, and at another time.

    Two frames come before, which may fill caches.

    Args:
        page: The page.
        count: The number of frames.
        are_executed: Whether the GPU executes them; a frame is encoded in any case, which is what
            takes the page's memory, and a software driver takes most of a second to execute it.
    """
    element = "document.querySelector('gsgen-model')"
    page.evaluate(f"{element}.pause()")
    page.evaluate(f"{element}.style.cssText = 'width: 64px; height: 48px; min-height: 0'; null")
    page.wait_for_function(f"{element}.camera.width === 64")
    page.evaluate(f"{element}.minRenderScale = 1")  # frames of one size, also where they are slow
    page.wait_for_timeout(500)
    page.evaluate(_SCRIPT, [2, True])
    profiler = page.context.new_cdp_session(page)
    before = _heap_bytes(profiler)
    result, in_flight = page.evaluate(_SCRIPT, [count, are_executed])
    growth = _heap_bytes(profiler) - before
    return SteadyFrames(made=result, in_flight=in_flight, heap_growth=growth)


def _heap_bytes(profiler: Any) -> int:
    profiler.send("HeapProfiler.collectGarbage")
    usage = profiler.send("Runtime.getHeapUsage")
    return int(usage["usedSize"] + usage["backingStorageSize"])
