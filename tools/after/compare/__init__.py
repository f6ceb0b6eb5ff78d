"""`pcpc compare`: what two runs, two folders of runs or two versions of the rigs differ in."""
