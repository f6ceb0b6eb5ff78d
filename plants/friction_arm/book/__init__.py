"""The book on the arm with friction: studies, tables, figures."""
