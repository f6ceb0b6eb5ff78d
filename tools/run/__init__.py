"""From a rig to a verdict: on a bus, in virtual time, frame by frame."""

TITLE, PLACE = "runs and single nodes", 2  # in `pcpc help`
