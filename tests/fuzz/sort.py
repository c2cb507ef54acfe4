"""Sort up to four million keys of every kind on every software driver here, and say how long it took.

Run by ``make fuzz-sort``.
"""

import json
import subprocess
import sys

from support.rendering.drivers import DRIVERS, description, environment

SIZES = ("0", "1", "4097", "1000000", "4000000")


def main() -> int:
    """Return 1 if a driver sorts otherwise than NumPy does, or there is none."""
    failed, tried_count = False, 0
    for driver in DRIVERS:
        driver_info = description(driver)
        if driver_info is None:
            sys.stdout.write(f"{driver} is not installed, so it was not tried\n")
            continue
        tried_count += 1
        completed = subprocess.run(
            [sys.executable, "-P", "-m", "support.rendering.driver_report", "-", *SIZES],
            stdout=subprocess.PIPE,
            text=True,
            env=environment(driver_info),
        )
        document = json.loads(completed.stdout or "{}")
        wrong = [*document.get("unsorted", ["nothing: it stopped"]), *document.get("unscanned", ())]
        sys.stdout.write(f"{driver}: {', '.join(wrong) or 'all sorted as NumPy does'}\n")
        failed |= bool(wrong)
    return int(failed or not tried_count)


if __name__ == "__main__":
    sys.exit(main())
