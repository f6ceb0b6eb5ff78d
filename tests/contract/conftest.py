"""Fixtures of the contracts."""

from refusing import refused

__all__ = ["refused"]
