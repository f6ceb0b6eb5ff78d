"""The least rig that is whole: a first-order lag and a proportional law, to time the loop with."""
