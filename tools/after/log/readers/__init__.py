"""Readers of recordings that others made: each yields frames, and keeps account of all else."""
