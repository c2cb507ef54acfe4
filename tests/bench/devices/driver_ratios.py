"""Compares frames on software drivers with another checkout, and with splat-transform's renderer.

    git worktree add --detach ../before COMMIT
    .venv/bin/python tests/bench/devices/driver_ratios.py --against ../before
    .venv/bin/python tests/bench/devices/driver_ratios.py --splat-transform node_modules/.bin/splat-transform

Figures are CPU seconds of a frame, the driver's threads included, so that other load on the machine
counts less. Processes of both sides alternate, and the least frame of each side counts.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[3]
EYE, TARGET, FOV = (-2.5, -0.5, -3.0), (1.0, 0.3, 1.0), 50.0
WARM_UP_FRAMES = 3  # frames: kernels are compiled, and rows are arranged
MORE_ROUNDS = 3  # frames of splat-transform after its first, whose process also reads and compiles
SOURCES = ("contract", "runtime", "sdk")


def write_ply(path: Path, parts: dict[str, np.ndarray]) -> None:
    """Write the Gaussians as a PLY file of 3DGS."""
    n = len(parts["center"])
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45))]
    names += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    sh = parts["color"].reshape(n, 16, 3)
    opacity = parts["opacity"]
    columns = [
        parts["center"],
        sh[:, 0],
        sh[:, 1:].transpose(0, 2, 1).reshape(n, 45),
        np.log(opacity / (1 - opacity))[:, None],
        np.log(parts["scale"]),
        parts["turn"],
    ]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [*(f"property float {name}" for name in names), "end_header", ""]
    with path.open("wb") as file:
        file.write("\n".join(header).encode())
        file.write(np.concatenate(columns, axis=1).astype("<f4").tobytes())


def frame_seconds(parts_path: str, size: str, frames: int, picture: str) -> None:
    """Draw in this process; print the CPU seconds of each frame as JSON."""
    from gsgen.contract.spec.geometry import covariance_upper
    from gsgen.runtime.renderer.renderer import Renderer
    from gsgen.runtime.scene.camera import Camera
    from gsgen.runtime.scene.scene import Scene
    from gsgen.runtime.scene.splat_data import SplatData

    parts = np.load(parts_path)
    rows = np.zeros((len(parts["center"]), 10), np.float32)
    rows[:, :3], rows[:, 3] = parts["center"], parts["opacity"]
    rows[:, 4:] = covariance_upper(parts["scale"], parts["turn"])
    width, height = map(int, size.split("x"))
    camera = Camera.look_at(EYE, TARGET, width=width, height=height, fov_y=FOV)
    renderer = Renderer(rasteriser="tiles")
    scene = Scene([SplatData(rows, parts["color"], "sh")])
    seconds = []
    for number in range(WARM_UP_FRAMES + frames):
        start_time = time.process_time()
        frame = renderer.render(scene, camera, background=(0, 0, 0, 1))
        if number >= WARM_UP_FRAMES:
            seconds.append(time.process_time() - start_time)
    if picture != "-":
        np.save(picture, frame.srgb[..., :3])
    sys.stdout.write(json.dumps({"device": renderer.device.name, "seconds": seconds}) + "\n")


def child(environment: dict[str, str], *words: str) -> dict[str, object]:
    """Run this file's worker, and return what it prints last."""
    completed = subprocess.run(
        [sys.executable, "-P", __file__, "--worker", *words],
        capture_output=True,
        text=True,
        env=environment,
    )
    if completed.returncode:
        sys.exit(completed.stderr)
    return json.loads(completed.stdout.splitlines()[-1])


def on_driver(description: Path, checkout: Path) -> dict[str, str]:
    """Return the environment of a process that draws by a checkout on a driver."""
    return os.environ | {
        "VK_DRIVER_FILES": str(description),
        "VK_ICD_FILENAMES": str(description),
        "PYTHONPATH": os.pathsep.join(str(checkout / part) for part in SOURCES),
    }


