"""What comes after a run: logs, verdict, report, replay, comparison."""
