"""What holds for every test."""

import os

os.environ["GSGEN_NO_CACHE"] = "1"  # no test keeps what it measured of a driver
