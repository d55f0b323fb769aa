"""Callbacks that report the progress of long work."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]
"""Called with the completed fraction, 0 to 1."""

Stages = Callable[[str, float], None]
"""Called with the stage and its completed fraction, 0 to 1."""


def named(progress: Stages | None, stage: str) -> Progress | None:
    """Progress of one stage."""
    if progress is None:
        return None
    return lambda part: progress(stage, part)


def portion(progress: Progress | None, start: float, size: float) -> Progress | None:
    """Progress of a part of the work as progress of the whole."""
    if progress is None:
        return None
    furthest = 0.0

    def tell(part: float) -> None:
        # A solver may search several times.
        nonlocal furthest
        furthest = max(furthest, part)
        progress(start + size * furthest)

    tell(0.0)
    return tell
