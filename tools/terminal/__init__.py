"""What every command stands on: terminal, progress, arguments, endings."""
