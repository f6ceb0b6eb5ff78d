"""The book on the arm with an unknown payload: studies, tables, figures."""
