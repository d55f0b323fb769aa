"""The smallest file that fails in the same way: delta debugging, lines then bytes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from tests.fuzz.cases import Case, Pool, fault


def reduced(case: Case, what: str, tries: int = 400) -> Case:
    """A case with as little as possible of its damaged file that breaks the same rule.

    Args:
        case: The case.
        what: The rule, as `fault` names it.
        tries: Most cases to run for it.
    """
    pool, left = Pool(), [tries]

    def fails(data: bytes) -> bool:
        left[0] -= 1
        smaller = replace(case, files={**case.files, case.file: data})
        ((_, outcome),) = pool.run([smaller])
        return fault(smaller, outcome) == what

    data = case.files[case.file]
    for split in (lambda data: data.splitlines(keepends=True), _bytes):
        parts = smallest(split(data), lambda parts: fails(b"".join(parts)), left)
        data = b"".join(parts)
    return replace(case, files={**case.files, case.file: data})


def _bytes(data: bytes) -> list[bytes]:
    return [data[k : k + 1] for k in range(len(data))]


def smallest(
    parts: Sequence[bytes],
    fails: Callable[[Sequence[bytes]], bool],
    left: list[int],
) -> Sequence[bytes]:
    """As few parts as still fail: halves are left out, then quarters, and so on.

    Args:
        parts: All of them, which fail.
        fails: Whether some do.
        left: Number of calls that are left, which `fails` counts down.
    """
    count = 2
    while len(parts) > 1 and left[0] > 0:
        size = -(-len(parts) // count)
        for start in range(0, len(parts), size):
            fewer = [*parts[:start], *parts[start + size :]]
            if left[0] > 0 and fails(fewer):
                parts, count = fewer, max(count - 1, 2)
                break
        else:
            if size == 1:
                break
            count = min(2 * count, len(parts))
    return parts
