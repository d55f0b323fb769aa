"""The site: all documents as pages that open from disk."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SITE = HERE.parents[1] / "out" / "site"


def build(folder: Path = SITE, configuration: Path = HERE / "mkdocs.yml") -> Path:
    """Build the site; a warning, such as a link that leads nowhere, is an error.

    Args:
        folder: Where to.
        configuration: File of mkdocs.

    Returns:
        The folder.

    Raises:
        RuntimeError: It has warnings: what was printed.
    """
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean"]
    words += ["--config-file", str(configuration), "--site-dir", str(folder)]
    # The theme would tell of its successor at every build.
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "true"}
    # Less talk (`--quiet`) would count no warnings.
    done = subprocess.run(
        words, check=False, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return folder
