"""What a pickle may do to whoever obeys it."""

import os
from pathlib import Path
from typing import Any


class Harmful:
    """Runs a command where a pickle reader obeys it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.path}",)