def transform_seconds(
    program: Path, description: Path, ply: Path, size: str, folder: Path
) -> tuple[float, np.ndarray]:
    """Return the CPU seconds of a further frame of splat-transform, and the picture of a frame."""
    from PIL import Image

    # It turns PLY files half a turn around z.
    eye, target = ((-x, -y, z) for x, y, z in (EYE, TARGET))
    frame = {"position": eye, "target": target, "fov": FOV, "up": [0, 1, 0]}
    durations = {}
    for frames in (1, 1, MORE_ROUNDS + 1):  # the first process compiles shaders, which Mesa stores
        track = folder / f"track_{frames}.json"
        track.write_text(json.dumps({"frameRate": 1, "frames": [frame] * frames}), "utf-8")
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [program, "-w", ply, "--camera-track", track, "--resolution", size, "--camera-near",
             "0.01", "--max-workers", "0", "--webp-effort", "0", folder / f"st{frames}.webp"],
            check=True,
            capture_output=True,
            env=on_driver(description, ROOT),
        )  # fmt: skip
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        durations[frames] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    picture = Image.open(next(iter(sorted(folder.glob("st1.*webp"))))).convert("RGB")
    return (durations[MORE_ROUNDS + 1] - durations[1]) / MORE_ROUNDS, np.asarray(picture) / 255


def compare(words: argparse.Namespace, folder: Path) -> None:
    """Print the ratios of each driver and size."""
    sys.path.insert(0, str(ROOT / "tests"))
    from support.measures import print_line
    from support.rendering.drivers import DRIVERS, description
    from support.rendering.room import room_parts

    parts = room_parts(words.gaussians)
    parts_path, ply, picture = folder / "room.npz", folder / "room.ply", folder / "picture.npy"
    np.savez(parts_path, **parts)
    if words.splat_transform:
        write_ply(ply, parts)
    checkouts = {"now": ROOT}
    if words.against:
        checkouts["before"] = words.against.resolve()
    for driver in words.drivers.split(","):
        driver_info = description(driver)
        if driver_info is None or driver not in DRIVERS:
            sys.exit(f"{driver} is not installed; `make drivers` installs it")
        for size in words.sizes.split(","):
            seconds: dict[str, list[float]] = {name: [] for name in checkouts}
            for _ in range(words.rounds):
                for name, checkout in checkouts.items():
                    message = child(
                        on_driver(driver_info, checkout), str(parts_path), size, str(words.frames),
                        str(picture) if name == "now" else "-",
                    )  # fmt: skip
                    seconds[name].append(min(message["seconds"]))  # type: ignore[type-var]
            min_costs = {name: min(values) for name, values in seconds.items()}
            text = f"{message['device']}, {words.gaussians:,} Gaussians, {size}: "
            text += ", ".join(f"{name} {value:.3f} CPU-s" for name, value in min_costs.items())
            if "before" in min_costs:
                ratios = [a / b for a, b in zip(seconds["now"], seconds["before"], strict=True)]
                text += f"; ratio {min_costs['now'] / min_costs['before']:.3f}"
                text += f" (median of rounds {statistics.median(ratios):.3f})"
            if words.splat_transform:
                other, computed = transform_seconds(
                    words.splat_transform, driver_info, ply, size, folder
                )
                error = np.square(computed - np.load(picture)).mean()
                text += f"; splat-transform {other:.2f} CPU-s, {other / min_costs['now']:.1f} times"
                text += f" ({-10 * np.log10(error):.0f} dB from it)"
            print_line(text)


def main() -> None:
    if sys.argv[1:2] == ["--worker"]:
        parts, size, frames, picture = sys.argv[2:]
        frame_seconds(parts, size, int(frames), picture)
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path, help="Another checkout of this repository.")
    parser.add_argument("--splat-transform", type=Path, help="The program, version 3.7.")
    parser.add_argument("--drivers", default="llvmpipe,SwiftShader")
    parser.add_argument("--sizes", default="640x360")
    parser.add_argument("--gaussians", type=int, default=1_000_000)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--rounds", type=int, default=3)
    with tempfile.TemporaryDirectory() as folder:
        compare(parser.parse_args(), Path(folder))


if __name__ == "__main__":
    main()
