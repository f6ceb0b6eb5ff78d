"""The book on the map with backlash: studies, tables, figures."""
