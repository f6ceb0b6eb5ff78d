"""Measured ratios against C and others."""
