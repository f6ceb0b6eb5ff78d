"""The two-link arm with dry friction in both joints."""
