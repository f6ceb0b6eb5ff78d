"""What the law beside it imports."""

SCALE = 1.5
