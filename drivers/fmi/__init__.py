"""The step of an FMU (FMI 2.0 and 3.0), which the loop calls through addresses."""
