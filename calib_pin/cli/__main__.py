"""Run the command line as `python -m calib_pin.cli`."""

import sys

from calib_pin.cli import main

sys.exit(main())
