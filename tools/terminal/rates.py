"""Rates as the command line takes them: 500k, 2kHz, 1Mbit/s."""

import argparse
import re


def bits_per_s(text: str) -> int:
    """Return the bits a second that a text such as 500k says."""
    return round(_scaled_number(text, "bit/s", "500k, 2M"))


def hz(text: str) -> float:
    """Return the frequency that a text such as 2kHz says."""
    return _scaled_number(text, "Hz", "500, 2kHz")


def frequency(text: str) -> float:
    """Return the frequency that a text such as 0.5Hz says; also below 1 Hz."""
    return _scaled_number(text, "Hz", "0.5, 20Hz", 1e-6)


def _scaled_number(text: str, unit: str, example: str, least: float = 1.0) -> float:
    """Return a number above 0 with k or M and perhaps its unit behind it."""
    found = re.fullmatch(rf"([0-9]*\.?[0-9]+) ?([kM]?)(?:{unit})?", text)
    value = float(found[1]) * {"": 1.0, "k": 1e3, "M": 1e6}[found[2]] if found else 0.0
    if not least <= value <= 1e9:
        raise argparse.ArgumentTypeError(f"expected a rate like {example}, got {text!r}")
    return value
