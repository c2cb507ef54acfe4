"""Files of npm packages that web pages load: fetched once, by exact version and digest."""

__all__ = ["NpmFiles"]

import hashlib
import subprocess
import tarfile
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import final

from platformdirs import user_cache_path

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.process.drafts import temporary_folder


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NpmFiles:
    """Some files of an npm package.

    Attributes:
        title: The library's name.
        package: The package's name.
        version: The exact version, with which the browser client is tested.
        sha256: Digest of the package's archive.
        folder: The folder of the package that the files are in, such as ``dist``; "." for its own.
        names: Paths of the files in it.
        option: Option of commands that names such a folder.
    """

    title: str
    package: str
    version: str
    sha256: str
    folder: str
    names: tuple[str, ...]
    option: str

    def cached(self) -> Path:
        """Return the cache folder of the user for the downloaded files."""
        return user_cache_path("gsgen", appauthor=False) / f"{self.package}-{self.version}"

    def located(self, user_folder: Path | None) -> Path:
        """Return a folder with the files, fetching them into the cache if needed.

        Args:
            user_folder: A folder of the user, such as ``dist`` of the npm package.

        Raises:
            InputUnreadable: ``user_folder`` lacks a file.
            ConfigInvalid: The files cannot be fetched, or are others than those of the version.
        """
        if user_folder is not None:
            missing = [name for name in self.names if not (user_folder / name).is_file()]
            if missing:
                hint = f"Name the {self._folder_words()} {self.package}@{self.version}."
                raise InputUnreadable(
                    f"the folder lacks {', '.join(missing)}", where=str(user_folder), hint=hint
                )
            return user_folder
        folder = self.cached()
        if not all((folder / name).is_file() for name in self.names):
            self._fetch(folder)
        return folder

    def _folder_words(self) -> str:
        folder = "folder" if self.folder == "." else f"folder `{self.folder}`"
        return f"{folder} of the npm package"

    def _fetch(self, folder: Path) -> None:
        """Fetch the npm package, check its digest, and put the needed files into ``folder``."""
        package = f"{self.package}@{self.version}"
        hint = f"Fetch {package} yourself, and name its folder: {self.option} DIR"
        npm = which("npm")
        if npm is None:
            message = f"npm is not installed, which fetches {self.title}"
            raise ConfigInvalid(message, where=package, hint=hint)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(folder.parent) as work_folder:
            result = subprocess.run(
                [npm, "pack", "--silent", package],
                cwd=work_folder,
                capture_output=True,
                text=True,
                encoding="utf-8",
            )
            archives = list(work_folder.glob("*.tgz"))
            if result.returncode or not archives:
                lines = result.stderr.strip().splitlines() or ["npm pack failed"]
                raise ConfigInvalid(lines[-1], where=package, hint=hint)
            content = archives[0].read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            if digest != self.sha256:
                message = f"has the digest {digest}, expected {self.sha256}"
                raise ConfigInvalid(message, where=package, hint=hint)
            source = Path("package", self.folder)
            with tarfile.open(archives[0]) as archive:
                for name in self.names:
                    file = archive.extractfile((source / name).as_posix())
                    assert file is not None, f"{name} is a file in the package of this digest"
                    target = work_folder / "files" / name
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(file.read())
            for name in self.names:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (work_folder / "files" / name).replace(folder / name)
