"""Write the frame plans of the browser client, plans.json, from the renderer."""

from pathlib import Path

from gsgen.runtime.web import plans

_ROOT = Path(__file__).parents[1]


def main() -> None:
    """Write plans.json into its package."""
    package, _, path = plans.PLANS_FILE.partition(":")
    folder = _ROOT / "runtime" / package.replace(".", "/")
    (folder / path).write_text(plans.plans_text(), "utf-8")


if __name__ == "__main__":
    main()
