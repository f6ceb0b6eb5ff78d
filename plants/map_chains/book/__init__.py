"""The book on the chains: studies, tables, figures."""
