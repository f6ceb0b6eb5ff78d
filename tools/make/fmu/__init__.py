"""FMUs: `pcpc generate fmu` makes one of a plant, `pcpc check` tells of those in a rig."""
