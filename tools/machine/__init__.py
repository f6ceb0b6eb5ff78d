"""What this machine offers: doctor, jitter, a kernel with vcan."""

TITLE, PLACE = "this machine", 7  # in `pcpc help`
