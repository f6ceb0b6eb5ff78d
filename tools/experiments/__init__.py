"""The studies that `pcpc experiment` knows, a module each, with `run(folder, progress, jobs)`."""
