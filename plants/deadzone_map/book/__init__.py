"""The book on the map with a deadzone: studies, tables, figures."""
