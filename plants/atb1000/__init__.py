"""A flexible gun barrel of bench size on an elevation drive; all figures are chosen."""
