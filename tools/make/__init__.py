"""What is made of rigs: new ones, DBC files, C, FMUs, devices."""
