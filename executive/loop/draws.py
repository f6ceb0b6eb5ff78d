"""Numbers that are drawn on purpose, the same in every run of a rig and a seed.

    s' = 48271 s mod 2^31 - 1,  u = s/(2^31 - 1)            Park and Miller's generator

Each frame and each fault has a generator of its own, which begins with a hash of its name.
"""

import zlib

PRIME, FACTOR = 2**31 - 1, 48271


def first(seed: int, name: str) -> int:
    """Return the s with which a generator begins."""
    return 1 + zlib.crc32(f"{seed} {name}".encode()) % (PRIME - 1)
