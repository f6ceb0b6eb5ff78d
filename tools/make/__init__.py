"""What is made of rigs: new ones, DBC files, C, FMUs, devices."""

TITLE, PLACE = "write rigs, DBC files, C and FMUs", 6  # in `pcpc help`
