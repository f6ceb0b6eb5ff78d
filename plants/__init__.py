"""Systems, one folder each, families of them, and the words that their files are written in."""
