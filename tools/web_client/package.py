"""Pack the browser client for npm, with the types of its comments (`make npm`)."""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from web_client.write import CLIENT

_ROOT: Final = Path(__file__).parents[2]
_NPM: Final = _ROOT / ".venv/npm"
_TAGS: Final = Path(__file__).with_name("tags.d.ts")
_COMPILER_OPTIONS: Final = (
    *("--allowJs", "--declaration", "--emitDeclarationOnly", "--skipLibCheck"),
    *("--target", "esnext", "--module", "esnext", "--moduleResolution", "bundler"),
)


def write_package(folder: Path) -> None:
    """Write the files of the npm package into a folder: the client as it is, types and licence.

    Raises:
        subprocess.CalledProcessError: The TypeScript compiler failed.
    """
    shutil.copytree(CLIENT, folder, ignore=shutil.ignore_patterns("ort"), dirs_exist_ok=True)
    shutil.copy(_ROOT / "LICENSE", folder)
    shutil.copy(_NPM / "fzstd-0.1.1/lib/index.d.ts", folder / "fzstd.d.ts")
    types = folder / "types"
    compiler = _NPM / "typescript-5.9.3/lib/tsc.js"
    gpu_types = _NPM / "types-0.1.74/dist/index.d.ts"
    modules = [folder / "gsgen.js", folder / "scene.js", *sorted(folder.glob("engines/*.js"))]
    inputs = [*map(str, modules), str(gpu_types)]
    command = ["node", str(compiler), *_COMPILER_OPTIONS, "--outDir", str(types), *inputs]
    subprocess.run(command, check=True)
    shutil.copy(_TAGS, types)
    entry = types / "gsgen.d.ts"
    entry.write_text(f'import "./tags.js";\n{entry.read_text("utf-8")}', "utf-8")


def pack(target: Path) -> Path:
    """Write the archive of the npm package into a folder, and return its path."""
    target.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        write_package(Path(folder))
        command = ["npm", "pack", "--silent", "--pack-destination", str(target.resolve())]
        result = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return target / result.stdout.strip()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", type=Path, help="Folder of the archive.")
    sys.stdout.write(f"{pack(parser.parse_args().target)}\n")
