"""The book on the quarter car: studies, tables, figures."""
