"""What the whole numbers of a campaign may be, checked before anything is compiled (no numba)."""

from pcpc.executive.errors import RigError

MOST = 10_000_000  # draws of a campaign, and of one that ends by its statement
MOST_THREADS = 1024
LIMITS = {"draws": MOST, "worst": MOST, "rare": MOST, "threads": MOST_THREADS}


def check_whole(option: str, value: object, least: int, most: int) -> None:
    """Raise RigError for what is no whole number from `least` to `most`."""
    if type(value) is not int or not least <= value <= most:
        raise RigError(f"--{option} {value}: expected a whole number from {least} to {most}")
