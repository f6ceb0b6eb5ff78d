"""While it runs: values, tuning, operation, pages, the watchdog."""

TITLE, PLACE = "during a run", 3  # in `pcpc help`
