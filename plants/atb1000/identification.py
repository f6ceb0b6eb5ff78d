"""What a log of the barrel tells of it; see plants/identification.py.

The trunnion's friction is LuGre: its static curve (Coulomb, break-away, Stribeck speed, viscous)
and its bristles. Each needs motion where it acts, and all but the play and the bristles need the
gear to be loaded.
"""

PARAMETERS = {
    "barrel.coulomb_Nm": "a move both ways, as slew10",
    "barrel.breakaway_Nm": "slow reversals, as lowspeed",
    "barrel.stribeck_rad_s": "slow motion through 0.01 rad/s, as lowspeed",
    "barrel.sig2_Nms_rad": "fast motion, as slew25",
    "barrel.hub_inertia_kg_m2": "a fast move, as slew10",
    "barrel.unbalance_Nm": "a move both ways, as slew10",
    "barrel.gap_rad": "a torque that changes its sign, as slew10",
}
