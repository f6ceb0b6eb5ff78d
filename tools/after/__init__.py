"""What comes after a run: logs, verdict, report, replay, comparison."""

TITLE, PLACE = "after a run", 4  # in `pcpc help`
