"""Fetch ONNX Runtime Web into the user's cache, for tests of the browser client."""

import sys

from gsgen.contract.errors import GsgenError
from gsgen.runtime.web.onnxruntime_web import ORT_VERSION, ort_folder


def main() -> None:
    """Fetch the pinned version unless it is there, and print where it is."""
    try:
        folder = ort_folder(None)
    except GsgenError as error:
        sys.exit(f"fetch_ort: {error}")
    sys.stdout.write(f"fetch_ort: {folder}, version {ORT_VERSION}\n")


if __name__ == "__main__":
    main()
