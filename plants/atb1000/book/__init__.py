"""The book on the gun barrel: studies, tables, figures."""
