"""The book on the telerobot: studies, tables, figures."""
