"""Buckets of times, `fine` of them to a doubling, so that a time is known to one part in `fine`.

    place of v ns    fine d + (v >> d)     d = 0 for v < 2 fine, else floor(log2(v / fine))      (1)

Below 2 fine ns a bucket is one nanosecond wide. What the doublings do not reach is in the last one.
Plain functions; `executive.loop.timing` and the player compile their own of them.
"""

OF_STAGES = (
    8,
    37,
)  # fine and doublings, of the loop: the last one is for 37 min and more


def place_of(ns: int, fine: int, doublings: int) -> int:
    """Return the place (1) of the bucket of a time."""
    d = 0
    while ns >> d >= 2 * fine and d < doublings:
        d += 1
    return fine * d + min(ns >> d, 2 * fine - 1)


def end_of(bucket: int, fine: int) -> int:
    """Return the largest whole ns of a bucket."""
    d = max(bucket // fine - 1, 0)
    return ((bucket - fine * d + 1) << d) - 1
