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
        subprocess.CalledProcessError: It has warnings, which it has printed.
    """
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "--quiet"]
    words += ["--config-file", str(configuration), "--site-dir", str(folder)]
    # The theme would tell of its successor at every build.
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "true"}
    subprocess.run(words, check=True, env=environment)
    return folder
