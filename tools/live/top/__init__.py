"""`pcpc top`: a running rig on one screen, renewed; reads only, and goes on with the next run."""
