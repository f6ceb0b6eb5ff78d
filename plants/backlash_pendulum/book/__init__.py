"""The book on the pendulum with backlash: studies, tables, figures."""
