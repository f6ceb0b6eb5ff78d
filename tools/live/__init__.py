"""While it runs: values, tuning, operation, pages, the watchdog."""
