"""pcpc from Python, as `import pcpc` offers it: runs, live nodes, a loop of one's own."""
