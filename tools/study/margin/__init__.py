"""`pcpc margin`: the sampled open loop of a rig, linearised and measured, and its margins.

loops        which signals close a loop, and where its commands go
operating    the reference held, the rig with what excites it
cycle_map    one cycle of all nodes as a map of their variables, without codec and limits
linear       its derivative: a state space at the sample rate
slopes       how its differences are taken, also of what is rounded
impulse      its answer to an impulse instead, where it is another one in every cycle
measured     the answer to a multisine in virtual time, with all that a run has
margins      what a frequency response comes to
balance      harmonic balance of the closed map: limit cycles of what is not linear
limit_cycle  from a rig with play or friction to the gain at which it begins to cycle
"""
