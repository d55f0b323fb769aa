"""Reports of results for people.

The public API has a function of the same name. Once a module of this package has been
imported, `calib_pin.report` is the package, so it can be called like that function.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _Report(ModuleType):
    """The package, which writes a page when it is called."""

    def __call__(self, *arguments: Any, **options: Any) -> None:
        """See `report.html.report`."""
        from calib_pin.report.html import report
        from calib_pin.setup.arguments import public

        public(report)(*arguments, **options)


sys.modules[__name__].__class__ = _Report
