"""The book on the arm with deadzones: studies, tables, figures."""
