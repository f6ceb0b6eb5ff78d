"""What `pcpc fit` estimates of the cart and its pole from a log, and against what.

The model's encoders round, which has no slope: their samples are compared with the truth. A log
knows l and J only together with the masses, so they are not estimated.
"""

PARAMETERS = {
    "cart.cart_kg": "a fast move",
    "cart.pole_kg": "a fast move",
    "cart.viscous_Ns_m": "a long move at speed",
}
SENSORS = {"FB.position": "cart.position_m", "FB.angle": "cart.angle_rad"}
