"""What it takes to start processes and to end them in order."""
